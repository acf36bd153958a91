use super::*;
use crate::testing::{header, points};
use mirador_ipc_schema::messages::{
    AlignmentMeta, LoopClosingMeta, PointScore, ScanMeta, ScoredScanMeta, ViewPlanMeta,
};
use mirador_ipc_schema::topics::Sizes;
use mirador_ipc_schema::{Domain, StopSignal, Wake};
use std::path::Path;

/// A recorder without ports that writes to `folder`.
fn recorder(folder: &Path, incarnation: u32) -> Recorder {
    Recorder::open(&setup(folder, "unused", incarnation), &RecorderConfig::default(), &mut || {}).unwrap()
}

fn setup(folder: &Path, domain: &str, incarnation: u32) -> ServiceSetup {
    ServiceSetup {
        name: "recorder".into(),
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

fn scan(n: u32, sent_ns: u64) -> ScanMeta {
    ScanMeta { header: header(n, sent_ns), ..ScanMeta::default() }
}

#[test]
fn a_fresh_run_overwrites_and_a_restart_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let count = || RunReader::open(&folder.path().join(RUN_FILE)).unwrap().count::<topics::Scan>();
    let mut first = recorder(folder.path(), 0);
    first.take::<topics::Scan>(&scan(0, 1), &points(0, 10)).unwrap();
    first.writer.finish().unwrap();
    assert_eq!(count(), 1);
    let mut restarted = recorder(folder.path(), 1);
    // The history gives the old scan once more.
    restarted.take::<topics::Scan>(&scan(0, 1), &points(0, 10)).unwrap();
    restarted.take::<topics::Scan>(&scan(1, 2), &points(1, 10)).unwrap();
    restarted.writer.finish().unwrap();
    assert_eq!(count(), 2);
    recorder(folder.path(), 0).writer.finish().unwrap();
    assert_eq!(count(), 0);
}

#[test]
fn a_recording_without_an_end_is_gone_on_with_at_the_first_start_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(RUN_FILE);
    let mut first = recorder(folder.path(), 0);
    first.take::<topics::Scan>(&scan(0, 1), &points(0, 10)).unwrap();
    first.flush().unwrap();
    let killed = std::fs::read(&path).unwrap();
    first.writer.finish().unwrap();
    std::fs::write(&path, killed).unwrap();
    recorder(folder.path(), 0).writer.finish().unwrap();
    assert_eq!(RunReader::open(&path).unwrap().scan_index(), [0]);
}

#[test]
fn health_is_recorded_when_it_says_something_new() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path(), 0);
    for (n, finished_scans) in (0..).zip([0, 0, 1, 1, 1, 2]) {
        let meta = Envelope { header: header(n, u64::from(n) + 1) };
        let health = ServiceHealth { finished_scans, state: 1, ..ServiceHealth::default() };
        recorder.take::<topics::ServiceHealth>(&meta, &[health]).unwrap();
    }
    recorder.writer.finish().unwrap();
    let reader = RunReader::open(&folder.path().join(RUN_FILE)).unwrap();
    assert_eq!(reader.count::<topics::ServiceHealth>(), 3);
}

#[test]
fn the_service_records_what_is_said_and_acknowledges_whole_scans() {
    let folder = tempfile::tempdir().unwrap();
    let domain = format!("rec{}", std::process::id());
    let setup = setup(folder.path(), &domain, 0);
    let stop = setup.stop.clone();
    let served = setup.clone();
    let service = std::thread::spawn(move || run(&served, &RecorderConfig::default()));
    let peer =
        Participant::join(setup.domain.clone(), "peer", 0, setup.sizes, Wake::Event, StopSignal::default()).unwrap();
    let health = peer.subscriber::<topics::ServiceHealth>().unwrap();
    let acknowledged = |wanted: u32| {
        let began = Instant::now();
        loop {
            while let Some(message) = health.receive().unwrap() {
                let now = message.items()[0];
                if now.state == mirador_ipc_schema::messages::SERVICE_RUNNING && now.finished_scans == wanted {
                    return;
                }
            }
            assert!(began.elapsed() < Duration::from_secs(20), "no acknowledgement of {wanted} scans");
            peer.wait(&[&health], HEARTBEAT);
        }
    };
    acknowledged(0);
    let scans = peer.publisher::<topics::Scan>().unwrap();
    let alignments = peer.publisher::<topics::Alignment>().unwrap();
    let scores = peer.publisher::<topics::ScoredScan>().unwrap();
    let plans = peer.publisher::<topics::ViewPlan>().unwrap();
    let loops = peer.publisher::<topics::LoopClosing>().unwrap();
    for n in 0..3 {
        scans.send_copy(scan(n, 0), &points(n, 500)).unwrap();
        alignments.send_copy(AlignmentMeta { header: header(n, 0), ..AlignmentMeta::default() }, &[]).unwrap();
        let scored = ScoredScanMeta { header: header(n, 0), ..ScoredScanMeta::default() };
        scores.send_copy(scored, &[PointScore::default(); 500]).unwrap();
        loops.send_copy(LoopClosingMeta { header: header(n, 0), ..LoopClosingMeta::default() }, &[]).unwrap();
        plans.send_copy(ViewPlanMeta { header: header(n, 0), ..ViewPlanMeta::default() }, &[]).unwrap();
        acknowledged(n + 1);
    }
    stop.set();
    service.join().unwrap().unwrap();
    let mut reader = RunReader::open(&folder.path().join(RUN_FILE)).unwrap();
    assert!(reader.is_complete());
    assert_eq!(reader.scan_index(), [0, 1, 2]);
    reader.read_scan(1, &mut |_, items| assert_eq!(items, points(1, 500))).unwrap();
    drop((health, scans, alignments, scores, plans, loops));
    drop(peer);
    let _ = setup.domain.remove_all();
}

