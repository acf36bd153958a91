//! The device's clock in ours: its microseconds since it was switched on, 32 bits that wrap every 71 minutes.
//!
//! A telegram can only be late, never early, so the least difference between arrival and the device's own time of sending
//! is nearest to the truth; that least is let rise slowly, as the two clocks drift.

/// Clocks of such devices are off by less than this.
const DRIFT: f64 = 200e-6;

/// Turns times of the device into ours.
#[derive(Debug, Clone, Default)]
pub(crate) struct DeviceClock {
    /// Time of the device without wrapping [us], and what came last of it.
    unwrapped_us: i64,
    last_us: Option<u32>,
    /// Our time less the device's [us], and when that was [us, ours].
    offset: Option<(f64, f64)>,
    /// The last time that was given out [ns].
    last_ns: Option<i64>,
}

impl DeviceClock {
    /// Our time [ns] of something the device measured at `measured_us` and sent at `sent_us` (its clock), which came here
    /// at `arrived_ns`.
    pub fn ours_ns(&mut self, measured_us: u32, sent_us: u32, arrived_ns: i64) -> i64 {
        let step = self.last_us.map_or(0, |last| i64::from(sent_us.wrapping_sub(last).cast_signed()));
        self.last_us = Some(sent_us);
        self.unwrapped_us += step;
        let arrived_us = arrived_ns as f64 * 1e-3;
        let seen = arrived_us - self.unwrapped_us as f64;
        let offset = match self.offset {
            // A step back or a long pause: the device was switched on again.
            Some((offset, at)) if step >= 0 && arrived_us - at < 60e6 => seen.min(offset + (arrived_us - at) * DRIFT),
            _ => seen,
        };
        self.offset = Some((offset, arrived_us));
        let age_us = f64::from(sent_us.wrapping_sub(measured_us));
        // The age of a sweep is a few milliseconds; a larger one is a device that was switched on in between.
        let age_us = if age_us < 1e6 { age_us } else { 0.0 };
        let ours_ns = ((self.unwrapped_us as f64 + offset - age_us) * 1e3) as i64;
        // While the least delay is still being found, times may be corrected to earlier ones; their order stays.
        let ours_ns = self.last_ns.filter(|_| step > 0).map_or(ours_ns, |last| ours_ns.max(last + 500 * step));
        self.last_ns = Some(ours_ns);
        ours_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn late_arrivals_do_not_shift_the_time_and_the_clock_may_wrap(
            start in any::<u32>(), delays in prop::collection::vec(0.0..20e3f64, 50..80),
        ) {
            let mut clock = DeviceClock::default();
            let mut errors = Vec::new();
            for (k, delay) in delays.iter().enumerate() {
                let truth_us = 20e3 * k as f64;
                let sent = start.wrapping_add((truth_us + 500.0) as u32);
                // One in three comes at once.
                let delay = if k % 3 == 0 { 0.0 } else { *delay };
                let arrived = ((1e9 + truth_us + 500.0 + delay) * 1e3) as i64;
                let ours = clock.ours_ns(start.wrapping_add(truth_us as u32), sent, arrived);
                errors.push((ours as f64 * 1e-3 - 1e9 - truth_us).abs());
            }
            prop_assert!(errors[3..].iter().all(|e| *e < 20.0), "{errors:?}");
        }
    }

    #[test]
    fn a_device_that_was_switched_on_again_begins_anew() {
        let mut clock = DeviceClock::default();
        clock.ours_ns(4_000_000, 4_000_500, 9_000_000_000_000);
        let ours = clock.ours_ns(1_000, 1_500, 9_010_000_000_000);
        assert!((ours - 9_009_999_500_000).abs() < 2_000, "{ours}");
    }
}
