//! The loop: a scored scan comes, the map is updated, the decision goes out.

use std::time::{Duration, Instant};

use mirador_core::geometry::{Pose, pose_from_rows, rows_from_pose};
use mirador_core::information_map::{Cell, CellState, InformationMap, TILE_CELLS, Tile, Zone};
use mirador_core::view_planning::{Situation, Strategy, StrategyRegistry, ViewPlan, Workspace};
use mirador_ipc_schema::messages::{
    ALIGNMENT_REJECTED, AlignmentMeta, Header, MapMeta, PathMeta, ScanId, ViewPlanMeta, Waypoint,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Received, Wakeable, clock, topics};
use mirador_service_common::{CheckpointError, InOrder, ServiceError, checkpoint, log_place, nanoseconds, view};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use crate::{PlanningServiceConfig, messages};

/// Plans after every scan of the run until the process is stopped.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &PlanningServiceConfig) -> Result<(), ServiceError> {
    config.validate().map_err(ServiceError::Config)?;
    let participant = setup.join()?;
    let mut planning = Planning::open(setup, config, &participant)?;
    planning.health.running(&participant);
    if planning.finished_scans > 0 {
        // What an earlier incarnation has finished is done: lockstep may wait for these very words.
        planning.health.finished(&participant, planning.finished_scans, Duration::ZERO);
    }
    while !setup.stop.is_set() {
        participant.wait(&planning.inbox.awaited(), HEARTBEAT);
        while let Some(step) = planning.inbox.next()? {
            planning.take_in(&participant, &step)?;
        }
        planning.outbox.serve_late_joiners();
        planning.health.heartbeat(&participant);
    }
    Ok(())
}

/// Everything that belongs to one scan.
struct Step {
    scan: Received<topics::Scan>,
    scores: Received<topics::ScoredScan>,
    alignment: AlignmentMeta,
    zones: Vec<Zone>,
}

struct Inbox {
    scans: InOrder<topics::Scan>,
    alignments: InOrder<topics::Alignment>,
    scores: InOrder<topics::ScoredScan>,
    zones: InOrder<topics::Zones>,
}

impl Inbox {
    fn open(participant: &Participant) -> Result<Self, ServiceError> {
        Ok(Self {
            scans: InOrder::new(participant.subscriber()?),
            alignments: InOrder::new(participant.subscriber()?),
            scores: InOrder::new(participant.subscriber()?),
            zones: InOrder::new(participant.subscriber()?),
        })
    }

    fn awaited(&self) -> Vec<&dyn Wakeable> {
        let ports = [self.scans.awaited(0), self.alignments.awaited(0), self.scores.awaited(0), self.zones.awaited(0)];
        ports.into_iter().flatten().collect()
    }

    /// The next scored scan with everything that belongs to it, if all of it is there.
    fn next(&mut self) -> Result<Option<Step>, ServiceError> {
        loop {
            self.scores.fill(0)?;
            let id = self.scores.front();
            self.scans.discard_before(id.unwrap_or(0));
            self.alignments.discard_before(id.unwrap_or(0));
            self.zones.discard_before(id.unwrap_or(0));
            self.scans.fill(0)?;
            self.alignments.fill(0)?;
            self.zones.fill(0)?;
            let Some(id) = id else { return Ok(None) };
            let parts = [self.scans.front(), self.alignments.front(), self.zones.front()];
            if parts.iter().any(|part| part.is_some_and(|of| of > id)) {
                tracing::warn!(scan = ScanId::unpack(id).scan, "a part of it was lost; it is not planned on");
                self.scores.pop();
            } else if parts.iter().all(|part| *part == Some(id)) {
                return Ok(self.put_together());
            } else if parts.iter().all(|part| part.is_none_or(|of| of == id)) {
                return Ok(None);
            }
            // Else parts of older scans came in just now; they are let go, and what follows them is looked at.
        }
    }

    /// The step of the oldest messages.
    fn put_together(&mut self) -> Option<Step> {
        let (scan, scores) = (self.scans.pop()?, self.scores.pop()?);
        let (alignment, zones) = (self.alignments.pop()?, self.zones.pop()?);
        Some(Step { scan, scores, alignment: *alignment.meta(), zones: read_zones(&zones) })
    }
}

fn read_zones(message: &Received<topics::Zones>) -> Vec<Zone> {
    let point = |v: [f32; 3]| Vector3::from(v).cast::<f64>();
    message.items().iter().map(|z| Zone { centre: Point3::from(point(z.centre)), normal: point(z.normal) }).collect()
}

struct Outbox {
    plans: Publisher<topics::ViewPlan>,
    paths: Publisher<topics::Path>,
    tiles: Publisher<topics::InformationMap>,
}

