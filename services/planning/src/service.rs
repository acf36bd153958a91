//! The loop: a scored scan comes, the map is updated, the decision goes out; older scans that were corrected are moved.

use std::time::{Duration, Instant};

use mirador_core::geometry::{Pose, pose_from_rows, rows_from_pose};
use mirador_core::information_map::{Condenser, Correction};
use mirador_core::view_planning::{
    Decision, PlanningConfig, Situation, StopReason, Strategy, StrategyRegistry, ViewPlan, Workspace,
};
use mirador_ipc_schema::messages::{
    ALIGNMENT_REJECTED, AlignmentMeta, CandidateView, Header, MAP_CAUSE_CORRECTION, MAP_CAUSE_RESTART, MAP_CAUSE_SCAN,
    PathMeta, ReplanRequest, ViewPlanMeta, Waypoint, WorkSpan,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Pause, Subscriber, Wakeable, clock, topics};
use mirador_service_common::{ServiceError, log_place, nanoseconds, view};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use crate::corrections::Corrections;
use crate::figures::FigureBook;
use crate::inbox::{Inbox, Step};
use crate::outbox::{Outbox, TileNews};
use crate::state::{self, KeptMap, Progress};
use crate::{PlanningServiceConfig, messages, replan, way};

/// Plans after every scan of the run until the process is stopped.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &PlanningServiceConfig) -> Result<(), ServiceError> {
    config.validate().map_err(ServiceError::Config)?;
    let participant = setup.join()?;
    let mut planning = Planning::open(setup, config, &participant)?;
    planning.health.running(&participant);
    planning.begin(&participant)?;
    while !setup.stop.is_set() {
        planning.pause = planning.wait(&participant);
        planning.inbox.look_for_scores(&participant)?;
        // A scan first: it is waited for.
        while let Some(step) = planning.inbox.next()? {
            // What belongs to scans before it is there by now, and holds for its plan.
            planning.corrections.receive()?;
            if planning.config.corrections.before_next_scan {
                planning.note_corrections();
                while planning.move_one()? {}
            }
            planning.take_in(&participant, &step)?;
        }
        planning.corrections.receive()?;
        planning.move_scans(&participant)?;
        planning.answer_requests()?;
        planning.outbox.serve_late_joiners();
        planning.health.heartbeat(&participant);
    }
    Ok(())
}

struct Planning<'a> {
    setup: &'a ServiceSetup,
    config: PlanningServiceConfig,
    inbox: Inbox,
    corrections: Corrections,
    outbox: Outbox,
    health: HealthReporter,
    pause: Pause,
    kept: KeptMap,
    figures: FigureBook,
    condenser: Condenser,
    strategy: Box<dyn Strategy>,
    workspace: Workspace,
    requests: Subscriber<topics::ReplanRequests>,
    progress: Progress,
    /// When the last plan was out.
    planned_at: Instant,
    /// Scans that were moved since tiles were sent, and the revision those showed.
    moved: u32,
    shown_revision: u64,
}

impl<'a> Planning<'a> {
    fn open(
        setup: &'a ServiceSetup,
        config: &PlanningServiceConfig,
        participant: &Participant,
    ) -> Result<Self, ServiceError> {
        // Readers first: what is sent while the map is made again waits in their buffers.
        let (inbox, corrections) = (Inbox::open(participant)?, Corrections::open(participant)?);
        let health = HealthReporter::open(participant, &setup.name)?;
        let (kept, progress) = state::open(&setup.state_file(), setup.incarnation == 0, config)?;
        let strategy = strategy_that_was_there(&config.view.strategy, &progress, config.seed)?;
        Ok(Self {
            setup,
            config: config.clone(),
            inbox,
            corrections,
            outbox: Outbox::open(participant)?,
            health,
            pause: Pause::default(),
            shown_revision: kept.map.revision(),
            kept,
            figures: FigureBook::default(),
            condenser: Condenser::new(),
            strategy,
            workspace: Workspace::new(),
            requests: participant.subscriber()?,
            progress,
            planned_at: Instant::now(),
            moved: 0,
        })
    }

    /// After a restart: says again what was said last, and what is finished. Lockstep may wait for these very words.
    fn begin(&mut self, participant: &Participant) -> Result<(), ServiceError> {
        if self.progress.planned_scans == 0 {
            return Ok(());
        }
        self.outbox.repeat(&self.progress.last_plan, &self.progress.last_path)?;
        let header = self.progress.header(clock::monotonic_ns());
        let news = TileNews { header, since: 0, cause: MAP_CAUSE_RESTART, moved_scans: 0 };
        self.outbox.send_tiles(&self.kept.map, &self.figures.figures(&self.kept.map), &news)?;
        self.health.finished(participant, self.progress.finished_scans, Duration::ZERO);
        Ok(())
    }

