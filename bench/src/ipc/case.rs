//! What is measured: the options of a run, and the one case that publisher and subscriber work off together.

use std::fmt;
use std::time::Duration;

use mirador_ipc_schema::messages::Point;
use mirador_ipc_schema::{Domain, DomainError, StopSignal, Wake};
use serde::{Deserialize, Serialize};

use super::BenchError;
use super::topic::MOST_SUBSCRIBERS;

/// Bytes of one item of the payload.
pub(super) const ITEM_BYTES: usize = size_of::<Point>();

/// Bytes of a full scan of the default scanner: 541 beams x 720 sweeps.
const FULL_SCAN: usize = 541 * 720 * ITEM_BYTES;

/// A payload and how often it is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Payload {
    /// Bytes, a multiple of 16 from 16 on (the size of a point).
    pub bytes: usize,
    /// Measured messages of each transport, at least 1.
    pub messages: u64,
    /// Bytes the publisher writes to memory of its own before each message. With a small payload this shows what a hop
    /// costs with the cold caches that writing a large one leaves, so that size and caches can be told apart.
    pub written_before: usize,
}

impl Payload {
    /// So many bytes, sent so often that the run does not take for ever.
    #[must_use]
    pub fn of(bytes: usize) -> Self {
        let messages = match bytes {
            0..1_000_000 => 1000,
            1_000_000..20_000_000 => 300,
            _ => 100,
        };
        Self { bytes, messages, written_before: 0 }
    }
}

/// Options of the message benchmark.
#[derive(Debug, Clone)]
pub struct IpcOptions {
    /// The payloads.
    pub payloads: Vec<Payload>,
    /// How the subscriber waits; each is a case of its own.
    pub wakes: Vec<Wake>,
    /// Whether every core has something else to do; each is a case of its own.
    pub loaded: Vec<bool>,
    /// How many subscribers there are, 1 to 8; each is a case of its own.
    pub subscribers: Vec<usize>,
    /// Whether the transports that copy are measured too.
    pub copies: bool,
    /// From one message to the next.
    pub pace: Duration,
    /// Messages of each transport, per case, that are sent first and not counted.
    pub warm_up: u64,
    /// Name of the domain, which must be unused; a random one if none is given.
    pub domain: Option<String>,
    /// Program and leading arguments that end up in [`peer_main`](super::peer_main); the benchmark appends its own.
    pub peer_command: Vec<String>,
    /// Ends the run early; what it made is removed all the same.
    pub stop: StopSignal,
}

impl Default for IpcOptions {
    fn default() -> Self {
        Self {
            payloads: vec![
                Payload::of(64),
                Payload::of(4096),
                Payload::of(256 << 10),
                Payload::of(FULL_SCAN),
                Payload { bytes: 64, messages: 300, written_before: FULL_SCAN },
            ],
            wakes: vec![Wake::Event, Wake::Poll],
            loaded: vec![false],
            subscribers: vec![1],
            copies: true,
            pace: Duration::from_millis(5),
            // More than a publisher has slots, so that every slot has been used once.
            warm_up: 64,
            domain: None,
            peer_command: Vec::new(),
            stop: StopSignal::default(),
        }
    }
}

impl IpcOptions {
    /// Checks every field.
    ///
    /// # Errors
    /// [`BenchError::BadOption`] names the field and what would be right.
    pub fn validate(&self) -> Result<(), BenchError> {
        let bad = |field, reason: &str| Err(BenchError::BadOption { field, reason: reason.into() });
        if self.payloads.is_empty() {
            return bad("payloads", "name at least one");
        }
        if self.payloads.iter().any(|p| p.bytes == 0 || p.bytes % ITEM_BYTES != 0) {
            return bad("payloads", "bytes must be a multiple of 16, from 16 on");
        }
        if self.payloads.iter().any(|p| p.written_before % ITEM_BYTES != 0) {
            return bad("payloads", "written_before must be a multiple of 16");
        }
        if self.payloads.iter().any(|p| p.messages == 0) {
            return bad("payloads", "messages must be at least 1");
        }
        if self.wakes.is_empty() {
            return bad("wakes", "name event, poll or both");
        }
        if self.loaded.is_empty() {
            return bad("loaded", "name false, true or both");
        }
        if self.subscribers.is_empty() || self.subscribers.iter().any(|n| !(1..=MOST_SUBSCRIBERS).contains(n)) {
            return bad("subscribers", "name one or more numbers from 1 to 8");
        }
        if self.pace > Duration::from_secs(1) {
            return bad("pace", "must be 0 to 1 s");
        }
        if self.peer_command.is_empty() {
            return bad("peer_command", "name the program that runs the second process");
        }
        Ok(())
    }

