//! Two strategies are only to be compared where they have come to the same: how much effort does one need to reach the
//! coverage and the quality that another ends with?

use super::Group;

/// What a strategy needed to reach what another ended with, run by run of the same seed.
#[derive(Debug, Clone, PartialEq)]
pub struct Matched {
    /// Pairs of runs.
    pub pairs: usize,
    /// Of those, how many times both coverage and quality were reached at some scan.
    pub reached: usize,
    /// Scans until then over all scans of the other; infinite where it was not reached.
    pub scans: Vec<f64>,
    /// The same of metres driven.
    pub metres: Vec<f64>,
    /// The same of mission time.
    pub mission: Vec<f64>,
}

/// Compares `own` with `other`, both in one world.
#[must_use]
pub fn matched(own: &Group, other: &Group) -> Matched {
    let mut found = Matched { pairs: 0, reached: 0, scans: Vec::new(), metres: Vec::new(), mission: Vec::new() };
    for other in &other.runs {
        let (Some(own), Some(end)) = (own.runs.iter().find(|run| run.seed == other.seed), other.last()) else {
            continue;
        };
        found.pairs += 1;
        let reached = own.reaches(end.coverage, end.quality).and_then(|k| Some((k, own.steps.get(k)?)));
        let Some((scan, step)) = reached else {
            for ratios in [&mut found.scans, &mut found.metres, &mut found.mission] {
                ratios.push(f64::INFINITY);
            }
            continue;
        };
        found.reached += 1;
        found.scans.push((scan + 1) as f64 / other.steps.len() as f64);
        // Whoever did not drive at all is matched by not driving.
        let over = |own: f64, other: f64| if own == other { 1.0 } else { own / other };
        found.metres.push(over(step.metres, end.metres));
        found.mission.push(over(step.mission_s, end.mission_s));
    }
    found
}

impl Matched {
    /// The median of ratios, `None` when that run did not reach it, or without runs.
    #[must_use]
    pub fn median(ratios: &[f64]) -> Option<f64> {
        crate::Summary::of(ratios).map(|summary| summary.p50).filter(|median| median.is_finite())
    }
}