    fn wait(&mut self, participant: &Participant) -> Pause {
        let [corrections, loops] = self.corrections.awaited() as [&dyn Wakeable; 2];
        let ports: Vec<_> = self.inbox.awaited().chain([corrections, loops, &self.requests]).collect();
        let timeout = if self.kept.poses.due() > 0 { Duration::ZERO } else { HEARTBEAT };
        participant.wait(&ports, timeout)
    }

    /// Moves the scans that were corrected, one after the other, unless a new scan comes: then the rest is done after
    /// that. With the last one the tiles go out, and the scans planned on count as finished.
    fn move_scans(&mut self, participant: &Participant) -> Result<(), ServiceError> {
        let (begin, began_ns) = (Instant::now(), clock::monotonic_ns());
        self.note_corrections();
        while !self.setup.stop.is_set() && !self.inbox.is_next_there()? && self.move_one()? {
            self.health.heartbeat(participant);
        }
        if self.kept.poses.due() > 0 {
            return Ok(());
        }
        let finished = self.finished_scans();
        if self.moved == 0 && finished == self.progress.finished_scans {
            return Ok(());
        }
        if self.moved > 0 {
            let newest = self.progress.planned_scans.saturating_sub(1);
            self.health.worked(WorkSpan::until_now("move", newest, 0, self.pause, began_ns));
            self.show(self.progress.header(clock::monotonic_ns()), MAP_CAUSE_CORRECTION)?;
        }
        self.progress.finished_scans = finished;
        state::save(&self.setup.state_file(), &self.kept, &self.progress)?;
        self.health.finished(participant, finished, begin.elapsed());
        Ok(())
    }

    /// How many scans are finished: planned on, and alignment has said what came of older ones, or did not in time.
    fn finished_scans(&mut self) -> u32 {
        let corrections = &self.config.corrections;
        let patience = Duration::from_millis(corrections.patience_ms.into());
        let planned = self.progress.planned_scans;
        if !corrections.awaited {
            return planned;
        }
        if self.progress.finished_scans < planned && self.planned_at.elapsed() > patience {
            tracing::warn!(scan = planned - 1, "alignment has not said what came of older scans; going on without");
            return planned;
        }
        self.progress.finished_scans.max(self.corrections.queue().told_scans().min(planned))
    }

    /// Notes where scans belong by the corrections that came after scans that are planned on.
    fn note_corrections(&mut self) {
        let planned = self.progress.planned_scans;
        for (scan, pose) in self.corrections.queue().due(planned) {
            if self.kept.poses.correct(scan.into(), &pose, &self.config.corrections.limits) == Correction::Unknown {
                tracing::debug!(scan, "its pose was corrected, but it is not in the map");
            }
        }
    }

    /// Moves one scan that is not where it belongs; whether there was one.
    fn move_one(&mut self) -> Result<bool, ServiceError> {
        let Some(due) = self.kept.poses.next_move() else { return Ok(false) };
        let number = u32::try_from(due.scan).unwrap_or(u32::MAX);
        let work = |reason: String| ServiceError::Work(format!("scan {number} cannot be moved: {reason}"));
        let evidence = self.kept.file.read(number)?.ok_or_else(|| work("its summary is gone".into()))?;
        self.kept.map.move_scan(&evidence, &due.from, &due.to).map_err(|e| work(e.to_string()))?;
        self.kept.map.move_zones(due.scan, &due.to);
        self.kept.poses.moved(&due);
        self.moved += 1;
        Ok(true)
    }

    fn take_in(&mut self, participant: &Participant, step: &Step) -> Result<(), ServiceError> {
        let begin = Instant::now();
        let number = step.scan.header().scan();
        if number < self.progress.planned_scans {
            self.health.finished(participant, self.progress.finished_scans, Duration::ZERO);
            return Ok(());
        }
        log_place(number, || step.scan.location());
        let header = Header::about(step.scan.header(), clock::monotonic_ns());
        let work = |reason: String| ServiceError::Work(format!("scan {number}: {reason}"));
        let map_from_scanner = pose_from_rows(&step.alignment.map_from_scanner)
            .ok_or_else(|| work("its alignment is not a rigid pose".into()))?;
        self.note_obstructions(&step.alignment, &map_from_scanner)?;
        if step.alignment.status != ALIGNMENT_REJECTED {
            self.note_way(&step.alignment, &map_from_scanner);
            self.update_map(number, step, &map_from_scanner).map_err(work)?;
        }
        let basis = Basis {
            scan_sent_ns: step.scan.header().sent_ns,
            map_from_scanner,
            ground_height_m: step.scores.meta().ground_height_m,
        };
        self.health.worked(WorkSpan::until_now("map", number, step.ready_ns, self.pause, header.began_ns));
        // From now on the thread was busy, not asleep.
        self.pause = Pause::default();
        let decide_ns = clock::monotonic_ns();
        self.decide(&basis, None, header, begin.elapsed())?;
        let planned = WorkSpan::until_now("plan", number, 0, self.pause, decide_ns);
        self.health.worked(planned);
        self.progress.ground_height_m = basis.ground_height_m;
        let robot = robot_pose(&basis.map_from_scanner, basis.ground_height_m);
        self.progress.visited.push((number, robot.translation.vector.into()));
        self.planned_at = Instant::now();
        if step.alignment.status != ALIGNMENT_REJECTED {
            // Still the summary of this scan; off the way of the plan, as disks are slow.
            let evidence = self.condenser.last().ok_or_else(|| work("its summary is gone".into()))?;
            self.kept.file.append(number, evidence)?;
        }
        self.show(header, MAP_CAUSE_SCAN)?;
        self.progress.planned_scans = number + 1;
        self.progress.last_scan = (header.id, header.stamp_ns, header.clock_id);
        if !self.config.corrections.awaited {
            self.progress.finished_scans = number + 1;
        }
        state::save(&self.setup.state_file(), &self.kept, &self.progress)?;
        self.health.worked(WorkSpan::until_now("show", number, 0, self.pause, planned.ended_ns));
        if !self.config.corrections.awaited {
            self.health.finished(participant, self.progress.finished_scans, begin.elapsed());
        }
        Ok(())
    }

