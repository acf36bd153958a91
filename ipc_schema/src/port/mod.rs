//! Typed ports over iceoryx2: loan, write in place, send; receive a borrowed view.

mod bell;
mod counters;
mod maps;
mod open;
mod participant;
mod publisher;
mod stop;
mod subscriber;
mod wait;
mod watch;

pub use bell::Bell;
pub use counters::{Counter, Counters};
pub use maps::SegmentLocation;
pub use open::PortError;
pub use participant::{JoinError, Participant, Peer, Waiter, Wake};
pub use publisher::{Loan, LoanError, PublishError, Publisher, SendFailure};
pub use stop::StopSignal;
pub use subscriber::{ReceiveFailure, Received, Subscriber};
pub use wait::{Pause, Wakeable};
pub use watch::Watch;

/// The variant of iceoryx2 whose ports and samples can be handed to another thread.
type Ipc = iceoryx2::prelude::ipc_threadsafe::Service;

#[cfg(test)]
mod tests;
