//! Whole scans scored: analytic ones, random ones and recorded ones.

use nalgebra::Vector3;
use proptest::prelude::*;

use super::super::obstacle::step_score;
use super::*;
use crate::surface::test_scans::{Shape, TestScan, ground, handheld_recording, pitching, pitching_recording, turning};
use crate::surface::{SurfaceBuilder, SurfaceConfig};

fn at_height(scanner_height_m: f64) -> GroundHeight {
    GroundHeight { scanner_height_m, origin: GroundHeightOrigin::Configured }
}

fn score_with(scan: ScanView<'_>, ground: GroundHeight, config: &ScoreConfig) -> (Vec<PointScore>, ScoreSummary) {
    let mut builder = SurfaceBuilder::new();
    let surface = builder.build(scan, &SurfaceConfig { threads: config.threads, ..SurfaceConfig::default() }).unwrap();
    let mut out = vec![PointScore::NONE; scan.points.len()];
    let level = UnitQuaternion::identity();
    let summary = Scorer::new().score(scan, surface, &level, ground, config, &mut out).unwrap();
    (out, summary)
}

fn score(scan: &TestScan) -> Vec<PointScore> {
    score_with(scan.view(), at_height(1.0), &ScoreConfig::default()).0
}

/// Mean F, mean B and the share of points with F over u_F and B over u_B, over the scored points that are wanted.
fn means(scan: &TestScan, scores: &[PointScore], wanted: impl Fn(&Point) -> bool) -> [f32; 4] {
    let mut sums = [0.0f32; 4];
    let mut count = 0.0f32;
    for (point, score) in scan.points.iter().zip(scores) {
        if score.is_reachable() && wanted(point) {
            let (f, b) = (PointScore::dequantise(score.navigable), PointScore::dequantise(score.obstacle));
            for (sum, value) in sums.iter_mut().zip([f, b, f32::from(f > 0.65), f32::from(b > 0.83)]) {
                *sum += value;
            }
            count += 1.0;
        }
    }
    assert!(count > 50.0, "only {count} points to judge by");
    sums.map(|s| s / count)
}

#[test]
fn flat_ground_is_navigable_and_no_obstacle() {
    for scan in [turning(&[ground(1.0)], 0.5, 10.0, 0.01, 21), pitching(&[ground(1.0)], 0.5, 10.0, 0.01, 21)] {
        let scores = score(&scan);
        let [f, b, over_f, over_b] = means(&scan, &scores, |p| p.x.hypot(p.y) < 20.0 && p.y.abs() <= p.x.abs());
        assert!(f > 0.95 && b < 0.03 && over_f > 0.999 && over_b == 0.0, "{f} {b} {over_f} {over_b}");
    }
}

#[test]
fn a_wall_is_an_obstacle_at_every_incidence() {
    for distance in [3.0, 6.0] {
        for incidence_deg in [0.0f64, 30.0, 45.0, 60.0, 75.0] {
            let (sin, cos) = incidence_deg.to_radians().sin_cos();
            let normal = Vector3::new(cos, sin, 0.0);
            let wall = Shape::Plane { normal, offset: distance * cos };
            let scan = turning(&[ground(1.0), wall], 0.5, 10.0, 0.01, 22);
            let scores = score(&scan);
            // The wall around the ray straight ahead, off its foot and below the robot's height.
            let on_wall = |p: &Point| p.y.abs() < 0.5 && p.x > 1.0 && (-0.8..-0.1).contains(&p.z);
            let [f, b, _, over_b] = means(&scan, &scores, on_wall);
            assert!(b > 0.9 && over_b > 0.95 && f < 0.1, "{distance} m, {incidence_deg} deg: {b} {over_b} {f}");
        }
    }
}

#[test]
fn the_literal_form_misses_the_wall_that_the_calibrated_one_sees() {
    let normal = Vector3::new(0.5, 0.75f64.sqrt(), 0.0);
    let scan = turning(&[ground(1.0), Shape::Plane { normal, offset: 3.0 }], 0.5, 10.0, 0.01, 23);
    let literal = ScoreConfig { obstacle_form: ObstacleForm::Literal, ..ScoreConfig::default() };
    let (scores, _) = score_with(scan.view(), at_height(1.0), &literal);
    let on_wall = |p: &Point| p.y.abs() < 0.5 && p.x > 1.0 && (-0.8..-0.1).contains(&p.z);
    let [_, _, _, over_b] = means(&scan, &scores, on_wall);
    assert!(over_b < 0.1, "{over_b}");
}