    /// Notes in the map where something held the robot on its way to this scan: where localisation had it, moved by what
    /// alignment has found it to be off there.
    fn note_obstructions(&mut self, alignment: &AlignmentMeta, map_from_scanner: &Pose) -> Result<(), ServiceError> {
        let prior = prior_of(alignment);
        let aligned = (alignment.status != ALIGNMENT_REJECTED).then_some(map_from_scanner);
        let (correction, height_m) = aligned
            .zip(prior)
            .map_or_else(|| (Pose::identity(), 0.0), |(now, before)| (now * before.inverse(), before.translation.z));
        for told in self.inbox.obstructions()? {
            let obstruction = told.moved_by(&correction, height_m);
            if !obstruction.is_usable() {
                tracing::warn!(
                    ?told,
                    "an obstruction is not finite, or its radius is not above 0 and at most 10 m; ignored"
                );
            }
            self.kept.map.obstruct(obstruction);
        }
        Ok(())
    }

    /// Notes in the map how far the robot has come along the last path, and where that was.
    fn note_way(&mut self, alignment: &AlignmentMeta, map_from_scanner: &Pose) {
        let Some((_, waypoints)) = messages::from_bytes::<PathMeta, Waypoint>(&self.progress.last_path) else { return };
        let path: Vec<_> = waypoints.iter().map(|waypoint| [waypoint.position[0], waypoint.position[1]]).collect();
        let place = |pose: &Pose| [pose.translation.x, pose.translation.y];
        let found = place(map_from_scanner);
        let believed = prior_of(alignment).map_or(found, |prior| place(&prior));
        let way = way::driven(&path, believed);
        self.kept.map.drove(&way::corrected(&way, [found[0] - believed[0], found[1] - believed[1]]));
    }

    fn update_map(&mut self, number: u32, step: &Step, map_from_scanner: &Pose) -> Result<(), String> {
        let scan = view::scan(step.scan.meta(), step.scan.items());
        let scores = view::scores(step.scores.items());
        let (config, threads) = (&self.config.map, self.setup.threads);
        let (evidence, summary) =
            self.condenser.condense(scan, scores, map_from_scanner, config, threads).map_err(|e| e.to_string())?;
        if summary.points_outside > 0 {
            tracing::warn!(scan = number, points = summary.points_outside, "points are too far away for the map");
        }
        self.kept.map.set_threads(threads);
        self.kept.map.add(evidence, map_from_scanner).map_err(|e| e.to_string())?;
        self.kept.poses.added(number.into(), *map_from_scanner);
        self.kept.map.update_zones(number.into(), &step.zones, map_from_scanner, &self.config.zones);
        Ok(())
    }

    /// Decides again for whoever asked, on the map as it is; a request that makes no sense is refused.
    fn answer_requests(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.requests.receive()? {
            for request in message.items() {
                self.answer(request)?;
            }
        }
        Ok(())
    }

    fn answer(&mut self, request: &ReplanRequest) -> Result<(), ServiceError> {
        let Some((last, _)) = messages::from_bytes::<ViewPlanMeta, CandidateView>(&self.progress.last_plan) else {
            tracing::warn!("asked to plan again, but nothing was planned on yet");
            return Ok(());
        };
        let settings = match replan::settings(&self.config.view, request) {
            Ok(settings) => settings,
            Err(reason) => {
                tracing::warn!(reason, "asked to plan again; refused");
                return Ok(());
            }
        };
        // Where the map has the scan now: it may have been moved since.
        let stands = self.kept.poses.pose(last.header.scan().into()).copied();
        let Some(map_from_scanner) = stands.or_else(|| pose_from_rows(&last.map_from_scanner)) else { return Ok(()) };
        let ground_height_m = self.progress.ground_height_m;
        let basis = Basis { scan_sent_ns: last.scan_sent_ns, map_from_scanner, ground_height_m };
        self.decide(&basis, Some(settings), self.progress.header(clock::monotonic_ns()), Duration::ZERO)
    }

