use super::*;
use crate::testing::Viewer;
use foxglove::Decode;
use foxglove::messages::{FrameTransform, PointCloud, PosesInFrame};
use mirador_ipc_schema::messages::{
    AlignmentMeta, Header, Point, PointScore, SERVICE_RUNNING, ScanId, ScanMeta, ScoredScanMeta, ViewPlanMeta,
};
use mirador_ipc_schema::topics::Sizes;
use mirador_ipc_schema::{Domain, Publisher, StopSignal, Wake, text, topics};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::thread::JoinHandle;
use tungstenite::Message;

/// A gateway in a domain of its own, and a peer that speaks to it as the services of a graph do.
struct Stage {
    setup: ServiceSetup,
    service: Option<JoinHandle<Result<(), ServiceError>>>,
    peer: Option<Peer>,
    _folder: tempfile::TempDir,
}

struct Peer {
    scans: Publisher<topics::Scan>,
    alignments: Publisher<topics::Alignment>,
    scores: Publisher<topics::ScoredScan>,
    plans: Publisher<topics::ViewPlan>,
    health: Subscriber<topics::ServiceHealth>,
    participant: Participant,
}

const POINTS: usize = 500;

impl Stage {
    fn new(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let setup = setup(folder.path(), &format!("gw{name}{}", std::process::id()), 0);
        let peer = Some(Peer::join(&setup));
        Self { setup, service: None, peer, _folder: folder }
    }

    fn start(&mut self, port: u16) {
        let (setup, config) = (self.setup.clone(), GatewayConfig { port, ..GatewayConfig::default() });
        self.service = Some(std::thread::spawn(move || run(&setup, &config)));
    }

    fn peer(&mut self) -> &mut Peer {
        self.peer.as_mut().unwrap()
    }

    /// A gateway that viewers can connect to, and its port.
    fn open(name: &str) -> (Self, u16) {
        let mut stage = Self::new(name);
        stage.start(0);
        let said = stage.peer().said("ws://");
        let port = said.rsplit(':').next().unwrap().parse().unwrap();
        (stage, port)
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        self.setup.stop.set();
        let ended = self.service.take().map(JoinHandle::join);
        self.peer = None;
        let _ = self.setup.domain.remove_all();
        if !std::thread::panicking() {
            assert!(matches!(ended, None | Some(Ok(Ok(())))), "the gateway failed");
        }
    }
}

impl Peer {
    fn join(setup: &ServiceSetup) -> Self {
        let stop = StopSignal::default();
        let participant = Participant::join(setup.domain.clone(), "peer", 0, setup.sizes, Wake::Event, stop).unwrap();
        Self {
            scans: participant.publisher().unwrap(),
            alignments: participant.publisher().unwrap(),
            scores: participant.publisher().unwrap(),
            plans: participant.publisher().unwrap(),
            health: participant.subscriber().unwrap(),
            participant,
        }
    }

    /// What the running gateway says of itself, once `part` is in it.
    fn said(&mut self, part: &str) -> String {
        let began = Instant::now();
        loop {
            while let Some(message) = self.health.receive().unwrap() {
                let health = message.items()[0];
                let said = text::unpack(&health.message);
                if health.state == SERVICE_RUNNING && said.contains(part) {
                    return said.to_owned();
                }
            }
            assert!(began.elapsed() < Duration::from_secs(20), "the gateway never said {part}");
            self.participant.wait(&[&self.health], HEARTBEAT);
        }
    }

    /// A scan, its pose, its scores and its plan.
    fn scan(&self, scan: u32) {
        let header = Header::new(ScanId { robot: 0, run: 2, scan }.pack(), i64::from(scan));
        self.scans.send_copy(ScanMeta { header, ..ScanMeta::default() }, &points(scan, POINTS)).unwrap();
        let meta = AlignmentMeta { header, map_from_scanner: pose(scan), status: 1, ..AlignmentMeta::default() };
        self.alignments.send_copy(meta, &[]).unwrap();
        let score = PointScore { quality: 65535, flags: 1, ..PointScore::default() };
        self.scores.send_copy(ScoredScanMeta { header, ..ScoredScanMeta::default() }, &[score; POINTS]).unwrap();
        self.plans.send_copy(ViewPlanMeta { header, ..ViewPlanMeta::default() }, &[]).unwrap();
    }
}

fn setup(folder: &Path, domain: &str, incarnation: u32) -> ServiceSetup {
    ServiceSetup {
        name: "gateway".into(),
        domain: Domain::new(domain).unwrap(),
        incarnation,
        sizes: Sizes { scan_points: 1000 },
        wake: Wake::Event,
        run_dir: folder.to_owned(),
        run: 2,
        threads: 1,
        stop: StopSignal::default(),
    }
}

fn points(scan: u32, n: usize) -> Vec<Point> {
    (0..n).map(|i| Point { x: i as f32 * 0.3, y: scan as f32, z: 0.5, intensity: 0, time: 0 }).collect()
}

fn pose(scan: u32) -> [f64; 16] {
    let x = 2.0 + f64::from(scan);
    [1., 0., 0., x, 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]
}

/// Waits for the cloud of a scan that [`Peer::scan`] has sent, and checks it. Who subscribes at the same moment may get the
/// scan before once more.
fn assert_cloud(viewer: &mut Viewer, scan: u32) {
    let x = |cloud: &PointCloud| cloud.pose.as_ref().unwrap().position.unwrap().x;
    let mut cloud = PointCloud::decode(viewer.drawing("/cloud").1.as_slice()).unwrap();
    while x(&cloud) < pose(scan)[3] {
        cloud = PointCloud::decode(viewer.drawing("/cloud").1.as_slice()).unwrap();
    }
    assert_eq!(cloud.data.len(), POINTS * 20);
    let numbers = |k: usize| f32::from_le_bytes(cloud.data[k..k + 4].try_into().unwrap());
    let last = points(scan, POINTS)[POINTS - 1];
    let at = (POINTS - 1) * 20;
    assert_eq!([at, at + 4, at + 8, at + 16].map(numbers), [last.x, last.y, last.z, 1.0]);
    assert_eq!(x(&cloud), pose(scan)[3]);
}

