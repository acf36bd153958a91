//! One run of a graph: start, watch, stop, clean up.

use std::fs::File;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use mirador_acquisition::SourceKind;
use mirador_ipc_schema::{Domain, Participant, Sizes, StopSignal, Wake, budget};
use rustix::fs::{FlockOperation, flock};
use rustix::process::Signal;

use super::child::{Fate, Launch, Supervised, last_line};
use super::monitor::Monitor;
use crate::UsageError;
use crate::graph::Graph;
use crate::outputs::{RegistrationTotals, ServiceTotals};

/// How often the supervisor looks after its children when nothing wakes it.
const LOOK: Duration = Duration::from_millis(20);
/// How often it looks for dead peers that are not its children.
const CLEAN: Duration = Duration::from_millis(500);
/// How long a service may take to end by itself. All of them together end well within the 2 s promised.
const GRACE: Duration = Duration::from_millis(1500);

/// What to run.
pub struct RunPlan {
    /// The graph, its sizes filled in.
    pub graph: Graph,
    /// Arguments every service gets.
    pub common: Vec<String>,
    /// The run directory.
    pub run_dir: PathBuf,
    /// No progress.
    pub quiet: bool,
    /// Set by Ctrl-C.
    pub stop: StopSignal,
}

/// Why a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ended {
    /// Every scan is finished.
    InputEnded,
    /// The user wished it.
    Interrupted,
    /// The source could not go on, or a service could not be kept alive.
    Fault(String),
}

/// What a run was like.
pub struct RunOutcome {
    /// Why it ended.
    pub ended: Ended,
    /// Counters of every service.
    pub services: Vec<ServiceTotals>,
    /// How a foreign registration did; `None` where there was none.
    pub registration: Option<RegistrationTotals>,
    /// Starts after deaths, over all services.
    pub restarts: u32,
    /// From the start of the first service to the end of the last.
    pub wall: Duration,
}

/// The supervisor's place in a domain: whoever has it is the only one who runs a graph there. Giving it up removes what
/// the graph has left.
pub struct Seat {
    domain: Domain,
    participant: Option<Participant>,
}

impl Seat {
    /// Takes the place for a graph whose sizes are filled in. Nothing outside the domain is touched, so that a graph
    /// that cannot run does no harm to the outputs of one that does.
    ///
    /// # Errors
    /// When somebody else runs in the domain, or shared memory has no room for the graph.
    pub fn take(graph: &Graph, stop: &StopSignal) -> Result<Self> {
        let domain = Domain::new(&graph.graph.domain)?;
        let sizes = Sizes { scan_points: graph.graph.max_points };
        // Between looking whether a domain is free and being seen in it nobody else may look.
        let _turn = turn_of(&domain)?;
        claim(&domain)?;
        let mut names: Vec<&str> = graph.services.entries().iter().map(|(name, _)| *name).collect();
        if graph.alignment.is_external() && graph.services.alignment.is_some() {
            names.push(budget::FOREIGN_REGISTRATION);
        }
        budget::check(&names, &sizes).map_err(|e| UsageError(e.to_string()))?;
        let participant = Participant::join(domain.clone(), "supervisor", 0, sizes, Wake::Event, stop.clone())?;
        Ok(Self { domain, participant: Some(participant) })
    }

    /// The supervisor as a process of the domain.
    ///
    /// # Errors
    /// When the seat was given up.
    pub fn participant(&self) -> Result<&Participant> {
        self.participant.as_ref().context("the seat was given up")
    }

    fn leave(&mut self) -> Result<()> {
        if self.participant.take().is_some() {
            // Everyone is gone: what remains are files that iceoryx2 leaves behind.
            self.domain.remove_all().context("the domain cannot be cleaned up")?;
        }
        Ok(())
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        if let Err(error) = self.leave() {
            tracing::warn!("{error:#}");
        }
    }
}

