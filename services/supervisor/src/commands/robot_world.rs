//! What a graph with a simulated robot takes from the robot's world, so that nothing has to be said twice: scanner, mount,
//! start, work area.

use std::sync::Arc;

use mirador_core::geometry::Pose;
use mirador_core::simulation::{CompiledScene, ReachConfig, ScannerConfig, reachable_cells};
use mirador_core::view_planning::WorkArea;

use crate::UsageError;
use crate::graph::Graph;

/// What the outputs want to know of the world.
pub struct RobotWorld {
    /// Where the scanner sits.
    pub robot_from_scanner: Pose,
    /// Centres of the cells that the robot can reach [m].
    pub reachable: Vec<[f64; 2]>,
    /// The world itself.
    pub scene: Arc<CompiledScene>,
    /// Cells of a scan.
    pub scan_cells: usize,
}

/// Fills in what the world says, and works out what the robot can reach in it.
///
/// # Errors
/// When there is no such world, no robot of that number, no turning laser on it, or it cannot leave its start.
pub fn fill_in(graph: &mut Graph) -> Result<RobotWorld, UsageError> {
    let usage = |error: &dyn std::fmt::Display| UsageError(error.to_string());
    let driven = graph.simulator.driven().map_err(|e| usage(&e))?;
    let scene = CompiledScene::new(graph.simulator.scene().map_err(|e| usage(&e))?).map_err(|e| usage(&e))?;
    let start = driven.robot.start;
    let cells = reachable_cells(&scene, &ReachConfig::default(), &start).map_err(|e| usage(&e))?;
    let reachable = (0..cells.reachable.len()).filter(|k| cells.reachable[*k]).map(|k| cells.centre(k)).collect();
    let ground = scene.ground_height(start.x, start.y).unwrap_or(0.0);
    let area = scene.scene().area;
    let mount = driven.robot_from_scanner;
    let height = mount.translation.z;

    graph.analysis.scores.scanner_height_m.get_or_insert(height);
    let (x, y) = (area.x_m, area.y_m);
    graph.planning.view.work_area.get_or_insert(WorkArea { min: [x[0], y[0]], max: [x[1], y[1]] });
    let (model, scanner) = (&mut graph.planning.view.scanner, &driven.scanner);
    model.range_m = scanner.range_max_m;
    model.ground_range_m = ScannerConfig { height_m: height, ..scanner.clone() }.ground_range_m();
    model.height_m = height;
    model.elevation_step_deg = scanner.beam_step_deg;
    model.azimuth_step_deg = scanner.turn_deg / scanner.sweeps as f64;
    let localization = &mut graph.localization;
    localization.start_xyz = [start.x, start.y, ground];
    localization.start_yaw_deg = start.yaw.to_degrees();
    localization.robot_from_scanner_xyz = mount.translation.vector.into();
    let (roll, pitch, yaw) = mount.rotation.euler_angles();
    localization.robot_from_scanner_rpy_deg = [roll, pitch, yaw].map(f64::to_degrees);
    graph.acquisition.scanner = ScannerConfig { height_m: height, ..driven.scanner.clone() };
    let scan_cells = scanner.beams * scanner.sweeps;
    Ok(RobotWorld { robot_from_scanner: mount, reachable, scene: Arc::new(scene), scan_cells })
}
