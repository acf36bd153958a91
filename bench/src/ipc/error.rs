//! Why the message benchmark could not be run.

use mirador_ipc_schema::{DomainError, JoinError, LoanError, PortError, ReceiveFailure, SendFailure};

use super::Transport;

/// Why the message benchmark could not be run.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// An option is outside its range.
    #[error("option {field}: {reason}")]
    BadOption {
        /// Name of the option.
        field: &'static str,
        /// What would be right.
        reason: String,
    },
    /// Files of the domain exist, so another graph may be using it.
    #[error("domain '{domain}' is in use: name another one, or clean it with `mirador doctor --fix`")]
    DomainInUse {
        /// The domain.
        domain: String,
    },
    /// The slots do not fit into shared memory.
    #[error(
        "/dev/shm has {free} bytes free, but slots for payloads of {payload_bytes} bytes need {needed}: enlarge it"
    )]
    NoSharedMemory {
        /// Bytes free.
        free: u64,
        /// Bytes needed.
        needed: u64,
        /// Bytes of the payload.
        payload_bytes: usize,
    },
    /// The domain cannot be used or cleaned.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The domain cannot be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// The topic cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// No slot to write in.
    #[error(transparent)]
    Loan(#[from] LoanError),
    /// A message could not be sent.
    #[error(transparent)]
    Send(#[from] SendFailure),
    /// A message could not be received.
    #[error(transparent)]
    Receive(#[from] ReceiveFailure),
    /// A call of the bare iceoryx2 API failed.
    #[error("iceoryx2: {what}: {reason}")]
    Iceoryx {
        /// What was tried.
        what: &'static str,
        /// What iceoryx2 said.
        reason: String,
    },
    /// A system call failed.
    #[error("{what}: {source}")]
    Io {
        /// What was tried.
        what: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// A message did not arrive, or not in its place.
    #[error("{transport}: message {expected} was lost ({found})")]
    Lost {
        /// The transport.
        transport: Transport,
        /// Number of the message that should have come.
        expected: u64,
        /// What came instead.
        found: String,
    },
    /// The second process cannot be started or failed; its own message is on standard error.
    #[error("second process '{command}': {reason}")]
    Peer {
        /// Its command line.
        command: String,
        /// What happened.
        reason: String,
    },
    /// The second process was not started by the benchmark, or by another version of it.
    #[error("bench-peer is started by `mirador bench ipc` itself: {reason}")]
    BadPeerArguments {
        /// What is wrong with its arguments.
        reason: String,
    },
    /// The benchmark was asked to end.
    #[error("interrupted")]
    Interrupted,
}

impl BenchError {
    /// Wraps the error of an iceoryx2 call.
    pub(super) fn iceoryx<E: std::fmt::Debug>(what: &'static str) -> impl FnOnce(E) -> Self {
        move |error| Self::Iceoryx { what, reason: format!("{error:?}") }
    }

    /// Wraps the error of a system call.
    pub(super) fn io<E: Into<std::io::Error>>(what: &'static str) -> impl FnOnce(E) -> Self {
        move |error| Self::Io { what, source: error.into() }
    }
}
