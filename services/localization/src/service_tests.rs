//! The whole service against a scripted robot, over real shared memory.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use mirador_ipc_schema::messages::{
    AlignmentMeta, ClockMeta, Envelope, Header, Imu, Nothing, Odometry, PoseEstimate, RobotPose, RobotState, ScanId,
};
use mirador_ipc_schema::service::ServiceSetup;
use mirador_ipc_schema::{Domain, Participant, Publisher, Sizes, StopSignal, Subscriber, Topic, Wake, topics};

use super::*;

const STEP_NS: i64 = 50_000_000;
const RUN: u32 = 5;

/// The rest of the graph: a robot that stands, a clock and an alignment.
struct Partner {
    participant: Participant,
    imu: Publisher<topics::Imu>,
    odometry: Publisher<topics::Odometry>,
    states: Publisher<topics::RobotState>,
    clock: Publisher<topics::Clock>,
    alignments: Publisher<topics::Alignment>,
    poses: Subscriber<topics::RobotPoses>,
    priors: Subscriber<topics::Pose>,
    step: i64,
}

fn id(scan: u32) -> u64 {
    ScanId { robot: 0, run: RUN, scan }.pack()
}

impl Partner {
    fn join(domain: &Domain) -> Self {
        let sizes = Sizes { scan_points: 10 };
        let stop = StopSignal::default();
        let participant = Participant::join(domain.clone(), "partner", 0, sizes, Wake::Event, stop).unwrap();
        Self {
            imu: participant.publisher().unwrap(),
            odometry: participant.publisher().unwrap(),
            states: participant.publisher().unwrap(),
            clock: participant.publisher().unwrap(),
            alignments: participant.publisher().unwrap(),
            poses: participant.subscriber().unwrap(),
            priors: participant.subscriber().unwrap(),
            participant,
            step: 0,
        }
    }

    fn next<T: Topic>(&self, port: &Subscriber<T>) -> Option<(Header, T::Item)> {
        let message = port.receive_within(&self.participant, Duration::from_secs(5)).unwrap()?;
        Some((*message.header(), message.items()[0]))
    }

    /// One control step of a robot that stands; what localisation says to it.
    fn control(&mut self, with_sensors: bool) -> (Header, RobotPose) {
        let from = self.step * STEP_NS;
        self.step += 1;
        let now = self.step * STEP_NS;
        if with_sensors {
            let imu: Vec<Imu> = (1..=5)
                .map(|k| Imu { stamp_ns: from + k * 10_000_000, acceleration: [0.0, 0.0, 9.81], ..Imu::default() })
                .collect();
            self.imu.send_copy(Envelope { header: Header::new(0, now) }, &imu).unwrap();
            let odometry = [Odometry { stamp_ns: now - 10_000_000, ..Odometry::default() }];
            self.odometry.send_copy(Envelope { header: Header::new(0, now) }, &odometry).unwrap();
        }
        let state = RobotState::default();
        self.states.send_one(Envelope { header: Header::new(0, now) }, state).unwrap();
        self.next(&self.poses).expect("every step is answered")
    }

    fn release(&self, scan: u32, stamp_ns: i64) {
        let meta = ClockMeta { header: Header::new(id(scan), stamp_ns), ..ClockMeta::default() };
        self.clock.send_one(meta, Nothing::default()).unwrap();
    }

    /// The prior that came last, and how many there were.
    fn priors(&self) -> (usize, Option<(Header, PoseEstimate)>) {
        let (mut count, mut last) = (0, None);
        while let Some(message) = self.priors.receive().unwrap() {
            (count, last) = (count + 1, Some((*message.header(), message.items()[0])));
        }
        (count, last)
    }
}

