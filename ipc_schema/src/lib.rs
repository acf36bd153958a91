//! What the processes of mirador say to each other.
//!
//! This crate depends on nothing else of mirador: with it alone anyone can write a service that listens to a topic or
//! takes the place of one of ours. It holds
//!
//! - the message layouts ([`messages`]): `#[repr(C)]`, without pointers or unnamed padding, described at run time
//!   ([`layout`]) so that a recording or another language can read them;
//! - the topics and the one table of their delivery rules ([`topics`]);
//! - the domain ([`Domain`]): which files and shared-memory segments belong to one graph;
//! - the memory budget ([`budget`]): what a graph will take of `/dev/shm`, checked before anything is created;
//! - typed ports ([`Participant`], [`Publisher`], [`Subscriber`]) over iceoryx2 that make the zero-copy path the easy
//!   one: loan a slice, write in place, send; receive a borrowed view. Bytes that are copied all the same are counted.

pub mod budget;
pub mod clock;
mod domain;
pub mod layout;
pub mod messages;
mod port;
mod roll_call;
pub mod service;
pub mod text;
pub mod topics;

pub use domain::{CleanupReport, Domain, DomainError};
pub use messages::{Envelope, Header, ScanId};
pub use port::{
    Bell, Counter, Counters, JoinError, Loan, LoanError, Participant, Pause, Peer, PortError, PublishError, Publisher,
    ReceiveFailure, Received, SegmentLocation, SendFailure, StopSignal, Subscriber, Waiter, Wake, Wakeable, Watch,
};
pub use roll_call::RollCall;
pub use topics::{Rules, Sizes, Topic};