#[test]
fn a_scan_that_was_overtaken_is_asked_for_once_in_a_while() {
    let mut ledger = Ledger::new(vec!["scan"]);
    let mut gaps = Gaps::new();
    assert!(ledger.admit("scan", &header(0, 1)));
    assert!(gaps.requests(&mut ledger).is_empty());
    assert!(ledger.admit("scan", &header(3, 4)));
    assert_eq!(gaps.requests(&mut ledger), [1, 2]);
    assert!(gaps.requests(&mut ledger).is_empty(), "not twice in a row");
    for scan in [1, 2] {
        assert!(ledger.admit("scan", &header(scan, 9)));
    }
    assert!(gaps.requests(&mut ledger).is_empty());
    assert_eq!(ledger.finished(), 4);
}

#[test]
fn a_disk_that_is_full_ends_the_service_with_an_error_that_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(RUN_FILE);
    std::os::unix::fs::symlink("/dev/full", &path).unwrap();
    let setup = setup(folder.path(), &format!("recfull{}", std::process::id()), 0);
    let error = run(&setup, &RecorderConfig::default()).unwrap_err();
    assert!(matches!(error, RecorderError::Write(WriteError::DiskFull { .. })), "{error}");
    assert!(error.to_string().contains("run.mcap"), "{error}");
    let _ = setup.domain.remove_all();
}

#[test]
fn what_waits_for_a_plan_is_recorded_when_the_recorder_is_to_end() {
    let folder = tempfile::tempdir().unwrap();
    let domain = format!("rech{}", std::process::id());
    let setup = setup(folder.path(), &domain, 0);
    let stop = setup.stop.clone();
    let served = setup.clone();
    let service = std::thread::spawn(move || run(&served, &RecorderConfig::default()));
    let peer =
        Participant::join(setup.domain.clone(), "peer", 0, setup.sizes, Wake::Event, StopSignal::default()).unwrap();
    // The graph plans, so that a scan waits for its plan.
    let planner = ServiceHealth { service: text::pack("planning"), state: 1, ..ServiceHealth::default() };
    let reports = peer.publisher::<topics::ServiceHealth>().unwrap();
    let health = peer.subscriber::<topics::ServiceHealth>().unwrap();
    let began = Instant::now();
    let mut is_running = false;
    while !is_running {
        while let Some(message) = health.receive().unwrap() {
            is_running |= message.items()[0].state == mirador_ipc_schema::messages::SERVICE_RUNNING
                && text::unpack(&message.items()[0].service) == "recorder";
        }
        assert!(began.elapsed() < Duration::from_secs(20), "the recorder does not begin");
        peer.wait(&[&health], HEARTBEAT);
    }
    reports.send_one(Envelope { header: header(0, 0) }, planner).unwrap();
    std::thread::sleep(3 * HEARTBEAT);
    let scans = peer.publisher::<topics::Scan>().unwrap();
    scans.send_copy(scan(0, 0), &points(0, 500)).unwrap();
    stop.set();
    service.join().unwrap().unwrap();
    let reader = RunReader::open(&folder.path().join(RUN_FILE)).unwrap();
    assert_eq!(reader.count::<topics::Scan>(), 1);
    drop((reports, health, scans, peer));
    setup.domain.remove_all().unwrap();
}