/// Runs a graph until its input ends, it fails, or the user stops it. Nothing of it is left afterwards.
pub fn run(plan: &RunPlan, mut seat: Seat) -> Result<RunOutcome> {
    let begin = Instant::now();
    let participant = seat.participant()?;
    let result = run_joined(plan, participant);
    let left = seat.leave();
    let (ended, services, registration) = result?;
    left?;
    let restarts = services.iter().map(|s| s.restarts).sum();
    Ok(RunOutcome { ended, services, registration, restarts, wall: begin.elapsed() })
}

/// Waits for the right to look into a domain and to join it; it ends when the file is closed. Other graphs of this user
/// that start at the same moment wait a few milliseconds.
fn turn_of(domain: &Domain) -> Result<File> {
    domain.config()?;
    let folder = domain.parent();
    let file = File::open(&folder).with_context(|| format!("{}: cannot be opened", folder.display()))?;
    flock(&file, FlockOperation::LockExclusive).with_context(|| format!("{}: cannot be locked", folder.display()))?;
    Ok(file)
}

/// Makes sure that nobody else runs in the domain, and removes what the dead have left.
fn claim(domain: &Domain) -> Result<()> {
    let alive = Participant::peers(domain)?.into_iter().find(|peer| peer.alive);
    if let Some(peer) = alive {
        return Err(UsageError(format!(
            "domain '{}' is in use by '{}' (process {}); end it, or give another --domain",
            domain.name(),
            peer.name,
            peer.pid
        ))
        .into());
    }
    let left = domain.remove_all()?;
    if left.segments > 0 {
        tracing::info!(files = left.segments, bytes = left.bytes, "removed what an earlier graph had left");
    }
    Ok(())
}

/// What a run leaves: why it ended, and the counters of services and of a foreign registration.
type Left = (Ended, Vec<ServiceTotals>, Option<RegistrationTotals>);

fn run_joined(plan: &RunPlan, participant: &Participant) -> Result<Left> {
    let mut monitor = Monitor::open(participant)?;
    let mut children = start_all(plan)?;
    let watched = watch(plan, participant, &mut monitor, &mut children);
    stop_all(&mut children, participant, &mut monitor);
    let mut ended = watched?;
    if let Ended::Fault(reason) = &mut ended {
        *reason = in_full(reason, &children).replace('\n', " ");
    }
    let totals = children.iter().rev().map(|c| monitor.totals_of(&c.launch.name, c.restarts()));
    Ok((ended, totals.collect(), monitor.registration.totals()))
}

fn start_all(plan: &RunPlan) -> Result<Vec<Supervised>> {
    let run = run_number();
    let launch = |name: &str, built_in: bool, entry: &crate::graph::ServiceEntry| Launch {
        name: name.to_owned(),
        built_in,
        entry: entry.clone(),
        common: plan.common.clone(),
        run,
        run_dir: plan.run_dir.clone(),
        domain: plan.graph.graph.domain.clone(),
        max_points: plan.graph.graph.max_points,
    };
    let services = plan.graph.services.entries();
    // Readers before writers: the recorder is there when the first message is sent, acquisition comes last.
    let own = services.iter().rev().map(|(name, entry)| launch(name, true, entry));
    let others = plan.graph.programs.iter().map(|(name, entry)| launch(name, false, entry));
    others.chain(own).map(Supervised::start).collect()
}

/// A number for the run: seconds since the epoch, as far as 24 bits hold them.
fn run_number() -> u32 {
    u32::try_from((mirador_ipc_schema::clock::utc_ns() / 1_000_000_000) & 0x00ff_ffff).unwrap_or(0)
}

