//! The built-in scenes keep what the demo and the tests of scores rely on.

use super::{CompiledScene, ReachConfig, ScanPose, ScanSeed, Scanner, ScannerConfig, Scene, reachable_cells};
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
