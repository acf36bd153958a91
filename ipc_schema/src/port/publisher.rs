//! Sending: loan a slice in shared memory, write in place, send.

use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{BackpressureAction, publisher};
use iceoryx2::prelude::*;
use iceoryx2::sample_mut::SampleMut;

use super::maps::{self, SegmentLocation};
use super::{Counters, Ipc, Participant, PortError, open};
use crate::messages::Meta;
use crate::topics::{Lag, Topic};

/// How long a publisher waits for a reader whose buffer is full. A dead reader is cleaned up by the supervisor within
/// a second; a living one that needs longer than this for a whole buffer is reported.
const BACKPRESSURE_LIMIT: Duration = Duration::from_secs(10);

/// Why nothing could be loaned.
#[derive(Debug, thiserror::Error)]
pub enum LoanError {
    /// The message is larger than the slots.
    #[error(
        "a message of {items} items does not fit topic '{topic}', whose slots hold {capacity}: raise graph.max_points"
    )]
    TooLarge {
        /// The topic.
        topic: &'static str,
        /// Items asked for.
        items: usize,
        /// Items of a slot.
        capacity: usize,
    },
    /// iceoryx2 has no slot.
    #[error("topic '{topic}' has no free slot: {reason}")]
    NoSlot {
        /// The topic.
        topic: &'static str,
        /// What iceoryx2 said.
        reason: String,
    },
}

/// Why a message did not reach everyone.
#[derive(Debug, thiserror::Error)]
pub enum SendFailure {
    /// A reader did not take its messages within the limit. It will see a gap.
    #[error("a reader of topic '{topic}' did not take its messages for {} s: message {sequence} did not reach it", BACKPRESSURE_LIMIT.as_secs())]
    Undelivered {
        /// The topic.
        topic: &'static str,
        /// Sequence number of the message.
        sequence: u64,
    },
    /// iceoryx2 could not send.
    #[error("topic '{topic}' cannot send: {reason}")]
    Other {
        /// The topic.
        topic: &'static str,
        /// What iceoryx2 said.
        reason: String,
    },
}

