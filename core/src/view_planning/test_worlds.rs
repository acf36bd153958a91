//! Small worlds drawn as text, for the tests of strategies.

use super::config::PlanningConfig;
use super::plan::ViewPlan;
use super::strategy::{Situation, Strategy};
use super::workspace::Workspace;
use crate::analysis::PointScore;
use crate::geometry::Pose;
use crate::information_map::{InformationMap, MapConfig};
use crate::scan::{Point, ScanView};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A world drawn as text: `.` ground, `-`, `=` and `^` ground 0.08 m, 0.6 m and 3 m higher, `#` wall, anything else unknown;
/// the first line has y = 0. Every cell holds eight points of quality `quality`.
pub fn map_of(rows: &[String], quality: f32) -> InformationMap {
    let (mut points, mut scores) = (Vec::new(), Vec::new());
    for (y, row) in rows.iter().enumerate() {
        for (x, kind) in row.chars().enumerate() {
            let (score, z) = match kind {
                '.' => (ground(quality), 0.0),
                '-' => (ground(quality), 0.08),
                '=' => (ground(quality), 0.6),
                '^' => (ground(quality), 3.0),
                '#' => (wall(quality), 0.0),
                _ => continue,
            };
            for _ in 0..8 {
                points.push(Point::new(0.3 * (x as f32 + 0.5), 0.3 * (y as f32 + 0.5), z));
                scores.push(score);
            }
        }
    }
    with_points(&points, &scores)
}

/// Ground of so many cells that stands as high at a place [m] as `height` says.
pub fn ground_of(width: usize, depth: usize, height: impl Fn(f32, f32) -> f32) -> InformationMap {
    let middles = (0..width * depth).map(|k| [k % width, k / width].map(|cell| 0.3 * (cell as f32 + 0.5)));
    let points: Vec<Point> = middles.flat_map(|[x, y]| [Point::new(x, y, height(x, y)); 8]).collect();
    with_points(&points, &vec![ground(0.3); points.len()])
}

fn with_points(points: &[Point], scores: &[PointScore]) -> InformationMap {
    let mut map = InformationMap::new(MapConfig::default()).unwrap();
    map.insert(ScanView::unordered(points), scores, &Pose::identity()).unwrap();
    map
}

fn ground(quality: f32) -> PointScore {
    score(0.95, 0.0, quality, &Vector3::z())
}

fn wall(quality: f32) -> PointScore {
    score(0.0, 0.95, quality, &Vector3::x())
}

fn score(navigable: f32, obstacle: f32, quality: f32, normal: &Vector3<f32>) -> PointScore {
    let mut score = PointScore { flags: PointScore::VALID | PointScore::REACHABLE, ..PointScore::NONE };
    score.navigable = PointScore::quantise(navigable);
    score.obstacle = PointScore::quantise(obstacle);
    score.quality = PointScore::quantise(quality);
    score.set_normal(normal);
    score
}

/// Points of a part of a house of three storeys of 3 m with ramps between them: another seed shows another part.
pub fn storeys(seed: u64) -> (Vec<Point>, Vec<PointScore>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut points, mut scores) = (Vec::new(), Vec::new());
    let corner = [random.next_u32() % 24, random.next_u32() % 24];
    for (x, y) in (0..20).flat_map(|x| (0..20).map(move |y| (corner[0] + x, corner[1] + y))) {
        for storey in 0..3 {
            let kind = random.next_u32() % 16;
            let at = |z: f32| Point::new(0.3 * (x as f32 + 0.5), 0.3 * (y as f32 + 0.5), z);
            let is_ramp = (10..13).contains(&y) && (4..24).contains(&x);
            let z = 3.0 * storey as f32 + if is_ramp { 0.15 * (x - 4) as f32 } else { 0.0 };
            match kind {
                0 => continue,
                1 => (points.push(at(z + 0.5)), scores.push(wall(0.3))),
                _ => (points.push(at(z)), scores.push(ground(0.02 * kind as f32))),
            };
        }
    }
    (points, scores)
}

/// Level ground.
pub fn field(width: usize, height: usize) -> Vec<String> {
    vec![".".repeat(width); height]
}

/// A robot at (x, y).
pub fn at(x: f64, y: f64) -> Situation {
    Situation { map_from_robot: Pose::translation(x, y, 0.0), scan_number: 1, run_seed: 7, threads: 1 }
}

/// Settings for small worlds.
pub fn config() -> PlanningConfig {
    let mut config =
        PlanningConfig { spacing_m: 1.0, cells_per_candidate: 20, informative_min_cells: 100, ..Default::default() };
    config.scanner.range_m = 6.0;
    config
}

/// Plans in a new workspace.
pub fn plan_with(
    strategy: &mut dyn Strategy,
    map: &InformationMap,
    situation: &Situation,
    config: &PlanningConfig,
) -> ViewPlan {
    strategy.plan(&mut Workspace::new(), map, situation, config)
}
