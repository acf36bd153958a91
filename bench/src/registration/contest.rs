//! Contestants measured in turns, so that whatever else the machine does hits all of them alike.

use std::collections::BTreeMap;
use std::time::Duration;

use mirador_core::geometry::Pose;

/// What one run gave.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sample {
    /// From raw points in memory to the pose [ms].
    pub ms: f64,
    /// The share of each phase [ms].
    pub parts: BTreeMap<String, f64>,
    /// `target_from_source`.
    pub pose: Pose,
    /// Steps taken, if it says.
    pub iterations: Option<u64>,
    /// Share of the source's points with a partner, if it says.
    pub overlap: Option<f64>,
}

/// Somebody who aligns the same pair again and again.
pub(super) trait Contestant {
    /// Name for messages.
    fn label(&self) -> String;
    /// One run; an error says why there is none, and it is not asked again.
    fn run(&mut self) -> Result<Sample, String>;
}

/// What a contestant gave over all rounds.
#[derive(Debug, Default)]
pub(super) struct Outcome {
    /// One a round, without the round of warming up.
    pub samples: Vec<Sample>,
    /// Why it left the contest.
    pub failure: Option<String>,
}

/// A pause before every run [ms]: the threads that OpenMP and TBB keep spinning after a run must not slow the next one.
const PAUSE: Duration = Duration::from_millis(10);

/// Lets everyone run `rounds` times after one round of warming up, in an order that is reversed every round. The
/// outcomes are in the order of `contestants`. Who fails is reported to `say` and out.
pub(super) fn hold(
    contestants: &mut [Box<dyn Contestant + '_>],
    rounds: usize,
    say: &mut dyn FnMut(&str),
) -> Vec<Outcome> {
    let mut outcomes: Vec<Outcome> = contestants.iter().map(|_| Outcome::default()).collect();
    for round in 0..=rounds {
        let mut turns: Vec<_> = contestants.iter_mut().zip(&mut outcomes).collect();
        if round % 2 == 1 {
            turns.reverse();
        }
        for (contestant, outcome) in turns.into_iter().filter(|(_, outcome)| outcome.failure.is_none()) {
            std::thread::sleep(PAUSE);
            match contestant.run() {
                Ok(_) if round == 0 => {}
                Ok(sample) => outcome.samples.push(sample),
                Err(reason) => {
                    say(&format!("{} is left out: {reason}", contestant.label()));
                    outcome.failure = Some(reason);
                }
            }
        }
    }
    outcomes
}

/// The median by nearest rank; `None` without values.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    crate::Summary::of(&values).map(|summary| summary.p50)
}

/// The median of each phase [ms].
pub(super) fn median_parts(runs: &[&BTreeMap<String, f64>]) -> BTreeMap<String, f64> {
    let phases = runs.first().into_iter().flat_map(|parts| parts.keys());
    phases
        .filter_map(|phase| Some((phase.clone(), median(runs.iter().filter_map(|parts| parts.get(phase)).copied())?)))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    struct Scripted<'a> {
        name: &'static str,
        runs: u32,
        last: u32,
        log: &'a RefCell<String>,
    }

    impl Contestant for Scripted<'_> {
        fn label(&self) -> String {
            self.name.into()
        }

        fn run(&mut self) -> Result<Sample, String> {
            self.log.borrow_mut().push_str(self.name);
            self.runs += 1;
            if self.runs > self.last {
                return Err("tired".into());
            }
            let pose = Pose::identity();
            Ok(Sample { ms: f64::from(self.runs), parts: BTreeMap::new(), pose, iterations: None, overlap: None })
        }
    }

    #[test]
    fn all_run_in_turns_and_who_fails_is_out() {
        let log = RefCell::new(String::new());
        let scripted = |name, last| Scripted { name, runs: 0, last, log: &log };
        let mut contestants: Vec<Box<dyn Contestant + '_>> =
            vec![Box::new(scripted("a", 99)), Box::new(scripted("b", 2)), Box::new(scripted("c", 99))];
        let mut said = Vec::new();
        let outcomes = hold(&mut contestants, 3, &mut |line| said.push(line.to_owned()));
        assert_eq!(*log.borrow(), "abc cba abc ca".replace(' ', ""));
        assert_eq!(said, ["b is left out: tired"]);
        let times = |k: usize| outcomes[k].samples.iter().map(|s| s.ms).collect::<Vec<_>>();
        assert_eq!(times(0), [2.0, 3.0, 4.0], "the first run is for warming up");
        assert_eq!((times(1), outcomes[1].failure.as_deref()), (vec![2.0], Some("tired")));
    }

    #[test]
    fn parts_are_medians_phase_by_phase() {
        let parts = |a: f64, b: f64| BTreeMap::from([("a".to_owned(), a), ("b".to_owned(), b)]);
        let runs = [parts(1.0, 30.0), parts(3.0, 10.0), parts(2.0, 20.0)];
        assert_eq!(median_parts(&runs.each_ref()), parts(2.0, 20.0));
        assert_eq!(median(std::iter::empty()), None);
    }
}