impl Outbox {
    fn serve_late_joiners(&self) {
        self.plans.serve_late_joiners();
        self.paths.serve_late_joiners();
        self.tiles.serve_late_joiners();
    }
}

struct Planning<'a> {
    setup: &'a ServiceSetup,
    config: PlanningServiceConfig,
    inbox: Inbox,
    outbox: Outbox,
    health: HealthReporter,
    map: InformationMap,
    strategy: Box<dyn Strategy>,
    workspace: Workspace,
    finished_scans: u32,
    /// The last decision was taken by an earlier incarnation, and nobody gets it from the history any more.
    is_decision_lost: bool,
}

impl<'a> Planning<'a> {
    fn open(
        setup: &'a ServiceSetup,
        config: &PlanningServiceConfig,
        participant: &Participant,
    ) -> Result<Self, ServiceError> {
        let (map, finished_scans) = saved_map(setup, config)?;
        let strategy = StrategyRegistry::default()
            .create(&config.view.strategy)
            .map_err(|e| ServiceError::Config(e.to_string()))?;
        Ok(Self {
            setup,
            config: config.clone(),
            inbox: Inbox::open(participant)?,
            outbox: Outbox {
                plans: participant.publisher()?,
                paths: participant.publisher()?,
                tiles: participant.publisher()?,
            },
            health: HealthReporter::open(participant, &setup.name)?,
            map,
            strategy,
            workspace: Workspace::new(),
            finished_scans,
            is_decision_lost: finished_scans > 0,
        })
    }

    fn take_in(&mut self, participant: &Participant, step: &Step) -> Result<(), ServiceError> {
        let begin = Instant::now();
        let number = step.scan.header().scan();
        let is_lost = std::mem::take(&mut self.is_decision_lost) && number + 1 == self.finished_scans;
        if number < self.finished_scans && !is_lost {
            self.health.finished(participant, self.finished_scans, Duration::ZERO);
            return Ok(());
        }
        log_place(number, || step.scan.location());
        let began_ns = clock::monotonic_ns();
        let work = |reason: String| ServiceError::Work(format!("scan {number}: {reason}"));
        let map_from_scanner = pose_from_rows(&step.alignment.map_from_scanner)
            .ok_or_else(|| work("its alignment is not a rigid pose".into()))?;
        // The scan of a lost decision is in the map already: the same is decided again, and the whole map is sent.
        let revision_before = if is_lost { 0 } else { self.map.revision() };
        if !is_lost && step.alignment.status != ALIGNMENT_REJECTED {
            self.update_map(step, &map_from_scanner).map_err(work)?;
        }
        let map_time = begin.elapsed();
        self.decide(step, &map_from_scanner, Header::about(step.scan.header(), began_ns), map_time)?;
        self.send_tiles(Header::about(step.scan.header(), began_ns), revision_before)?;
        if !is_lost {
            self.finished_scans = number + 1;
            save_map(self.setup, &self.map, self.finished_scans)?;
        }
        self.health.finished(participant, self.finished_scans, begin.elapsed());
        Ok(())
    }

    /// Plans on the map as it is, and sends the decision and the path.
    fn decide(
        &mut self,
        step: &Step,
        map_from_scanner: &Pose,
        header: Header,
        map_time: Duration,
    ) -> Result<(), ServiceError> {
        let begin = Instant::now();
        let situation = Situation {
            map_from_robot: robot_pose(map_from_scanner, step.scores.meta().ground_height_m),
            scan_number: u64::from(step.scan.header().scan()),
            run_seed: self.config.seed,
            threads: self.setup.threads,
        };
        let plan = self.strategy.plan(&mut self.workspace, &self.map, &situation, &self.config.view);
        let known = ViewPlanMeta {
            header,
            scan_sent_ns: step.scan.header().sent_ns,
            map_ns: nanoseconds(map_time),
            planning_ns: nanoseconds(begin.elapsed()),
            map_from_scanner: rows_from_pose(map_from_scanner),
            cells_known: self.map.known_cells().count() as u32,
            zones: self.map.zones().len() as u32,
            map_tiles: self.map.tiles().count() as u32,
            map_bytes: self.map_bytes(),
            ..messages::plan_meta(&plan)
        };
        self.send_plan(known, &plan)?;
        self.send_path(header, &plan)
    }

    fn update_map(&mut self, step: &Step, map_from_scanner: &Pose) -> Result<(), String> {
        let scan = view::scan(step.scan.meta(), step.scan.items());
        self.map.insert(scan, view::scores(step.scores.items()), map_from_scanner).map_err(|e| e.to_string())?;
        let scanner = Point3::from(map_from_scanner.translation.vector);
        self.map.update_zones(&step.zones, &scanner, &self.config.zones);
        Ok(())
    }

