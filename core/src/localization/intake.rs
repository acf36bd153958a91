//! Readings wait here until their time has come; what cannot be used is refused and counted.

use std::collections::VecDeque;

use super::readings::Reading;

/// Readings that may wait; more than the sensors of one robot say in several seconds.
const CAPACITY: usize = 4096;
/// A stamp farther ahead of the time than this is wrong [ns].
const AHEAD_NS: i64 = 1_000_000_000;

/// What was refused of one sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SensorRefusals {
    /// Values that are not finite, or that no such sensor could mean.
    pub bad_values: u64,
    /// Stamps not after the sensor's last one, or before what the estimate is already past.
    pub out_of_order: u64,
    /// Stamps more than a second ahead.
    pub ahead: u64,
    /// More readings than can wait.
    pub too_many: u64,
}

impl SensorRefusals {
    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.bad_values + self.out_of_order + self.ahead + self.too_many
    }
}

/// What was refused of each sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Refusals {
    /// Inertial unit.
    pub imu: SensorRefusals,
    /// Wheels.
    pub wheels: SensorRefusals,
    /// Satellite receiver.
    pub gnss: SensorRefusals,
    /// Magnetometer.
    pub magnetometer: SensorRefusals,
    /// Level laser.
    pub laser: SensorRefusals,
}

impl Refusals {
    fn of(&mut self, sensor: usize) -> &mut SensorRefusals {
        match sensor {
            0 => &mut self.imu,
            1 => &mut self.wheels,
            2 => &mut self.gnss,
            3 => &mut self.magnetometer,
            _ => &mut self.laser,
        }
    }
}

/// The readings that wait, in the order in which they will count.
#[derive(Debug, Clone, Default)]
pub(super) struct Intake {
    waiting: VecDeque<Reading>,
    /// The newest stamp of each sensor.
    newest: [Option<i64>; 5],
    /// Everything up to here has counted.
    done_ns: Option<i64>,
    pub refusals: Refusals,
}

impl Intake {
    /// Takes a reading in, if it can be used.
    pub fn push(&mut self, reading: Reading) {
        let (sensor, stamp) = (reading.sensor(), reading.stamp_ns());
        let refusals = self.refusals.of(sensor);
        if !reading.is_finite() || reading.is_absurd() {
            refusals.bad_values += 1;
        } else if self.done_ns.is_some_and(|done| stamp > done.saturating_add(AHEAD_NS)) {
            refusals.ahead += 1;
        } else if self.newest[sensor].is_some_and(|newest| stamp <= newest)
            || self.done_ns.is_some_and(|done| stamp <= done)
        {
            refusals.out_of_order += 1;
        } else if self.waiting.len() >= CAPACITY {
            refusals.too_many += 1;
        } else {
            self.newest[sensor] = Some(stamp);
            let key = (stamp, sensor);
            let at = self.waiting.partition_point(|other| (other.stamp_ns(), other.sensor()) <= key);
            self.waiting.insert(at, reading);
        }
    }

    /// The next reading up to a time.
    pub fn next(&mut self, until_ns: i64) -> Option<Reading> {
        self.waiting.front().is_some_and(|reading| reading.stamp_ns() <= until_ns).then(|| self.waiting.pop_front())?
    }

    /// Everything up to a time has counted.
    pub fn done(&mut self, until_ns: i64) {
        self.done_ns = Some(until_ns);
    }
}
