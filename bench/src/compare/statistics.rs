//! Two series of samples: whether one is greater than the other by more than a margin, and by how much.

use statrs::distribution::{ContinuousCDF, Normal};
use statrs::stats_tests::Alternative;
use statrs::stats_tests::mannwhitneyu::{MannWhitneyUMethod, mannwhitneyu};

use super::BATCHES;

/// The change from one series to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shift {
    /// Median of the ratios of a new to an old sample.
    pub ratio: f64,
    /// Ends of its confidence interval.
    pub interval: [f64; 2],
    /// The chance of such samples if the new ones are not greater by more than the margin.
    pub p_greater: f64,
    /// The chance of such samples if the new ones are not smaller by more than the margin.
    pub p_smaller: f64,
}

/// Samples that can be taken for independent of each other: the samples themselves, or the medians of consecutive
/// batches where there are many.
pub(super) fn independent(samples: &[f64]) -> Vec<f64> {
    if samples.len() < 2 * BATCHES {
        return samples.to_vec();
    }
    let bounds = (0..=BATCHES).map(|k| k * samples.len() / BATCHES).collect::<Vec<_>>();
    let batches = bounds.windows(2).filter_map(|b| samples.get(b[0]..b[1]));
    batches.filter_map(|batch| median(batch.to_vec())).collect()
}

/// How `new` differs from `old`, both positive or zero; `margin` is a share. `confidence` is that of the interval.
pub(super) fn shift(old: &[f64], new: &[f64], margin: f64, confidence: f64) -> Shift {
    let grown = |values: &[f64]| values.iter().map(|v| v * (1.0 + margin)).collect::<Vec<_>>();
    let (ratio, interval) = ratio(old, new, confidence);
    Shift { ratio, interval, p_greater: p_greater(new, &grown(old)), p_smaller: p_greater(old, &grown(new)) }
}

/// One-sided p-value of `a` being greater than `b`. Exact where the tail is small and no two values are the same, where
/// the normal approximation asks for too much; else by that; 1 where all values are the same.
fn p_greater(a: &[f64], b: &[f64]) -> f64 {
    let method = MannWhitneyUMethod::AsymptoticInclContinuityCorrection;
    let Ok((u, p)) = mannwhitneyu(a, b, method, Alternative::Greater) else { return 1.0 };
    let (most, mut all) = (a.len() * b.len(), [a, b].concat());
    all.sort_unstable_by(f64::total_cmp);
    let has_ties = all.windows(2).any(|pair| pair[0] == pair[1]);
    // Without ties u is a whole number.
    let from_the_top = most.saturating_sub(u as usize);
    if !has_ties && most <= BATCHES * BATCHES && from_the_top <= most / 4 {
        return exact_tail(a.len(), b.len(), from_the_top);
    }
    if p.is_finite() { p } else { 1.0 }
}

/// The chance that U of two series of these lengths from the same distribution is at most `u`. The orders with each U
/// are counted by their generating function, the product of (1 - q^(n+i)) / (1 - q^i) over i = 1..m (Mann and Whitney
/// 1947); counts in the tail are whole numbers that f64 holds exactly.
fn exact_tail(m: usize, n: usize, u: usize) -> f64 {
    let mut counts = vec![0.0; u + 1];
    counts[0] = 1.0;
    let mut orders = 1.0;
    for i in 1..=m {
        orders *= (n + i) as f64 / i as f64;
        for k in (n + i..=u).rev() {
            counts[k] -= counts[k - n - i];
        }
        for k in i..=u {
            counts[k] += counts[k - i];
        }
    }
    (counts.iter().sum::<f64>() / orders).clamp(0.0, 1.0)
}

/// The median of all ratios and its interval, by the ranks that the Mann-Whitney test leaves open (Hodges and Lehmann
/// 1963; Moses 1965). Ratios to zero are left out; without any the ratio is 1.
fn ratio(old: &[f64], new: &[f64], confidence: f64) -> (f64, [f64; 2]) {
    let mut ratios: Vec<f64> = new.iter().flat_map(|n| old.iter().filter(|o| **o > 0.0).map(move |o| n / o)).collect();
    ratios.sort_unstable_by(f64::total_cmp);
    let (m, n) = (old.len() as f64, new.len() as f64);
    let z = Normal::standard().inverse_cdf(0.5 + 0.5 * confidence);
    let outside = (m * n / 2.0 - z * (m * n * (m + n + 1.0) / 12.0).sqrt()).floor().max(0.0) as usize;
    let at = |k: usize| ratios.get(k.min(ratios.len().saturating_sub(1))).copied().unwrap_or(1.0);
    let last = ratios.len().saturating_sub(1);
    (median(ratios.clone()).unwrap_or(1.0), [at(outside), at(last.saturating_sub(outside))])
}

