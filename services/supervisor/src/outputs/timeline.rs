//! Where the time from the last beam to the plan goes: work, waiting for the other branch, and the graph itself.

use super::run_data::ScanRecord;

/// One scan's way through the graph, in CLOCK_MONOTONIC [ns]. Alignment and surface run side by side; the scores need
/// both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timeline {
    /// The scan was sent: its last beam is there.
    pub scan_sent: u64,
    /// Alignment began to work on it.
    pub alignment_began: u64,
    /// Its pose was sent.
    pub alignment_sent: u64,
    /// Time of preparing and aligning.
    pub alignment_work: u64,
    /// Analysis began to work on it.
    pub surface_began: u64,
    /// Time of meshing.
    pub surface_work: u64,
    /// Its scores were sent.
    pub scores_sent: u64,
    /// Time of scoring.
    pub analysis_work: u64,
    /// Planning began to work on it.
    pub planning_began: u64,
    /// Time of the map update.
    pub map_work: u64,
    /// Time of the decision.
    pub planning_work: u64,
    /// The plan was sent.
    pub plan_sent: u64,
}

/// A part of the way that no algorithm works in.
pub struct Gap {
    /// Name of the part, stable.
    pub name: &'static str,
    /// Its length [ns].
    pub of: fn(&Timeline) -> u64,
}

/// From message to message: what the graph itself adds. The clock of the work within a service starts after it woke.
pub const GAPS: [Gap; 6] = [
    Gap { name: "scan_to_alignment", of: |t| t.alignment_began.saturating_sub(t.scan_sent) },
    Gap { name: "scan_to_surface", of: |t| t.surface_began.saturating_sub(t.scan_sent) },
    Gap { name: "alignment_rest", of: |t| (t.alignment_sent - t.alignment_began).saturating_sub(t.alignment_work) },
    Gap { name: "alignment_to_analysis", of: |t| t.analysis_began().saturating_sub(t.both_there()) },
    Gap { name: "scores_to_planning", of: |t| t.planning_began.saturating_sub(t.scores_sent) },
    Gap {
        name: "planning_rest",
        of: |t| (t.plan_sent - t.planning_began).saturating_sub(t.map_work + t.planning_work),
    },
];

impl Timeline {
    /// The way of a scan; `None` when it did not come through, or when its messages contradict each other, as after a
    /// restart on the way.
    #[must_use]
    pub fn of(scan: &ScanRecord) -> Option<Self> {
        let (alignment, scored, plan) = (scan.alignment?, scan.scored?, scan.first_plan?);
        let timeline = Self {
            scan_sent: scan.scan.header.sent_ns,
            alignment_began: alignment.header.began_ns,
            alignment_sent: alignment.header.sent_ns,
            alignment_work: alignment.prepare_ns.saturating_add(alignment.align_ns),
            surface_began: scored.header.began_ns,
            surface_work: scored.surface_ns,
            scores_sent: scored.header.sent_ns,
            analysis_work: scored.analysis_ns,
            planning_began: plan.header.began_ns,
            map_work: plan.map_ns,
            planning_work: plan.planning_ns,
            plan_sent: plan.header.sent_ns,
        };
        timeline.is_in_order().then_some(timeline)
    }

    fn is_in_order(&self) -> bool {
        let way = [self.scan_sent, self.alignment_began, self.alignment_sent, self.scores_sent, self.planning_began];
        way.is_sorted()
            && self.planning_began <= self.plan_sent
            && self.scan_sent <= self.surface_began
            && self.surface_began.saturating_add(self.surface_work) <= self.scores_sent
    }

    /// From the last beam to the plan [ns].
    #[must_use]
    pub fn end_to_end(&self) -> u64 {
        self.plan_sent - self.scan_sent
    }

    /// The longer of the two branches, and what follows both [ns]: what the way takes if the graph itself takes nothing.
    #[must_use]
    pub fn work(&self) -> u64 {
        self.alignment_work.max(self.surface_work) + self.analysis_work + self.map_work + self.planning_work
    }

    /// The graph's own share [ns].
    #[must_use]
    pub fn graph_overhead(&self) -> u64 {
        self.end_to_end().saturating_sub(self.work())
    }

    /// Pose and surface are there.
    fn both_there(&self) -> u64 {
        self.alignment_sent.max(self.surface_began + self.surface_work)
    }

    fn analysis_began(&self) -> u64 {
        self.scores_sent.saturating_sub(self.analysis_work)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timeline() -> Timeline {
        Timeline {
            scan_sent: 1000,
            alignment_began: 1040,
            alignment_sent: 1400,
            alignment_work: 350,
            surface_began: 1050,
            surface_work: 100,
            scores_sent: 1500,
            analysis_work: 70,
            planning_began: 1560,
            map_work: 50,
            planning_work: 200,
            plan_sent: 1830,
        }
    }

    #[test]
    fn the_gaps_and_the_work_make_up_the_whole_way() {
        let t = timeline();
        let gaps: Vec<u64> = GAPS.iter().map(|gap| (gap.of)(&t)).collect();
        assert_eq!(gaps, [40, 50, 10, 30, 60, 20]);
        assert_eq!((t.end_to_end(), t.work(), t.graph_overhead()), (830, 670, 160));
        // All gaps but that of the branch that was not waited for.
        assert_eq!(gaps.iter().sum::<u64>() - gaps[1], t.graph_overhead());
    }

    #[test]
    fn messages_out_of_order_make_no_timeline() {
        assert!(timeline().is_in_order());
        assert!(!Timeline { scores_sent: 1300, ..timeline() }.is_in_order());
        assert!(!Timeline { plan_sent: 1500, ..timeline() }.is_in_order());
    }
}
