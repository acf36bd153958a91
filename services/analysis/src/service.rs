//! The loop: a scan comes, its surface is worked out; its pose comes, its scores go out.

use std::time::{Duration, Instant};

use mirador_core::analysis::{GroundHeight, GroundHeightOrigin, ScoreConfig, ScoreSummary, Scorer, Zone, ZoneFinder};
use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_core::surface::{SurfaceBuilder, SurfaceConfig};
use mirador_ipc_schema::messages::{self, AlignmentMeta, Envelope, Header, ScanId, ScoredScanMeta, WorkSpan};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Pause, Publisher, Received, Subscriber, Wakeable, clock, topics};
use mirador_service_common::{InOrder, ServiceError, log_place, nanoseconds, view};

use crate::AnalysisConfig;

/// Alignment is woken by the same message, perhaps on the same core, and what the scores wait for is its pose: it begins
/// first. The surface has more than ten milliseconds until then.
const HEAD_START: Duration = Duration::from_micros(200);

/// Scores every scan of the run until the process is stopped.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &AnalysisConfig) -> Result<(), ServiceError> {
    config.validate().map_err(ServiceError::Config)?;
    let participant = setup.join()?;
    let mut analysis = Analysis::open(setup, config, &participant)?;
    analysis.health.running(&participant);
    while !setup.stop.is_set() {
        analysis.pause = analysis.wait(&participant);
        analysis.receive(&participant)?;
        analysis.scores.serve_late_joiners();
        analysis.zones.serve_late_joiners();
        analysis.health.heartbeat(&participant);
    }
    Ok(())
}

struct Analysis {
    config: AnalysisConfig,
    scans: InOrder<topics::Scan>,
    alignments: Subscriber<topics::Alignment>,
    scores: Publisher<topics::ScoredScan>,
    zones: Publisher<topics::Zones>,
    health: HealthReporter,
    pause: Pause,
    surface: SurfaceBuilder,
    scorer: Scorer,
    finder: ZoneFinder,
    found_zones: Vec<Zone>,
    /// The scan whose surface is worked out and whose pose is awaited.
    current: Option<Current>,
    /// Alignments whose scan was not taken yet, by id; a handful at most.
    early: Vec<AlignmentMeta>,
    finished_scans: u32,
}

struct Current {
    scan: Received<topics::Scan>,
    began_ns: u64,
    surface_time: Duration,
    triangles_kept: u32,
    triangles_discarded: u32,
}

impl Analysis {
    fn open(setup: &ServiceSetup, config: &AnalysisConfig, participant: &Participant) -> Result<Self, ServiceError> {
        // The surface is worked out beside the alignment, which is what the scores wait for: it leaves that its cores. The
        // scores have them for themselves.
        let beside = setup.threads.div_ceil(2);
        let config = AnalysisConfig {
            surface: SurfaceConfig { threads: beside, ..config.surface.clone() },
            scores: ScoreConfig { threads: setup.threads, ..config.scores.clone() },
            zones: config.zones.clone(),
        };
        Ok(Self {
            config,
            scans: InOrder::new(participant.subscriber()?),
            alignments: participant.subscriber()?,
            scores: participant.publisher()?,
            zones: participant.publisher()?,
            health: HealthReporter::open(participant, &setup.name)?,
            pause: Pause::default(),
            surface: SurfaceBuilder::new(),
            scorer: Scorer::new(),
            finder: ZoneFinder::new(),
            found_zones: Vec::new(),
            current: None,
            early: Vec::new(),
            finished_scans: 0,
        })
    }

    fn awaited(&self) -> Vec<&dyn Wakeable> {
        let scans = self.scans.awaited(usize::from(self.current.is_some()));
        scans.into_iter().chain([&self.alignments as &dyn Wakeable]).collect()
    }

    /// Waits; a pose whose scan is at hand is looked for as soon as it is announced.
    fn wait(&self, participant: &Participant) -> Pause {
        let ports = self.awaited();
        if self.current.is_some() {
            return participant.wait_announced(&ports, HEARTBEAT);
        }
        participant.wait(&ports, HEARTBEAT)
    }

    /// Takes what is there. One scan is worked on at a time: the next waits until this is done.
    fn receive(&mut self, participant: &Participant) -> Result<(), ServiceError> {
        loop {
            self.scans.fill(usize::from(self.current.is_some()))?;
            if self.current.is_none() {
                match self.scans.pop() {
                    Some(scan) => self.begin(participant, scan)?,
                    None => return self.receive_alignments(),
                }
            }
            self.receive_alignments()?;
            let Some(current) = &self.current else { continue };
            let id = current.scan.header().id;
            // A scan older than the pose at hand lost its own pose; it cannot be finished any more.
            let Some(place) = self.early.iter().position(|a| a.header.id >= id) else { return Ok(()) };
            let alignment = self.early[place];
            self.early.retain(|a| a.header.id > id);
            if let Some(current) = self.current.take() {
                if alignment.header.id == id {
                    self.finish(participant, &current, &alignment)?;
                } else {
                    self.early.push(alignment);
                    tracing::warn!(scan = ScanId::unpack(id).scan, "its alignment did not come; it is not scored");
                }
            }
        }
    }

