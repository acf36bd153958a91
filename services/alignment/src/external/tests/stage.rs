//! A domain with alignment's end and one that answers, in a thread with a participant of its own.

use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use mirador_core::geometry::{pose_from_rows, rows_from_pose};
use mirador_core::registration::conformance::scenes::{Rectangle, scan_of};
use mirador_core::registration::{RegistrationConfig, Registry};
use mirador_core::scan::Point;
use mirador_ipc_schema::messages::{
    Envelope, Header, KeyframePoint, RegistrationRequestMeta, RegistrationResult, RegistrationStatus,
};
use mirador_ipc_schema::{Domain, Participant, Publisher, Sizes, StopSignal, Wake, text, topics};

use super::super::*;

pub(super) type Results = Publisher<topics::RegistrationResult>;

/// What the answering end does with a request; it ends with the process if this says so.
pub(super) type Behaviour = fn(&RegistrationRequestMeta, &[KeyframePoint], &Results) -> Goes;

#[derive(PartialEq)]
pub(super) enum Goes {
    On,
    Away,
}

pub(super) fn participant(domain: &Domain, name: &str, stop: &StopSignal) -> Participant {
    Participant::join(domain.clone(), name, 0, Sizes { scan_points: 100_000 }, Wake::Event, stop.clone()).unwrap()
}

/// A domain with alignment's end, and perhaps somebody who answers.
pub(super) struct Stage {
    domain: Domain,
    stop: StopSignal,
    answerer: Option<JoinHandle<()>>,
    pub own: Option<(External, Participant)>,
    pub tally: Tally,
}

impl Stage {
    pub fn new(deadline_ms: u32, behaviour: Option<Behaviour>) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let domain =
            Domain::new(&format!("ext{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed))).unwrap();
        let stop = StopSignal::default();
        let own = participant(&domain, "alignment", &stop);
        let link = Link::open(&own, deadline_ms).unwrap();
        let answerer = behaviour.map(|behaviour| answer(&domain, &stop, behaviour));
        assert!(answerer.is_none() || link.wait_for_somebody(Duration::from_secs(30), || ()), "nobody answers");
        let (fallback, tally) = (built_in("gicp"), Tally::new("gicp"));
        let rules = Rules { acceptance: AcceptanceConfig::default(), final_pair_distance_m: 0.5 };
        let external = External::new(fallback, link, tally.clone(), rules);
        Self { domain, stop, answerer, own: Some((external, own)), tally }
    }

    pub fn align(&mut self, scans: &[Vec<Point>; 2], start: &Pose, limits: &Limits) -> Alignment {
        let external = &mut self.own.as_mut().unwrap().0;
        align(external, scans, start, limits)
    }

    pub fn status(&self) -> RegistrationStatus {
        self.tally.status()
    }

    pub fn last_fault(&self) -> String {
        text::unpack(&self.status().last_fault).to_owned()
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        self.stop.set();
        let ended = self.answerer.take().map(JoinHandle::join);
        self.own = None;
        self.domain.remove_all().unwrap();
        if !std::thread::panicking() {
            assert!(ended.is_none_or(|e| e.is_ok()), "the answering end has failed");
        }
    }
}

pub(super) fn answer(domain: &Domain, stop: &StopSignal, behaviour: Behaviour) -> JoinHandle<()> {
    let (domain, stop) = (domain.clone(), stop.clone());
    std::thread::spawn(move || {
        let own = participant(&domain, "registration", &stop);
        let requests = own.subscriber::<topics::RegistrationRequest>().unwrap();
        let results = own.publisher::<topics::RegistrationResult>().unwrap();
        while !stop.is_set() {
            own.wait(&[&requests], Duration::from_millis(20));
            while let Some(request) = requests.receive().unwrap() {
                if behaviour(request.meta(), request.items(), &results) == Goes::Away {
                    return;
                }
            }
        }
    })
}

pub(super) fn built_in(name: &str) -> Box<dyn Registration> {
    Registry::default().create(name, &RegistrationConfig::default()).unwrap()
}

pub(super) fn align(
    method: &mut dyn Registration,
    scans: &[Vec<Point>; 2],
    start: &Pose,
    limits: &Limits,
) -> Alignment {
    let [target, source] = scans.each_ref().map(|points| method.prepare(ScanView::unordered(points)).unwrap());
    method.align(&*target, &*source, start, limits).unwrap()
}

pub(super) fn pair(scene: &[Rectangle], target_from_source: &Pose) -> [Vec<Point>; 2] {
    [scan_of(scene, &Pose::identity(), 40.0, 1), scan_of(scene, target_from_source, 40.0, 2)]
}

pub(super) fn truth() -> Pose {
    Pose::new(nalgebra::Vector3::new(0.4, -0.3, 0.05), nalgebra::Vector3::new(0.01, 0.02, 0.05))
}

/// The answer of an honest process: point to plane over the points of the request.
pub(super) fn honest(request: &RegistrationRequestMeta, items: &[KeyframePoint]) -> RegistrationResult {
    let (target, source) = items.split_at(request.target_points as usize);
    assert_eq!(source.len(), request.source_points as usize);
    assert!(items.iter().all(|p| p.position[3] == 1.0 && p.normal[3] == 0.0));
    let points = |items: &[KeyframePoint]| -> Vec<Point> {
        items.iter().map(|p| Point::new(p.position[0], p.position[1], p.position[2])).collect()
    };
    let start = pose_from_rows(&request.initial_target_from_source).unwrap();
    let limits = Limits {
        max_iterations: request.max_iterations,
        pair_distance_m: request.pair_distance_m,
        max_translation_m: request.max_translation_m,
        max_rotation: request.max_rotation,
    };
    let found = align(&mut *built_in("point_to_plane"), &[points(target), points(source)], &start, &limits);
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

pub(super) fn send(results: &Results, result: RegistrationResult) -> Goes {
    results.send_one(Envelope { header: Header::new(0, 0) }, result).unwrap();
    Goes::On
}