#[test]
fn a_slope_of_15_deg_is_navigable_for_a_theta_of_30_deg_but_not_of_15() {
    let (sin, cos) = 15f64.to_radians().sin_cos();
    let slope = Shape::Plane { normal: Vector3::new(-sin, 0.0, cos), offset: -cos };
    let scan = turning(&[slope], 0.5, 40.0, 0.01, 24);
    for (theta_deg, share) in [(30.0, 0.998), (15.0, 0.0)] {
        let config = ScoreConfig { theta_deg, ..ScoreConfig::default() };
        let (scores, _) = score_with(scan.view(), at_height(1.0), &config);
        let along = |p: &Point| p.x.abs() > 2.0 * p.y.abs() && p.x.abs() < 15.0;
        let [_, _, over_f, over_b] = means(&scan, &scores, along);
        assert!(if share > 0.0 { over_f > share } else { over_f < 0.01 }, "theta {theta_deg}: {over_f}");
        assert_eq!(over_b, 0.0);
    }
}

#[test]
fn points_out_of_reach_keep_their_quality_and_are_not_scored() {
    let wall = Shape::Plane { normal: Vector3::x(), offset: 4.0 };
    let scan = turning(&[ground(1.0), wall], 0.5, 60.0, 0.0, 25);
    let scores = score(&scan);
    let (mut high, mut over_robot) = (0, 0);
    for (point, score) in scan.points.iter().zip(&scores).filter(|(_, s)| s.is_valid()) {
        let (height, distance) = (point.z + 1.0, point.x.hypot(point.y));
        let robot_height = ScoreConfig::default().robot_height_m as f32;
        assert_eq!(score.is_reachable(), within_reach(height, distance, 20f32.to_radians().tan(), robot_height));
        if !score.is_reachable() {
            assert!(score.navigable == 0 && score.obstacle == 0 && score.quality > 0);
            high += 1;
        }
        // B_l is 0 over the robot; only the points next to its height take some from their neighbours. (Cells grow with
        // distance, so only the near part of the wall is judged.)
        if score.is_reachable() && height > robot_height + 0.2 && distance < 6.0 {
            assert_eq!(score.obstacle, 0);
            over_robot += 1;
        }
    }
    assert!(high > 100 && over_robot > 100);
}

#[test]
fn a_tilted_scan_is_scored_in_the_level_frame() {
    let tilt = UnitQuaternion::from_euler_angles(0.2, -0.3, 1.0);
    let down = tilt.inverse() * Vector3::z();
    let scan = turning(&[Shape::Plane { normal: down, offset: -1.0 }], 1.0, 20.0, 0.0, 26);
    let mut builder = SurfaceBuilder::new();
    let surface = builder.build(scan.view(), &SurfaceConfig::default()).unwrap();
    let mut out = vec![PointScore::NONE; scan.points.len()];
    let config = ScoreConfig::default();
    Scorer::new().score(scan.view(), surface, &tilt, at_height(1.0), &config, &mut out).unwrap();
    let [f, b, over_f, _] = means(&scan, &out, |p| p.vector().norm() < 8.0);
    assert!(f > 0.97 && b < 0.02 && over_f == 1.0, "{f} {b} {over_f}");
}

#[test]
fn a_scanner_that_leans_by_45_deg_or_hangs_upside_down_sees_the_same_ground_once_levelled() {
    for angle in [45f64, 180.0] {
        let tilt = UnitQuaternion::from_euler_angles(angle.to_radians(), 0.0, 0.0);
        let down = tilt.inverse() * Vector3::z();
        let scan = turning(&[Shape::Plane { normal: down, offset: -1.0 }], 1.0, 80.0, 0.0, 28);
        let mut builder = SurfaceBuilder::new();
        let surface = builder.build(scan.view(), &SurfaceConfig::default()).unwrap();
        let config = ScoreConfig::default();
        let ground = GroundHeight::resolve(&config, scan.view(), surface, &tilt);
        assert!(ground.origin == GroundHeightOrigin::Estimated && (ground.scanner_height_m - 1.0).abs() < 0.02);
        let mut out = vec![PointScore::NONE; scan.points.len()];
        Scorer::new().score(scan.view(), surface, &tilt, ground, &config, &mut out).unwrap();
        let [f, b, over_f, over_b] = means(&scan, &out, |p| p.vector().norm() < 8.0);
        assert!(f > 0.95 && b < 0.05 && over_f > 0.99 && over_b == 0.0, "{angle} deg: {f} {b} {over_f} {over_b}");
    }
}

