//! Simulator and acquisition over a real domain, with a partner that answers control steps and pose priors as navigation
//! and localization do.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mirador_acquisition::{AcquisitionConfig, SourceKind};
use mirador_ipc_schema::messages::{
    Envelope, Header, MotionCommand, PoseEstimate, RobotState, SCAN_HAS_PRIOR, ScanId, ScanMeta, ScanRequest,
    ScanRequestKind,
};
use mirador_ipc_schema::service::ServiceSetup;
use mirador_ipc_schema::{Domain, Participant, Publisher, Sizes, StopSignal, Subscriber, Wake, topics};
use mirador_service_common::ServiceError;
use mirador_simulator::SimulatorConfig;

const CELLS: usize = 720 * 541;
const PERIOD_NS: i64 = 50_000_000;
const PATIENCE: Duration = Duration::from_secs(120);

/// A domain and a folder of one test, both services in threads.
struct Stage {
    domain: Domain,
    folder: tempfile::TempDir,
    running: Vec<(StopSignal, JoinHandle<Result<(), ServiceError>>)>,
}

impl Stage {
    fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!("s{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        Self { domain: Domain::new(&name).unwrap(), folder: tempfile::tempdir().unwrap(), running: Vec::new() }
    }

    fn setup(&self, name: &str, incarnation: u32, stop: &StopSignal) -> ServiceSetup {
        ServiceSetup {
            name: name.into(),
            domain: self.domain.clone(),
            incarnation,
            sizes: Sizes { scan_points: CELLS },
            wake: Wake::Event,
            run_dir: self.folder.path().into(),
            run: 7,
            threads: 2,
            stop: stop.clone(),
        }
    }

    fn start_simulator(&mut self, config: SimulatorConfig) {
        let stop = StopSignal::default();
        let setup = self.setup("simulator", 0, &stop);
        self.running.push((stop, std::thread::spawn(move || mirador_simulator::run(&setup, &config))));
    }

    fn start_acquisition(&mut self, incarnation: u32) {
        let stop = StopSignal::default();
        let setup = self.setup("acquisition", incarnation, &stop);
        let scanner = SimulatorConfig::default().driven().unwrap().scanner;
        let config = AcquisitionConfig { source: SourceKind::Robot, scanner, ..AcquisitionConfig::default() };
        self.running.push((stop, std::thread::spawn(move || mirador_acquisition::run(&setup, &config))));
    }

    /// Ends the service that was started last.
    fn stop_last(&mut self) {
        let (stop, thread) = self.running.pop().unwrap();
        stop.set();
        thread.join().unwrap().unwrap();
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        for (stop, thread) in self.running.drain(..).rev() {
            stop.set();
            let _ = thread.join();
        }
        let _ = self.domain.remove_all();
    }
}

/// Navigation and localization, played by a test.
struct Partner {
    participant: Participant,
    states: Subscriber<topics::RobotState>,
    clock: Subscriber<topics::Clock>,
    scans: Subscriber<topics::Scan>,
    commands: Publisher<topics::MotionCommand>,
    requests: Publisher<topics::ScanRequests>,
    poses: Publisher<topics::Pose>,
    begun: Instant,
}

impl Partner {
    fn join(stage: &Stage) -> Self {
        let setup = stage.setup("partner", 0, &StopSignal::default());
        let participant = setup.join().unwrap();
        Self {
            states: participant.subscriber().unwrap(),
            clock: participant.subscriber().unwrap(),
            scans: participant.subscriber().unwrap(),
            commands: participant.publisher().unwrap(),
            requests: participant.publisher().unwrap(),
            poses: participant.publisher().unwrap(),
            participant,
            begun: Instant::now(),
        }
    }

    /// The next state, pose priors being answered meanwhile; or the next scan.
    fn next(&self) -> Next {
        loop {
            assert!(self.begun.elapsed() < PATIENCE, "nothing comes");
            while let Some(message) = self.clock.receive().unwrap() {
                let header = Header::new(message.header().id, message.header().stamp_ns);
                self.poses
                    .send_one(Envelope { header }, PoseEstimate { source: 1, ..PoseEstimate::default() })
                    .unwrap();
            }
            if let Some(message) = self.scans.receive().unwrap() {
                return Next::Scan(*message.meta(), bytes_of(message.items()));
            }
            if let Some(message) = self.states.receive().unwrap() {
                return Next::State(message.header().stamp_ns, message.items()[0]);
            }
            self.participant.wait(&[&self.states, &self.clock, &self.scans], Duration::from_millis(50));
        }
    }

