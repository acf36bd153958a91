//! What a strategy is: from a map and a situation to a plan.

use super::config::PlanningConfig;
use super::plan::ViewPlan;
use super::workspace::Workspace;
use crate::geometry::Pose;
use crate::information_map::InformationMap;

/// Where the robot is and where the run stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Situation {
    /// The robot's base on the ground, in the map frame.
    pub map_from_robot: Pose,
    /// Number of the scan just taken in; mixed into the seed, so that every plan draws anew.
    pub scan_number: u64,
    /// Seed of the run.
    pub run_seed: u64,
    /// Worker threads to use, at least 1. The plan does not depend on it.
    pub threads: usize,
}

/// Chooses where to scan next. A strategy may keep what it learnt between plans; from the same state, the same input
/// gives the same plan to the last bit, whatever the workspace was used for before.
pub trait Strategy: Send {
    /// The name under which the registry knows it.
    fn name(&self) -> &str;

    /// The robot was there and planned there: told of every scan of the run so far, in their order, before the first plan
    /// after a restart, so that the plans are those of a strategy that was there. Who keeps nothing need not care.
    fn remember(&mut self, _situation: &Situation) {}

    /// Decides where to go, or to stop, and says why. `config` has been validated. `workspace` saves time only: planning
    /// again on the same map and situation, by other weights or another strategy, finds its candidates evaluated.
    fn plan(
        &mut self,
        workspace: &mut Workspace,
        map: &InformationMap,
        situation: &Situation,
        config: &PlanningConfig,
    ) -> ViewPlan;
}
