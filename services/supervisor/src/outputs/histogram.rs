//! Latencies in bounded memory: HDR histograms.

use hdrhistogram::Histogram;
use serde::Serialize;

/// Significant digits that are kept: quantiles are at most a thousandth too high.
const DIGITS: u8 = 3;

/// Quantiles of latencies [ms]; null where nothing was measured.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Quantiles {
    /// Median.
    pub p50: Option<f64>,
    /// 90th percentile.
    pub p90: Option<f64>,
    /// 99th percentile.
    pub p99: Option<f64>,
    /// 99.9th percentile.
    pub p99_9: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// Number of measurements.
    pub n: usize,
}

/// So many are kept as they are before the histogram takes over.
const EXACT: usize = 1000;

/// Any number of latencies. The first thousand give exact quantiles, every one of which was measured; with more of them the
/// memory grows with the logarithm of the largest one, not with their number.
#[derive(Debug, Clone, Default)]
pub struct Latencies {
    few: Vec<u64>,
    /// All of them, once they are not few any more.
    many: Option<Histogram<u64>>,
    largest: u64,
}

impl Latencies {
    /// The latencies [ns].
    pub fn of(ns: impl IntoIterator<Item = u64>) -> Self {
        let mut latencies = Self::default();
        ns.into_iter().for_each(|ns| latencies.add(ns));
        latencies
    }

    /// Adds one [ns].
    pub fn add(&mut self, ns: u64) {
        self.largest = self.largest.max(ns);
        if self.many.is_none() && self.few.len() == EXACT {
            // Its own check of the digits cannot fail for a constant that is in range.
            self.many = Histogram::new(DIGITS).ok();
            if let Some(many) = &mut self.many {
                self.few.drain(..).for_each(|ns| record(many, ns));
            }
        }
        match &mut self.many {
            Some(many) => record(many, ns),
            None => self.few.push(ns),
        }
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.many.as_ref().map_or(self.few.len() as u64, Histogram::len)
    }

    /// The smallest value that at least this share of all values does not exceed [ns]; `None` without values.
    #[must_use]
    pub fn quantile(&self, share: f64) -> Option<u64> {
        if let Some(many) = &self.many {
            // The histogram answers with the upper end of the class; no value lies above the largest.
            return Some(many.value_at_quantile(share).min(self.largest));
        }
        let mut sorted = self.few.clone();
        sorted.sort_unstable();
        let rank = (share * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.saturating_sub(1)).copied()
    }

    /// All quantiles that are shown [ms].
    #[must_use]
    pub fn quantiles(&self) -> Quantiles {
        let ms = |share: f64| self.quantile(share).map(|ns| ns as f64 / 1e6);
        Quantiles {
            p50: ms(0.5),
            p90: ms(0.9),
            p99: ms(0.99),
            p99_9: ms(0.999),
            max: ms(1.0),
            n: usize::try_from(self.count()).unwrap_or(usize::MAX),
        }
    }
}

/// Records a value; the histogram grows to have a place for it.
fn record(histogram: &mut Histogram<u64>, ns: u64) {
    if histogram.record(ns).is_err() {
        // It cannot grow so far: it counts as the largest that there is a place for.
        histogram.saturating_record(ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_values_to_three_digits() {
        let q = Latencies::of((1..=2000).rev().map(|k| k * 1_000_000)).quantiles();
        let near = |found: Option<f64>, expected: f64| {
            let found = found.unwrap();
            assert!(found >= expected && found <= expected * 1.001, "{found} for {expected}");
        };
        near(q.p50, 1000.0);
        near(q.p90, 1800.0);
        near(q.p99, 1980.0);
        near(q.p99_9, 1998.0);
        assert_eq!((q.max, q.n), (Some(2000.0), 2000));
        let few = Latencies::of((1..=200).rev().map(|k| k * 1_000_000)).quantiles();
        assert_eq!((few.p50, few.p99, few.p99_9), (Some(100.0), Some(198.0), Some(200.0)), "exact");
        assert_eq!(Latencies::default().quantiles(), Quantiles::default());
    }

    #[test]
    fn values_of_one_size_are_all_their_quantiles_however_large_and_many() {
        for (ns, n) in [(0, 1), (1, 1001), (7_000_000, 5000), (u64::MAX / 4, 1), (u64::MAX / 4, 3000)] {
            let q = Latencies::of(std::iter::repeat_n(ns, n)).quantiles();
            assert_eq!((q.p50, q.p99_9, q.max, q.n), (q.max, q.max, Some(ns as f64 / 1e6), n), "{ns}");
        }
    }
}