#[test]
fn a_scan_upside_down_whose_alignment_does_not_know_is_nowhere_navigable() {
    let ceiling = Shape::Plane { normal: Vector3::z(), offset: 1.0 };
    let scan = turning(&[ceiling], 1.0, 80.0, 0.0, 29);
    let mut builder = SurfaceBuilder::new();
    let surface = builder.build(scan.view(), &SurfaceConfig::default()).unwrap();
    let (config, level) = (ScoreConfig::default(), UnitQuaternion::identity());
    let ground = GroundHeight::resolve(&config, scan.view(), surface, &level);
    assert_eq!(ground.origin, GroundHeightOrigin::Assumed);
    let mut out = vec![PointScore::NONE; scan.points.len()];
    let summary = Scorer::new().score(scan.view(), surface, &level, ground, &config, &mut out).unwrap();
    assert!(summary.valid > 1000);
    assert!(out.iter().all(|s| PointScore::dequantise(s.navigable) < 0.01 && s.obstacle < 6554));
}

#[test]
fn a_scan_without_returns_has_no_scores() {
    let points = vec![Point::EMPTY; 60 * 40];
    for scan in [ScanView::ordered(&points, Grid { rows: 60, cols: 40 }).unwrap(), ScanView::unordered(&points)] {
        let (out, summary) = score_with(scan, at_height(1.0), &ScoreConfig { threads: 2, ..ScoreConfig::default() });
        assert!(out.iter().all(|s| *s == PointScore::NONE));
        assert_eq!((summary.valid, summary.reachable, summary.mean_quality), (0, 0, 0.0));
    }
}

/// F and B of every point by the formulas, neighbour by neighbour.
fn by_the_formulas(scan: ScanView<'_>, surface: &Surface, config: &ScoreConfig) -> Vec<[f32; 2]> {
    let rule = Rule::new(&UnitQuaternion::identity(), at_height(1.0), config);
    let shapes = surface.points();
    let own: Vec<Own> = scan
        .points
        .iter()
        .zip(shapes)
        .map(|(point, shape)| rule.own([point.x, point.y, point.z], shape.normal, shape.incidence))
        .collect();
    let Grid { rows, cols } = scan.grid.unwrap();
    let linked = |index: usize| {
        let mut all = Vec::new();
        surface.for_each_neighbour(index, |n| all.push(n));
        let (row, col) = (index / cols, index % cols);
        let at = |row: usize, col: usize| Some(row % rows * cols + col % cols).filter(|n| all.contains(n));
        let line = [at(row, col + cols - 1), at(row, col + 1)];
        let column = [at(row + rows - 1, col), at(row + 1, col)];
        (all, [line, column])
    };
    let steps = config.obstacle_form == ObstacleForm::Stepped;
    let obstacle: Vec<f32> = (0..own.len())
        .map(|index| {
            let (_, pairs) = linked(index);
            let legs = pairs.into_iter().flatten().flatten().filter(|_| steps && own[index].state & LOW != 0);
            let step = |n: usize| step_score([0, 1, 2].map(|axis| own[n].level[axis] - own[index].level[axis]));
            legs.map(step).fold(own[index].obstacle, f32::max)
        })
        .collect();
    (0..own.len())
        .map(|index| {
            let (all, pairs) = linked(index);
            let share = 1.0 / all.len().max(1) as f32;
            let f: f32 = all.iter().map(|n| own[*n].navigable).sum();
            let b: f32 = all.iter().map(|n| obstacle[*n]).sum();
            let pair = |[one, other]: [Option<usize>; 2]| {
                one.zip(other).filter(|_| steps).map_or(0.0, |(one, other)| obstacle[one].min(obstacle[other]))
            };
            let around = pairs.map(pair).into_iter().fold(b * share, f32::max);
            let both = rule.combine([own[index].navigable, obstacle[index]], [f * share, around]);
            both.map(|score| if own[index].state & REACHABLE != 0 { score } else { 0.0 })
        })
        .collect()
}

