//! Sensors that fall silent or babble for a while: what does the rest of the graph make of it?

use mirador_core::simulation::Readings;
use serde::{Deserialize, Serialize};

/// A sensor by the topic that it speaks on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorTopic {
    /// Wheels.
    Odometry,
    /// Inertial unit.
    Imu,
    /// Satellite receiver.
    Gnss,
    /// Magnetometer.
    Magnetometer,
    /// Ultrasonic rangers.
    Rangers,
    /// Battery.
    Battery,
    /// All fixed lasers.
    PlanarScan,
    /// The laser on the turning head.
    LaserSweep,
    /// The head itself.
    Encoder,
}

/// What is wrong with a sensor for a while.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SensorFault {
    /// Which sensor.
    pub topic: SensorTopic,
    /// From this simulated time on [s], 0 or more,
    pub from_s: f64,
    /// and before this one [s].
    pub to_s: f64,
    /// It says everything so many times, 0 to 1,000: 0 is silence, much more than 1 is babble.
    #[serde(default)]
    pub repeats: usize,
}

/// What would be right for each number.
pub(crate) const TIMES: &str = "0 or more, and from_s before to_s";
pub(crate) const REPEATS: &str = "0 (silence) to 1000";

impl SensorFault {
    /// The field that is out of range with its value, if one is.
    pub(crate) fn wrong_field(&self) -> Option<(&'static str, f64, &'static str)> {
        if !(self.from_s >= 0.0 && self.from_s.is_finite()) {
            return Some(("faults.from_s", self.from_s, TIMES));
        }
        if !(self.to_s > self.from_s && self.to_s.is_finite()) {
            return Some(("faults.to_s", self.to_s, TIMES));
        }
        (self.repeats > 1000).then_some(("faults.repeats", self.repeats as f64, REPEATS))
    }

    /// Spoils what the sensor has said up to a simulated time [s].
    pub(crate) fn spoil(&self, time: f64, readings: &mut Readings) {
        if !(self.from_s..self.to_s).contains(&time) {
            return;
        }
        let repeats = self.repeats;
        match self.topic {
            SensorTopic::Odometry => repeat(&mut readings.odometry, repeats),
            SensorTopic::Imu => repeat(&mut readings.imu, repeats),
            SensorTopic::Gnss => repeat(&mut readings.gnss, repeats),
            SensorTopic::Magnetometer => repeat(&mut readings.magnetometer, repeats),
            SensorTopic::Rangers => repeat(&mut readings.rangers, repeats),
            SensorTopic::Battery => repeat(&mut readings.battery, repeats),
            SensorTopic::PlanarScan => repeat(&mut readings.planar, repeats),
            SensorTopic::LaserSweep => repeat(&mut readings.sweeps, repeats),
            SensorTopic::Encoder => repeat(&mut readings.ticks, repeats),
        }
    }
}

fn repeat<R: Clone>(readings: &mut Vec<R>, repeats: usize) {
    *readings = readings.iter().flat_map(|reading| std::iter::repeat_n(reading.clone(), repeats)).collect();
}

#[cfg(test)]
mod tests {
    use mirador_core::simulation::BatteryReading;

    use super::*;

    #[test]
    fn a_sensor_says_nothing_or_too_much_while_the_fault_lasts_and_the_others_speak_on() {
        let said = |repeats: usize, time: f64| {
            let battery = BatteryReading { time, voltage: 24.0, current: 1.0, charge: 0.9, is_low: false };
            let mut readings = Readings { battery: vec![battery; 2], ..Readings::default() };
            let fault = |topic| SensorFault { topic, from_s: 1.0, to_s: 2.0, repeats };
            fault(SensorTopic::Imu).spoil(time, &mut readings);
            assert_eq!(readings.battery.len(), 2);
            fault(SensorTopic::Battery).spoil(time, &mut readings);
            readings.battery.len()
        };
        assert_eq!([0.9, 1.0, 1.9, 2.0].map(|time| said(0, time)), [2, 0, 0, 2]);
        assert_eq!(said(5, 1.5), 10);
    }
}
