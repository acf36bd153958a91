//! A scan put together from what the turning laser says: sweeps of beams, each with a time of its own, and readings of
//! the head's encoder in between (section 1).
//!
//! Nothing is taken for granted of the way here: packets may be missing, late, repeated, in any order, or of another
//! turn of the head. A packet counts by its own number and time; what does not fit most of the others is left out.
//! A beam whose time no two readings bracket closely enough, and a sweep that never came, are empty cells: no point is
//! ever invented.

mod packets;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use self::packets::{Kept, Timeline};
use super::{Grid, Point};
use crate::threads;

/// What turns and how it speaks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TurningHead {
    /// The order of the scan: a row a sweep, a column a beam.
    pub grid: (usize, usize),
    /// Azimuth of the head at the home switch, scanner frame [rad].
    pub home: f64,
    /// From sweep to sweep [ns].
    pub sweep_ns: i64,
    /// From reading to reading of the encoder [ns].
    pub tick_ns: i64,
    /// Angle of a count of the encoder, which rounds down [rad]; 0 for one that does not round.
    pub count: f64,
    /// Beams between two readings farther apart than this are left out [ns].
    pub gap_ns: i64,
}

impl TurningHead {
    /// The source's head: sweeps every 20 ms, readings every 10 ms with 14 bits a turn; four readings in a row may be
    /// missing.
    #[must_use]
    pub fn new(grid: Grid, home: f64) -> Self {
        let count = std::f64::consts::TAU / 16384.0;
        let (sweep_ns, tick_ns, gap_ns) = (20_000_000, 10_000_000, 50_000_000);
        Self { grid: (grid.rows, grid.cols), home, sweep_ns, tick_ns, count, gap_ns }
    }

    /// The order of its scans.
    #[must_use]
    pub fn grid(&self) -> Grid {
        Grid { rows: self.grid.0, cols: self.grid.1 }
    }
}

/// A reading of the encoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadReading {
    /// When [ns].
    pub stamp_ns: i64,
    /// Of the head since the home switch [rad].
    pub angle: f64,
    /// Counts the readings since the home switch.
    pub reading: u32,
}

/// What is said of a sweep beside its beams.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepHead {
    /// Time of the first beam [ns].
    pub stamp_ns: i64,
    /// From the first to the last beam [ns].
    pub duration_ns: u64,
    /// Angle of the first beam over the horizon ahead of the head [rad].
    pub first_angle: f64,
    /// From beam to beam [rad].
    pub angle_step: f64,
    /// Counts the sweeps of the device.
    pub sweep: u32,
}

/// A beam of a sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepBeam {
    /// Range [m]; anything but a positive number is no return.
    pub range: f32,
    /// Sensor's own scale.
    pub intensity: u16,
    /// Time as a fraction of the sweep, 0 to 65535.
    pub time: u16,
}

/// What became of the packets of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PacketCounts {
    /// Rows of the grid without a sweep.
    pub missing_sweeps: u32,
    /// Readings of the encoder that were not there.
    pub missing_readings: u32,
    /// Sweeps and readings that came again.
    pub repeated: u32,
    /// Sweeps and readings that came after a later one.
    pub late: u32,
    /// Sweeps and readings whose time or form does not fit the others'.
    pub unfit: u32,
    /// Sweeps before the home switch or after the last row.
    pub outside: u32,
    /// Sweeps and readings for which there was no room.
    pub surplus: u32,
    /// Beams with a range that no two readings bracket closely enough.
    pub unplaced_beams: u32,
}

impl PacketCounts {
    /// Whether all went well.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        *self == Self { outside: self.outside, ..Self::default() }
    }
}

/// A scan that is put together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assembled {
    /// Time of the first beam of the first row [ns].
    pub begin_ns: i64,
    /// From the first beam to the last [ns].
    pub duration_ns: u64,
    /// Cells with a return.
    pub returns: usize,
    /// What became of the packets.
    pub counts: PacketCounts,
}

/// Takes the packets of one scan after the other. Its memory is that of one scan, and is kept.
#[derive(Debug, Clone)]
pub struct ScanAssembly {
    head: TurningHead,
    kept: Kept,
}

impl ScanAssembly {
    /// Waits for the packets of a scan.
    #[must_use]
    pub fn new(head: TurningHead) -> Self {
        Self { head, kept: Kept::new(&head) }
    }

    /// The head it was made for.
    #[must_use]
    pub fn head(&self) -> &TurningHead {
        &self.head
    }