fn follows_the_formulas(scan: ScanView<'_>, config: &ScoreConfig) {
    let mut builder = SurfaceBuilder::new();
    let surface = builder.build(scan, &SurfaceConfig::default()).unwrap();
    let (scores, _) = score_with(scan, at_height(1.0), config);
    for (index, (record, [f, b])) in scores.iter().zip(by_the_formulas(scan, surface, config)).enumerate() {
        let found = [record.navigable, record.obstacle].map(PointScore::dequantise);
        assert!((found[0] - f).abs() < 2e-5 && (found[1] - b).abs() < 2e-5, "{index}: {found:?} {f} {b}");
    }
}

/// The same scan with lines and columns exchanged.
fn transposed(scan: &TestScan) -> (Vec<Point>, Grid) {
    let Grid { rows, cols } = scan.view().grid.unwrap();
    let points = (0..rows * cols).map(|k| scan.points[k % rows * cols + k / rows]).collect();
    (points, Grid { rows: cols, cols: rows })
}

#[test]
fn neighbours_count_alike_in_the_middle_of_a_grid_at_its_edges_and_over_its_seam() {
    let wall = Shape::Plane { normal: Vector3::x(), offset: 6.0 };
    let kerb = Shape::Block { from: Vector3::new(-9.0, 3.0, -1.0), to: Vector3::new(9.0, 3.6, -0.85) };
    let scan = turning(&[ground(1.0), wall, kerb], 1.5, 30.0, 0.01, 30);
    let (points, grid) = transposed(&scan);
    for obstacle_form in [ObstacleForm::Stepped, ObstacleForm::Calibrated, ObstacleForm::Literal] {
        let config = ScoreConfig { obstacle_form, ..ScoreConfig::default() };
        follows_the_formulas(scan.view(), &config);
        follows_the_formulas(ScanView::ordered(&points, grid).unwrap(), &config);
    }
}

#[test]
fn a_kerb_that_the_means_lose_beside_the_ground_is_found_by_its_steps() {
    let kerb = Shape::Block { from: Vector3::new(6.0, -4.0, -1.0), to: Vector3::new(7.5, 4.0, -0.85) };
    let scan = turning(&[ground(1.0), kerb], 0.5, 10.0, 0.01, 31);
    let on_face = |p: &Point| (p.x - 6.0).abs() < 0.05 && p.y.abs() < 3.5 && (-0.97..-0.86).contains(&p.z);
    let found = |obstacle_form| {
        let (scores, _) = score_with(scan.view(), at_height(1.0), &ScoreConfig { obstacle_form, ..Default::default() });
        means(&scan, &scores, on_face)[3]
    };
    let (stepped, calibrated) = (found(ObstacleForm::Stepped), found(ObstacleForm::Calibrated));
    assert!(stepped > 0.75 && calibrated < 0.1, "{stepped} {calibrated}");
}

#[test]
fn a_bank_of_45_deg_is_no_obstacle_by_its_steps() {
    let (sin, cos) = 45f64.to_radians().sin_cos();
    let bank = Shape::Plane { normal: Vector3::new(-sin, 0.0, cos), offset: -4.0 * sin - cos };
    let scan = turning(&[ground(1.0), bank], 0.5, 40.0, 0.01, 32);
    let (scores, _) = score_with(scan.view(), at_height(1.0), &ScoreConfig { theta_deg: 30.0, ..Default::default() });
    let [_, b, _, over_b] = means(&scan, &scores, |p| p.x > 4.1 && p.z < 0.0 && p.y.abs() < 3.0);
    assert!(over_b == 0.0 && b > 0.3, "{b} {over_b}");
}

#[test]
fn quality_falls_below_one_half_at_four_metres_of_ground() {
    let scan = turning(&[ground(1.0)], 0.5, 0.0, 0.0, 27);
    let scores = score(&scan);
    let mean = |from: f32, to: f32| {
        let ring: Vec<f32> = scan
            .points
            .iter()
            .zip(&scores)
            .filter(|(p, s)| s.is_valid() && (from..to).contains(&p.x.hypot(p.y)))
            .map(|(_, s)| PointScore::dequantise(s.quality))
            .collect();
        ring.iter().sum::<f32>() / ring.len() as f32
    };
    // The calibrated values at 2, 3, 4, 5 and 8 m.
    for (d, quality) in [(2.0, 1.0), (3.0, 0.98), (4.0, 0.51), (5.0, 0.25), (8.0, 0.07)] {
        let found = mean(d - 0.15, d + 0.15);
        assert!((found - quality).abs() < 0.06, "{d} m: {found} instead of {quality}");
    }
}

