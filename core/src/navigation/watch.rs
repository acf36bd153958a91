//! Whether the sensors that driving depends on speak, and make sense.

use std::fmt;

use super::config::WatchConfig;
use super::obstacles::{Echo, LaserView};

/// A sensor that driving depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Watched {
    /// The front laser.
    Laser,
    /// The ultrasonic rangers.
    Rangers,
}

impl fmt::Display for Watched {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Laser => "the front laser",
            Self::Rangers => "the ring of rangers",
        })
    }
}

/// What is wrong with a sensor.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SensorFault {
    /// It says nothing, or nothing that makes sense.
    #[error("{sensor} has said nothing of use for {seconds:.2} s ({refused} messages refused so far)")]
    Silent {
        /// Which.
        sensor: Watched,
        /// For how long [s].
        seconds: f64,
        /// What it said that makes no sense: values that are not finite, stamps that go back or are far ahead.
        refused: u64,
    },
    /// It says far too much.
    #[error("{sensor} babbles: {messages} messages within a second")]
    Babbles {
        /// Which.
        sensor: Watched,
        /// Within the second.
        messages: u32,
    },
}

/// What was taken and refused of both sensors: the laser, then the rangers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WatchCounters {
    /// Messages that made sense.
    pub taken: [u64; 2],
    /// Messages that did not.
    pub refused: [u64; 2],
}

#[derive(Debug, Clone, Copy, Default)]
struct Sensor {
    last_ns: Option<i64>,
    /// Messages since the second of `window_ns` began, and in the one before.
    messages: u32,
    window_ns: i64,
    babbled: u32,
}

/// Ears on both sensors.
#[derive(Debug, Clone, Default)]
pub(super) struct Watch {
    begun_ns: Option<i64>,
    now_ns: i64,
    sensors: [Sensor; 2],
    pub counters: WatchCounters,
}

const SECOND_NS: i64 = 1_000_000_000;

impl Watch {
    /// Whether a sweep may be used.
    pub fn laser(&mut self, view: &LaserView<'_>) -> bool {
        let mut mount = view.mount_xyz.iter().chain([&view.mount_yaw, &view.first_angle, &view.angle_step]);
        let ranges_fit = view.ranges.iter().all(|range| range.is_nan() || (0.0..1e4).contains(range));
        let makes_sense = mount.all(|x| x.is_finite()) && !view.ranges.is_empty() && ranges_fit;
        self.note(Watched::Laser, view.stamp_ns, makes_sense, false)
    }

    /// Whether an echo may be used.
    pub fn echo(&mut self, echo: &Echo) -> bool {
        let mut values = echo.mount_xyz.iter().chain(&echo.yaw_pitch).chain([&echo.aperture]);
        let makes_sense = values.all(|x| x.is_finite()) && (echo.range.is_nan() || (0.0..1e3).contains(&echo.range));
        // All rangers speak at the same time.
        self.note(Watched::Rangers, echo.stamp_ns, makes_sense, true)
    }

    fn note(&mut self, which: Watched, stamp_ns: i64, makes_sense: bool, may_repeat: bool) -> bool {
        let index = which as usize;
        let sensor = &mut self.sensors[index];
        sensor.messages = sensor.messages.saturating_add(1);
        let is_later = sensor.last_ns.is_none_or(|last| stamp_ns > last || (may_repeat && stamp_ns == last));
        let is_ahead = self.begun_ns.is_some() && stamp_ns > self.now_ns.saturating_add(SECOND_NS);
        let is_taken = makes_sense && is_later && !is_ahead;
        if is_taken {
            sensor.last_ns = Some(stamp_ns);
            self.counters.taken[index] += 1;
        } else {
            self.counters.refused[index] += 1;
        }
        is_taken
    }

    /// Lets time pass; what is wrong now, if anything.
    pub fn check(&mut self, now_ns: i64, config: &WatchConfig) -> Option<SensorFault> {
        let begun = *self.begun_ns.get_or_insert(now_ns);
        self.now_ns = now_ns;
        let mut fault = None;
        for (which, needed) in [(Watched::Laser, config.needs_laser), (Watched::Rangers, config.needs_rangers)] {
            let refused = self.counters.refused[which as usize];
            let sensor = &mut self.sensors[which as usize];
            if now_ns.saturating_sub(sensor.window_ns) >= SECOND_NS {
                (sensor.babbled, sensor.messages, sensor.window_ns) = (sensor.messages, 0, now_ns);
            }
            let messages = sensor.messages.max(sensor.babbled);
            if messages > config.max_messages_per_s {
                fault = fault.or(Some(SensorFault::Babbles { sensor: which, messages }));
            }
            let seconds = now_ns.saturating_sub(sensor.last_ns.unwrap_or(begun)) as f64 * 1e-9;
            if needed && seconds > config.silence_s {
                fault = fault.or(Some(SensorFault::Silent { sensor: which, seconds, refused }));
            }
        }
        fault
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(stamp_ns: i64, ranges: &[f32]) -> LaserView<'_> {
        LaserView { stamp_ns, first_angle: -1.5, angle_step: 0.01, mount_xyz: [0.5, 0.0, 0.4], mount_yaw: 0.0, ranges }
    }

    fn echo(stamp_ns: i64, range: f64) -> Echo {
        Echo { stamp_ns, sensor: 0, mount_xyz: [0.5, 0.0, 0.3], yaw_pitch: [0.0, 0.4], aperture: 0.3, range }
    }

    #[test]
    fn silence_and_nonsense_are_noticed_within_a_second_and_end_when_the_sensor_returns() {
        let config = WatchConfig::default();
        let mut watch = Watch::default();
        let step = 50_000_000;
        let ranges = [1.0_f32, f32::NAN, 2.0];
        for k in 0..40 {
            assert!(watch.laser(&view(k * step, &ranges)) && watch.echo(&echo(k * step, f64::NAN)));
            assert_eq!(watch.check(k * step, &config), None);
        }
        // Wrong stamps and bad values do not count as speaking.
        let mut noticed = None;
        for k in 40..60 {
            assert!(!watch.laser(&view(5 * step, &ranges)) && !watch.laser(&view(k * step, &[f32::INFINITY])));
            watch.echo(&echo(k * step, 0.6));
            noticed = noticed.or(watch.check(k * step, &config).map(|fault| (k, fault)));
        }
        let (k, fault) = noticed.unwrap();
        assert!(k - 40 <= 10, "after {} steps", k - 40);
        assert!(fault.to_string().starts_with("the front laser has said nothing of use for 0.5"), "{fault}");
        watch.laser(&view(60 * step, &ranges));
        watch.echo(&echo(60 * step, 0.6));
        assert_eq!(watch.check(60 * step, &config), None);
    }

    #[test]
    fn a_sensor_that_babbles_is_named() {
        let config = WatchConfig::default();
        let mut watch = Watch::default();
        watch.check(0, &config);
        (0..500).for_each(|k| assert!(watch.laser(&view(k + 1, &[1.0]))));
        let fault = watch.check(50_000_000, &config).unwrap();
        assert_eq!(fault, SensorFault::Babbles { sensor: Watched::Laser, messages: 500 });
    }
}
