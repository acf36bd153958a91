//! Who only watches a graph makes way for those who work on a scan: nothing about it is taken before its plan is out.
//!
//! To write or draw a scan takes milliseconds of a core. Taken as it comes, that would be a core of which alignment, analysis
//! or planning wait for their turn.

use std::time::{Duration, Instant};

/// What goes from hand to hand between a scan and its plan, in the order of the topics.
const ON_THE_WAY: [&str; 6] = ["clock", "scan", "alignment", "scored_scan", "zones", "pose"];

/// Nobody is woken for these: they are taken whenever something else is.
const BESIDE: &str = "service_health";

/// The topic that ends the way.
const END: &str = "view_plan";

/// A plan takes no longer than this; what waits longer is taken without.
const PATIENCE: Duration = Duration::from_millis(100);

/// When the messages of a scan are taken by somebody who only watches.
#[derive(Debug, Default)]
pub struct Courtesy {
    waits_since: Option<Instant>,
}

impl Courtesy {
    /// Whether the messages of a topic wait for the plan.
    #[must_use]
    pub fn holds(topic: &str) -> bool {
        ON_THE_WAY.contains(&topic)
    }

    /// Whether a message of a topic is worth waking for, in a graph that plans.
    #[must_use]
    pub fn wakes(topic: &str) -> bool {
        !Self::holds(topic) && topic != BESIDE
    }

    /// Whether everything is to be taken now, given the topics on which messages are there: the plan is, or they have waited
    /// long enough.
    pub fn is_over<'a>(&mut self, ready: impl Iterator<Item = &'a str>) -> bool {
        let (mut waits, mut has_ended) = (false, false);
        for topic in ready {
            waits |= Self::holds(topic);
            has_ended |= topic == END;
        }
        if !waits {
            self.waits_since = None;
            return true;
        }
        let since = *self.waits_since.get_or_insert_with(Instant::now);
        let is_over = has_ended || since.elapsed() >= PATIENCE;
        if is_over {
            self.waits_since = None;
        }
        is_over
    }
}

#[cfg(test)]
mod tests {
    use mirador_ipc_schema::topics::ALL;

    use super::*;

    #[test]
    fn a_scan_waits_for_its_plan_or_for_the_end_of_patience() {
        let mut courtesy = Courtesy::default();
        assert!(courtesy.is_over(["odometry"].into_iter()));
        assert!(!courtesy.is_over(["scan", "odometry"].into_iter()));
        assert!(!courtesy.is_over(["scan", "scored_scan"].into_iter()));
        assert!(courtesy.is_over(["scan", "scored_scan", "view_plan"].into_iter()));
        assert!(!courtesy.is_over(["scan"].into_iter()));
        std::thread::sleep(PATIENCE);
        assert!(courtesy.is_over(["scan"].into_iter()));
        assert!(!courtesy.is_over(["scan"].into_iter()), "the next one waits as long");
    }

    #[test]
    fn the_topics_are_topics_of_the_graph() {
        for topic in ON_THE_WAY.into_iter().chain([BESIDE, END]) {
            assert!(ALL.iter().any(|t| t.rules.name == topic), "{topic}");
        }
        assert!(Courtesy::wakes("view_plan") && Courtesy::wakes("imu") && !Courtesy::wakes("scan"));
    }
}
