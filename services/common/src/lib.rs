//! What the services share: messages seen as the types of `mirador-core`, messages in the order of the scans, checkpoints,
//! the courtesy of those who only watch, and the errors of a service loop.

pub mod checkpoint;
mod courtesy;
mod error;
mod in_order;
mod place;
pub mod view;

pub use checkpoint::CheckpointError;
pub use courtesy::Courtesy;
pub use error::ServiceError;
pub use in_order::InOrder;
pub use place::{log_keyframes, log_place};

/// A time in whole nanoseconds, as messages carry it.
#[must_use]
pub fn nanoseconds(time: std::time::Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
