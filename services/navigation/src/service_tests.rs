//! The whole service against a scripted robot, over real shared memory.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use mirador_ipc_schema::messages::{
    Beam, DECISION_STOP, Envelope, Header, LoopClosingMeta, MotionCommand, PathMeta, PlanarScanMeta, Ranger, RobotPose,
    RobotState, ScanId, ScanRequestKind, ViewPlanMeta, Waypoint,
};
use mirador_ipc_schema::service::ServiceSetup;
use mirador_ipc_schema::{Domain, Participant, Publisher, Sizes, StopSignal, Subscriber, Wake, text, topics};

use super::*;
use crate::service::NAVIGATION;

const STEP_NS: i64 = 50_000_000;
const RUN: u32 = 9;
const IDENTITY: [f64; 16] = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];

/// The rest of the graph: a robot on a line, its sensors, and planning.
struct Partner {
    participant: Participant,
    lasers: Publisher<topics::PlanarScan>,
    rangers: Publisher<topics::Rangers>,
    states: Publisher<topics::RobotState>,
    poses: Publisher<topics::RobotPoses>,
    plans: Publisher<topics::ViewPlan>,
    paths: Publisher<topics::Path>,
    loops: Publisher<topics::LoopClosing>,
    commands: Subscriber<topics::MotionCommand>,
    requests: Subscriber<topics::ScanRequests>,
    status: Subscriber<topics::NavigationStatus>,
    obstructions: Subscriber<topics::Obstructions>,
    /// What the laser sees ahead [m].
    ahead: f32,
    step: i64,
    x: f64,
    linear: f64,
    state: RobotState,
}

fn id(scan: u32) -> u64 {
    ScanId { robot: 0, run: RUN, scan }.pack()
}

impl Partner {
    fn join(domain: &Domain) -> Self {
        let (sizes, stop) = (Sizes { scan_points: 10 }, StopSignal::default());
        let participant = Participant::join(domain.clone(), "partner", 0, sizes, Wake::Event, stop).unwrap();
        Self {
            lasers: participant.publisher().unwrap(),
            rangers: participant.publisher().unwrap(),
            states: participant.publisher().unwrap(),
            poses: participant.publisher().unwrap(),
            plans: participant.publisher().unwrap(),
            paths: participant.publisher().unwrap(),
            loops: participant.publisher().unwrap(),
            commands: participant.subscriber().unwrap(),
            requests: participant.subscriber().unwrap(),
            status: participant.subscriber().unwrap(),
            obstructions: participant.subscriber().unwrap(),
            ahead: f32::NAN,
            participant,
            step: 0,
            x: 0.0,
            linear: 0.0,
            state: RobotState::default(),
        }
    }

    /// Says one control step; the laser may be silent.
    fn say(&mut self, with_laser: bool) {
        self.step += 1;
        let now = self.step * STEP_NS;
        let header = Header::new(0, now);
        if with_laser {
            let meta = PlanarScanMeta { header, angle_step: 0.1, mount_xyz: [0.5, 0.0, 0.42], ..Default::default() };
            self.lasers.send_copy(meta, &[Beam { range: self.ahead, ..Beam::default() }; 10]).unwrap();
        }
        let ranger = Ranger {
            stamp_ns: now,
            mount_xyz: [0.52, 0.0, 0.36],
            mount_yaw_pitch: [0.0, 0.436],
            aperture: 0.349,
            range: 0.63,
            ..Ranger::default()
        };
        self.rangers.send_one(Envelope { header }, ranger).unwrap();
        self.states.send_one(Envelope { header }, self.state).unwrap();
        let mut pose = RobotPose { map_from_robot: IDENTITY, linear: self.linear, ..RobotPose::default() };
        pose.map_from_robot[3] = self.x;
        self.poses.send_one(Envelope { header }, pose).unwrap();
    }

    fn answer(&self, within: Duration) -> Option<MotionCommand> {
        let message = self.commands.receive_within(&self.participant, within).unwrap()?;
        let command = message.items()[0];
        assert_eq!((command.stamp_ns, command.source), (self.step * STEP_NS, NAVIGATION));
        Some(command)
    }