#[test]
fn records_of_another_length_are_refused() {
    let points = [Point::EMPTY; 3];
    let scan = ScanView::unordered(&points);
    let mut builder = SurfaceBuilder::new();
    let surface = builder.build(scan, &SurfaceConfig::default()).unwrap();
    let mut out = [PointScore::NONE; 2];
    let level = UnitQuaternion::identity();
    let error = Scorer::new().score(scan, surface, &level, at_height(1.0), &ScoreConfig::default(), &mut out);
    assert_eq!(error, Err(ScoreError::LengthMismatch { scan: 3, surface: 3, out: 2 }));
}

fn is_consistent(scan: ScanView<'_>, scores: &[PointScore]) -> bool {
    scan.points.iter().zip(scores).all(|(point, score)| {
        let kept = (0..4).filter(|k| score.keeps_triangle_without(*k)).count();
        let unit = (score.normal().norm() - 1.0).abs() < 0.01;
        kept <= 2
            && (!score.is_valid() || (unit && point.is_return() && score.area.is_finite()))
            && (score.is_reachable() || (score.navigable == 0 && score.obstacle == 0))
    })
}

proptest! {
    #[test]
    fn any_grid_is_scored_consistently_and_the_same_by_any_number_of_threads(
        cells in prop::collection::vec((0..8u8, prop::array::uniform3(-3.0..3.0f32)), 1200), rows in 20..60usize,
    ) {
        let points: Vec<Point> = cells.iter().enumerate().map(|(i, (kind, p))| match kind {
            0 => Point::EMPTY,
            1 => Point::new(p[0], p[1], p[2]),
            _ => Point::new(2.0 + 0.02 * p[0], 0.03 * (i % 40) as f32 - 0.6, 0.03 * (i / 40) as f32 - 1.0),
        }).collect();
        let cols = 1200 / rows;
        let scan = ScanView::ordered(&points[..rows * cols], Grid { rows, cols }).unwrap();
        let (one, _) = score_with(scan, at_height(1.0), &ScoreConfig::default());
        prop_assert!(is_consistent(scan, &one));
        for threads in [2, 3] {
            let (other, _) = score_with(scan, at_height(1.0), &ScoreConfig { threads, ..ScoreConfig::default() });
            prop_assert_eq!(&one, &other);
        }
        let cloud = ScanView::unordered(scan.points);
        let (one, _) = score_with(cloud, at_height(1.0), &ScoreConfig::default());
        let (two, _) = score_with(cloud, at_height(1.0), &ScoreConfig { threads: 2, ..ScoreConfig::default() });
        prop_assert!(is_consistent(cloud, &one));
        prop_assert_eq!(&one, &two);
    }
}

#[test]
fn recorded_scans_are_scored_with_some_ground_and_some_obstacles() {
    let name = "recorded_scans_are_scored_with_some_ground_and_some_obstacles";
    let ordered = pitching_recording(name);
    let cloud = handheld_recording(name);
    let views = [ordered.as_ref().map(TestScan::view), cloud.as_deref().map(ScanView::unordered)];
    for scan in views.into_iter().flatten() {
        let mut builder = SurfaceBuilder::new();
        let surface = builder.build(scan, &SurfaceConfig::default()).unwrap();
        let (config, level) = (ScoreConfig::default(), UnitQuaternion::identity());
        let ground = GroundHeight::resolve(&config, scan, surface, &level);
        assert_eq!(ground.origin, GroundHeightOrigin::Estimated);
        let mut out = vec![PointScore::NONE; scan.points.len()];
        let summary = Scorer::new().score(scan, surface, &level, ground, &config, &mut out).unwrap();
        assert!(is_consistent(scan, &out));
        let share =
            |wanted: fn(&PointScore) -> bool| out.iter().filter(|s| wanted(s)).count() as f64 / summary.valid as f64;
        let navigable = share(|s| PointScore::dequantise(s.navigable) > 0.65);
        let obstacle = share(|s| PointScore::dequantise(s.obstacle) > 0.83);
        println!("{summary:?}: navigable {navigable:.3}, obstacle {obstacle:.3}");
        assert!(navigable > 0.02 && obstacle > 0.02);
    }
}
