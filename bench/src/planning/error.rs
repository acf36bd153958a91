//! Why the planning benchmark could not be run.

use mirador_core::view_planning::UnknownStrategy;

use crate::exploration::ExplorationError;
use crate::registration::RegistrationBenchError;

/// Why the planning benchmark could not be run.
#[derive(Debug, thiserror::Error)]
pub enum PlanningBenchError {
    /// An option is outside its range.
    #[error("option {field}: {reason}")]
    BadOption {
        /// Name of the option.
        field: &'static str,
        /// What would be right.
        reason: String,
    },
    /// No strategy has the name.
    #[error(transparent)]
    Strategy(#[from] UnknownStrategy),
    /// An exploration cannot be carried out.
    #[error(transparent)]
    Exploration(#[from] ExplorationError),
    /// The simulated drive cannot be made.
    #[error(transparent)]
    Drive(#[from] RegistrationBenchError),
}
