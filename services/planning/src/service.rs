//! The loop: a scored scan comes, the map is updated, the decision goes out.

use std::time::{Duration, Instant};

use mirador_core::geometry::{Pose, pose_from_rows, rows_from_pose};
use mirador_core::information_map::{Cell, CellState, InformationMap, TILE_CELLS, Tile, Zone};
use mirador_core::view_planning::{Situation, Strategy, StrategyRegistry, ViewPlan};
use mirador_ipc_schema::messages::{
    ALIGNMENT_REJECTED, AlignmentMeta, Header, MapMeta, PathMeta, ScanId, ViewPlanMeta, Waypoint,
};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Received, Subscriber, Wakeable, clock, topics};
use mirador_service_common::{CheckpointError, ServiceError, checkpoint, log_place, nanoseconds, view};
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
    while !setup.stop.is_set() {
        participant.wait(&[&planning.inbox.scores], HEARTBEAT);
        planning.inbox.connect();
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
    scans: Subscriber<topics::Scan>,
    alignments: Subscriber<topics::Alignment>,
    scores: Subscriber<topics::ScoredScan>,
    zones: Subscriber<topics::Zones>,
    /// Parts of the step that is being put together.
    pending: Option<Received<topics::ScoredScan>>,
    scan: Option<Received<topics::Scan>>,
    alignment: Option<AlignmentMeta>,
    seen_zones: Option<(u64, Vec<Zone>)>,
}

impl Inbox {
    /// Takes up the connection to publishers that came after this reader. Until a reader has looked once, a publisher
    /// does not wait for it: what does not fit into the buffer is lost. The scores wake the loop and are looked at anyway.
    fn connect(&self) {
        let others: [&dyn Wakeable; 3] = [&self.scans, &self.alignments, &self.zones];
        for port in others {
            port.is_ready();
        }
    }

    /// The next scored scan with everything that belongs to it, if all of it is there. The scores come last but for the
    /// zones, which follow them at once.
    fn next(&mut self) -> Result<Option<Step>, ServiceError> {
        if self.pending.is_none() {
            self.pending = self.scores.receive()?;
        }
        let Some(scores) = &self.pending else { return Ok(None) };
        let id = scores.header().id;
        while self.scan.as_ref().is_none_or(|s| s.header().id < id) {
            // The older scan is let go first: a reader may hold two at most.
            self.scan = None;
            match self.scans.receive()? {
                Some(scan) => self.scan = Some(scan),
                None => break,
            }
        }
        while self.alignment.is_none_or(|a| a.header.id < id) {
            match self.alignments.receive()? {
                Some(message) => self.alignment = Some(*message.meta()),
                None => break,
            }
        }
        while self.seen_zones.as_ref().is_none_or(|(of, _)| *of < id) {
            match self.zones.receive()? {
                Some(message) => self.seen_zones = Some((message.header().id, read_zones(&message))),
                None => break,
            }
        }
        self.put_together(id)
    }

    fn put_together(&mut self, id: u64) -> Result<Option<Step>, ServiceError> {
        let scan = self.scan.as_ref().map(|s| s.header().id);
        let alignment = self.alignment.map(|a| a.header.id);
        let zones = self.seen_zones.as_ref().map(|(of, _)| *of);
        let parts = [scan, alignment, zones];
        if parts.iter().any(|part| part.is_some_and(|of| of > id)) {
            tracing::warn!(scan = ScanId::unpack(id).scan, "a part of it was lost; it is not planned on");
            self.pending = None;
            return Ok(None);
        }
        if parts.iter().any(|part| *part != Some(id)) {
            return Ok(None);
        }
        let (Some(scores), Some(scan), Some(alignment), Some((_, zones))) =
            (self.pending.take(), self.scan.take(), self.alignment, self.seen_zones.take())
        else {
            return Ok(None);
        };
        Ok(Some(Step { scan, scores, alignment, zones }))
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
    finished_scans: u32,
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
            inbox: Inbox {
                scans: participant.subscriber()?,
                alignments: participant.subscriber()?,
                scores: participant.subscriber()?,
                zones: participant.subscriber()?,
                pending: None,
                scan: None,
                alignment: None,
                seen_zones: None,
            },
            outbox: Outbox {
                plans: participant.publisher()?,
                paths: participant.publisher()?,
                tiles: participant.publisher()?,
            },
            health: HealthReporter::open(participant, &setup.name)?,
            map,
            strategy,
            finished_scans,
        })
    }

    fn take_in(&mut self, participant: &Participant, step: &Step) -> Result<(), ServiceError> {
        let begin = Instant::now();
        let number = step.scan.header().scan();
        if number < self.finished_scans {
            self.health.finished(participant, self.finished_scans, Duration::ZERO);
            return Ok(());
        }
        log_place(number, &step.scan);
        let began_ns = clock::monotonic_ns();
        let work = |reason: String| ServiceError::Work(format!("scan {number}: {reason}"));
        let map_from_scanner = pose_from_rows(&step.alignment.map_from_scanner)
            .ok_or_else(|| work("its alignment is not a rigid pose".into()))?;
        let revision_before = self.map.revision();
        if step.alignment.status != ALIGNMENT_REJECTED {
            self.update_map(step, &map_from_scanner).map_err(work)?;
        }
        let map_time = begin.elapsed();
        let situation = Situation {
            map_from_robot: robot_pose(&map_from_scanner, step.scores.meta().ground_height_m),
            scan_number: u64::from(number),
            run_seed: self.config.seed,
            threads: self.setup.threads,
        };
        let plan = self.strategy.plan(&self.map, &situation, &self.config.view);
        let planning_time = begin.elapsed() - map_time;
        let header = Header::about(step.scan.header(), began_ns);
        let known = ViewPlanMeta {
            header,
            scan_sent_ns: step.scan.header().sent_ns,
            map_ns: nanoseconds(map_time),
            planning_ns: nanoseconds(planning_time),
            map_from_scanner: rows_from_pose(&map_from_scanner),
            cells_known: self.map.known_cells().count() as u32,
            zones: self.map.zones().len() as u32,
            map_tiles: self.map.tiles().count() as u32,
            map_bytes: self.map_bytes(),
            ..messages::plan_meta(&plan)
        };
        self.send_plan(known, &plan)?;
        self.send_path(header, &plan)?;
        self.send_tiles(header, revision_before)?;
        self.finished_scans = number + 1;
        save_map(self.setup, &self.map, self.finished_scans)?;
        self.health.finished(participant, self.finished_scans, begin.elapsed());
        Ok(())
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