    /// The domain of this run.
    ///
    /// # Errors
    /// [`DomainError::BadName`].
    pub(super) fn domain(&self) -> Result<Domain, DomainError> {
        match &self.domain {
            Some(name) => Domain::new(name),
            None => {
                let nanoseconds = mirador_ipc_schema::clock::utc_ns() & 0xffff_ffff;
                Domain::new(&format!("bench-{:x}-{nanoseconds:x}", std::process::id()))
            }
        }
    }
}

/// How a message gets from one process to the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Transport {
    /// Our handles.
    Mirador,
    /// The bare API under them.
    Iceoryx2,
    /// A Unix stream socket.
    UnixSocket,
    /// A pipe.
    Pipe,
}

impl Transport {
    /// Its name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Mirador => "mirador",
            Self::Iceoryx2 => "iceoryx2",
            Self::UnixSocket => "unix_socket",
            Self::Pipe => "pipe",
        }
    }
}

impl fmt::Display for Transport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Two transports that take turns.
pub(super) type Pair = [Transport; 2];
/// In place: what the benchmark is about.
pub(super) const IN_PLACE: Pair = [Transport::Mirador, Transport::Iceoryx2];
/// Copied, for comparison.
pub(super) const COPIED: Pair = [Transport::UnixSocket, Transport::Pipe];

/// Everything both processes must agree on. It travels to the second one as an argument.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Case {
    /// Name of the domain.
    pub domain: String,
    /// The transports that take turns.
    pub pair: Pair,
    /// Whether every core has something else to do.
    pub loaded: bool,
    /// How many subscribers there are.
    pub subscribers: usize,
    /// Whether the subscriber polls.
    pub poll: bool,
    /// Points of a payload.
    pub points: usize,
    /// See [`Payload::written_before`].
    pub written_before: usize,
    /// Rounds that are not counted.
    pub warm_up: u64,
    /// Rounds in all; each sends one message over each transport.
    pub rounds: u64,
    /// Core of the subscriber.
    pub subscriber_core: Option<usize>,
}

impl Case {
    /// How the subscriber waits.
    pub fn wake(&self) -> Wake {
        if self.poll { Wake::Poll } else { Wake::Event }
    }

    /// Bytes of a payload.
    pub fn payload_bytes(&self) -> usize {
        self.points * ITEM_BYTES
    }

    /// The turns of both processes: number of the round, and 0 or 1 for the transport of the pair. The order changes
    /// every round, so that none always comes behind the other.
    pub fn turns(&self) -> impl Iterator<Item = (u64, usize)> + use<> {
        (0..self.rounds)
            .flat_map(|round| if round % 2 == 0 { [(round, 0), (round, 1)] } else { [(round, 1), (round, 0)] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(rounds: u64) -> Case {
        let domain = "a".into();
        Case {
            domain,
            pair: IN_PLACE,
            loaded: false,
            subscribers: 1,
            poll: true,
            points: 4,
            written_before: 0,
            warm_up: 1,
            rounds,
            subscriber_core: Some(1),
        }
    }

    #[test]
    fn the_order_changes_every_round() {
        let turns: Vec<_> = case(3).turns().collect();
        assert_eq!(turns, [(0, 0), (0, 1), (1, 1), (1, 0), (2, 0), (2, 1)]);
    }

    #[test]
    fn a_case_survives_the_command_line() {
        let text = serde_json::to_string(&case(7)).unwrap();
        assert_eq!(serde_json::from_str::<Case>(&text).unwrap(), case(7));
    }

    #[test]
    fn an_option_outside_its_range_is_named() {
        let good = IpcOptions { peer_command: vec!["x".into()], ..IpcOptions::default() };
        assert!(good.validate().is_ok());
        let odd = IpcOptions { payloads: vec![Payload { bytes: 65, messages: 1, written_before: 0 }], ..good.clone() };
        assert!(odd.validate().unwrap_err().to_string().contains("payloads"));
        let slow = IpcOptions { pace: Duration::from_secs(2), ..good.clone() };
        assert!(slow.validate().unwrap_err().to_string().contains("pace"));
        let many = IpcOptions { subscribers: vec![1, 9], ..good.clone() };
        assert!(many.validate().unwrap_err().to_string().contains("subscribers"));
        let alone = IpcOptions { peer_command: Vec::new(), ..good };
        assert!(alone.validate().unwrap_err().to_string().contains("peer_command"));
    }

    #[test]
    fn every_run_gets_a_valid_domain_of_its_own() {
        let options = IpcOptions::default();
        assert_ne!(options.domain().unwrap(), options.domain().unwrap());
    }
}