    fn answer(&self, stamp_ns: i64, linear: f64) {
        let command = MotionCommand {
            stamp_ns,
            linear,
            angular: 0.0,
            valid_ns: 2 * PERIOD_NS as u64,
            source: 4,
            ..MotionCommand::default()
        };
        self.commands.send_one(Envelope { header: Header::new(0, stamp_ns) }, command).unwrap();
    }

    fn ask_for_scan(&self, scan: u32) {
        let request = ScanRequest { kind: ScanRequestKind::TAKE, scan, reserved: 0 };
        self.requests.send_one(Envelope { header: Header::new(0, 0) }, request).unwrap();
    }
}

enum Next {
    State(i64, RobotState),
    Scan(ScanMeta, Vec<u8>),
}

fn bytes_of(points: &[mirador_ipc_schema::messages::Point]) -> Vec<u8> {
    let words = points
        .iter()
        .flat_map(|p| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits(), u32::from(p.intensity), u32::from(p.time)]);
    words.flat_map(u32::to_le_bytes).collect()
}

/// Drives two seconds ahead, stands, has a scan taken and returns it with the robot's way and the states' stamps.
fn drive_and_scan(seed: u64) -> (ScanMeta, Vec<u8>, f64, Vec<i64>) {
    let mut stage = Stage::new();
    stage.start_acquisition(0);
    let partner = Partner::join(&stage);
    stage.start_simulator(SimulatorConfig { seed, ..SimulatorConfig::default() });
    let (mut stamps, mut way, mut from) = (Vec::new(), 0.0, None);
    loop {
        match partner.next() {
            Next::State(stamp_ns, state) => {
                let place = [state.map_from_robot[3], state.map_from_robot[7]];
                let from = *from.get_or_insert(place);
                way = f64::hypot(place[0] - from[0], place[1] - from[1]);
                if stamps.len() == 60 {
                    partner.ask_for_scan(0);
                }
                partner.answer(stamp_ns, if stamps.len() < 40 { 0.5 } else { 0.0 });
                stamps.push(stamp_ns);
            }
            Next::Scan(meta, points) => return (meta, points, way, stamps),
        }
    }
}

#[test]
fn a_robot_drives_as_it_is_told_and_its_scan_arrives_whole_with_the_same_bits_every_time() {
    let (meta, points, way, stamps) = drive_and_scan(3);
    let id = ScanId::unpack(meta.header.id);
    assert_eq!((id.scan, id.run, meta.rows, meta.cols), (0, 7, 720, 541));
    assert!((100_000..300_000).contains(&meta.returns), "{}", meta.returns);
    assert_eq!(meta.flags, SCAN_HAS_PRIOR);
    assert_eq!(meta.duration_ns, 719 * 20_000_000 + 15_000_000);
    assert!((0.8..1.1).contains(&way), "{way}");
    assert!(stamps.windows(2).all(|pair| pair[1] - pair[0] == PERIOD_NS) && stamps[0] == 0);
    // Asked for in step 60, it begins with the next one, and every row has points.
    assert_eq!(meta.header.stamp_ns, 60 * PERIOD_NS);
    let row = points.len() / 720;
    let is_return = |point: &[u8]| !f32::from_le_bytes(point[..4].try_into().unwrap()).is_nan();
    assert!(points.chunks(row).all(|row| row.chunks(20).any(is_return)));
    let (again, same_points, ..) = drive_and_scan(3);
    assert!(points == same_points && again.returns == meta.returns);
    assert!(drive_and_scan(4).1 != points);
}

#[test]
fn a_scan_in_which_acquisition_died_is_taken_again() {
    let mut stage = Stage::new();
    stage.start_simulator(SimulatorConfig::default());
    stage.start_acquisition(0);
    let partner = Partner::join(&stage);
    let (mut steps, mut restarted) = (0, false);
    loop {
        match partner.next() {
            Next::State(stamp_ns, state) => {
                if steps == 20 {
                    partner.ask_for_scan(0);
                }
                if steps == 120 {
                    assert_eq!(state.scanning, 1);
                    stage.stop_last();
                    stage.start_acquisition(1);
                    restarted = true;
                }
                partner.answer(stamp_ns, 0.0);
                steps += 1;
            }
            Next::Scan(meta, points) => {
                assert!(restarted && meta.header.stamp_ns >= 120 * PERIOD_NS, "{}", meta.header.stamp_ns);
                let row = points.len() / 720;
                let is_return = |point: &[u8]| !f32::from_le_bytes(point[..4].try_into().unwrap()).is_nan();
                assert!(points.chunks(row).all(|row| row.chunks(20).any(is_return)));
                return;
            }
        }
    }
}
