//! `mirador bench ipc`: what one hop between two processes costs.
//!
//! A message is stamped (CLOCK_MONOTONIC) right before it is sent, and the hop ends when the other process holds it.
//! The publisher is the calling process, the subscriber a second one; each is pinned to a core of its own. Several subscribers
//! are a process each and share the second core.
//!
//! | transport | what it is |
//! |---|---|
//! | `mirador` | our [`Publisher`](mirador_ipc_schema::Publisher) and [`Subscriber`](mirador_ipc_schema::Subscriber) on a topic like `scan`, with up to eight readers |
//! | `iceoryx2` | the bare API under it: same message, slots, buffers and domain, pages resident alike |
//! | `unix_socket` | a stream socket to each subscriber, the message copied in and out, default buffers |
//! | `pipe` | an anonymous pipe, likewise |
//!
//! The first two are measured in turns, message by message at one pace, the order changing every round (A B, B A, ...),
//! so that whatever else the machine does hits both; likewise the two that copy. Rows of the report:
//!
//! - `hop`: the latency, of all subscribers together;
//! - `hop_last`: where there are several, that of the one that had the message last;
//! - `hop_ratio`: mirador over iceoryx2, percentile by percentile (p50 is the one that counts);
//! - `wake_up`, `transport`: the hop in two parts, in place: until a sleeping subscriber is awake, and the rest. Polling
//!   there is no waking up, and the transport is the hop;
//! - `payload_write`: writing the payload, which is not part of the hop: in the loaned slot for the first two, in a
//!   buffer of the process for the others;
//! - `send_call`: how long the publisher is busy with sending, the wake-up of the subscriber included.

mod bare;
mod case;
mod error;
mod load;
mod payload;
mod peer;
mod peer_process;
mod pin;
mod receive;
mod run;
mod send;
mod topic;

pub use case::{IpcOptions, Payload, Transport};
pub use error::BenchError;
pub use mirador_ipc_schema::Wake;
pub use peer::peer_main;
pub use run::run;
