//! A deterministic simulator of the source's scanner (sections 5.3 and 5.4): scenes as small text files, and rays
//! against their triangles.
//!
//! A [`Scene`] is read from TOML, compiled once to a [`CompiledScene`] (triangles, labels, one bounding volume
//! hierarchy), and scanned any number of times by a [`Scanner`], which writes straight into the caller's slice. The
//! same scene, pose and seed give the same bits, whatever the number of threads.

#[cfg(test)]
mod builtin_tests;
mod compiled_scene;
mod file_values;
mod object_tables;
mod reachable;
mod scanner;
mod scanner_config;
mod scene;
mod scene_file;
mod shapes;
mod terrain;

pub use compiled_scene::{CompileError, CompiledScene, Hit};
pub use reachable::{ReachConfig, ReachError, ReachableCells, reachable_cells};
pub use scanner::{ScanError, ScanSeed, Scanner};
pub use scanner_config::{ScannerConfig, ScannerConfigError};
pub use scene::{Label, Placement, ScanPose, Scene, SceneError, SceneObject, WorkArea};
pub use shapes::Shape;
pub use terrain::{Bump, Roughness, Terrain, TerrainConfig, Wave};
