//! The protocol with fake peers: shell scripts in the place of the Python program.

use super::*;

/// Patience that a script which answers at once never uses up, however busy the machine.
const LONG: Duration = Duration::from_secs(30);
/// Patience with a script that will never answer.
const SHORT: Duration = Duration::from_millis(300);

const READY: &str = r#"echo '{"ready": "fake", "version": "1.2"}'; "#;
const IDENTITY: &str = "[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]";

fn start(script: &str, patience: Duration) -> Result<PeerProcess, PeerError> {
    PeerProcess::start(Path::new("sh"), script, patience)
}

fn fake(script: &str, patience: Duration) -> PeerProcess {
    start(&format!("{READY}{script}"), patience).unwrap()
}

fn ask(peer: &mut PeerProcess) -> Result<PairAnswer, PeerError> {
    peer.ask("pair", &json!({"data": "d"}))
}

#[test]
fn a_well_behaved_peer_answers_again_and_again() {
    let answer = format!(r#"{{"ms": 2.5, "pose": {IDENTITY}, "iterations": 3, "parts": {{"align": 1.5}}}}"#);
    let mut peer = fake(&format!("while read -r line; do echo '{answer}'; done"), LONG);
    assert_eq!((peer.name.as_str(), peer.version.as_str()), ("fake", "1.2"));
    for _ in 0..3 {
        let answer = ask(&mut peer).unwrap();
        assert_eq!((answer.ms, answer.pose, answer.iterations), (2.5, Pose::identity(), Some(3)));
        assert_eq!(answer.parts["align"], 1.5);
    }
}

#[test]
fn the_clouds_arrive_after_their_counts_and_only_once() {
    // It has loaded them only if these are the coordinates of three points.
    let script = r#"
        read -r line
        read_floats() { head -c 36 | od -An -tf4 -v | tr -s ' \n' ' '; }
        if [ "$(read_floats)" = " 1 2 3 1 2 3 4 5 6 " ]; then echo '{"loaded": "d"}'; fi
        read -r line
        echo '{"loaded": "x"}'"#;
    let mut peer = fake(script, LONG);
    let (twice, once) = ([Point::new(1.0, 2.0, 3.0); 2], [Point::new(4.0, 5.0, 6.0)]);
    peer.load("d", &[&twice, &once]).unwrap();
    peer.load("d", &[&twice]).unwrap();
    assert!(matches!(peer.load("e", &[&[]]), Err(PeerError::Garbage(_))), "it has loaded something else");
}

#[test]
fn a_peer_without_its_library_is_absent() {
    let error = start(r#"echo '{"absent": "No module named small_gicp"}'"#, LONG).unwrap_err();
    assert_eq!(error, PeerError::Absent("No module named small_gicp".into()));
}

#[test]
fn a_python_that_is_not_there_is_reported() {
    let error = PeerProcess::start(Path::new("/no/such/python"), "", LONG).unwrap_err();
    assert!(matches!(&error, PeerError::Start(text) if text.contains("/no/such/python")), "{error}");
}

#[test]
fn a_crash_is_reported_with_its_status() {
    assert!(matches!(start("exit 3", LONG), Err(PeerError::Ended(status)) if status.contains('3')));
    let mut peer = fake("read -r line; kill -SEGV $$", LONG);
    let error = ask(&mut peer).unwrap_err();
    assert!(matches!(&error, PeerError::Ended(status) if status.contains("signal")), "{error}");
    assert!(error.is_fatal());
}

#[test]
fn a_peer_that_does_not_read_what_it_is_sent_hangs_nobody() {
    let mut peer = fake("exec sleep 100", SHORT);
    let cloud = vec![Point::new(1.0, 2.0, 3.0); 100_000];
    assert!(matches!(peer.load("d", &[&cloud]), Err(PeerError::Hung(_))));
}

#[test]
fn a_hanging_peer_is_killed_after_the_time_limit() {
    let mut peer = fake("read -r line; exec sleep 100", SHORT);
    let error = ask(&mut peer).unwrap_err();
    assert!(matches!(error, PeerError::Hung(_)) && error.is_fatal(), "{error}");
    assert!(peer.child.try_wait().unwrap().is_some(), "it is still alive");
}

#[test]
fn garbage_is_quoted_and_fatal() {
    assert!(matches!(start("echo hello", LONG), Err(PeerError::Garbage(line)) if line == "hello"));
    assert!(matches!(start("echo '{}'", LONG), Err(PeerError::Garbage(_))));
    let sheared = IDENTITY.replacen('1', "2", 1);
    for wrong in ["[1, 2]", r#"{"ms": 1.0}"#, r#"{"ms": 1.0, "pose": [1, 2]}"#, "{\"ms\": nan"]
        .map(str::to_owned)
        .into_iter()
        .chain([format!(r#"{{"ms": 1.0, "pose": {sheared}}}"#)])
    {
        let mut peer = fake(&format!("read -r line; echo '{wrong}'; exec sleep 100"), LONG);
        let error = ask(&mut peer).unwrap_err();
        assert!(matches!(error, PeerError::Garbage(_)), "{wrong}: {error}");
    }
}

#[test]
fn a_refused_request_leaves_the_peer_alive() {
    let answer = format!(r#"{{"ms": 1.0, "pose": {IDENTITY}, "iterations": null}}"#);
    let script = format!(r#"read -r line; echo '{{"error": "ValueError: no"}}'; read -r line; echo '{answer}'"#);
    let mut peer = fake(&script, LONG);
    let error = ask(&mut peer).unwrap_err();
    assert_eq!(error, PeerError::Refused("ValueError: no".into()));
    assert!(!error.is_fatal());
    assert_eq!(ask(&mut peer).unwrap().iterations, None);
}