    fn map_bytes(&self) -> u64 {
        let tiles = self.map.tiles().count() as u64;
        tiles * (size_of::<Tile>() + TILE_CELLS * size_of::<Cell>()) as u64
    }

    fn send_plan(&self, meta: ViewPlanMeta, plan: &ViewPlan) -> Result<(), ServiceError> {
        let capacity = self.outbox.plans.capacity();
        let open = plan.candidates.len().min(capacity);
        let count = (open + plan.rejected.len()).min(capacity);
        let mut loan = self.outbox.plans.loan(count)?;
        *loan.meta_mut() = meta;
        let (candidates, rejected) = loan.items_mut().split_at_mut(open);
        for (item, candidate) in candidates.iter_mut().zip(&plan.candidates) {
            *item = messages::candidate(candidate);
        }
        for (item, place) in rejected.iter_mut().zip(&plan.rejected) {
            *item = messages::rejected(place);
        }
        Ok(loan.send()?)
    }

    fn send_path(&self, header: Header, plan: &ViewPlan) -> Result<(), ServiceError> {
        let waypoints = plan.path.get(..plan.path.len().min(self.outbox.paths.capacity())).unwrap_or_default();
        let mut loan = self.outbox.paths.loan(waypoints.len())?;
        *loan.meta_mut() = PathMeta {
            header,
            map_revision: plan.map_revision,
            length_m: messages::length(waypoints),
            cost: plan.chosen().map_or(0.0, |c| c.cost),
        };
        for (item, waypoint) in loan.items_mut().iter_mut().zip(waypoints) {
            *item = Waypoint { position: *waypoint, navigability: self.navigability_at(waypoint) };
        }
        Ok(loan.send()?)
    }

    fn navigability_at(&self, position: &[f64; 3]) -> f64 {
        let cell = self.map.cell_containing(position[0], position[1]);
        match cell.map(|index| self.map.state(index)) {
            Some(CellState::Known(navigability)) => navigability,
            _ => 0.0,
        }
    }

    /// The tiles that changed since a revision, in as many messages as they need.
    fn send_tiles(&self, header: Header, revision_before: u64) -> Result<(), ServiceError> {
        let changed: Vec<_> = self.map.tiles_changed_since(revision_before).collect();
        let capacity = self.outbox.tiles.capacity();
        let parts = changed.chunks(capacity).len();
        let known = self.map.known_cells().count();
        let quality: f64 = self.map.known_cells().filter_map(|(_, cell)| cell.quality()).sum();
        for (part, tiles) in changed.chunks(capacity).enumerate() {
            let mut loan = self.outbox.tiles.loan(tiles.len())?;
            *loan.meta_mut() = MapMeta {
                header,
                revision: self.map.revision(),
                cell_m: self.map.cell_m(),
                tiles_total: self.map.tiles().count() as u32,
                cells_known: known as u32,
                mean_quality: if known == 0 { 0.0 } else { quality / known as f64 },
                bytes: self.map_bytes(),
                part: part as u32,
                parts: parts as u32,
                reserved: 0,
            };
            for (item, tile) in loan.items_mut().iter_mut().zip(tiles) {
                messages::write_tile(tile, &self.map, item);
            }
            loan.send()?;
        }
        Ok(())
    }
}

/// The robot's base: on the ground under the scanner, upright, heading as the scanner does.
fn robot_pose(map_from_scanner: &Pose, ground_height_m: f64) -> Pose {
    let (_, _, yaw) = map_from_scanner.rotation.euler_angles();
    let position = map_from_scanner.translation.vector + Vector3::new(0.0, 0.0, ground_height_m);
    Pose::from_parts(Translation3::from(position), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw))
}

/// The checkpoint: the number of finished scans, then the map.
fn save_map(setup: &ServiceSetup, map: &InformationMap, finished_scans: u32) -> Result<(), ServiceError> {
    let mut content = finished_scans.to_le_bytes().to_vec();
    content.extend_from_slice(&map.to_bytes());
    Ok(checkpoint::save(&setup.state_file(), &content)?)
}

fn saved_map(setup: &ServiceSetup, config: &PlanningServiceConfig) -> Result<(InformationMap, u32), ServiceError> {
    let empty = || InformationMap::new(config.map).map_err(|e| ServiceError::Config(e.to_string()));
    if setup.incarnation == 0 {
        return Ok((empty()?, 0));
    }
    let path = setup.state_file();
    let Some(content) = checkpoint::load(&path)? else { return Ok((empty()?, 0)) };
    let invalid = |reason: String| CheckpointError::Invalid { path: path.clone(), reason };
    let (count, bytes) = content.split_first_chunk::<4>().ok_or_else(|| invalid("it is empty".into()))?;
    let map = InformationMap::from_bytes(bytes).map_err(|e| invalid(e.to_string()))?;
    Ok((map, u32::from_le_bytes(*count)))
}
