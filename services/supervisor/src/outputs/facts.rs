//! What the supervisor knows of a run beyond its recording.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use mirador_core::geometry::Pose;
use mirador_core::simulation::CompiledScene;
use serde::Serialize;

use super::RegistrationTotals;
use super::run_data::RunData;
use super::work::Usage;

/// What one service did in a run, added up over its restarts.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ServiceTotals {
    /// Name of the service.
    pub name: String,
    /// How often it was started again.
    pub restarts: u32,
    /// Largest resident memory [bytes].
    pub resident_bytes: u64,
    /// CPU time, page faults and context switches.
    #[serde(flatten)]
    pub usage: Usage,
    /// Payload bytes copied out of or into shared memory through its ports.
    pub copied_payload_bytes: u64,
    /// Messages it saw to be missing.
    pub lost_messages: u64,
    /// Messages it could not deliver.
    pub undelivered_messages: u64,
    /// Messages it sent.
    pub sent_messages: u64,
    /// Messages it received.
    pub received_messages: u64,
}

/// What the supervisor knows of a run beyond its recording.
#[derive(Debug, Clone, Default)]
pub struct RunFacts {
    /// Heading of the report.
    pub title: String,
    /// True poses `world_from_scanner`, under the scan's `source_index` (its place in the folder or scene); `None`
    /// when there is no truth.
    pub truth: Option<BTreeMap<u32, Pose>>,
    /// Where the scanner sits on a robot that drove, `robot_from_scanner`; with it the true poses of the scans are read
    /// from the recording. `None` where no robot drove.
    pub robot_from_scanner: Option<Pose>,
    /// Centres of the cells that the robot can reach, in the frame of the true poses (the map's own without them) [m];
    /// `None` when unknown.
    pub truth_cells: Option<Vec<[f64; 2]>>,
    /// The scene that was scanned, in the same frame; `None` where it was none.
    pub scene: Option<Arc<CompiledScene>>,
    /// Restarts of all services together.
    pub restarts: u32,
    /// How a foreign registration did; `None` where there was none.
    pub registration: Option<RegistrationTotals>,
    /// Every service.
    pub services: Vec<ServiceTotals>,
    /// The user ended the run.
    pub interrupted: bool,
    /// What made it impossible to go on, in words.
    pub fault: Option<String>,
    /// Duration of the run.
    pub wall_time: Duration,
    /// The configuration as used, TOML.
    pub config: String,
}

impl RunFacts {
    /// The same with the true poses that a simulated robot has recorded.
    pub(super) fn with_truth_of(&self, data: &RunData) -> Self {
        let recorded = || data.drive.truth_of(&data.scans, self.robot_from_scanner.as_ref()?);
        Self { truth: self.truth.clone().or_else(recorded), ..self.clone() }
    }
}
