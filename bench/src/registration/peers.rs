//! The peers from PyPI, one Python process each, and what they are asked.

use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;
use std::time::Duration;

use mirador_core::geometry::{Pose, rows_from_pose};
use mirador_core::scan::Point;
use serde_json::json;

use super::contest::{Contestant, Sample};
use super::data::{PairData, SequenceData};
use super::mapper::SequenceRun;
use super::peer_process::{GraphAnswer, PairAnswer, PeerError, PeerProcess, SequenceAnswer};
use super::relaxation::GraphRun;
use super::{Case, RegistrationOptions};

/// The longest a peer may take for one answer; the slowest of them need a second for each of 45 scans.
const PATIENCE: Duration = Duration::from_secs(240);

/// The settings of the published comparisons, for every peer that has them.
const VOXEL_M: f64 = 0.25;
const CHAIN_VOXEL_M: f64 = 0.1;
const NEIGHBOURS: usize = 10;

const PROTOCOL: &str = include_str!("../../peers/protocol.py");
const SMALL_GICP: &str = include_str!("../../peers/small_gicp_peer.py");
const GTSAM: &str = include_str!("../../peers/gtsam_peer.py");
const KISS_ICP: &str = include_str!("../../peers/kiss_icp_peer.py");

/// The methods of small_gicp that are compared.
const SMALL_GICP_METHODS: [&str; 3] = ["GICP", "VGICP", "PLANE_ICP"];

/// The optimisers of GTSAM that are compared.
pub(super) const GTSAM_METHODS: [&str; 2] = ["GaussNewton", "LevenbergMarquardt"];

/// A process that several contestants share; it is gone once it has failed.
type Shared = Rc<RefCell<Option<PeerProcess>>>;

/// The peers that are there.
pub(super) struct Peers {
    small_gicp: Shared,
    /// One process for each number of threads, since TBB takes it from the first call in a process.
    kiss_icp: Vec<(usize, Shared)>,
    gtsam: Shared,
}

impl Peers {
    /// Starts whoever is installed; who is not is reported to `say`.
    pub fn start(options: &RegistrationOptions, threads: &[usize], say: &mut dyn FnMut(&str)) -> Self {
        let mut start = |name: &str, program: &str| {
            let python = options.python.as_deref()?;
            match PeerProcess::start(python, &format!("{PROTOCOL}\n{program}"), PATIENCE) {
                Ok(peer) => {
                    say(&format!("{} {} is there", peer.name, peer.version));
                    Some(peer)
                }
                Err(error) => {
                    let python = python.display();
                    say(&format!(
                        "{name} is left out: {error} (python: {python}; install it with `{python} -m pip install \
                         {}`, or name another Python by --python or MIRADOR_PYTHON)",
                        name.replace('_', "-")
                    ));
                    None
                }
            }
        };
        let clouds = options.wants(Case::Pair) || options.wants(Case::Sequence);
        let small_gicp = if clouds { start("small_gicp", SMALL_GICP) } else { None };
        let mut kiss_icp = Vec::new();
        for threads in threads.iter().filter(|_| options.wants(Case::Sequence)) {
            // Where it is not installed, saying so once is enough.
            let Some(peer) = start("kiss_icp", KISS_ICP) else { break };
            kiss_icp.push((*threads, shared(Some(peer))));
        }
        let gtsam = if options.wants(Case::Relaxation) { start("gtsam", GTSAM) } else { None };
        Self { small_gicp: shared(small_gicp), kiss_icp, gtsam: shared(gtsam) }
    }

