//! Revolutions of the laser: which there are and where they begin in the file, and their points.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::packets::{CaptureError, Packets};
use super::velodyne::{DataPacket, Firing, Model, PacketFault};
use crate::scan::{Grid, Point};

/// A revolution begins when the azimuth falls by more than this [1/100 deg]: it has gone past straight behind.
const FALL: u32 = 18_000;
/// A revolution with less than this share of the firings of a full one was cut off.
const WHOLE: f64 = 0.9;
/// Straight behind, where the seam between two revolutions lies [1/100 deg].
const BEHIND: u32 = 18_000;

/// One revolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Revolution {
    /// When its first packet was captured [ns since 1970 UTC].
    pub stamp_ns: i64,
    /// How long it took [ns].
    pub duration_ns: u64,
    /// Rows are firings of all lasers, columns are lasers from the lowest up.
    pub grid: Grid,
    /// Offset of the packet in which it begins.
    offset: u64,
    /// The firing of that packet with which it begins.
    skip: usize,
}

/// A capture whose revolutions are known; their points are read when they are asked for.
#[derive(Debug)]
pub struct Capture {
    path: PathBuf,
    /// The file up to its first packet: what later packets are framed by.
    head: Vec<u8>,
    revolutions: Vec<Revolution>,
    /// Packets of the right size that were none, with the first reason.
    bad_packets: u64,
}

/// Cuts a stream of firings into revolutions.
#[derive(Default)]
struct Seam {
    last: Option<u32>,
}

impl Seam {
    /// Whether a firing is the first of a revolution. Azimuths are counted from straight behind, so that what lies ahead of
    /// the sensor is in one piece.
    fn is_crossed(&mut self, firing: &Firing) -> bool {
        let place = (firing.azimuth + BEHIND) % 36_000;
        let last = self.last.replace(place);
        last.is_some_and(|last| last > place && last - place > FALL)
    }
}

impl Capture {
    /// Goes through a capture once and notes its whole revolutions; those at its ends, which were cut off, are left out.
    ///
    /// # Errors
    /// See [`CaptureError`].
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        let mut packets = Packets::open(path)?;
        let mut index = Index::default();
        packets.for_each(|packet| {
            index.first_offset.get_or_insert(packet.offset);
            match DataPacket::parse(packet.payload) {
                None => {}
                Some(Err(fault)) => index.note(fault),
                Some(Ok(data)) => index.take(packet.offset, packet.stamp_ns, &data),
            }
            true
        })?;
        let seen = packets.seen;
        let Some(model) = index.model else {
            return Err(CaptureError::NoData { path: path.to_owned(), packets: seen, other: index.other_words() });
        };
        let revolutions = index.whole(model);
        if revolutions.is_empty() {
            return Err(CaptureError::NoRevolution { path: path.to_owned() });
        }
        let head = head_of(path, index.first_offset.unwrap_or(0))?;
        Ok(Self { path: path.to_owned(), head, revolutions, bad_packets: index.bad })
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its whole revolutions, in the order of time.
    #[must_use]
    pub fn revolutions(&self) -> &[Revolution] {
        &self.revolutions
    }

    /// Packets of the size of data packets that were damaged or from another model.
    #[must_use]
    pub fn bad_packets(&self) -> u64 {
        self.bad_packets
    }

    /// Writes the points of a revolution in the sensor's frame (x ahead, y to the left), one a cell of its grid; shots
    /// without a return are empty cells. The time of a point is its fraction of the revolution.
    ///
    /// # Errors
    /// When the file is another one than when it was opened, or `out` has not exactly the cells of the revolution.
    pub fn read(&self, revolution: &Revolution, out: &mut [Point]) -> Result<(), CaptureError> {
        let changed = || CaptureError::Changed { path: self.path.clone() };
        let Grid { rows, cols } = revolution.grid;
        if out.len() != rows * cols {
            return Err(changed());
        }
        out.fill(Point::EMPTY);
        let mut packets = Packets::open_at(&self.path, &self.head, revolution.offset)?;
        let (mut row, mut begin_ns, mut skip) = (0, None, revolution.skip);
        packets.for_each(|packet| {
            let Some(Ok(data)) = DataPacket::parse(packet.payload) else { return true };
            let begin = *begin_ns.get_or_insert(packet.stamp_ns);
            for firing in data.firings().skip(std::mem::take(&mut skip)) {
                let Some(line) = out.get_mut(row * cols..(row + 1) * cols).filter(|_| row < rows) else { return false };
                write_firing(&data, firing, (packet.stamp_ns - begin, revolution.duration_ns), line);
                row += 1;
            }
            row < rows
        })?;
        if row == rows { Ok(()) } else { Err(changed()) }
    }
}

