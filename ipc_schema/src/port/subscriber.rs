//! Receiving: a borrowed view of what the publisher wrote.

use std::cell::RefCell;
use std::os::fd::BorrowedFd;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use iceoryx2::port::listener::Listener;
use iceoryx2::port::subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;

use super::maps::{self, SegmentLocation};
use super::{Counters, Ipc, Participant, PortError, Wake, Wakeable, open};
use crate::layout::Record;
use crate::messages::{Header, Meta};
use crate::topics::{Lag, Topic};

/// Why a message could not be received.
#[derive(Debug, thiserror::Error)]
pub enum ReceiveFailure {
    /// The service holds more messages of the topic than its rules allow.
    #[error("topic '{topic}': {borrowed} messages are still held; drop one before the next is received")]
    TooManyHeld {
        /// The topic.
        topic: &'static str,
        /// The limit.
        borrowed: usize,
    },
    /// iceoryx2 could not receive.
    #[error("topic '{topic}' cannot receive: {reason}")]
    Other {
        /// The topic.
        topic: &'static str,
        /// What iceoryx2 said.
        reason: String,
    },
}

/// The next sequence number expected of a publisher.
struct Origin {
    publisher: u128,
    next_sequence: u64,
}

/// The port of iceoryx2, which the participant knows of, too.
type Reader<T> = subscriber::Subscriber<Ipc, [<T as Topic>::Item], <T as Topic>::Meta>;

/// What connects to publishers that came later.
pub(super) trait Connect: Send + Sync {
    fn connect(&self);
}

impl<I: Record, M: Meta> Connect for subscriber::Subscriber<Ipc, [I], M> {
    fn connect(&self) {
        // A connection that fails shows at the next receive.
        let _ = self.has_samples();
    }
}

/// The receiving end of a topic.
pub struct Subscriber<T: Topic> {
    port: Arc<Reader<T>>,
    listener: Option<Listener<Ipc>>,
    counters: Arc<Counters>,
    origins: RefCell<Vec<Origin>>,
    service: open::PubSub<T>,
}

impl<T: Topic> Subscriber<T> {
    pub(super) fn open(participant: &Participant) -> Result<Self, PortError> {
        let rules = T::RULES;
        let service = open::pub_sub::<T>(&participant.node, &participant.domain)?;
        let full = |reason: String| PortError::Full { topic: rules.name, port: "subscriber", reason };
        // The listener first: a message that arrives in between wakes it.
        let listener = match participant.wake {
            Wake::Poll => None,
            Wake::Event => {
                let event = open::event::<T>(&participant.node)?;
                Some(event.listener_builder().create().map_err(|e| full(format!("{e:?}")))?)
            }
        };
        let port =
            service.subscriber_builder().buffer_size(rules.buffer).create().map_err(|e| full(format!("{e:?}")))?;
        let counters = Arc::clone(&participant.counters);
        Ok(Self { port: Arc::new(port), listener, counters, origins: RefCell::new(Vec::new()), service })
    }

    pub(super) fn reader(&self) -> Weak<dyn Connect> {
        let port: Weak<Reader<T>> = Arc::downgrade(&self.port);
        port
    }

    /// How many publish the topic; one that was killed counts until somebody has cleaned up after it.
    #[must_use]
    pub fn publishers(&self) -> usize {
        self.service.dynamic_config().number_of_publishers()
    }

    /// The next message, if there is one. It stays in the publisher's segment; dropping it frees the slot.
    ///
    /// # Errors
    /// See [`ReceiveFailure`].
    pub fn receive(&self) -> Result<Option<Received<T>>, ReceiveFailure> {
        let topic = T::RULES.name;
        let sample = self.port.receive().map_err(|e| match e {
            iceoryx2::port::ReceiveError::ExceedsMaxBorrows => {
                ReceiveFailure::TooManyHeld { topic, borrowed: T::RULES.borrowed }
            }
            e => ReceiveFailure::Other { topic, reason: format!("{e:?}") },
        })?;
        let Some(sample) = sample else { return Ok(None) };
        self.count_gap(sample.origin().value(), sample.user_header().header());
        self.counters.received.add(1);
        Ok(Some(Received { sample, counters: Arc::clone(&self.counters) }))
    }