    fn receive_alignments(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.alignments.receive()? {
            self.early.push(*message.meta());
        }
        self.early.sort_by_key(|a| a.header.id);
        Ok(())
    }

    fn begin(&mut self, participant: &Participant, scan: Received<topics::Scan>) -> Result<(), ServiceError> {
        let number = scan.header().scan();
        if number < self.finished_scans {
            self.health.finished(participant, self.finished_scans, Duration::ZERO);
            return Ok(());
        }
        log_place(number, || scan.location());
        std::thread::sleep(HEAD_START);
        let begin = Instant::now();
        let began_ns = clock::monotonic_ns();
        let work = |reason: String| ServiceError::Work(format!("scan {number}: {reason}"));
        let points = view::scan(scan.meta(), scan.items());
        let surface = self.surface.build(points, &self.config.surface).map_err(|e| work(e.to_string()))?;
        // Zones are found in the scanner's frame: they need no pose either.
        let zones = &mut self.found_zones;
        self.finder.find(surface, points, &self.config.zones, zones).map_err(|e| work(e.to_string()))?;
        // Counted while the pose is awaited.
        let (triangles_kept, triangles_discarded) = (surface.kept_count() as u32, surface.discarded().len() as u32);
        let surface_time = begin.elapsed();
        self.health.worked(WorkSpan::until_now("surface", number, scan.header().sent_ns, self.pause, began_ns));
        // From now on the thread was busy, not asleep.
        self.pause = Pause::default();
        self.current = Some(Current { scan, began_ns, surface_time, triangles_kept, triangles_discarded });
        Ok(())
    }

    fn finish(
        &mut self,
        participant: &Participant,
        current: &Current,
        alignment: &AlignmentMeta,
    ) -> Result<(), ServiceError> {
        let (begin, began_ns) = (Instant::now(), clock::monotonic_ns());
        let number = current.scan.header().scan();
        let work = |reason: String| ServiceError::Work(format!("scan {number}: {reason}"));
        let Some(map_from_scanner) = pose_from_rows(&alignment.map_from_scanner) else {
            return Err(work("its alignment is not a rigid pose".into()));
        };
        let scan = view::scan(current.scan.meta(), current.scan.items());
        let surface = self.surface.surface();
        let level_from_scanner = &map_from_scanner.rotation;
        let ground = GroundHeight::resolve(&self.config.scores, scan, surface, level_from_scanner);
        let mut loan = self.scores.loan(scan.points.len())?;
        let summary = self
            .scorer
            .score(scan, surface, level_from_scanner, ground, &self.config.scores, view::scores_mut(loan.items_mut()))
            .map_err(|e| work(e.to_string()))?;
        let analysis_time = begin.elapsed();
        let header = Header::about(current.scan.header(), current.began_ns);
        *loan.meta_mut() = ScoredScanMeta {
            header,
            scan_sent_ns: current.scan.header().sent_ns,
            alignment_sent_ns: alignment.header.sent_ns,
            surface_ns: nanoseconds(current.surface_time),
            analysis_ns: nanoseconds(analysis_time),
            triangles_kept: current.triangles_kept,
            triangles_discarded: current.triangles_discarded,
            alignment_status: alignment.status,
            scanner_position: map_from_scanner.translation.vector.into(),
            zones: self.found_zones.len() as u32,
            ..summary_part(&summary)
        };
        // The scores last: with them everything is there that planning waits for. It wakes up with the zones.
        self.send_zones(header, &map_from_scanner)?;
        loan.send()?;
        self.health.worked(WorkSpan::until_now("scores", number, alignment.header.sent_ns, self.pause, began_ns));
        self.pause = Pause::default();
        self.finished_scans = number + 1;
        self.health.finished(participant, self.finished_scans, current.surface_time + begin.elapsed());
        Ok(())
    }

    fn send_zones(&self, header: Header, map_from_scanner: &Pose) -> Result<(), ServiceError> {
        // The largest ones, when there are more than a message holds.
        let capacity = self.zones.capacity();
        let mut order: Vec<&Zone> = self.found_zones.iter().collect();
        order.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
        order.truncate(capacity);
        let mut loan = self.zones.loan(order.len())?;
        *loan.meta_mut() = Envelope { header };
        for (item, zone) in loan.items_mut().iter_mut().zip(order) {
            let centre = map_from_scanner * zone.centre.cast::<f64>();
            let normal = map_from_scanner.rotation * zone.normal.cast::<f64>();
            *item = messages::Zone {
                centre: centre.coords.cast::<f32>().into(),
                normal: normal.cast::<f32>().into(),
                area: zone.area_m2,
                triangles: zone.triangles,
                scan: header.scan(),
                merged: 0,
            };
        }
        Ok(loan.send()?)
    }
}

fn summary_part(summary: &ScoreSummary) -> ScoredScanMeta {
    ScoredScanMeta {
        ground_height_m: -summary.scanner_height_m,
        mean_quality: summary.mean_quality,
        points_valid: summary.valid as u32,
        points_reachable: summary.reachable as u32,
        ground_source: match summary.ground_origin {
            GroundHeightOrigin::Configured => 0,
            GroundHeightOrigin::Estimated => 1,
            GroundHeightOrigin::Assumed => 2,
        },
        ..ScoredScanMeta::default()
    }
}
