//! A registration process of somebody else's: a test program once more, run with an environment variable saying how it behaves.
//! The test program has a test named as below, which does nothing else.

use std::time::Duration;

use mirador_core::geometry::{pose_from_rows, rows_from_pose};
use mirador_core::registration::{Limits, RegistrationConfig, Registry};
use mirador_core::scan::{Point, ScanView};
use mirador_ipc_schema::messages::{Envelope, Header, KeyframePoint, RegistrationRequestMeta, RegistrationResult};
use mirador_ipc_schema::service::{HealthReporter, ServiceSetup};
use mirador_ipc_schema::{ScanId, StopSignal, topics};

/// How the answering process is told how to behave.
pub const BEHAVIOUR: &str = "MIRADOR_TEST_ANSWERS";
/// The name of the test that is the answering process.
const ANSWERER: &str = "the_answering_process";

/// What the test of that name does: without the wish it is no test of its own.
pub fn answer_if_asked() {
    if let Ok(behaviour) = std::env::var(BEHAVIOUR) {
        answer(&behaviour);
    }
}

/// The setting that makes the test program itself the one that registers.
pub fn command() -> String {
    let own = std::env::current_exe().unwrap();
    format!("programs.registration.command=[\"{}\", \"--exact\", \"{ANSWERER}\", \"--nocapture\"]", own.display())
}

/// The same, with what it prints in its log.
pub fn logging_command() -> String {
    let own = std::env::current_exe().unwrap();
    let command = format!("exec \\\"{}\\\" --exact {ANSWERER} --nocapture >&2", own.display());
    format!("programs.registration.command=[\"sh\", \"-c\", \"{command}\"]")
}

/// The requests that a log tells of: the target scan's number, and the source scan's with the place of the keyframes.
pub fn requests(log: &str) -> Vec<(u32, (u64, u64, u64))> {
    let numbers = |line: &str| line.split(' ').map(|word| word.parse().ok()).collect::<Option<Vec<u64>>>();
    let found = log.lines().filter_map(numbers).filter(|numbers| numbers.len() == 4);
    found.map(|n| (n[0] as u32, (n[1], n[2], n[3]))).collect()
}

/// Answers requests, well or ill, until it is ended.
fn answer(behaviour: &str) {
    let setup = ServiceSetup::from_environment(StopSignal::from_terminal().unwrap()).unwrap();
    let (own, stop) = (setup.join().unwrap(), setup.stop.clone());
    let requests = own.subscriber::<topics::RegistrationRequest>().unwrap();
    let results = own.publisher::<topics::RegistrationResult>().unwrap();
    let mut health = HealthReporter::open(&own, &setup.name).unwrap();
    health.running(&own);
    let send = |result| results.send_one(Envelope { header: Header::new(0, 0) }, result).unwrap();
    while !stop.is_set() {
        own.wait(&[&requests], Duration::from_millis(20));
        health.heartbeat(&own);
        while let Some(request) = requests.receive().unwrap() {
            let place = request.location().unwrap();
            let target = ScanId::unpack(request.meta().target_id).scan;
            println!("{target} {} {} {}", request.header().scan(), place.inode, place.offset);
            let honest = || honest(request.meta(), request.items());
            match behaviour {
                "honest" => send(honest()),
                "crash" => std::process::abort(),
                "hang" => loop {
                    std::thread::sleep(Duration::from_secs(3600));
                },
                "named" if [request.meta().target_id, request.header().id].contains(&u64::MAX) => {
                    send(RegistrationResult { target_from_source: [f64::NAN; 16], ..honest() });
                }
                "named" => send(honest()),
                "nan" => send(RegistrationResult { target_from_source: [f64::NAN; 16], ..honest() }),
                "non_rigid" => {
                    let target_from_source = std::array::from_fn(|i| if i % 5 == 0 { 1.5 } else { 0.0 });
                    send(RegistrationResult { target_from_source, ..honest() });
                }
                "older" => send(RegistrationResult { request: request.meta().request - 1, ..honest() }),
                "flood" => {
                    let result = RegistrationResult { request: u64::MAX, ..honest() };
                    while !stop.is_set() {
                        send(result);
                    }
                }
                "schema" => send(RegistrationResult { schema: 1, ..honest() }),
                other => panic!("no such behaviour: {other}"),
            }
        }
    }
}

/// What point to plane finds between the keyframes of a request.
fn honest(request: &RegistrationRequestMeta, items: &[KeyframePoint]) -> RegistrationResult {
    let mut method = Registry::default().create("point_to_plane", &RegistrationConfig::default()).unwrap();
    let (target, source) = items.split_at(request.target_points as usize);
    let [target, source] = [target, source].map(|items| {
        let points: Vec<Point> =
            items.iter().map(|p| Point::new(p.position[0], p.position[1], p.position[2])).collect();
        method.prepare(ScanView::unordered(&points)).unwrap()
    });
    let start = pose_from_rows(&request.initial_target_from_source).unwrap();
    let limits = Limits {
        max_iterations: request.max_iterations,
        pair_distance_m: request.pair_distance_m,
        max_translation_m: request.max_translation_m,
        max_rotation: request.max_rotation,
    };
    let found = method.align(&*target, &*source, &start, &limits).unwrap();
    RegistrationResult {
        request: request.request,
        target_from_source: rows_from_pose(&found.target_from_source),
        covariance: std::array::from_fn(|i| found.covariance[(i / 6, i % 6)]),
        overlap: found.overlap,
        residual_m: found.residual_rms_m,
        iterations: found.iterations,
        converged: u32::from(found.converged),
        constrained: u32::from(found.constraint.mask()),
        schema: topics::registration_schema(),
    }
}
