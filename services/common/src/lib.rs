//! What the services share: messages seen as the types of `mirador-core`, checkpoints, and the errors of a service loop.

pub mod checkpoint;
mod error;
pub mod view;

pub use checkpoint::CheckpointError;
pub use error::ServiceError;
