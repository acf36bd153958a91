//! A deterministic simulator of the source's scanner (sections 5.3 and 5.4): scenes as small text files, and rays
//! against their triangles.
//!
//! A [`Scene`] is read from TOML, compiled once to a [`CompiledScene`] (triangles, labels, one bounding volume
//! hierarchy), and scanned any number of times by a [`Scanner`], which writes straight into the caller's slice. The
//! same scene, pose and seed give the same bits, whatever the number of threads.

mod assets;
#[cfg(test)]
mod builtin_tests;
mod camera;
mod compiled_scene;
mod file_values;
mod height_grid;
mod model;
mod model_distance;
mod model_tables;
mod object_tables;
mod physics;
mod ray_tree;
mod reachable;
mod robot;
mod robot_tables;
mod scanner;
mod scanner_config;
mod scene;
mod scene_file;
mod sensors;
mod shapes;
mod simulator;
mod standing;
mod terrain;

pub use camera::{Camera, Image, ImageError, top_view};
pub use compiled_scene::{CompileError, CompiledScene, Hit};
pub use height_grid::{HeightFile, HeightGrid};
pub use model::{Mesh, ModelError, Place};
pub use model_distance::{ModelDistance, ModelDistances};
pub use physics::{Motion, Physics, PhysicsConfig, PhysicsError};
pub use reachable::{CellKind, ReachConfig, ReachError, ReachableCells, reachable_cells};
pub use robot::{BodyBox, Robot, Sensor, SensorKind, Wheel, WheelKind};
pub use scanner::{ScanError, ScanSeed, Scanner};
pub use scanner_config::{ScannerConfig, ScannerConfigError};
pub use scene::{Colour, Label, ModelPlacement, Origin, Placement, ScanPose, Scene, SceneError, SceneObject, WorkArea};
pub use sensors::*;
pub use shapes::Shape;
pub use simulator::{PlanarSweep, Readings, Simulator, SimulatorConfig, SimulatorError};
pub use terrain::{Bump, Roughness, Terrain, TerrainConfig, Wave};
