//! Why an exploration could not be carried out.

use mirador_core::analysis::{ScoreConfigError, ScoreError};
use mirador_core::information_map::{InsertError, MapConfigError};
use mirador_core::simulation::{CompileError, ReachError, ScanError, ScannerConfigError, SceneError};
use mirador_core::surface::SurfaceError;
use mirador_core::view_planning::{PlanningConfigError, UnknownStrategy};

/// Why an exploration could not be carried out.
#[derive(Debug, thiserror::Error)]
pub enum ExplorationError {
    /// No strategy has the name.
    #[error(transparent)]
    Strategy(#[from] UnknownStrategy),
    /// The planner's settings are out of range.
    #[error(transparent)]
    Config(#[from] PlanningConfigError),
    /// There is no such scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The scene cannot be built.
    #[error(transparent)]
    Compile(#[from] CompileError),
    /// The robot cannot stand at the scene's start.
    #[error(transparent)]
    Reach(#[from] ReachError),
    /// The scanner cannot be built.
    #[error(transparent)]
    Scanner(#[from] ScannerConfigError),
    /// A scan cannot be taken.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// A scan has no surface.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// A scan cannot be scored.
    #[error(transparent)]
    Score(#[from] ScoreError),
    /// Zones cannot be found.
    #[error(transparent)]
    Zones(#[from] ScoreConfigError),
    /// The map's settings are out of range.
    #[error(transparent)]
    MapConfig(#[from] MapConfigError),
    /// A scan cannot be inserted.
    #[error(transparent)]
    Insert(#[from] InsertError),
}