    /// One control step, answered; the robot moves as it is told.
    fn control(&mut self, with_laser: bool) -> MotionCommand {
        self.say(with_laser);
        let command = self.answer(Duration::from_secs(5)).expect("every step is answered");
        self.x += command.linear * 0.05;
        self.linear = command.linear;
        command
    }

    /// The scans that have been asked for.
    fn asked(&self) -> Vec<u32> {
        let mut scans = Vec::new();
        while let Some(message) = self.requests.receive().unwrap() {
            scans.extend(message.items().iter().filter(|r| r.kind == ScanRequestKind::TAKE).map(|r| r.scan));
        }
        scans
    }

    fn statuses(&self) -> Vec<(u32, String)> {
        let mut said = Vec::new();
        while let Some(message) = self.status.receive().unwrap() {
            said.extend(message.items().iter().map(|s| (s.state, text::unpack(&s.reason).to_owned())));
        }
        said
    }

    /// The robot comes to rest, asks for a scan once, and the head turns for it; how many steps the first two took.
    fn turn_head(&mut self, scan: u32) -> usize {
        let mut steps = 0;
        loop {
            self.control(true);
            match self.asked()[..] {
                [] => steps += 1,
                [asked] if asked == scan => break,
                ref other => panic!("asked for {other:?} instead of {scan}"),
            }
            assert!(steps < 200, "scan {scan} is not asked for");
        }
        self.state.scanning = 1;
        self.state.scans = scan + 1;
        self.control(true);
        self.control(true);
        self.state.scanning = 0;
        steps
    }
}

fn send_plan(partner: &Partner, scan: u32, decision: u32, waypoints: &[[f64; 3]]) {
    let header = Header::new(id(scan), 0);
    let plan = ViewPlanMeta { header, decision, reason_code: text::pack("done"), ..ViewPlanMeta::default() };
    partner.plans.send_copy(plan, &[]).unwrap();
    let items: Vec<_> = waypoints.iter().map(|position| Waypoint { position: *position, navigability: 1.0 }).collect();
    partner.paths.send_copy(PathMeta { header, ..PathMeta::default() }, &items).unwrap();
    partner.loops.send_copy(LoopClosingMeta { header, ..LoopClosingMeta::default() }, &[]).unwrap();
}