    /// Everyone who aligns pairs, with this number of threads.
    pub fn pair_contestants<'a>(&self, threads: usize, data: &'a PairData) -> Vec<PeerPair<'a>> {
        if self.small_gicp.borrow().is_none() {
            return Vec::new();
        }
        let contestant = |method| PeerPair { peer: Rc::clone(&self.small_gicp), method, threads, data };
        SMALL_GICP_METHODS.into_iter().map(contestant).collect()
    }

    /// small_gicp's GICP from scan to scan by the priors; `None` when it is not there or failed.
    pub fn align_chain(&self, threads: usize, data: &SequenceData, say: &mut dyn FnMut(&str)) -> Option<SequenceRun> {
        let arguments = json!({
            "data": data.name, "method": "GICP", "threads": threads, "voxel_m": CHAIN_VOXEL_M,
            "neighbours": NEIGHBOURS, "correspondence_m": 1.0,
            "priors": data.priors.iter().map(rows_from_pose).collect::<Vec<_>>(),
        });
        ask_sequence(&self.small_gicp, "sequence", &arguments, data, say)
    }

    /// KISS-ICP without priors; `None` when it is not there or failed.
    pub fn odometry(
        &self,
        threads: usize,
        voxel_m: f64,
        data: &SequenceData,
        say: &mut dyn FnMut(&str),
    ) -> Option<SequenceRun> {
        let (_, peer) = self.kiss_icp.iter().find(|(count, _)| *count == threads)?;
        let arguments = json!({"data": data.name, "threads": threads, "voxel_m": voxel_m});
        ask_sequence(peer, "odometry", &arguments, data, say)
    }

    /// Version of KISS-ICP, if it is there.
    pub fn kiss_icp_version(&self) -> Option<String> {
        let (_, peer) = self.kiss_icp.first()?;
        peer.borrow().as_ref().map(|peer| peer.version.clone())
    }

    /// An optimiser of GTSAM on a graph of so many nodes in a g2o file; `None` when it is not there or failed.
    pub fn relax(&self, method: &str, file: &Path, nodes: usize, say: &mut dyn FnMut(&str)) -> Option<GraphRun> {
        let mut slot = self.gtsam.borrow_mut();
        let answer = slot.as_mut()?.ask::<GraphAnswer>("relax", &json!({"file": file, "method": method}));
        let failure = match answer {
            Ok(a) if a.poses.len() == nodes => {
                return Some(GraphRun { ms: a.ms, parts: a.parts, poses: a.poses, iterations: a.iterations });
            }
            Ok(a) => format!("{} poses of {nodes}", a.poses.len()),
            Err(error) => {
                if error.is_fatal() {
                    *slot = None;
                }
                error.to_string()
            }
        };
        say(&format!("gtsam {method} is left out: {failure}"));
        None
    }

    /// Version of GTSAM, if it is there.
    pub fn gtsam_version(&self) -> Option<String> {
        self.gtsam.borrow().as_ref().map(|peer| peer.version.clone())
    }

    /// Version of small_gicp, if it is there.
    pub fn small_gicp_version(&self) -> Option<String> {
        self.small_gicp.borrow().as_ref().map(|peer| peer.version.clone())
    }
}

fn shared(peer: Option<PeerProcess>) -> Shared {
    Rc::new(RefCell::new(peer))
}

/// Asks about a data set, which is loaded first; a process that has failed is dropped.
fn ask<A: serde::de::DeserializeOwned>(
    shared: &Shared,
    request: &str,
    arguments: &serde_json::Value,
    data: &str,
    clouds: &[&[Point]],
) -> Result<A, String> {
    let mut slot = shared.borrow_mut();
    let peer = slot.as_mut().ok_or("its process is gone")?;
    let result = peer.load(data, clouds).and_then(|()| peer.ask(request, arguments));
    if result.as_ref().is_err_and(PeerError::is_fatal) {
        *slot = None;
    }
    result.map_err(|error| error.to_string())
}

fn ask_sequence(
    shared: &Shared,
    request: &str,
    arguments: &serde_json::Value,
    data: &SequenceData,
    say: &mut dyn FnMut(&str),
) -> Option<SequenceRun> {
    let name = shared.borrow().as_ref().map(|peer| peer.name.clone())?;
    let clouds: Vec<&[Point]> = data.scans.iter().map(Vec::as_slice).collect();
    let answer = ask::<SequenceAnswer>(shared, request, arguments, &data.name, &clouds);
    match answer {
        Ok(a) if a.ms.len() == clouds.len() && a.poses.len() == clouds.len() => {
            Some(SequenceRun { each_ms: a.ms, parts: a.parts, poses: a.poses })
        }
        Ok(answer) => {
            let (times, poses) = (answer.ms.len(), answer.poses.len());
            say(&format!("{name} on {} is left out: {times} times and {poses} poses of it", data.name));
            None
        }
        Err(reason) => {
            say(&format!("{name} on {} is left out: {reason}", data.name));
            None
        }
    }
}

/// A method of a peer on a pair.
pub(super) struct PeerPair<'a> {
    peer: Shared,
    method: &'static str,
    threads: usize,
    data: &'a PairData,
}

impl PeerPair<'_> {
    /// The method's name in the report.
    pub fn method(&self) -> String {
        format!("small_gicp {}", self.method)
    }
}

impl Contestant for PeerPair<'_> {
    fn label(&self) -> String {
        format!("{} on {}", self.method(), self.data.name)
    }

    fn run(&mut self) -> Result<Sample, String> {
        let data = self.data;
        let arguments = json!({
            "data": data.name, "method": self.method, "threads": self.threads, "voxel_m": VOXEL_M,
            "neighbours": NEIGHBOURS, "correspondence_m": data.correspondence_m,
        });
        let clouds = [data.target.as_slice(), data.source.as_slice()];
        let answer: PairAnswer = ask(&self.peer, "pair", &arguments, &data.name, &clouds)?;
        let pose: Pose = answer.pose;
        Ok(Sample { ms: answer.ms, parts: answer.parts, pose, iterations: answer.iterations, overlap: None })
    }
}
