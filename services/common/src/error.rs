//! Why a service loop ends.

use mirador_ipc_schema::{JoinError, LoanError, PortError, PublishError, ReceiveFailure, SendFailure};

use crate::CheckpointError;

/// What every service can fail of; what is particular to one service comes as `Config` or `Work`.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The service's table in the graph file is wrong.
    #[error("{0}")]
    Config(String),
    /// The domain cannot be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A topic cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// A message could not be received.
    #[error(transparent)]
    Receive(#[from] ReceiveFailure),
    /// A message could not be sent.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// The state for a restart could not be written or read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The work itself failed; the text names the scan and the cause.
    #[error("{0}")]
    Work(String),
}

impl From<LoanError> for ServiceError {
    fn from(error: LoanError) -> Self {
        Self::Publish(error.into())
    }
}

impl From<SendFailure> for ServiceError {
    fn from(error: SendFailure) -> Self {
        Self::Publish(error.into())
    }
}
