//! The built-in scenes keep what the demo and the tests of scores rely on.

use super::{
    CellKind, CompiledScene, ReachConfig, ReachableCells, ScanPose, ScanSeed, Scanner, ScannerConfig, Scene,
    reachable_cells,
};
use crate::scan::Point;

const SEED: ScanSeed = ScanSeed { seed: 1, scan: 0 };

/// A scan every 2 deg, noise free, as points of the map.
fn scan_in_map(world: &CompiledScene, pose: &ScanPose) -> Vec<nalgebra::Point3<f64>> {
    let config = ScannerConfig { beam_step_deg: 2.0, beams: 136, sweeps: 180, ..ScannerConfig::default() };
    let scanner = Scanner::new(config.noise_free()).unwrap();
    let map_from_scanner = world.level_scanner_pose(pose, 1.0).unwrap();
    let mut points = vec![Point::EMPTY; scanner.grid().cells()];
    scanner.scan(world, &map_from_scanner, SEED, 2, &mut points, None).unwrap();
    points.iter().filter(|p| p.is_return()).map(|p| map_from_scanner * p.position()).collect()
}

/// Whether the straight line from a scanner to a point of the map meets nothing before it.
fn sees(world: &CompiledScene, from: &ScanPose, to: &nalgebra::Point3<f64>) -> bool {
    let origin = nalgebra::Point3::from(world.level_scanner_pose(from, 1.0).unwrap().translation.vector);
    let line = to - origin;
    world.cast(&origin, &line.normalize(), 50.0).is_some_and(|hit| (hit.range - line.norm()).abs() < 0.02)
}

#[test]
fn the_tours_of_the_builtin_scenes_stand_on_free_ground() {
    for name in Scene::builtin_names() {
        let world = CompiledScene::new(Scene::builtin(name).unwrap()).unwrap();
        let scene = world.scene();
        let cells = reachable_cells(&world, &ReachConfig::default(), &scene.start).unwrap();
        for pose in &scene.poses {
            assert!(cells.contains(pose.x, pose.y), "{name}: {pose:?}");
        }
    }
}

#[test]
fn the_simple_tour_has_eight_poses_six_to_twelve_metres_apart() {
    let scene = Scene::builtin("simple").unwrap();
    assert_eq!(scene.poses.len(), 8);
    assert_eq!(scene.poses[0], scene.start);
    for pair in scene.poses.windows(2) {
        let apart = (pair[1].x - pair[0].x).hypot(pair[1].y - pair[0].y);
        assert!((6.0..=12.0).contains(&apart), "{apart}");
    }
}

#[test]
fn neighbouring_scans_of_the_simple_tour_overlap() {
    let world = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    for pair in world.scene().poses.windows(2) {
        let points = scan_in_map(&world, &pair[1]);
        let shared = points.iter().filter(|p| sees(&world, &pair[0], p)).count();
        let overlap = shared as f64 / points.len() as f64;
        assert!(overlap > 0.5, "{:?}: {overlap}", pair[1]);
    }
}

#[test]
fn the_simple_tour_sees_nearly_every_reachable_cell() {
    let world = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let scene = world.scene();
    let cells = reachable_cells(&world, &ReachConfig::default(), &scene.start).unwrap();
    let covered = cells.coverage(|x, y| {
        let ground = nalgebra::Point3::new(x, y, world.ground_height(x, y).unwrap());
        scene.poses.iter().any(|pose| sees(&world, pose, &ground))
    });
    assert!(covered > 0.97, "{covered}");
    let area = (cells.cols * cells.rows) as f64;
    let share = cells.count() as f64 / area;
    assert!((0.85..0.99).contains(&share), "house and tree block some, the hill is gentle: {share}");
}

#[test]
fn the_simple_scene_gives_a_typical_number_of_returns() {
    let world = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let scanner = Scanner::new(ScannerConfig::default()).unwrap();
    let map_from_scanner = world.level_scanner_pose(&world.scene().start, 1.0).unwrap();
    let mut points = vec![Point::EMPTY; scanner.grid().cells()];
    scanner.scan(&world, &map_from_scanner, SEED, 2, &mut points, None).unwrap();
    let returns = points.iter().filter(|p| p.is_return()).count();
    assert!((120_000..200_000).contains(&returns), "{returns}");
    // The ground reaches 15 m beyond the start on every side, so no steep ray may slip through it.
    for (index, point) in points.iter().enumerate() {
        let ray = scanner.ray(index / 541, index % 541).unwrap();
        assert!(ray.z > -0.15 || point.is_return(), "{index}");
    }
}

#[test]
fn the_worlds_are_what_they_are_for() {
    let cells = |name: &str| {
        let world = CompiledScene::new(Scene::builtin(name).unwrap()).unwrap();
        let cells = reachable_cells(&world, &ReachConfig::default(), &world.scene().start).unwrap();
        (world, cells)
    };
    let kinds = |cells: &ReachableCells, kind| cells.kinds.iter().filter(|k| **k == kind).count();
    let (town, reach) = cells("structured");
    assert!(reach.contains(-11.0, 20.0) && reach.contains(-32.0, -20.5), "gardens");
    assert!(reach.contains(-28.2, 12.0) && reach.contains(-16.6, 12.0), "gaps between houses");
    assert!(kinds(&reach, CellKind::Obstacle) * 5 > reach.kinds.len(), "houses take much of a town");
    assert!(town.label_counts().iter().filter(|(_, count)| *count > 0).count() >= 7);
    let (_, reach) = cells("unstructured");
    let levels = |x, y| reach.heights[reach.index(x, y).unwrap()].len();
    assert_eq!(levels(-12.0, -5.9), 2, "over and under the bridge in the gorge");
    assert_eq!(levels(14.0, -24.0), 2, "over and under the overpass");
    assert!(kinds(&reach, CellKind::Steep) * 10 > reach.kinds.len());
    let share = reach.count() as f64 / reach.kinds.len() as f64;
    assert!((0.4..0.8).contains(&share), "{share}");
    let (_, reach) = cells("field");
    assert!(reach.count() as f64 > 0.98 * reach.kinds.len() as f64);
}

#[test]
fn points_of_a_noise_free_scan_lie_on_the_surfaces() {
    for name in Scene::builtin_names() {
        let mut scene = Scene::builtin(name).unwrap();
        // Grass ends rays before the ground.
        scene.terrain.grass_m = 0.0;
        let world = CompiledScene::new(scene).unwrap();
        for point in scan_in_map(&world, &world.scene().start).iter().step_by(11) {
            let distance = world.distance_to_surface(point, 1.0).unwrap();
            assert!(distance <= 2e-5 * (1.0 + point.coords.norm()), "{name}: {distance}");
        }
    }
    let world = CompiledScene::new(Scene::builtin("plane").unwrap()).unwrap();
    let over = nalgebra::Point3::new(-8.0, 4.0, 0.4);
    assert!((world.distance_to_surface(&over, 1.0).unwrap() - 0.4).abs() < 1e-5);
    assert_eq!(world.distance_to_surface(&over, 0.3), None);
}
