//! Typed ports over iceoryx2: loan, write in place, send; receive a borrowed view.

mod counters;
mod maps;
mod open;
mod participant;
mod publisher;
mod stop;
mod subscriber;
mod wait;

pub use counters::Counters;
pub use maps::SegmentLocation;
pub use open::PortError;
pub use participant::{JoinError, Participant, Peer, Wake};
pub use publisher::{Loan, LoanError, PublishError, Publisher, SendFailure};
pub use stop::StopSignal;
pub use subscriber::{ReceiveFailure, Received, Subscriber};
pub use wait::Wakeable;

#[cfg(test)]
mod tests;
