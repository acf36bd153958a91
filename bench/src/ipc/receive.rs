//! The receiving end of each transport: wait for the message of this turn, take the time, look at the message.

use std::io::Read;
use std::time::{Duration, Instant};

use mirador_ipc_schema::clock::monotonic_ns;
use mirador_ipc_schema::messages::Point;
use mirador_ipc_schema::{Header, Participant, Subscriber, Wake};

use super::bare::{BareListener, BareSubscriber};
use super::payload::{HEAD, head, is_intact};
use super::topic::MeasuredScan;
use super::{BenchError, Transport};

/// After this a message counts as lost: far more than any pace, and than what a loaded machine makes it wait.
const LOST_AFTER: Duration = Duration::from_secs(10);

/// The receiving end of a transport.
pub(super) trait Receive {
    /// Waits for message `sequence`.
    fn receive(&mut self, sequence: u64) -> Result<Heard, BenchError>;
}

/// Times of one message [ns].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Heard {
    /// From the stamp to holding it.
    pub latency: u64,
    /// Of that, until the subscriber was awake; none where it does not sleep.
    pub wake_up: Option<u64>,
}

impl Heard {
    /// A message stamped at `sent`, held at `now`, for which a subscriber that sleeps was awake at `woke`. One that was
    /// there before the subscriber had fallen asleep needed no waking.
    fn of(sent: u64, now: u64, woke: Option<u64>) -> Self {
        let latency = now.saturating_sub(sent);
        Self { latency, wake_up: woke.map(|woke| woke.saturating_sub(sent).min(latency)) }
    }
}

/// The latency of a message received `now`, if it is the one that was expected and intact. Looking at it comes behind
/// taking the time.
fn heard(
    transport: Transport,
    expected: u64,
    points: usize,
    now: u64,
    header: &Header,
    items: &[Point],
    woke: Option<u64>,
) -> Result<Heard, BenchError> {
    if header.sequence != expected {
        return Err(BenchError::Lost { transport, expected, found: format!("message {} came", header.sequence) });
    }
    if !is_intact(items, expected, points) {
        return Err(BenchError::Lost { transport, expected, found: "its points are not its own".into() });
    }
    Ok(Heard::of(header.sent_ns, now, woke))
}

fn nothing(transport: Transport, expected: u64) -> BenchError {
    BenchError::Lost { transport, expected, found: format!("nothing came for {} s", LOST_AFTER.as_secs()) }
}

/// Our handle: the call for a reader of one topic.
pub(super) struct ReceiveMirador {
    pub participant: Participant,
    pub wake: Wake,
    pub subscriber: Subscriber<MeasuredScan>,
    pub points: usize,
}

impl Receive for ReceiveMirador {
    fn receive(&mut self, sequence: u64) -> Result<Heard, BenchError> {
        if self.wake == Wake::Poll {
            let Some(message) = self.subscriber.receive_within(&self.participant, LOST_AFTER)? else {
                return Err(nothing(Transport::Mirador, sequence));
            };
            let now = monotonic_ns();
            return heard(Transport::Mirador, sequence, self.points, now, message.header(), message.items(), None);
        }
        let (begin, mut woke) = (Instant::now(), 0);
        loop {
            if let Some(message) = self.subscriber.receive()? {
                let (now, items) = (monotonic_ns(), message.items());
                return heard(Transport::Mirador, sequence, self.points, now, message.header(), items, Some(woke));
            }
            if begin.elapsed() > LOST_AFTER {
                return Err(nothing(Transport::Mirador, sequence));
            }
            woke = self.participant.wait(&[&self.subscriber], LOST_AFTER).woke_ns;
        }
    }
}

/// The bare API, used in the fastest of its documented ways: `Listener::timed_wait`, or `receive` again and again.
pub(super) struct ReceiveIceoryx2 {
    pub subscriber: BareSubscriber,
    pub listener: Option<BareListener>,
    pub points: usize,
}

impl Receive for ReceiveIceoryx2 {
    fn receive(&mut self, sequence: u64) -> Result<Heard, BenchError> {
        let begin = Instant::now();
        let mut woke = self.listener.as_ref().map(|_| 0);
        loop {
            if let Some(sample) = self.subscriber.receive().map_err(BenchError::iceoryx("receive"))? {
                let now = monotonic_ns();
                let header = &sample.user_header().header;
                return heard(Transport::Iceoryx2, sequence, self.points, now, header, sample.payload(), woke);
            }
            match &self.listener {
                Some(listener) => {
                    listener.timed_wait(|_| {}, LOST_AFTER).map_err(BenchError::iceoryx("wait for an event"))?;
                    woke = Some(monotonic_ns());
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
    fn receive(&mut self, sequence: u64) -> Result<Heard, BenchError> {
        self.stream.read_exact(&mut self.buffer).map_err(BenchError::io("read from the first process"))?;
        let now = monotonic_ns();
        let found = head(&self.buffer);
        match found {
            // Waking up and copying go hand in hand: nobody can tell them apart from outside.
            Some((stamp, number)) if number == sequence => Ok(Heard::of(stamp, now, None)),
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
