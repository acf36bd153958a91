//! Rays, labels, noise and determinism of the scanner.

use super::*;
use crate::simulation::{ScanPose, Scene};

const SEED: ScanSeed = ScanSeed { seed: 3, scan: 1 };

fn world(tail: &str) -> CompiledScene {
    let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-20, 20], y_m = [-20, 20] }\n";
    CompiledScene::new(Scene::from_toml(&format!("{head}{tail}"), "test").unwrap()).unwrap()
}

/// One turn of 72 sweeps with 28 beams from -45 to 225 deg.
fn coarse() -> ScannerConfig {
    ScannerConfig { beam_step_deg: 10.0, beams: 28, sweeps: 72, ..ScannerConfig::default() }
}

fn pose(world: &CompiledScene, x: f64, y: f64, yaw: f64) -> Pose {
    world.level_scanner_pose(&ScanPose { x, y, yaw }, 1.0).unwrap()
}

fn scan(config: ScannerConfig, world: &CompiledScene, pose: &Pose, seed: ScanSeed, threads: usize) -> Vec<Point> {
    let scanner = Scanner::new(config).unwrap();
    let mut points = vec![Point::EMPTY; scanner.grid().cells()];
    scanner.scan(world, pose, seed, threads, &mut points, None).unwrap();
    points
}

fn bits(points: &[Point]) -> Vec<u8> {
    bytemuck::cast_slice(points).to_vec()
}

#[test]
fn the_default_scanner_is_the_source_s() {
    let scanner = Scanner::new(ScannerConfig::default()).unwrap();
    assert_eq!(scanner.grid(), Grid { rows: 720, cols: 541 });
    let first = scanner.ray(360, 0).unwrap();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    assert!((first - Vector3::new(half, 0.0, -half)).norm() < 1e-12, "{first}");
    let zenith = scanner.ray(5, 270).unwrap();
    assert!((zenith - Vector3::z()).norm() < 1e-12, "{zenith}");
    assert_eq!(scanner.ray(720, 0), None);
    assert_eq!(scanner.ray(0, 541), None);
}

