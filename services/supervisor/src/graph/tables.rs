//! The tables of a graph file.

use std::collections::BTreeMap;

use mirador_acquisition::AcquisitionConfig;
use mirador_alignment::AlignmentConfig;
use mirador_analysis::AnalysisConfig;
use mirador_gateway::GatewayConfig;
use mirador_ipc_schema::Wake;
use mirador_laser_driver::LaserDriverConfig;
use mirador_localization::LocalizationConfig;
use mirador_navigation::NavigationConfig;
use mirador_planning::PlanningServiceConfig;
use mirador_recorder::RecorderConfig;
use mirador_simulator::SimulatorConfig;
use serde::{Deserialize, Serialize};

/// The services of mirador, in the order of the data flow.
pub const SERVICES: [&str; 10] = [
    "simulator",
    "laser_driver",
    "acquisition",
    "localization",
    "alignment",
    "analysis",
    "planning",
    "navigation",
    "gateway",
    "recorder",
];

/// A whole graph file.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Graph {
    /// Version of the file's layout: 1.
    pub config_version: u32,
    /// What holds for the graph as a whole.
    #[serde(default)]
    pub graph: GraphTable,
    /// Which of mirador's services run, and how.
    #[serde(default)]
    pub services: ServiceTables,
    /// Other programs that are started, watched and stopped with the graph.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub programs: BTreeMap<String, ServiceEntry>,
    /// The simulated robot and its world.
    #[serde(default)]
    pub simulator: SimulatorConfig,
    /// The laser that is spoken to.
    #[serde(default)]
    pub laser_driver: LaserDriverConfig,
    /// Where scans come from.
    #[serde(default)]
    pub acquisition: AcquisitionConfig,
    /// Where the robot is.
    #[serde(default)]
    pub localization: LocalizationConfig,
    /// How they are aligned.
    #[serde(default)]
    pub alignment: AlignmentConfig,
    /// How points are scored.
    #[serde(default)]
    pub analysis: AnalysisConfig,
    /// How the map is kept and the next view chosen.
    #[serde(default)]
    pub planning: PlanningServiceConfig,
    /// How the robot follows its path.
    #[serde(default)]
    pub navigation: NavigationConfig,
    /// What is shown live.
    #[serde(default)]
    pub gateway: GatewayConfig,
    /// What is recorded.
    #[serde(default)]
    pub recorder: RecorderConfig,
}

/// What holds for the graph as a whole.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct GraphTable {
    /// Name of the graph on this host: a-z, 0-9, '-' and '_', at most 24.
    pub domain: String,
    /// Points of the largest scan: sizes the shared-memory slots. 0 takes it from the source.
    pub max_points: usize,
    /// Each scan waits until every service has finished the one before: same input, same bits.
    pub lockstep: bool,
    /// How services learn of messages.
    pub wake: WakeWord,
}

impl Default for GraphTable {
    fn default() -> Self {
        Self { domain: "mirador".into(), max_points: 0, lockstep: true, wake: WakeWord::Event }
    }
}

/// How services learn of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum WakeWord {
    /// They sleep until an event wakes them.
    Event,
    /// They look again and again; takes a core each.
    Poll,
}

impl From<WakeWord> for Wake {
    fn from(word: WakeWord) -> Self {
        match word {
            WakeWord::Event => Self::Event,
            WakeWord::Poll => Self::Poll,
        }
    }
}

/// Which of mirador's services run.
#[derive(Debug, Clone, Default, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ServiceTables {
    /// Is the robot and its world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulator: Option<ServiceEntry>,
    /// Speaks to a laser.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub laser_driver: Option<ServiceEntry>,
    /// Delivers scans.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acquisition: Option<ServiceEntry>,
    /// Knows where the robot is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub localization: Option<ServiceEntry>,
    /// Finds the poses of scans.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alignment: Option<ServiceEntry>,
    /// Scores their points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub analysis: Option<ServiceEntry>,
    /// Keeps the map and chooses the next view.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub planning: Option<ServiceEntry>,
    /// Drives the robot to the next view.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub navigation: Option<ServiceEntry>,
    /// Shows the run live in viewers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gateway: Option<ServiceEntry>,
    /// Writes everything down.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recorder: Option<ServiceEntry>,
}

impl ServiceTables {
    /// The services that run, in the order of the data flow.
    #[must_use]
    pub fn entries(&self) -> Vec<(&'static str, &ServiceEntry)> {
        let entries = [
            &self.simulator,
            &self.laser_driver,
            &self.acquisition,
            &self.localization,
            &self.alignment,
            &self.analysis,
            &self.planning,
            &self.navigation,
            &self.gateway,
            &self.recorder,
        ];
        entries.into_iter().zip(SERVICES).filter_map(|(entry, name)| entry.as_ref().map(|e| (name, e))).collect()
    }
}

/// How a process of the graph is run.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ServiceEntry {
    /// Program and arguments that take the service's place; empty for mirador's own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub command: Vec<String>,
    /// Cores it may use; empty for all.
    pub cores: Vec<usize>,
    /// Worker threads.
    pub threads: usize,
    /// What happens when it ends by itself.
    pub restart: RestartPolicy,
    /// Most restarts within a minute; one more ends the run.
    pub max_restarts: u32,
    /// Once it has reported its health, it is ended, and started again as its rule says, when it reports nothing for
    /// this time; 0 never [ms].
    pub health_timeout_ms: u32,
    /// Only for programs and the gateway: the run goes on without it when it may not be started again.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub optional: bool,
}

impl Default for ServiceEntry {
    fn default() -> Self {
        Self {
            command: Vec::new(),
            cores: Vec::new(),
            threads: 1,
            restart: RestartPolicy::OnFailure,
            max_restarts: 5,
            health_timeout_ms: 0,
            optional: false,
        }
    }
}

/// What happens when a process ends by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RestartPolicy {
    /// The run ends.
    Never,
    /// It is started again when it failed or was killed; when it ended well, it stays ended.
    OnFailure,
    /// It is started again in any case.
    Always,
}