/// The middle value, or the mean of the two in the middle.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let half = values.len() / 2;
    let upper = *values.get(half)?;
    Some(if values.len() % 2 == 1 { upper } else { 0.5 * (upper + values.get(half.checked_sub(1)?)?) })
}

/// Holm's correction: the p-values of a family of tests, each so large that comparing it with `alpha` keeps the chance of
/// any error at all below `alpha`.
pub(super) fn holm(p_values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p_values.len()).collect();
    order.sort_by(|a, b| p_values[*a].total_cmp(&p_values[*b]));
    let mut adjusted = vec![1.0; p_values.len()];
    let mut largest = 0.0_f64;
    for (rank, place) in order.into_iter().enumerate() {
        largest = largest.max(p_values[place] * (p_values.len() - rank) as f64).min(1.0);
        adjusted[place] = largest;
    }
    adjusted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_p_value_is_that_of_the_published_test() {
        // The example in SciPy's documentation of its mannwhitneyu: 0.1111 on both sides, exactly 14 of 126 orders.
        let p = p_greater(&[19.0, 22.0, 16.0, 29.0, 24.0], &[20.0, 11.0, 17.0, 12.0]);
        assert!((p - 7.0 / 126.0).abs() < 1e-12, "{p}");
        // Two values are the same: the normal approximation, of SciPy too.
        let p = p_greater(&[19.0, 22.0, 16.0, 29.0, 24.0], &[20.0, 11.0, 16.0, 12.0]);
        assert!((0.03..0.06).contains(&p), "{p}");
        assert_eq!(p_greater(&[5.0; 9], &[5.0; 9]), 1.0);
    }

    /// Every order of few values, one by one.
    #[test]
    fn the_exact_tail_is_what_counting_gives() {
        let (m, n) = (4_usize, 5_usize);
        let mut counts = vec![0_u32; m * n + 1];
        for order in 0_u32..1 << (m + n) {
            if order.count_ones() as usize == m {
                let places = (0..m + n).filter(|k| order >> k & 1 == 1);
                let u: usize = places.enumerate().map(|(rank, place)| place - rank).sum();
                counts[u] += 1;
            }
        }
        let orders: u32 = counts.iter().sum();
        for u in 0..=m * n {
            let expected = f64::from(counts[..=u].iter().sum::<u32>()) / f64::from(orders);
            assert!((exact_tail(m, n, u) - expected).abs() < 1e-12, "{u}");
        }
        // One order of C(16, 8) = 12870.
        assert!((exact_tail(8, 8, 0) - 1.0 / 12_870.0).abs() < 1e-15);
    }

    #[test]
    fn holm_multiplies_by_the_tests_that_are_left() {
        // Worked through by hand: 0.01*4, 0.02*3, then never less than before.
        let adjusted = holm(&[0.02, 0.01, 0.04, 0.03]);
        let expected = [0.06, 0.04, 0.06, 0.06];
        assert!(adjusted.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{adjusted:?}");
        assert!(holm(&[]).is_empty());
    }

    #[test]
    fn the_ratio_is_that_of_the_series_and_inside_its_interval() {
        let old: Vec<f64> = (0..20).map(|k| 10.0 + 0.1 * f64::from(k)).collect();
        let new: Vec<f64> = old.iter().map(|v| v * 1.2).collect();
        let shift = shift(&old, &new, 0.05, 0.99);
        assert!((shift.ratio - 1.2).abs() < 1e-9, "{shift:?}");
        assert!(shift.interval[0] < 1.2 && shift.interval[1] > 1.2 && shift.interval[0] > 1.1, "{shift:?}");
        assert!(shift.p_greater < 1e-3 && shift.p_smaller > 0.99, "{shift:?}");
    }

    #[test]
    fn many_samples_become_the_medians_of_batches_and_few_stay() {
        let many: Vec<f64> = (0..300).map(f64::from).collect();
        let batches = independent(&many);
        assert_eq!((batches.len(), batches[0], batches[29]), (BATCHES, 4.5, 294.5));
        assert_eq!(independent(&many[..59]).len(), 59);
        assert_eq!(independent(&many[..61]).len(), BATCHES);
    }
}