#[test]
fn neighbouring_cells_are_neighbours_in_direction() {
    let scanner = Scanner::new(ScannerConfig::default()).unwrap();
    for sweep in (0..719).step_by(37) {
        for beam in 0..540 {
            let ray = scanner.ray(sweep, beam).unwrap();
            let step = 0.502f64.to_radians();
            assert!((ray.norm() - 1.0).abs() < 1e-12);
            assert!(ray.angle(&scanner.ray(sweep, beam + 1).unwrap()) < step);
            assert!(ray.angle(&scanner.ray(sweep + 1, beam).unwrap()) < step);
        }
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_bit_and_the_seed_does() {
    let world = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let pose = pose(&world, -9.0, -10.0, 0.3);
    let config = ScannerConfig { dropout: 0.02, ..coarse() };
    let one = bits(&scan(config.clone(), &world, &pose, SEED, 1));
    for threads in [0, 2, 3] {
        assert_eq!(one, bits(&scan(config.clone(), &world, &pose, SEED, threads)));
    }
    assert_ne!(one, bits(&scan(config.clone(), &world, &pose, ScanSeed { seed: 4, ..SEED }, 1)));
    assert_ne!(one, bits(&scan(config, &world, &pose, ScanSeed { scan: 2, ..SEED }, 1)));
}

#[test]
fn points_without_noise_lie_on_the_surface_their_label_names() {
    let tail = "terrain = { slope_x_deg = 3, margin_m = 40 }\n\
                [[box]]\nlabel = \"wall\"\nx_m = 6\ny_m = 0\nz_m = -2\nlength_m = 2\nwidth_m = 8\nheight_m = 6\n";
    let world = world(tail);
    let map_from_scanner = pose(&world, 1.0, 2.0, 0.7);
    let config = ScannerConfig { beam_step_deg: 1.0, beams: 271, sweeps: 180, ..ScannerConfig::default() };
    let scanner = Scanner::new(config.noise_free()).unwrap();
    let mut points = vec![Point::EMPTY; scanner.grid().cells()];
    let mut labels = vec![None; points.len()];
    scanner.scan(&world, &map_from_scanner, SEED, 2, &mut points, Some(&mut labels)).unwrap();
    let mut seen = [0; 2];
    for (point, label) in points.iter().zip(&labels) {
        assert_eq!(point.is_return(), label.is_some());
        let Some(label) = label else { continue };
        let p = map_from_scanner * point.position();
        let off_plane = (p.z - p.x * 3.0f64.to_radians().tan()) * 3.0f64.to_radians().cos();
        let (dx, dy, dz) = ((p.x - 6.0).abs() - 1.0, p.y.abs() - 4.0, (p.z - 1.0).abs() - 3.0);
        let off_box = dx.max(dy).max(dz);
        match label {
            Label::Ground => assert!(off_plane.abs() < 1e-3 && off_box > -1e-3, "{p}"),
            Label::Wall => assert!(off_box.abs() < 1e-3 && off_plane > -1e-3, "{p}"),
            other => panic!("there is no {other} in this scene"),
        }
        assert!(point.range() <= 50.0);
        seen[usize::from(*label == Label::Wall)] += 1;
    }
    assert!(seen[0] > 5000 && seen[1] > 500, "{seen:?}");
    let empty = points.iter().filter(|p| !p.is_return()).count();
    assert!(empty > points.len() / 3, "the sky gives no returns: {empty}");
}

#[test]
fn a_noise_free_scan_has_the_true_ranges() {
    let world = CompiledScene::new(Scene::builtin("plane").unwrap()).unwrap();
    let map_from_scanner = pose(&world, 0.0, 0.0, 0.2);
    let scanner = Scanner::new(coarse().noise_free()).unwrap();
    let points = scan(coarse().noise_free(), &world, &map_from_scanner, SEED, 1);
    for (index, point) in points.iter().enumerate() {
        let range = scanner.true_range(&world, &map_from_scanner, index / 28, index % 28);
        assert_eq!(range.is_some(), point.is_return());
        assert!(range.is_none_or(|range| (range - f64::from(point.range())).abs() < 1e-4));
    }
}

#[test]
fn noise_has_the_asked_spread_along_the_ray_and_no_bias() {
    let world = world("");
    let pose = pose(&world, 0.0, 0.0, 0.0);
    let config = ScannerConfig { noise_m: 0.02, first_beam_deg: -45.0, beam_step_deg: 1.0, beams: 30, ..coarse() };
    let truth = scan(config.noise_free(), &world, &pose, SEED, 1);
    let noisy = scan(config, &world, &pose, SEED, 1);
    let errors: Vec<_> = truth.iter().zip(&noisy).map(|(t, n)| f64::from(n.range() - t.range())).collect();
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let sigma = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt();
    assert!(mean.abs() < 4.0 * 0.02 / n.sqrt(), "{mean}");
    assert!((sigma - 0.02).abs() < 0.0015, "{sigma}");
    assert!(truth.iter().zip(&noisy).all(|(t, n)| t.vector().normalize().dot(&n.vector().normalize()) > 0.999_999));
}

#[test]
fn grass_ends_rays_at_heights_up_to_its_own_and_leaves_walls_alone() {
    let tail = "terrain = { grass_m = 0.08, margin_m = 30 }\n\
                [[wall]]\nfrom_m = [5, -9]\nto_m = [5, 9]\nheight_m = 3\nthickness_m = 0.4\n";
    let world = world(tail);
    let config = ScannerConfig { beam_step_deg: 1.0, beams: 60, ..coarse() }.noise_free();
    let points = scan(config, &world, &pose(&world, 0.0, 0.0, 0.0), SEED, 2);
    let returns: Vec<_> = points.iter().filter(|p| p.is_return()).collect();
    let (wall, ground): (Vec<&Point>, Vec<&Point>) = returns.into_iter().partition(|p| (p.x - 4.8).abs() < 1e-3);
    assert!(wall.len() > 100);
    let heights: Vec<_> = ground.iter().filter(|p| p.x < 4.8).map(|p| p.z + 1.0).collect();
    assert!(heights.iter().all(|z| (-1e-4..0.0801).contains(z)));
    let mean = heights.iter().sum::<f32>() / heights.len() as f32;
    assert!((mean - 0.04).abs() < 0.003, "{mean}");
}

#[test]
fn dropouts_empty_the_asked_share_of_cells() {
    let world = world("");
    let pose = pose(&world, 0.0, 0.0, 0.0);
    let config = ScannerConfig { first_beam_deg: -45.0, beam_step_deg: 1.0, beams: 30, ..coarse() };
    let lost = scan(ScannerConfig { dropout: 0.25, ..config.clone() }, &world, &pose, SEED, 1);
    let share = lost.iter().filter(|p| !p.is_return()).count() as f64 / lost.len() as f64;
    assert!((share - 0.25).abs() < 0.04, "{share}");
    assert!(scan(ScannerConfig { dropout: 1.0, ..config }, &world, &pose, SEED, 1).iter().all(|p| !p.is_return()));
}

#[test]
fn nothing_outside_the_ranges_gives_a_return() {
    let world = world("terrain = { margin_m = 100 }\n");
    let pose = pose(&world, 0.0, 0.0, 0.0);
    let config =
        ScannerConfig { range_min_m: 2.0, range_max_m: 12.0, noise_m: 0.5, beam_step_deg: 0.5, beams: 90, ..coarse() };
    let points = scan(config, &world, &pose, SEED, 1);
    let returns: Vec<_> = points.iter().filter(|p| p.is_return()).map(Point::range).collect();
    assert!(!returns.is_empty() && returns.len() < points.len());
    assert!(returns.iter().all(|range| (1.9999..12.0001).contains(range)));
}

#[test]
fn time_runs_from_the_first_beam_to_the_last() {
    let world = world("[[sphere]]\nlabel = \"other\"\nx_m = 0\ny_m = 0\nz_m = -9\nradius_m = 10\n");
    // The scanner stands within a closed sphere, so every beam returns.
    let points = scan(coarse(), &world, &pose(&world, 0.0, 0.0, 0.0), SEED, 1);
    assert!(points.iter().all(Point::is_return));
    assert_eq!(points[0].time, 0);
    assert_eq!(points[points.len() - 1].time, 65535);
    assert!(points.windows(2).all(|pair| pair[0].time < pair[1].time));
}

#[test]
fn slices_of_the_wrong_length_are_refused() {
    let world = world("");
    let scanner = Scanner::new(coarse()).unwrap();
    let pose = pose(&world, 0.0, 0.0, 0.0);
    let mut points = vec![Point::EMPTY; 28 * 72];
    let short = scanner.scan(&world, &pose, SEED, 1, &mut points[1..], None);
    assert_eq!(short, Err(ScanError::WrongPoints { cells: 2016, given: 2015 }));
    let labels = scanner.scan(&world, &pose, SEED, 1, &mut points, Some(&mut [None; 5]));
    assert_eq!(labels, Err(ScanError::WrongLabels { cells: 2016, given: 5 }));
}

#[test]
fn a_field_out_of_range_is_named_with_its_range() {
    let message = |config: ScannerConfig| config.validate().unwrap_err().to_string();
    let text = message(ScannerConfig { dropout: 1.5, ..coarse() });
    assert_eq!(text, "scanner.dropout = 1.5 is out of range: must lie in 0 ..= 1");
    assert!(message(ScannerConfig { noise_m: f64::NAN, ..coarse() }).contains("noise_m"));
    assert!(message(ScannerConfig { beams: 40, ..coarse() }).contains("the fan"));
    assert!(message(ScannerConfig { range_max_m: 0.05, ..coarse() }).contains("range_max_m"));
}

#[test]
fn a_config_is_written_as_toml_and_read_back() {
    let text = toml::to_string(&coarse()).unwrap();
    assert_eq!(toml::from_str::<ScannerConfig>(&text).unwrap(), coarse());
    assert!(toml::from_str::<ScannerConfig>("beems = 3").is_err());
}

#[test]
fn dark_and_grazing_surfaces_give_fewer_returns() {
    let wall = |colour: u8| {
        format!(
            "[[wall]]\nfrom_m = [12, -9]\nto_m = [12, 9]\nheight_m = 6\nthickness_m = 0.4\ncolour = [{colour}, {colour}, {colour}]\n"
        )
    };
    let config = ScannerConfig { beam_step_deg: 1.0, beams: 60, ..ScannerConfig::lms111() };
    let config = ScannerConfig { divergence_deg: 0.0, ..config };
    let on_wall = |colour| {
        let world = world(&wall(colour));
        let points = scan(config.clone(), &world, &pose(&world, 0.0, 0.0, 0.0), SEED, 2);
        points.iter().filter(|p| p.is_return() && (p.x - 11.8).abs() < 0.1).copied().collect::<Vec<_>>()
    };
    let (bright, dark) = (on_wall(230), on_wall(6));
    assert!(dark.len() * 3 < bright.len(), "{} {}", dark.len(), bright.len());
    assert!(bright.iter().all(|p| p.intensity > 1000), "{:?}", bright[0]);
    // Open ground: all returns near, hardly any where the beams graze.
    let world = world("terrain = { margin_m = 60 }\n");
    let points = scan(config.clone(), &world, &pose(&world, 0.0, 0.0, 0.0), SEED, 2);
    let share = |low: f64, high: f64| {
        let ideal = scan(config.noise_free(), &world, &pose(&world, 0.0, 0.0, 0.0), SEED, 2);
        let inside = |p: &Point| (low..high).contains(&f64::from(p.range()));
        let seen = ideal.iter().zip(&points).filter(|(i, p)| inside(i) && p.is_return()).count();
        seen as f64 / ideal.iter().filter(|p| inside(p)).count() as f64
    };
    assert!(share(1.0, 5.0) > 0.99 && share(25.0, 50.0) < 0.1, "{} {}", share(1.0, 5.0), share(25.0, 50.0));
}

#[test]
fn at_edges_ranges_mix_and_elsewhere_they_do_not() {
    // A post 0.5 m before a wall: nearer than the pulse is long.
    let tail = "[[box]]\nlabel = \"other\"\nx_m = 5\ny_m = 0\nlength_m = 0.4\nwidth_m = 0.5\nheight_m = 3\n\
                [[wall]]\nfrom_m = [5.5, -9]\nto_m = [5.5, 9]\nheight_m = 3\nthickness_m = 0.4\n";
    let world = world(tail);
    let at = pose(&world, 0.0, 0.0, 0.0);
    let ideal = ScannerConfig { first_beam_deg: -10.0, beams: 41, ..ScannerConfig::default() }.noise_free();
    let wide = ScannerConfig { divergence_deg: 0.86, ..ideal.clone() };
    let (ideal, wide) = (scan(ideal, &world, &at, SEED, 1), scan(wide.clone(), &world, &at, SEED, 2));
    let between = |points: &[Point]| {
        points.iter().filter(|p| p.is_return() && (4.85..5.25).contains(&p.x) && p.y.abs() < 0.4).count()
    };
    assert_eq!(between(&ideal), 0);
    assert!(between(&wide) > 20, "{}", between(&wide));
    let changed = ideal.iter().zip(&wide).filter(|(a, b)| (a.range() - b.range()).abs() > 1e-6).count();
    assert!(changed * 20 < ideal.len(), "{changed} of {}", ideal.len());
}

#[test]
fn mixed_ranges_do_not_depend_on_the_number_of_threads() {
    let world = CompiledScene::new(Scene::builtin("structured").unwrap()).unwrap();
    let config = ScannerConfig { beam_step_deg: 2.0, beams: 136, sweeps: 180, ..ScannerConfig::lms111() };
    let at = pose(&world, -34.0, 0.5, 0.0);
    assert_eq!(bits(&scan(config.clone(), &world, &at, SEED, 1)), bits(&scan(config, &world, &at, SEED, 3)));
}

#[test]
fn the_range_of_the_ground_is_where_half_of_the_returns_of_middling_ground_are_lost() {
    let world = world("ground_colour = [76, 76, 76]\n[terrain]\nmargin_m = 20\n");
    let config = ScannerConfig { divergence_deg: 0.0, ..ScannerConfig::lms111() };
    let range = config.ground_range_m();
    assert!((range - 9.9).abs() < 0.1, "{range}");
    let points = scan(config.clone(), &world, &pose(&world, 0.0, 0.0, 0.0), SEED, 2);
    let ideal = scan(config.noise_free(), &world, &pose(&world, 0.0, 0.0, 0.0), SEED, 2);
    // Of the beams that meet the ground at so many times the range, the share that returns.
    let share = |from: f64, to: f64| {
        let meets = ideal.iter().zip(&points).filter(|(ideal, _)| {
            let at = f64::from(ideal.x).hypot(f64::from(ideal.y)).hypot(f64::from(ideal.z)) / range;
            ideal.is_return() && (from..to).contains(&at)
        });
        let (all, seen) = meets.fold((0, 0), |(all, seen), (_, p)| (all + 1, seen + usize::from(p.is_return())));
        assert!(all > 500, "{all}");
        f64::from(seen as u32) / f64::from(all)
    };
    let (near, at, far) = (share(0.5, 0.75), share(0.93, 1.07), share(1.35, 1.8));
    assert!(near > 0.95 && (0.3..0.7).contains(&at) && far < 0.1, "{near} {at} {far}");
    assert_eq!(ScannerConfig::default().ground_range_m(), ScannerConfig::default().range_max_m);
}