/// Runs the service in a thread while `script` plays the partner.
fn with_service(config: &LocalizationConfig, script: impl FnOnce(&mut Partner)) {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let name = format!("l{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
    let domain = Domain::new(&name).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let setup = ServiceSetup {
        name: "localization".into(),
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
    while health
        .receive_within(&partner.participant, Duration::from_millis(20))
        .unwrap()
        .is_none_or(|m| m.items()[0].state == 0)
    {
        assert!(begin.elapsed() < Duration::from_secs(10), "the service has not come up");
    }
    script(&mut partner);
    setup.stop.set();
    service.join().unwrap().unwrap();
    drop((health, partner));
    domain.remove_all().unwrap();
}

#[test]
fn every_step_is_answered_and_a_scan_has_one_prior_with_the_clocks_id() {
    let config = LocalizationConfig { start_xyz: [3.0, -2.0, 0.5], ..LocalizationConfig::default() };
    with_service(&config, |partner| {
        for step in 1..=20 {
            let (header, pose) = partner.control(true);
            assert_eq!((header.stamp_ns, pose.lost, pose.aligned_scan), (step * STEP_NS, 0, u32::MAX));
            assert_eq!(header.id, id(u32::MAX));
        }
        // Released ahead of its time: the prior waits for the step that ends after it.
        partner.release(4, 21 * STEP_NS + 1);
        partner.control(true);
        std::thread::sleep(Duration::from_millis(100));
        assert_eq!(partner.priors().0, 0);
        partner.control(true);
        let (header, prior) = partner.next(&partner.priors).expect("a prior");
        assert_eq!((header.id, header.stamp_ns, prior.source, prior.lost), (id(4), 21 * STEP_NS + 1, 1, 0));
        let place = [prior.map_from_scanner[3], prior.map_from_scanner[7], prior.map_from_scanner[11]];
        let off = [place[0] - 3.0, place[1] + 2.0, place[2] - 1.5];
        assert!(off.iter().all(|x| x.abs() < 0.02) && prior.covariance[0] > 0.0, "{place:?}");
        partner.release(4, 21 * STEP_NS + 1);
        partner.control(true);
        partner.control(true);
        assert_eq!(partner.priors().0, 0, "the same scan has one prior");
        let mut aligned = AlignmentMeta {
            header: Header::new(id(4), 0),
            map_from_scanner: prior.map_from_scanner,
            status: mirador_ipc_schema::messages::ALIGNMENT_ACCEPTED,
            ..AlignmentMeta::default()
        };
        aligned.map_from_scanner[3] += 1.0;
        for k in 0..6 {
            aligned.pair_covariance[7 * k] = 1e-4;
        }
        partner.alignments.send_copy(aligned, &[]).unwrap();
        let (header, pose) = partner.control(true);
        assert_eq!((header.id, pose.aligned_scan), (id(4), 4));
        assert!((pose.map_from_robot[3] - 4.0).abs() < 0.05, "{}", pose.map_from_robot[3]);
    });
}

#[test]
fn silence_of_the_sensors_is_said_within_a_second_of_their_time() {
    with_service(&LocalizationConfig::default(), |partner| {
        (0..10).for_each(|_| assert_eq!(partner.control(true).1.lost, 0));
        let silent = (0..20).position(|_| partner.control(false).1.lost == 1);
        assert!(silent.is_some_and(|steps| steps < 20), "{silent:?}");
        assert_eq!(partner.control(true).1.lost, 0, "and ends with the next word");
    });
}

#[test]
fn a_wrong_setting_is_named() {
    let mut config = LocalizationConfig::default();
    config.gnss.gate = 0.0;
    let domain = Domain::new("l-none").unwrap();
    let setup = ServiceSetup {
        name: "localization".into(),
        domain,
        incarnation: 0,
        sizes: Sizes { scan_points: 10 },
        wake: Wake::Event,
        run_dir: "none".into(),
        run: RUN,
        threads: 1,
        stop: StopSignal::default(),
    };
    let message = run(&setup, &config).unwrap_err().to_string();
    assert!(message.contains("localization.gnss.gate = 0"), "{message}");
}
