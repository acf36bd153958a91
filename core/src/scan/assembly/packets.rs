//! The packets of a scan as they are kept, and what their numbers and times say together.

use super::{HeadReading, PacketCounts, SweepBeam, SweepHead, TurningHead};

/// Packets kept beyond those of a whole scan: of a turn that was broken off, or from before the home switch.
const SPARE: usize = 64;
/// No return.
const NOTHING: SweepBeam = SweepBeam { range: f32::NAN, intensity: 0, time: 0 };

/// Everything that has come, once.
#[derive(Debug, Clone)]
pub(super) struct Kept {
    sweeps: Vec<SweepHead>,
    /// `cols` a sweep, in the order of `sweeps`.
    beams: Vec<SweepBeam>,
    cols: usize,
    readings: Vec<HeadReading>,
    most_sweeps: usize,
    most_readings: usize,
    newest_sweep: Option<(i64, u32)>,
    newest_reading: Option<(i64, u32)>,
    counts: PacketCounts,
}

impl Kept {
    pub fn new(head: &TurningHead) -> Self {
        let (rows, cols) = head.grid;
        let most_readings = rows * usize::try_from(head.sweep_ns / head.tick_ns.max(1)).unwrap_or(1).max(1);
        let (most_sweeps, most_readings) = (rows + SPARE, most_readings + 2 * SPARE);
        Self {
            sweeps: Vec::with_capacity(most_sweeps),
            beams: Vec::with_capacity(most_sweeps * cols),
            cols,
            readings: Vec::with_capacity(most_readings),
            most_sweeps,
            most_readings,
            newest_sweep: None,
            newest_reading: None,
            counts: PacketCounts::default(),
        }
    }

    pub fn clear(&mut self) {
        self.sweeps.clear();
        self.beams.clear();
        self.readings.clear();
        (self.newest_sweep, self.newest_reading) = (None, None);
        self.counts = PacketCounts::default();
    }

    pub fn sweeps(&self) -> usize {
        self.sweeps.len()
    }

    pub fn readings(&self) -> usize {
        self.readings.len()
    }

    pub fn sweep(&self, slot: usize) -> (&SweepHead, &[SweepBeam]) {
        (&self.sweeps[slot], &self.beams[slot * self.cols..(slot + 1) * self.cols])
    }

    pub fn add_reading(&mut self, reading: HeadReading) {
        let key = (reading.stamp_ns, reading.reading);
        if !reading.angle.is_finite() {
            self.counts.unfit += 1;
            return;
        }
        // What comes in order, as nearly all do, cannot have come before.
        let is_newest = self.newest_reading.is_none_or(|newest| key > newest);
        if !is_newest {
            if self.readings.iter().any(|kept| (kept.stamp_ns, kept.reading) == key) {
                self.counts.repeated += 1;
                return;
            }
            self.counts.late += 1;
        }
        if self.readings.len() == self.most_readings {
            self.counts.surplus += 1;
            return;
        }
        if is_newest {
            self.newest_reading = Some(key);
        }
        self.readings.push(reading);
    }

    pub fn add_sweep(&mut self, sweep: SweepHead, beams: impl ExactSizeIterator<Item = SweepBeam>, head: &TurningHead) {
        let key = (sweep.stamp_ns, sweep.sweep);
        let fits = sweep.first_angle.is_finite()
            && sweep.angle_step.is_finite()
            && sweep.duration_ns <= head.sweep_ns.unsigned_abs()
            && beams.len() == self.cols;
        if !fits {
            self.counts.unfit += 1;
            return;
        }
        let is_newest = self.newest_sweep.is_none_or(|newest| key > newest);
        if !is_newest {
            if self.sweeps.iter().any(|kept| (kept.stamp_ns, kept.sweep) == key) {
                self.counts.repeated += 1;
                return;
            }
            self.counts.late += 1;
        }
        if self.sweeps.len() == self.most_sweeps && !self.make_room(head) {
            self.counts.surplus += 1;
            return;
        }
        if is_newest {
            self.newest_sweep = Some(key);
        }
        self.sweeps.push(sweep);
        self.beams.extend(beams);
        // An iterator that breaks its word must not shift the beams of others.
        self.beams.resize(self.sweeps.len() * self.cols, NOTHING);
    }