fn write_firing(data: &DataPacket<'_>, firing: Firing, (packet_ns, duration_ns): (i64, u64), line: &mut [Point]) {
    for shot in data.shots(firing) {
        let [x, y, z] = shot.position;
        let Some(cell) = line.get_mut(shot.place).filter(|_| x.is_finite()) else { continue };
        let share = (packet_ns as f64 + 1e3 * f64::from(shot.time_us)) / duration_ns.max(1) as f64;
        let time = (65535.0 * share.clamp(0.0, 1.0)).round() as u16;
        *cell = Point { x, y, z, intensity: u16::from(shot.strength), time };
    }
}

/// What is noted on the first way through a file.
#[derive(Default)]
struct Index {
    first_offset: Option<u64>,
    model: Option<Model>,
    seam: Seam,
    begun: Vec<Begun>,
    bad: u64,
    fault: Option<PacketFault>,
}

/// A revolution that has begun.
struct Begun {
    offset: u64,
    skip: usize,
    packet_ns: i64,
    /// Of its first firing [ns].
    start_ns: i64,
    firings: usize,
    /// Begins at a seam, not where the capture does.
    is_whole: bool,
}

impl Index {
    fn note(&mut self, fault: PacketFault) {
        self.bad += 1;
        self.fault.get_or_insert(fault);
    }

    fn take(&mut self, offset: u64, stamp_ns: i64, data: &DataPacket<'_>) {
        if *self.model.get_or_insert(data.model) != data.model {
            self.bad += 1;
            return;
        }
        for (skip, firing) in data.firings().enumerate() {
            let is_crossed = self.seam.is_crossed(&firing);
            if is_crossed || self.begun.is_empty() {
                let start_ns = stamp_ns + (1e3 * firing.time_us) as i64;
                let begun = Begun { offset, skip, packet_ns: stamp_ns, start_ns, firings: 0, is_whole: is_crossed };
                self.begun.push(begun);
            }
            if let Some(last) = self.begun.last_mut() {
                last.firings += 1;
            }
        }
    }

    /// The revolutions between two seams; a gap in the capture makes a short one, which is none.
    fn whole(&self, model: Model) -> Vec<Revolution> {
        let most = self.begun.iter().map(|begun| begun.firings).max().unwrap_or(0);
        let pairs = self.begun.iter().zip(self.begun.iter().skip(1));
        pairs
            .filter(|(begun, _)| begun.is_whole && begun.firings as f64 >= WHOLE * most as f64)
            .map(|(begun, next)| Revolution {
                stamp_ns: begun.packet_ns,
                duration_ns: u64::try_from(next.start_ns - begun.packet_ns).unwrap_or(0),
                grid: Grid { rows: begun.firings, cols: model.lasers() },
                offset: begun.offset,
                skip: begun.skip,
            })
            .collect()
    }

    /// What the packets of the right size were instead.
    fn other_words(&self) -> String {
        match self.fault {
            None => String::new(),
            Some(PacketFault::Model(code)) => format!("{} are of another model (code {code:#04x})", self.bad),
            Some(PacketFault::NoMark | PacketFault::Azimuth) => format!("{} have the size but not the form", self.bad),
        }
    }
}

fn head_of(path: &Path, length: u64) -> Result<Vec<u8>, CaptureError> {
    let fail = |source| CaptureError::Io { path: path.to_owned(), source };
    let mut head = Vec::new();
    File::open(path).map_err(fail)?.take(length).read_to_end(&mut head).map_err(fail)?;
    Ok(head)
}