/// Runs the service in a thread while `script` plays the partner.
fn with_service(config: &NavigationConfig, script: impl FnOnce(&mut Partner)) {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let name = format!("n{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
    let domain = Domain::new(&name).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let setup = ServiceSetup {
        name: "navigation".into(),
        domain: domain.clone(),
        incarnation: 0,
        sizes: Sizes { scan_points: 10 },
        wake: Wake::Event,
        run_dir: folder.path().into(),
        run: RUN,
        threads: 1,
        stop: StopSignal::default(),
    };
    let mut partner = Partner::join(&domain);
    let health = partner.participant.subscriber::<topics::ServiceHealth>().unwrap();
    let (other, config) = (setup.clone(), config.clone());
    let service = std::thread::spawn(move || run(&other, &config).map_err(|e| e.to_string()));
    let begin = Instant::now();
    loop {
        let message = health.receive_within(&partner.participant, Duration::from_millis(20)).unwrap();
        if message.is_some_and(|m| m.items()[0].state != 0) {
            break;
        }
        assert!(begin.elapsed() < Duration::from_secs(10), "the service has not come up");
    }
    script(&mut partner);
    setup.stop.set();
    service.join().unwrap().unwrap();
    drop((health, partner));
    domain.remove_all().unwrap();
}

#[test]
fn a_scan_is_asked_for_once_its_plan_takes_no_time_and_is_driven_to_the_next_scan() {
    with_service(&NavigationConfig::default(), |partner| {
        let steps = partner.turn_head(0);
        assert!((20..=21).contains(&steps), "it stands for a second first: {steps} steps");
        // The head stands: this step is not answered before everything about the scan is there.
        partner.say(true);
        assert!(partner.answer(Duration::from_millis(150)).is_none());
        send_plan(partner, 0, 0, &[[0.0; 3], [1.0, 0.0, 0.0]]);
        let answer = partner.answer(Duration::from_secs(5)).expect("the plan answers the step");
        assert_eq!(answer.linear, 0.0, "the pose is older than the alignment");
        let first = partner.control(true);
        assert!(first.linear > 0.0 && first.valid_ns == 200_000_000, "{first:?}");
        partner.turn_head(1);
        assert!((partner.x - 1.0).abs() < 0.2, "at {}", partner.x);
        assert!(partner.statuses().iter().any(|(state, _)| *state == 1));
        partner.say(true);
        send_plan(partner, 1, DECISION_STOP, &[]);
        assert_eq!(partner.answer(Duration::from_secs(5)).unwrap().linear, 0.0);
        (0..5).for_each(|_| assert_eq!(partner.control(true).linear, 0.0));
        assert_eq!(partner.asked(), [0_u32; 0]);
        let last = partner.statuses().pop().unwrap();
        assert!(last.0 == 0 && last.1.starts_with("done"), "{last:?}");
    });
}

#[test]
fn a_silent_laser_stops_the_robot_within_a_second_until_it_returns() {
    with_service(&NavigationConfig::default(), |partner| {
        partner.turn_head(0);
        partner.say(true);
        send_plan(partner, 0, 0, &[[0.0; 3], [20.0, 0.0, 0.0]]);
        partner.answer(Duration::from_secs(5)).unwrap();
        (0..20).for_each(|_| _ = partner.control(true));
        assert!(partner.control(true).linear > 0.3);
        let stopped = (0..20).position(|_| partner.control(false).linear == 0.0);
        assert!(stopped.is_some(), "{stopped:?}");
        assert!(partner.statuses().contains(&(3, "the front laser is silent".into())));
        let again = (0..40).position(|_| partner.control(true).linear > 0.0);
        assert!(again.is_some(), "goes on when it returns");
    });
}

#[test]
fn without_lockstep_the_robot_stands_while_it_waits_for_the_plan() {
    let config = NavigationConfig { is_lockstep: false, await_corrections: false, ..NavigationConfig::default() };
    with_service(&config, |partner| {
        partner.turn_head(0);
        (0..5).for_each(|_| assert_eq!(partner.control(true).linear, 0.0));
        send_plan(partner, 0, 0, &[[0.0; 3], [5.0, 0.0, 0.0]]);
        let drives = (0..40).position(|_| partner.control(true).linear > 0.0);
        assert!(drives.is_some());
    });
}

#[test]
fn where_something_holds_the_robot_is_told_before_the_scan_there_is_asked_for() {
    with_service(&NavigationConfig::default(), |partner| {
        partner.turn_head(0);
        partner.say(true);
        send_plan(partner, 0, 0, &[[0.0; 3], [10.0, 0.0, 0.0]]);
        partner.answer(Duration::from_secs(5)).unwrap();
        (0..40).for_each(|_| _ = partner.control(true));
        assert!(partner.obstructions.receive().unwrap().is_none());
        // A quarter of a metre before the laser, and there again after it has backed up.
        partner.ahead = 0.25;
        let told = (0..600).find_map(|_| {
            partner.control(true);
            let told = partner.obstructions.receive().unwrap().map(|message| message.items()[0]);
            assert_eq!(partner.asked(), [0_u32; 0], "the scan is not asked for before");
            told
        });
        let told = told.expect("the target is given up");
        let front = partner.x + 0.75;
        assert!((told.centre[0] - front).abs() < 0.1 && told.centre[1].abs() < 0.05, "{told:?}, front at {front}");
        assert_eq!((told.scan, told.radius), (0, 0.3));
        assert!(partner.statuses().iter().any(|(state, why)| *state == 5 && why.starts_with("blocked")));
        partner.ahead = f32::NAN;
        partner.turn_head(1);
    });
}