    /// The next message, waiting for it at most `timeout` or until the process should end. While polling, this is the
    /// shortest way to a message: nothing stands between two looks.
    ///
    /// # Errors
    /// See [`ReceiveFailure`].
    pub fn receive_within(
        &self,
        participant: &Participant,
        timeout: Duration,
    ) -> Result<Option<Received<T>>, ReceiveFailure> {
        /// Looks between two glances at the clock and the wish to stop.
        const LOOKS: usize = 64;
        let begin = Instant::now();
        loop {
            let looks = if participant.wake == Wake::Poll { LOOKS } else { 1 };
            for _ in 0..looks {
                if let Some(message) = self.receive()? {
                    return Ok(Some(message));
                }
                std::hint::spin_loop();
            }
            let left = timeout.saturating_sub(begin.elapsed());
            if left.is_zero() || participant.stop.is_set() {
                return Ok(None);
            }
            if participant.wake == Wake::Event {
                participant.wait(&[self], left);
            }
        }
    }

    /// A publisher counts its messages without holes, so a hole is a loss. The first message of a publisher only sets
    /// the count: what was sent before this reader came was never meant for it.
    fn count_gap(&self, publisher: u128, header: &Header) {
        let mut origins = self.origins.borrow_mut();
        let next_sequence = header.sequence.saturating_add(1);
        let Some(origin) = origins.iter_mut().find(|o| o.publisher == publisher) else {
            origins.push(Origin { publisher, next_sequence });
            return;
        };
        let lost = header.sequence.saturating_sub(origin.next_sequence);
        if lost > 0 && T::RULES.lag != Lag::Supersede {
            self.counters.lost.add(lost);
            tracing::warn!(topic = T::RULES.name, lost, next = header.sequence, "messages are missing");
        }
        origin.next_sequence = next_sequence;
    }
}

impl<T: Topic> Wakeable for Subscriber<T> {
    fn is_ready(&self) -> bool {
        // A connection that fails shows at the next receive.
        self.port.has_samples().unwrap_or(true)
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        let listener = self.listener.as_ref()?;
        // SAFETY: the descriptor belongs to the listener, which `self` owns and never replaces, so it stays open for the
        // lifetime of the returned borrow; nobody closes it by hand.
        Some(unsafe { BorrowedFd::borrow_raw(listener.file_descriptor().native_handle()) })
    }

    fn drain_events(&self) {
        if let Some(listener) = &self.listener {
            // An event that cannot be read wakes us again at once, and the messages are looked at in any case.
            let _ = listener.try_wait(|_| {});
        }
    }
}

/// A message, in place.
pub struct Received<T: Topic> {
    sample: Sample<Ipc, [T::Item], T::Meta>,
    counters: Arc<Counters>,
}

impl<T: Topic> Received<T> {
    /// The meta part.
    #[must_use]
    pub fn meta(&self) -> &T::Meta {
        self.sample.user_header()
    }

    /// The header.
    #[must_use]
    pub fn header(&self) -> &Header {
        self.meta().header()
    }

    /// The items, where the publisher wrote them.
    #[must_use]
    pub fn items(&self) -> &[T::Item] {
        self.sample.payload()
    }

    /// A copy of the items. The bytes are counted.
    #[must_use]
    pub fn copy_items(&self) -> Vec<T::Item> {
        self.counters.copied_payload_bytes.add(size_of_val(self.items()) as u64);
        self.items().to_vec()
    }

    /// Where the items lie in shared memory.
    #[must_use]
    pub fn location(&self) -> Option<SegmentLocation> {
        maps::locate(self.items().as_ptr())
    }
}