/// Why a whole message could not be sent.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// Nothing could be loaned.
    #[error(transparent)]
    Loan(#[from] LoanError),
    /// It did not reach everyone.
    #[error(transparent)]
    Send(#[from] SendFailure),
}

/// The sending end of a topic.
pub struct Publisher<T: Topic> {
    port: publisher::Publisher<Ipc, [T::Item], T::Meta>,
    notifier: Notifier<Ipc>,
    counters: Arc<Counters>,
    sequence: Cell<u64>,
    incarnation: u32,
    capacity: usize,
}

impl<T: Topic> Publisher<T> {
    pub(super) fn open(participant: &Participant) -> Result<Self, PortError> {
        let rules = T::RULES;
        let service = open::pub_sub::<T>(&participant.node, &participant.domain)?;
        let event = open::event::<T>(&participant.node)?;
        let capacity = participant.sizes.items(rules.capacity);
        let mut builder = service
            .publisher_builder()
            .initial_max_slice_len(capacity)
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(rules.loaned)
            .backpressure_strategy(BackpressureStrategy::DiscardData);
        if rules.lag == Lag::Wait {
            builder = builder.set_backpressure_handler(|info| {
                if info.elapsed_time > BACKPRESSURE_LIMIT {
                    return BackpressureAction::DiscardDataAndFail;
                }
                // iceoryx2 would spin; a reader that lags by a whole buffer needs far longer than this pause.
                std::thread::sleep(Duration::from_micros(50));
                BackpressureAction::Retry
            });
        }
        let full = |reason: String| PortError::Full { topic: rules.name, port: "publisher", reason };
        let port = builder.create().map_err(|e| full(format!("{e:?}")))?;
        let notifier = event.notifier_builder().create().map_err(|e| full(format!("{e:?}")))?;
        maps::prefault(&participant.domain).map_err(|source| PortError::NoMemory {
            topic: rules.name,
            bytes: (rules.slots() * capacity * size_of::<T::Item>()) as u64,
            source,
        })?;
        Ok(Self {
            port,
            notifier,
            counters: Arc::clone(&participant.counters),
            sequence: Cell::new(0),
            incarnation: participant.incarnation,
            capacity,
        })
    }

    /// The most items a message may have.
    #[must_use]
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// A slice of `items` items in shared memory, to be written in place and sent. Its bytes are whatever an earlier
    /// message left there: write every item.
    ///
    /// # Errors
    /// See [`LoanError`].
    pub fn loan(&self, items: usize) -> Result<Loan<'_, T>, LoanError> {
        let topic = T::RULES.name;
        if items > self.capacity {
            return Err(LoanError::TooLarge { topic, items, capacity: self.capacity });
        }
        let sample =
            self.port.loan_slice_uninit(items).map_err(|e| LoanError::NoSlot { topic, reason: format!("{e:?}") })?;
        // SAFETY: every bit pattern is a valid item (`Topic::Item: Record`, hence `bytemuck::Pod`), and the bytes are
        // initialised: they are pages of a shared-memory file, which the system hands out filled with zeros, and no
        // code ever writes padding or uninitialised values to them (`Pod` types have no padding).
        let sample = unsafe { sample.assume_init() };
        Ok(Loan { sample, publisher: self })
    }

    /// Sends a message of one item.
    ///
    /// # Errors
    /// See [`LoanError`] and [`SendFailure`].
    pub fn send_one(&self, meta: T::Meta, item: T::Item) -> Result<(), PublishError> {
        let mut loan = self.loan(1)?;
        *loan.meta_mut() = meta;
        loan.items_mut()[0] = item;
        loan.send()?;
        Ok(())
    }

    /// Sends a copy of `items`. The bytes are counted: for clouds write in place instead.
    ///
    /// # Errors
    /// See [`LoanError`] and [`SendFailure`].
    pub fn send_copy(&self, meta: T::Meta, items: &[T::Item]) -> Result<(), PublishError> {
        let mut loan = self.loan(items.len())?;
        *loan.meta_mut() = meta;
        loan.items_mut().copy_from_slice(items);
        self.counters.copied_payload_bytes.add(size_of_val(items) as u64);
        loan.send()?;
        Ok(())
    }

    /// Gives late joiners the history; to be called every 50 ms while nothing is sent.
    pub fn serve_late_joiners(&self) {
        // A reader that cannot be connected now is tried again at the next call and at the next send.
        if self.port.update_connections().is_ok() {
            return;
        }
        tracing::debug!(topic = T::RULES.name, "a late joiner could not be connected yet");
    }

    /// Wakes the readers ahead of a message that is all but ready: those that [wait for what is announced](Participant::wait_announced)
    /// are awake and look for it when it comes, instead of beginning to wake up.
    pub fn announce(&self) {
        self.wake_readers();
    }

    fn wake_readers(&self) {
        // A full event queue means that the reader is awake anyway.
        let _ = self.notifier.notify();
    }
}

/// A message being written in shared memory.
pub struct Loan<'p, T: Topic> {
    sample: SampleMut<Ipc, [T::Item], T::Meta>,
    publisher: &'p Publisher<T>,
}

impl<T: Topic> Loan<'_, T> {
    /// The meta part, to be filled in; sequence, incarnation and send time are filled in by [`Loan::send`].
    pub fn meta_mut(&mut self) -> &mut T::Meta {
        self.sample.user_header_mut()
    }

    /// The items, to be written in place.
    pub fn items_mut(&mut self) -> &mut [T::Item] {
        self.sample.payload_mut()
    }

    /// The items written so far.
    #[must_use]
    pub fn items(&self) -> &[T::Item] {
        self.sample.payload()
    }

    /// Where the items lie in shared memory.
    #[must_use]
    pub fn location(&self) -> Option<SegmentLocation> {
        maps::locate(self.sample.payload().as_ptr())
    }

    /// Sends the message and wakes the readers.
    ///
    /// # Errors
    /// See [`SendFailure`].
    pub fn send(mut self) -> Result<(), SendFailure> {
        let publisher = self.publisher;
        let sequence = publisher.sequence.get();
        let header = self.sample.user_header_mut().header_mut();
        header.sequence = sequence;
        header.incarnation = publisher.incarnation;
        header.sent_ns = crate::clock::monotonic_ns();
        let sent = self.sample.send();
        // The number is used up even when a reader missed the message: that is how it sees the gap.
        publisher.sequence.set(sequence + 1);
        publisher.wake_readers();
        publisher.counters.sent.add(1);
        let topic = T::RULES.name;
        match sent {
            Ok(_) => Ok(()),
            Err(iceoryx2::port::SendError::UnableToDeliver) => {
                publisher.counters.undelivered.add(1);
                Err(SendFailure::Undelivered { topic, sequence })
            }
            Err(e) => Err(SendFailure::Other { topic, reason: format!("{e:?}") }),
        }
    }
}
