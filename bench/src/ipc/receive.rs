//! The receiving end of each transport: wait for the message of this turn, take the time, look at the message.

use std::io::Read;
use std::time::{Duration, Instant};

use mirador_ipc_schema::clock::monotonic_ns;
use mirador_ipc_schema::messages::Point;
use mirador_ipc_schema::topics::Scan;
use mirador_ipc_schema::{Header, Participant, Subscriber};

use super::bare::{BareListener, BareSubscriber};
use super::payload::{HEAD, head, is_intact};
use super::{BenchError, Transport};

/// After this a message counts as lost: far more than any pace, and than what a loaded machine makes it wait.
const LOST_AFTER: Duration = Duration::from_secs(10);

/// The receiving end of a transport.
pub(super) trait Receive {
    /// Waits for message `sequence`; its latency [ns].
    fn receive(&mut self, sequence: u64) -> Result<u64, BenchError>;
}

/// The latency of a message received `now`, if it is the one that was expected and intact. Looking at it comes behind
/// taking the time.
fn latency(
    transport: Transport,
    expected: u64,
    points: usize,
    now: u64,
    header: &Header,
    items: &[Point],
) -> Result<u64, BenchError> {
    if header.sequence != expected {
        return Err(BenchError::Lost { transport, expected, found: format!("message {} came", header.sequence) });
    }
    if !is_intact(items, expected, points) {
        return Err(BenchError::Lost { transport, expected, found: "its points are not its own".into() });
    }
    Ok(now.saturating_sub(header.sent_ns))
}

fn nothing(transport: Transport, expected: u64) -> BenchError {
    BenchError::Lost { transport, expected, found: format!("nothing came for {} s", LOST_AFTER.as_secs()) }
}

/// Our handle: the call for a reader of one topic.
pub(super) struct ReceiveMirador {
    pub participant: Participant,
    pub subscriber: Subscriber<Scan>,
    pub points: usize,
}

impl Receive for ReceiveMirador {
    fn receive(&mut self, sequence: u64) -> Result<u64, BenchError> {
        let Some(message) = self.subscriber.receive_within(&self.participant, LOST_AFTER)? else {
            return Err(nothing(Transport::Mirador, sequence));
        };
        let now = monotonic_ns();
        latency(Transport::Mirador, sequence, self.points, now, message.header(), message.items())
    }
}

/// The bare API, used in the fastest of its documented ways: `Listener::timed_wait`, or `receive` again and again.
pub(super) struct ReceiveIceoryx2 {
    pub subscriber: BareSubscriber,
    pub listener: Option<BareListener>,
    pub points: usize,
}

impl Receive for ReceiveIceoryx2 {
    fn receive(&mut self, sequence: u64) -> Result<u64, BenchError> {
        let begin = Instant::now();
        loop {
            if let Some(sample) = self.subscriber.receive().map_err(BenchError::iceoryx("receive"))? {
                let now = monotonic_ns();
                let header = &sample.user_header().header;
                return latency(Transport::Iceoryx2, sequence, self.points, now, header, sample.payload());
            }
            match &self.listener {
                Some(listener) => {
                    listener.timed_wait(|_| {}, LOST_AFTER).map_err(BenchError::iceoryx("wait for an event"))?;
                }
                None => std::hint::spin_loop(),
            }
            if begin.elapsed() > LOST_AFTER {
                return Err(nothing(Transport::Iceoryx2, sequence));
            }
        }
    }
}

/// A stream: the message is there when its last byte is.
pub(super) struct ReceiveBytes<R: Read> {
    pub transport: Transport,
    pub stream: R,
    pub buffer: Vec<u8>,
}

impl<R: Read> Receive for ReceiveBytes<R> {
    fn receive(&mut self, sequence: u64) -> Result<u64, BenchError> {
        self.stream.read_exact(&mut self.buffer).map_err(BenchError::io("read from the first process"))?;
        let now = monotonic_ns();
        let found = head(&self.buffer);
        match found {
            Some((stamp, number)) if number == sequence => Ok(now.saturating_sub(stamp)),
            _ => Err(BenchError::Lost {
                transport: self.transport,
                expected: sequence,
                found: format!("message {} came", found.map_or(u64::MAX, |(_, number)| number)),
            }),
        }
    }
}

/// A buffer for messages of `bytes` bytes, its pages resident.
pub(super) fn resident_buffer(bytes: usize) -> Vec<u8> {
    // A byte other than 0: zeroed memory is mapped only at its first use.
    vec![1; bytes.max(HEAD)]
}