#[test]
fn a_viewer_sees_what_the_graph_says() {
    let (mut stage, port) = Stage::open("see");
    let mut viewer = Viewer::connect(port);
    assert_eq!(viewer.offered()["/cloud"], "foxglove.PointCloud");
    assert_eq!(viewer.offered()["/candidates"], "foxglove.SceneUpdate");
    assert_eq!(viewer.offered().len(), mirador_viewers::CHANNELS.len());
    for scan in 0..3 {
        stage.peer().scan(scan);
        assert_cloud(&mut viewer, scan);
    }
    stage.peer().scan(3);
    let (time, frame) = viewer.drawing("/tf");
    assert!(clock::utc_ns().abs_diff(time) < 60_000_000_000, "it is dated now");
    assert_eq!(FrameTransform::decode(frame.as_slice()).unwrap().translation.unwrap().x, pose(3)[3]);
}

#[test]
fn a_viewer_that_comes_late_gets_what_there_is() {
    let (mut stage, port) = Stage::open("late");
    let mut first = Viewer::connect(port);
    for scan in 0..2 {
        stage.peer().scan(scan);
        first.drawing("/cloud");
    }
    let mut late = Viewer::connect(port);
    let poses = PosesInFrame::decode(late.drawing("/poses").1.as_slice()).unwrap();
    assert_eq!(poses.poses.len(), 2);
    let mut late = Viewer::connect(port);
    assert_cloud(&mut late, 1);
    let mut late = Viewer::connect(port);
    let model = PointCloud::decode(late.drawing("/model").1.as_slice()).unwrap();
    assert_eq!(model.data.len(), 2 * POINTS * 20, "both scans");
}

#[test]
fn a_port_that_is_taken_is_named_and_served_once_it_is_free() {
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = other.local_addr().unwrap().port();
    let mut stage = Stage::new("taken");
    stage.start(port);
    let said = stage.peer().said("taken by another program");
    assert!(said.contains(&format!("127.0.0.1:{port}")) && said.contains("gateway.port"), "{said}");
    drop(other);
    stage.peer().said("live at ws://");
    stage.peer().scan(0);
    assert_cloud(&mut Viewer::connect(port), 0);
}

#[test]
fn a_babbling_client_is_told_so_and_the_others_see_on() {
    let (mut stage, port) = Stage::open("babble");
    let mut good = Viewer::connect(port);
    let mut babbler = Viewer::connect(port);
    for wrong in [
        Message::text("{\"op\":\"smell\"}"),
        Message::text("not even that"),
        Message::binary(vec![250_u8; 33]),
        Message::text("{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":9999,\"channelId\":123456789}]}"),
    ] {
        assert!(babbler.say(wrong));
        let said = babbler.text("status")["message"].as_str().unwrap().to_owned();
        assert!(said.contains("Invalid message") || said.contains("Unknown channel"), "{said}");
    }
    // One that does not listen either is shown the door.
    let began = Instant::now();
    while babbler.say(Message::binary(vec![250_u8; 33])) {
        assert!(began.elapsed() < Duration::from_secs(20), "it may babble on");
    }
    // Someone who does not speak the protocol at all.
    let mut stranger = TcpStream::connect(("127.0.0.1", port)).unwrap();
    std::io::Write::write_all(&mut stranger, &[7; 5000]).unwrap();
    stage.peer().scan(0);
    assert_cloud(&mut good, 0);
}

#[test]
fn a_client_that_does_not_read_loses_the_oldest_drawings_and_holds_up_nobody() {
    let (mut stage, port) = Stage::open("stall");
    let mut stalled = Viewer::connect(port);
    let mut good = Viewer::connect(port);
    let scans = 60;
    for scan in 0..scans {
        stage.peer().scan(scan);
        assert_cloud(&mut good, scan);
    }
    let mut seen = 0;
    loop {
        let cloud = PointCloud::decode(stalled.drawing("/cloud").1.as_slice()).unwrap();
        seen += 1;
        if cloud.pose.unwrap().position.unwrap().x == pose(scans - 1)[3] {
            break;
        }
    }
    assert!(seen < scans, "{seen} of {scans}: the newest is there, older ones are not");
    let mut late = Viewer::connect(port);
    assert_cloud(&mut late, scans - 1);
}

#[test]
fn a_restarted_gateway_shows_what_was_recorded() {
    let mut stage = Stage::new("again");
    let file = stage.setup.run_dir.join(RUN_FILE);
    let mut run = mirador_recorder::RunWriter::create(&file, &mirador_recorder::RecorderConfig::default()).unwrap();
    let header = Header::new(ScanId { robot: 0, run: 2, scan: 0 }.pack(), 0);
    let meta = AlignmentMeta { header, map_from_scanner: pose(0), status: 1, ..AlignmentMeta::default() };
    run.record::<topics::Alignment>(&meta, &[]).unwrap();
    // A recorder that still writes: there is no end yet.
    run.flush().unwrap();
    stage.setup.incarnation = 1;
    stage.start(0);
    let port = stage.peer().said("ws://").rsplit(':').next().unwrap().parse().unwrap();
    let poses = PosesInFrame::decode(Viewer::connect(port).drawing("/poses").1.as_slice()).unwrap();
    assert_eq!(poses.poses[0].position.unwrap().x, pose(0)[3]);
}
