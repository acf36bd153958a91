//! The sending end of each transport: write the payload, stamp, send.

use std::io::Write;

use bytemuck::cast_slice_mut;
use mirador_ipc_schema::clock::monotonic_ns;
use mirador_ipc_schema::messages::{Point, ScanMeta};
use mirador_ipc_schema::{Header, Publisher};

use super::BenchError;
use super::bare::{BareNotifier, BarePublisher};
use super::payload::{fill, point, put_head};
use super::topic::MeasuredScan;

/// Durations of one message on the publisher's side [ns].
#[derive(Debug, Clone, Copy)]
pub(super) struct Sent {
    /// Writing the payload.
    pub write_ns: u64,
    /// From the stamp until the publisher can go on.
    pub send_ns: u64,
}

/// The sending end of a transport.
pub(super) trait Send {
    /// Writes the payload of message `sequence` and sends it.
    fn send(&mut self, sequence: u64) -> Result<Sent, BenchError>;
}

/// The meta part of message `sequence`.
fn meta(sequence: u64, points: usize) -> ScanMeta {
    ScanMeta {
        header: Header::new(sequence, 0),
        returns: u32::try_from(points).unwrap_or(u32::MAX),
        ..ScanMeta::default()
    }
}

/// Our handle.
pub(super) struct SendMirador {
    pub publisher: Publisher<MeasuredScan>,
    pub points: usize,
}

impl Send for SendMirador {
    fn send(&mut self, sequence: u64) -> Result<Sent, BenchError> {
        let mut loan = self.publisher.loan(self.points)?;
        let begin = monotonic_ns();
        fill(loan.items_mut(), sequence);
        let written = monotonic_ns();
        *loan.meta_mut() = meta(sequence, self.points);
        let stamp = monotonic_ns();
        loan.send()?;
        Ok(Sent { write_ns: written - begin, send_ns: monotonic_ns() - stamp })
    }
}

/// The bare API.
pub(super) struct SendIceoryx2 {
    pub publisher: BarePublisher,
    pub notifier: Option<BareNotifier>,
    pub points: usize,
}

impl Send for SendIceoryx2 {
    fn send(&mut self, sequence: u64) -> Result<Sent, BenchError> {
        let sample = self.publisher.loan_slice_uninit(self.points).map_err(BenchError::iceoryx("loan"))?;
        let begin = monotonic_ns();
        let mut sample = sample.write_from_fn(|index| point(sequence, index));
        let written = monotonic_ns();
        let header = sample.user_header_mut();
        *header = meta(sequence, self.points);
        header.header.sequence = sequence;
        let stamp = monotonic_ns();
        header.header.sent_ns = stamp;
        sample.send().map_err(BenchError::iceoryx("send"))?;
        if let Some(notifier) = &self.notifier {
            notifier.notify().map_err(BenchError::iceoryx("notify"))?;
        }
        Ok(Sent { write_ns: written - begin, send_ns: monotonic_ns() - stamp })
    }
}

/// Streams that take the message as bytes, one subscriber's after the other's: one write call for the whole of it.
pub(super) struct SendBytes<W: Write> {
    pub streams: Vec<W>,
    pub points: Vec<Point>,
}

impl<W: Write> Send for SendBytes<W> {
    fn send(&mut self, sequence: u64) -> Result<Sent, BenchError> {
        let begin = monotonic_ns();
        fill(&mut self.points, sequence);
        let written = monotonic_ns();
        let stamp = monotonic_ns();
        let bytes = cast_slice_mut(&mut self.points);
        put_head(bytes, stamp, sequence);
        for stream in &mut self.streams {
            stream.write_all(bytes).map_err(BenchError::io("write to the second process"))?;
        }
        Ok(Sent { write_ns: written - begin, send_ns: monotonic_ns() - stamp })
    }
}