fn watch(
    plan: &RunPlan,
    participant: &Participant,
    monitor: &mut Monitor,
    children: &mut [Supervised],
) -> Result<Ended> {
    let is_live = plan.graph.acquisition.source == SourceKind::Robot;
    let bar = if is_live {
        crate::progress::counter("scans", plan.quiet)
    } else {
        crate::progress::bar(0, "scans", plan.quiet)
    };
    let mut cleaned = Instant::now();
    loop {
        if plan.stop.is_set() {
            bar.abandon_with_message("stopping");
            return Ok(Ended::Interrupted);
        }
        participant.wait(&monitor.wakeables(), LOOK);
        monitor.listen()?;
        if !is_live {
            bar.set_length(u64::from(monitor.scans_expected));
        }
        bar.set_position(u64::from(monitor.scans_planned));
        bar.set_message(format!("{}{}", monitor.decision, monitor.driving));
        for child in children.iter_mut() {
            let fate = child.look_after(&|| {
                participant.clean_dead_peers();
            })?;
            match fate {
                // It is not heard of yet.
                Fate::Restarted => monitor.forget(&child.launch.name),
                Fate::GaveUp if child.launch.entry.optional => {
                    let cause = cause_of(child);
                    tracing::warn!("{cause}; the run goes on without it");
                    monitor.mourn(&child.launch.name, &cause);
                    continue;
                }
                Fate::Running => end_if_silent(child, monitor),
                _ => {}
            }
            if fate == Fate::GaveUp || (fate == Fate::Ended && child.launch.built_in) {
                monitor.listen()?;
                bar.abandon();
                return Ok(Ended::Fault(cause_of(child)));
            }
        }
        if let Some(fault) = &monitor.fault {
            bar.abandon();
            return Ok(Ended::Fault(fault.clone()));
        }
        if monitor.ended {
            bar.finish();
            return Ok(Ended::InputEnded);
        }
        if cleaned.elapsed() > CLEAN {
            participant.clean_dead_peers();
            monitor.repeat_losses();
            cleaned = Instant::now();
        }
    }
}

/// Ends a process that has reported its health and then reports nothing for longer than it may.
fn end_if_silent(child: &Supervised, monitor: &mut Monitor) {
    let (name, limit) = (&child.launch.name, Duration::from_millis(child.launch.entry.health_timeout_ms.into()));
    if limit.is_zero() || monitor.silent_for(name).is_none_or(|silence| silence < limit) {
        return;
    }
    tracing::warn!(service = name, limit_ms = limit.as_millis(), "says nothing for too long; it is killed");
    child.signal(Signal::KILL);
    monitor.forget(name);
}

fn cause_of(child: &Supervised) -> String {
    let log = child.launch.log_path();
    let said = last_line(&log).unwrap_or_else(|| "it said nothing".into());
    let end = child.last_end();
    format!("{} ended ({end}): {said}", child.launch.name)
}

/// A reason that a service gave in a message, which holds only so much of it, in the words with which it ended.
fn in_full(reason: &str, children: &[Supervised]) -> String {
    let said = children.iter().filter_map(|child| last_line(&child.launch.log_path()));
    said.into_iter().find(|line| line.starts_with(reason)).unwrap_or_else(|| reason.to_owned())
}

/// Ends the children in the order of the data flow, the recorder last, and waits for them.
fn stop_all(children: &mut [Supervised], participant: &Participant, monitor: &mut Monitor) {
    let begin = Instant::now();
    let is_recorder = |child: &Supervised| child.launch.name == "recorder";
    for recorder in [false, true] {
        for child in children.iter().filter(|c| is_recorder(c) == recorder) {
            child.signal(Signal::TERM);
        }
        let waiting = |children: &mut [Supervised]| {
            children.iter_mut().any(|child| (child.launch.name == "recorder") == recorder && child.is_alive())
        };
        // The recorder may write on: what it holds is the run. The others have nothing left to say.
        let limit = if recorder { GRACE * 20 } else { GRACE };
        while waiting(children) && begin.elapsed() < limit {
            std::thread::sleep(Duration::from_millis(5));
            if let Err(error) = monitor.listen() {
                tracing::debug!(%error, "the last words of a service were not heard");
            }
        }
    }
    for child in children.iter_mut().filter_map(|c| c.is_alive().then_some(c)) {
        tracing::warn!(service = child.launch.name, "did not end by itself; it is killed");
        child.signal(Signal::KILL);
    }
    participant.clean_dead_peers();
}

/// Refuses a graph whose sources are larger than its slots.
pub fn check_slots(largest_scan: usize, max_points: usize) -> Result<()> {
    if largest_scan > max_points {
        bail!(UsageError(format!(
            "the largest scan has {largest_scan} points, but the slots hold {max_points}: raise graph.max_points to \
             {largest_scan}, or set it to 0 to take it from the source"
        )));
    }
    Ok(())
}
