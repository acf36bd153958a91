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

/// A world drawn as text: `.` ground, `#` wall, anything else unknown; the first line has y = 0. Every cell of ground
/// holds eight points of quality `quality`.
pub fn map_of(rows: &[String], quality: f32) -> InformationMap {
    let (mut points, mut scores) = (Vec::new(), Vec::new());
    for (y, row) in rows.iter().enumerate() {
        for (x, kind) in row.chars().enumerate() {
            let (navigable, obstacle, normal) = match kind {
                '.' => (0.95, 0.0, Vector3::z()),
                '#' => (0.0, 0.95, Vector3::x()),
                _ => continue,
            };
            let mut score = PointScore { flags: PointScore::VALID | PointScore::REACHABLE, ..PointScore::NONE };
            score.navigable = PointScore::quantise(navigable);
            score.obstacle = PointScore::quantise(obstacle);
            score.quality = PointScore::quantise(quality);
            score.set_normal(&normal);
            for _ in 0..8 {
                points.push(Point::new(0.3 * (x as f32 + 0.5), 0.3 * (y as f32 + 0.5), 0.0));
                scores.push(score);
            }
        }
    }
    let mut map = InformationMap::new(MapConfig::default()).unwrap();
    map.insert(ScanView::unordered(&points), &scores, &Pose::identity()).unwrap();
    map
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