    /// Lets go of sweeps outside the scan, as come from a laser that never pauses. Whether there is room then.
    fn make_room(&mut self, head: &TurningHead) -> bool {
        let Some(home_ns) = home_ns(head, &self.readings) else { return false };
        let outside = |sweep: &SweepHead| !(0..head.grid.0 as i64).contains(&row_at(head, home_ns, sweep.stamp_ns));
        let mut to = 0;
        for from in 0..self.sweeps.len() {
            if outside(&self.sweeps[from]) {
                self.counts.outside += 1;
                continue;
            }
            self.sweeps[to] = self.sweeps[from];
            self.beams.copy_within(from * self.cols..(from + 1) * self.cols, to * self.cols);
            to += 1;
        }
        self.sweeps.truncate(to);
        self.beams.truncate(to * self.cols);
        to < self.most_sweeps
    }
}

/// The row whose time is nearest.
fn row_at(head: &TurningHead, home_ns: i64, stamp_ns: i64) -> i64 {
    let after = stamp_ns.saturating_sub(home_ns).saturating_add(head.sweep_ns / 2);
    after.div_euclid(head.sweep_ns.max(1))
}

/// When the head was at home, by most of the readings.
fn home_ns(head: &TurningHead, readings: &[HeadReading]) -> Option<i64> {
    let mut homes: Vec<i64> = readings.iter().map(|reading| home_by(head, reading)).collect();
    median(&mut homes)
}

fn home_by(head: &TurningHead, reading: &HeadReading) -> i64 {
    reading.stamp_ns.saturating_sub(i64::from(reading.reading).saturating_mul(head.tick_ns))
}

/// The middle one; of an even number the lower.
fn median(values: &mut [i64]) -> Option<i64> {
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable(middle).1)
}

/// Which sweep is which row, and where the head was when.
pub(super) struct Timeline<'a> {
    head: &'a TurningHead,
    kept: &'a Kept,
    /// By row: the place of its sweep among the kept.
    rows: Vec<Option<usize>>,
    /// Readings that fit, by time.
    readings: Vec<HeadReading>,
    /// Time of the first row's first beam [ns]; `None` when no sweep has a row.
    pub begin_ns: Option<i64>,
    /// From there to the last row's last beam [ns].
    pub duration_ns: u64,
    pub counts: PacketCounts,
}

impl<'a> Timeline<'a> {
    pub fn new(head: &'a TurningHead, kept: &'a Kept) -> Self {
        let rows = vec![None; head.grid.0];
        let (readings, begin_ns, counts) = (Vec::new(), None, kept.counts);
        let mut timeline = Self { head, kept, rows, readings, begin_ns, duration_ns: 0, counts };
        if let Some(home_ns) = home_ns(head, &kept.readings) {
            timeline.sort_readings(home_ns);
            timeline.place_sweeps(home_ns);
        } else {
            timeline.counts.unfit += kept.sweeps.len() as u32;
        }
        timeline.counts.missing_sweeps = timeline.rows.iter().filter(|row| row.is_none()).count() as u32;
        timeline.counts.missing_readings = timeline.missing_readings();
        timeline
    }

    fn sort_readings(&mut self, home_ns: i64) {
        let off = |reading: &HeadReading| home_by(self.head, reading).saturating_sub(home_ns).saturating_abs();
        let fit = self.kept.readings.iter().filter(|reading| off(reading) < self.head.tick_ns / 2);
        self.readings.extend(fit.copied());
        self.counts.unfit += (self.kept.readings.len() - self.readings.len()) as u32;
        self.readings.sort_unstable_by_key(|reading| (reading.reading, reading.stamp_ns));
        let all = self.readings.len();
        self.readings.dedup_by_key(|reading| reading.reading);
        self.counts.repeated += (all - self.readings.len()) as u32;
    }