    /// Plans on the map as it is, by the graph's settings or by `other` ones, and sends the decision and the path.
    fn decide(
        &mut self,
        basis: &Basis,
        other: Option<PlanningConfig>,
        header: Header,
        map_time: Duration,
    ) -> Result<(), ServiceError> {
        let begin = Instant::now();
        let situation = Situation {
            map_from_robot: robot_pose(&basis.map_from_scanner, basis.ground_height_m),
            scan_number: u64::from(header.scan()),
            run_seed: self.config.seed,
            threads: self.setup.threads,
        };
        let mut plan = self.choose(&situation, other.as_ref())?;
        let is_shut_in = plan.decision == Decision::Stop { reason: StopReason::NothingReachable };
        if is_shut_in && other.is_none() && self.kept.map.forget_obstructions() {
            tracing::warn!(
                scan = header.scan(),
                "no way is left between the places that held the robot; they are tried again"
            );
            plan = self.choose(&situation, None)?;
        }
        let map = &self.kept.map;
        let known = ViewPlanMeta {
            header,
            scan_sent_ns: basis.scan_sent_ns,
            map_ns: nanoseconds(map_time),
            planning_ns: nanoseconds(begin.elapsed()),
            map_from_scanner: rows_from_pose(&basis.map_from_scanner),
            cells_known: map.known_count() as u32,
            zones: map.zones().len() as u32,
            map_tiles: map.tile_count() as u32,
            map_bytes: map.bytes() as u64,
            ..messages::plan_meta(&plan)
        };
        self.progress.last_plan = self.outbox.send_plan(known, &plan)?;
        self.progress.last_path = self.outbox.send_path(header, &plan, &self.kept.map)?;
        Ok(())
    }

    /// The plan by the settings of the run, or by others.
    fn choose(&mut self, situation: &Situation, other: Option<&PlanningConfig>) -> Result<ViewPlan, ServiceError> {
        let (map, own) = (&self.kept.map, &self.config.view);
        let settings = other.unwrap_or(own);
        if settings.strategy == own.strategy {
            return Ok(self.strategy.plan(&mut self.workspace, map, situation, settings));
        }
        let mut strategy = strategy_that_was_there(&settings.strategy, &self.progress, self.config.seed)?;
        Ok(strategy.plan(&mut self.workspace, map, situation, settings))
    }

    /// Sends the tiles that changed since the last time.
    fn show(&mut self, header: Header, cause: u32) -> Result<(), ServiceError> {
        let news = TileNews { header, since: self.shown_revision, cause, moved_scans: self.moved };
        self.outbox.send_tiles(&self.kept.map, &self.figures.figures(&self.kept.map), &news)?;
        self.shown_revision = self.kept.map.revision();
        self.moved = 0;
        Ok(())
    }
}

/// What a decision is taken on beside the map.
struct Basis {
    /// When the scan was sent, CLOCK_MONOTONIC [ns].
    scan_sent_ns: u64,
    map_from_scanner: Pose,
    /// Height of the ground under the robot relative to the scanner [m].
    ground_height_m: f64,
}

/// A new strategy that knows where the robot has planned before in this run.
fn strategy_that_was_there(name: &str, progress: &Progress, run_seed: u64) -> Result<Box<dyn Strategy>, ServiceError> {
    let mut strategy = StrategyRegistry::default().create(name).map_err(|e| ServiceError::Config(e.to_string()))?;
    for &(scan, [x, y, z]) in &progress.visited {
        let (map_from_robot, scan_number) = (Pose::translation(x, y, z), u64::from(scan));
        strategy.remember(&Situation { map_from_robot, scan_number, run_seed, threads: 1 });
    }
    Ok(strategy)
}

/// The robot's base: on the ground under the scanner, upright, heading as the scanner does.
fn robot_pose(map_from_scanner: &Pose, ground_height_m: f64) -> Pose {
    let (_, _, yaw) = map_from_scanner.rotation.euler_angles();
    let position = map_from_scanner.translation.vector + Vector3::new(0.0, 0.0, ground_height_m);
    Pose::from_parts(Translation3::from(position), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw))
}

/// Where localisation had the scan, if it said so.
fn prior_of(alignment: &AlignmentMeta) -> Option<Pose> {
    pose_from_rows(&alignment.prior).filter(|_| alignment.has_prior != 0)
}
