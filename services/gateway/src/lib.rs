//! The gateway: a run live in viewers. It listens to the graph as the recorder does, and serves the same drawings over
//! Foxglove's WebSocket protocol, on loopback only.
//!
//! Nobody waits for a viewer. Drawings go into a queue of bounded length for each client, whose oldest ones give way;
//! what nobody has subscribed to is not drawn. The process runs at low priority.

mod config;
mod server;
mod service;

#[cfg(test)]
#[path = "../../../tests/support/viewer.rs"]
mod testing;

pub use config::GatewayConfig;
pub use service::run;