    /// A laser that runs freely begins its sweeps at any phase of the head's timer, but at always the same: the row is
    /// told by the sweep's number, and the number of the first row by most of the sweeps.
    fn place_sweeps(&mut self, home_ns: i64) {
        let head = self.head;
        let sweeps = &self.kept.sweeps;
        let number = |sweep: &SweepHead| i64::from(sweep.sweep);
        let mut offsets: Vec<i64> =
            sweeps.iter().map(|sweep| row_at(head, home_ns, sweep.stamp_ns) - number(sweep)).collect();
        let Some(offset) = median(&mut offsets) else { return };
        let row_of = |sweep: &SweepHead| number(sweep) + offset;
        let mut begins: Vec<i64> = sweeps
            .iter()
            .map(|sweep| sweep.stamp_ns.saturating_sub(row_of(sweep).saturating_mul(head.sweep_ns)))
            .collect();
        let Some(begin_ns) = median(&mut begins) else { return };
        for (slot, sweep) in sweeps.iter().enumerate() {
            let row = row_of(sweep);
            let off = sweep.stamp_ns.saturating_sub(begin_ns).saturating_sub(row.saturating_mul(head.sweep_ns));
            if off.saturating_abs() >= head.sweep_ns / 2 {
                self.counts.unfit += 1;
                continue;
            }
            let Some(place) = usize::try_from(row).ok().and_then(|row| self.rows.get_mut(row)) else {
                self.counts.outside += 1;
                continue;
            };
            let sooner = place.filter(|other| (sweeps[*other].stamp_ns, *other) <= (sweep.stamp_ns, slot));
            self.counts.repeated += u32::from(place.is_some());
            *place = sooner.or(Some(slot));
        }
        if self.rows.iter().any(Option::is_some) {
            let sweep_ns = sweeps.iter().map(|sweep| sweep.duration_ns).max().unwrap_or(0);
            self.begin_ns = Some(begin_ns);
            self.duration_ns = (head.grid.0 as u64).saturating_sub(1) * head.sweep_ns.unsigned_abs() + sweep_ns;
        }
    }

    fn missing_readings(&self) -> u32 {
        let Some(begin_ns) = self.begin_ns else { return 0 };
        let (head, first) = (self.head, self.readings.first());
        let Some(home_ns) = first.map(|reading| home_by(head, reading)) else { return 0 };
        // Those that bracket the first and the last beam, and all in between.
        let from = begin_ns.saturating_sub(home_ns).div_euclid(head.tick_ns);
        let after = begin_ns.saturating_add_unsigned(self.duration_ns).saturating_sub(home_ns);
        let to = after.saturating_add(head.tick_ns - 1).div_euclid(head.tick_ns);
        let range = from.max(0)..=to;
        let there = self.readings.iter().filter(|reading| range.contains(&i64::from(reading.reading))).count() as i64;
        u32::try_from(to.saturating_sub(from.max(0)).saturating_add(1).saturating_sub(there).max(0)).unwrap_or(u32::MAX)
    }

    /// When the last beam is fired and up to when there are readings [ns].
    pub fn span(&self) -> (i64, i64) {
        let last = self.begin_ns.map_or(i64::MAX, |begin| begin.saturating_add_unsigned(self.duration_ns));
        (last, self.readings.last().map_or(i64::MIN, |reading| reading.stamp_ns))
    }

    pub fn row(&self, row: usize) -> Option<usize> {
        self.rows.get(row).copied().flatten()
    }

    pub fn course(&self) -> Course<'_> {
        Course { head: self.head, readings: &self.readings, at: 0 }
    }
}

/// The head's angle over time; for times that go up it is quick.
pub(super) struct Course<'a> {
    head: &'a TurningHead,
    readings: &'a [HeadReading],
    at: usize,
}

impl Course<'_> {
    /// The head's angle since home [rad], `within` [ns] after a stamp, between the two readings that bracket it; `None`
    /// where there are no two or they are too far apart.
    pub fn angle(&mut self, stamp_ns: i64, within: f64) -> Option<f64> {
        // An integer stamp and a small rest: nothing is rounded away however far the clock has gone.
        let whole = within.floor();
        let (time_ns, rest) = (stamp_ns.saturating_add(whole as i64), within - whole);
        let brackets = |at: usize| {
            let [from, to] = [self.readings.get(at)?, self.readings.get(at + 1)?];
            (from.stamp_ns <= time_ns && time_ns <= to.stamp_ns).then_some((from, to))
        };
        let (from, to) = brackets(self.at).or_else(|| {
            self.at = self.readings.partition_point(|reading| reading.stamp_ns <= time_ns).checked_sub(1)?;
            // At the very last reading there is no next one.
            self.at = self.at.min(self.readings.len().checked_sub(2)?);
            brackets(self.at)
        })?;
        let between_ns = to.stamp_ns - from.stamp_ns;
        if between_ns > self.head.gap_ns || between_ns <= 0 {
            return None;
        }
        let share = ((time_ns - from.stamp_ns) as f64 + rest) / between_ns as f64;
        // A reading stands for all angles of its count: the middle is the best guess.
        Some(from.angle + share * (to.angle - from.angle) + 0.5 * self.head.count)
    }
}