    /// Forgets the packets: another scan begins.
    pub fn clear(&mut self) {
        self.kept.clear();
    }

    /// Whether nothing has come yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.kept.sweeps() + self.kept.readings() == 0
    }

    /// Sweeps kept up to now.
    #[must_use]
    pub fn sweeps(&self) -> usize {
        self.kept.sweeps()
    }

    /// Readings kept up to now.
    #[must_use]
    pub fn readings(&self) -> usize {
        self.kept.readings()
    }

    /// Takes a reading of the encoder.
    pub fn add_reading(&mut self, reading: HeadReading) {
        self.kept.add_reading(reading);
    }

    /// Takes a sweep.
    pub fn add_sweep(&mut self, sweep: SweepHead, beams: impl ExactSizeIterator<Item = SweepBeam>) {
        self.kept.add_sweep(sweep, beams, &self.head);
    }

    /// Whether every row has its sweep and the readings reach to the last beam: waiting longer gives nothing.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        // Only when the numbers allow for it is it worth a closer look.
        if self.kept.sweeps() < self.head.grid.0 || self.kept.readings() < 2 {
            return false;
        }
        let timeline = Timeline::new(&self.head, &self.kept);
        let (last, reach) = timeline.span();
        timeline.counts.missing_sweeps == 0 && reach >= last
    }

    /// What [`ScanAssembly::write`] would find, without the beams: neither returns nor unplaced beams are counted.
    #[must_use]
    pub fn survey(&self) -> Option<Assembled> {
        let Timeline { begin_ns, duration_ns, counts, .. } = Timeline::new(&self.head, &self.kept);
        begin_ns.map(|begin_ns| Assembled { begin_ns, duration_ns, returns: 0, counts })
    }

    /// Puts the scan together from what is there: one point a cell in the scanner's frame, on `threads` threads. `None`,
    /// with every cell empty, when there is not a single sweep that readings place.
    ///
    /// # Errors
    /// When `points` does not have one element a cell; the error is their number.
    pub fn write(&self, threads: usize, points: &mut [Point]) -> Result<Option<Assembled>, usize> {
        let grid = self.head.grid();
        if points.len() != grid.cells() {
            return Err(grid.cells());
        }
        let timeline = Timeline::new(&self.head, &self.kept);
        let mut tallies = vec![Tally::default(); grid.rows];
        let rows = points.chunks_mut(grid.cols.max(1)).zip(&mut tallies).enumerate();
        threads::for_each(rows, threads, |(row, (line, tally))| {
            *tally = self.write_row(&timeline, row, line);
        });
        let mut counts = timeline.counts;
        counts.unplaced_beams = tallies.iter().map(|tally| tally.unplaced).sum();
        let returns = tallies.iter().map(|tally| tally.returns).sum();
        Ok(timeline.begin_ns.map(|begin_ns| Assembled { begin_ns, duration_ns: timeline.duration_ns, returns, counts }))
    }

    fn write_row(&self, timeline: &Timeline<'_>, row: usize, line: &mut [Point]) -> Tally {
        let mut tally = Tally::default();
        line.fill(Point::EMPTY);
        let (Some(slot), Some(begin_ns)) = (timeline.row(row), timeline.begin_ns) else { return tally };
        let (sweep, beams) = self.kept.sweep(slot);
        let mut course = timeline.course();
        for (beam, (point, said)) in line.iter_mut().zip(beams).enumerate() {
            if !(said.range.is_finite() && said.range > 0.0) {
                continue;
            }
            let within = f64::from(said.time) / 65535.0 * sweep.duration_ns as f64;
            let Some(angle) = course.angle(sweep.stamp_ns, within) else {
                tally.unplaced += 1;
                continue;
            };
            let (azimuth_sin, azimuth_cos) = (self.head.home + angle).sin_cos();
            let (sin, cos) = (sweep.first_angle + sweep.angle_step * beam as f64).sin_cos();
            let range = f64::from(said.range);
            let level = range * cos;
            let after = sweep.stamp_ns.saturating_sub(begin_ns) as f64 + within;
            let fraction = (after / timeline.duration_ns.max(1) as f64).clamp(0.0, 1.0);
            *point = Point {
                x: (level * azimuth_cos) as f32,
                y: (level * azimuth_sin) as f32,
                z: (range * sin) as f32,
                intensity: said.intensity,
                time: (65535.0 * fraction).round() as u16,
            };
            tally.returns += 1;
        }
        tally
    }
}

/// What a row came to.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    returns: usize,
    unplaced: u32,
}
