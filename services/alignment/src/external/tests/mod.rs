//! Answers of every kind, over real shared memory.

mod stage;

use std::time::Duration;

use mirador_core::geometry::rows_from_pose;
use mirador_core::registration::conformance::scenes::{CORRIDOR, YARD, scan_of};
use mirador_core::scan::Point;
use mirador_ipc_schema::messages::{self as m, Header, KeyframePoint, RegistrationResult};
use mirador_ipc_schema::{Domain, StopSignal, topics};

use super::*;
use stage::{Behaviour, Goes, Stage, align, built_in, honest, pair, participant, send, truth};

/// An answer comes in microseconds; this is for those that do not come.
const DEADLINE_MS: u32 = 300;
/// Where a deadline that passes would hide what is looked for.
const PATIENT_MS: u32 = 60_000;

/// Runs one alignment, expects it to be the built-in method's to the last bit, with one fault of this kind, named so.
fn refused(deadline_ms: u32, behaviour: Option<Behaviour>, place: usize, words: &str) {
    let mut stage = Stage::new(deadline_ms, behaviour);
    let scans = pair(&YARD, &truth());
    let found = stage.align(&scans, &Pose::identity(), &Limits::default());
    assert_eq!(found, align(&mut *built_in("gicp"), &scans, &Pose::identity(), &Limits::default()));
    let status = stage.status();
    assert_eq!((status.questions, status.answered, status.fallbacks), (1, 0, 1), "{}", stage.last_fault());
    assert_eq!(status.faults[place], 1, "{}", stage.last_fault());
    assert!(stage.last_fault().contains(words), "{}", stage.last_fault());
    assert_eq!(stage.tally.last_method(), "gicp");
    assert!(stage.tally.words().contains("0 of 1 answered") && stage.tally.words().contains(words));
}

#[test]
fn an_honest_answer_is_taken_with_its_covariance() {
    let mut stage = Stage::new(PATIENT_MS, Some(|request, items, results| send(results, honest(request, items))));
    let scans = pair(&YARD, &truth());
    let found = stage.align(&scans, &Pose::identity(), &Limits::default());
    let error = truth().inverse() * found.target_from_source;
    assert!(error.translation.vector.norm() < 0.03 && rotation_angle(&error) < 0.005, "{error}");
    assert!(found.converged && found.overlap > 0.7 && found.constraint.mask() == 0b11_1111);
    let status = stage.status();
    assert_eq!((status.questions, status.answered, status.fallbacks), (1, 1, 0), "{}", stage.last_fault());
    assert!(status.last_answer_ns > 0 && status.max_answer_ns == status.total_answer_ns);
    assert_eq!((stage.tally.last_method(), stage.last_fault().as_str()), ("external", ""));
    // Its covariance is the answer's: that of points once more thinned, which is another than gicp's.
    let own = align(&mut *built_in("gicp"), &scans, &Pose::identity(), &Limits::default());
    assert!(found.covariance != own.covariance && found.covariance.cholesky().is_some());
}

#[test]
fn a_request_names_its_two_scans_and_what_is_no_single_scan_by_no_id() {
    let mut stage = Stage::new(
        PATIENT_MS,
        Some(|request, items, results| {
            let (target, source) = (request.target_id, (request.header.id, request.header.stamp_ns));
            assert!(matches!((target, source), (7, (9, 5)) | (u64::MAX, (8, 0))), "{target} {source:?}");
            send(results, honest(request, items))
        }),
    );
    stage.tally.set_newest(Header::new(9, 5));
    let scans = pair(&YARD, &truth());
    // The newest scan to an older one, and an older one to a local map.
    for pair in [PairIds { target: Some(7), source: Some(9) }, PairIds { target: None, source: Some(8) }] {
        stage.own.as_mut().unwrap().0.name_pair(pair);
        stage.align(&scans, &Pose::identity(), &Limits::default());
    }
    assert_eq!(stage.status().answered, 2, "{}", stage.last_fault());
}

#[test]
fn values_that_are_not_finite_are_refused() {
    let behaviours: [(Behaviour, &str); 4] = [
        (
            |q, i, r| {
                let mut a = honest(q, i);
                a.target_from_source[3] = f64::NAN;
                send(r, a)
            },
            "its pose holds",
        ),
        (
            |q, i, r| {
                let mut a = honest(q, i);
                a.target_from_source = [f64::NAN; 16];
                send(r, a)
            },
            "its pose holds",
        ),
        (
            |q, i, r| {
                let mut a = honest(q, i);
                a.covariance[7] = f64::INFINITY;
                send(r, a)
            },
            "its covariance holds",
        ),
        (|q, i, r| send(r, RegistrationResult { overlap: f64::NAN, ..honest(q, i) }), "its overlap or residual holds"),
    ];
    for (behaviour, words) in behaviours {
        refused(PATIENT_MS, Some(behaviour), m::REGISTRATION_NOT_FINITE, words);
    }
}

#[test]
fn matrices_that_are_no_rigid_motion_are_refused() {
    let behaviours: [Behaviour; 3] = [
        |q, i, r| {
            let mut a = honest(q, i);
            a.target_from_source[0] *= 1.1;
            send(r, a)
        },
        |q, i, r| {
            let mut a = honest(q, i);
            a.target_from_source[15] = 0.0;
            send(r, a)
        },
        // A mirror.
        |q, i, r| {
            let mut a = honest(q, i);
            (0..3).for_each(|k| a.target_from_source[4 * k] *= -1.0);
            send(r, a)
        },
    ];
    for behaviour in behaviours {
        refused(PATIENT_MS, Some(behaviour), m::REGISTRATION_NOT_RIGID, "not a rigid motion");
    }
}

#[test]
fn what_is_no_covariance_is_refused() {
    let behaviours: [Behaviour; 3] = [
        |q, i, r| send(r, RegistrationResult { covariance: [0.0; 36], ..honest(q, i) }),
        |q, i, r| {
            let mut a = honest(q, i);
            a.covariance[0] = -1e-4;
            send(r, a)
        },
        |q, i, r| {
            let mut a = honest(q, i);
            a.covariance[1] += 0.5 * a.covariance[0];
            send(r, a)
        },
    ];
    for behaviour in behaviours {
        refused(PATIENT_MS, Some(behaviour), m::REGISTRATION_COVARIANCE, "not symmetric and positive definite");
    }
}

#[test]
fn a_pose_outside_the_limits_is_refused() {
    let far: Behaviour = |q, i, r| {
        let target_from_source = rows_from_pose(&Pose::translation(5.0, 0.0, 0.0));
        send(r, RegistrationResult { target_from_source, ..honest(q, i) })
    };
    refused(PATIENT_MS, Some(far), m::REGISTRATION_OUTSIDE, "5.000 m");
    let turned: Behaviour = |q, i, r| {
        let pose = Pose::new(nalgebra::Vector3::zeros(), nalgebra::Vector3::new(0.0, 0.0, 1.0));
        send(r, RegistrationResult { target_from_source: rows_from_pose(&pose), ..honest(q, i) })
    };
    refused(PATIENT_MS, Some(turned), m::REGISTRATION_OUTSIDE, "1.000 rad");
}

#[test]
fn a_confident_pose_that_is_wrong_is_refused() {
    // Somewhere else, and where it began.
    let elsewhere: Behaviour = |q, i, r| {
        let target_from_source = rows_from_pose(&Pose::translation(-1.2, 0.9, 0.4));
        send(r, RegistrationResult { target_from_source, converged: 1, ..honest(q, i) })
    };
    refused(PATIENT_MS, Some(elsewhere), m::REGISTRATION_WRONG, "its pose");
    let echo: Behaviour = |q, i, r| {
        let target_from_source = q.initial_target_from_source;
        send(r, RegistrationResult { target_from_source, converged: 1, ..honest(q, i) })
    };
    refused(PATIENT_MS, Some(echo), m::REGISTRATION_WRONG, "its pose is not the end");
    // One that gives up where the built-in method does not.
    let lazy: Behaviour = |q, i, r| send(r, RegistrationResult { converged: 0, ..honest(q, i) });
    refused(PATIENT_MS, Some(lazy), m::REGISTRATION_WRONG, "not converged");
}

#[test]
fn who_does_not_fit_may_say_so() {
    let mut stage = Stage::new(PATIENT_MS, Some(|request, items, results| send(results, honest(request, items))));
    let elsewhere: Vec<Point> =
        scan_of(&YARD, &Pose::identity(), 40.0, 3).iter().map(|p| Point::new(p.x, p.y, p.z + 30.0)).collect();
    let scans = [scan_of(&YARD, &Pose::identity(), 40.0, 1), elsewhere];
    let found = stage.align(&scans, &Pose::identity(), &Limits::default());
    assert!(found.overlap == 0.0 && !found.converged);
    assert_eq!((stage.status().answered, stage.status().fallbacks), (1, 0), "{}", stage.last_fault());
}

#[test]
fn no_answer_in_time_is_late() {
    refused(DEADLINE_MS, Some(|_, _, _| Goes::On), m::REGISTRATION_LATE, "no answer within 300 ms");
}

#[test]
fn an_answer_to_an_older_request_is_not_taken() {
    let older: Behaviour = |q, i, r| send(r, RegistrationResult { request: q.request - 1, ..honest(q, i) });
    refused(DEADLINE_MS, Some(older), m::REGISTRATION_OUTDATED, "it answered request 0 instead of request 1");
}

#[test]
fn a_flood_is_told_from_an_answer() {
    let flood: Behaviour = |q, i, r| {
        let result = RegistrationResult { request: 0, ..honest(q, i) };
        (0..1000).for_each(|_| {
            send(r, result);
        });
        Goes::On
    };
    refused(PATIENT_MS, Some(flood), m::REGISTRATION_FLOOD, "it floods");
}

#[test]
fn a_flood_of_right_answers_is_noticed_at_the_next_request() {
    let flood: Behaviour = |q, i, r| {
        let result = honest(q, i);
        (0..1000).for_each(|_| {
            send(r, result);
        });
        Goes::On
    };
    let mut stage = Stage::new(PATIENT_MS, Some(flood));
    let scans = pair(&YARD, &truth());
    stage.align(&scans, &Pose::identity(), &Limits::default());
    assert_eq!(stage.status().answered, 1, "{}", stage.last_fault());
    std::thread::sleep(Duration::from_millis(100));
    stage.align(&scans, &Pose::identity(), &Limits::default());
    assert_eq!(stage.status().faults[m::REGISTRATION_FLOOD], 1, "{}", stage.tally.words());
}

#[test]
fn another_schema_is_named_with_both_sides() {
    let other: Behaviour = |q, i, r| send(r, RegistrationResult { schema: 0x1234_5678, ..honest(q, i) });
    refused(PATIENT_MS, Some(other), m::REGISTRATION_SCHEMA, "there 12345678");
}

#[test]
fn nobody_there_costs_no_time() {
    refused(PATIENT_MS, None, m::REGISTRATION_ABSENT, "no registration process answers");
}

#[test]
fn who_ends_while_asked_is_not_waited_for() {
    refused(PATIENT_MS, Some(|_, _, _| Goes::Away), m::REGISTRATION_DIED, "ended while it was asked");
}

#[test]
fn who_fails_again_and_again_is_asked_less_and_less_and_trusted_again_once_it_answers() {
    // Wrong for the first three requests that it gets.
    let ill: Behaviour = |q, i, r| {
        let overlap = if q.request <= 3 { f64::NAN } else { 0.5 };
        send(r, RegistrationResult { overlap, ..honest(q, i) })
    };
    let mut stage = Stage::new(PATIENT_MS, Some(ill));
    let scans = pair(&YARD, &truth());
    let mut methods = Vec::new();
    for _ in 0..9 {
        stage.align(&scans, &Pose::identity(), &Limits::default());
        methods.push(stage.tally.last_method() == "external");
    }
    // Asked at 1, 2, 4 (after one pause), 8 (after three), 9.
    assert_eq!(methods, [false, false, false, false, false, false, false, true, true]);
    let status = stage.status();
    assert_eq!((status.faults[m::REGISTRATION_NOT_FINITE], status.faults[m::REGISTRATION_PAUSED]), (3, 4));
    assert!(stage.last_fault().contains("not finite"), "a pause does not hide its cause: {}", stage.last_fault());
}

#[test]
fn along_a_corridor_nobody_may_be_sure() {
    let sure: Behaviour = |q, i, r| {
        let mut covariance = [0.0; 36];
        (0..6).for_each(|k| covariance[7 * k] = 1e-8);
        send(r, RegistrationResult { covariance, ..honest(q, i) })
    };
    let mut stage = Stage::new(PATIENT_MS, Some(sure));
    let scans = pair(&CORRIDOR, &Pose::translation(0.5, 0.1, 0.05));
    let found = stage.align(&scans, &Pose::translation(0.2, 0.0, 0.0), &Limits::default());
    assert_eq!(stage.status().answered, 1, "{}", stage.last_fault());
    assert_eq!(found.constraint.mask(), 0b11_1110);
    assert!(found.covariance[(0, 0)] > 1.0 && found.covariance[(1, 1)] < 1e-3, "{}", found.covariance);
}

#[test]
fn a_start_is_judged_and_nonsense_refused_without_asking() {
    let mut stage = Stage::new(PATIENT_MS, Some(|_, _, _| panic!("nobody was to be asked")));
    let scans = pair(&YARD, &truth());
    let judged = stage.align(&scans, &truth(), &Limits { max_iterations: 0, ..Limits::default() });
    assert_eq!((judged.target_from_source, judged.iterations), (truth(), 0));
    let external = &mut stage.own.as_mut().unwrap().0;
    let scan = external.prepare(ScanView::unordered(&scans[0])).unwrap();
    let error = external.align(&*scan, &*scan, &Pose::translation(f64::NAN, 0.0, 0.0), &Limits::default()).unwrap_err();
    assert_eq!(error, AlignError::StartNotFinite);
    assert_eq!(stage.status().questions, 0);
}

#[test]
fn keyframes_are_read_where_they_were_written() {
    // Two requests use two places: it is no constant that is compared.
    let domain = Domain::new(&format!("extplace{}", std::process::id())).unwrap();
    let stop = StopSignal::default();
    let (own, other) = (participant(&domain, "alignment", &stop), participant(&domain, "registration", &stop));
    let publisher = own.publisher::<topics::RegistrationRequest>().unwrap();
    let subscriber = other.subscriber::<topics::RegistrationRequest>().unwrap();
    let (mut held, mut written) = (Vec::new(), Vec::new());
    for request in 0..2 {
        let mut loan = publisher.loan(5).unwrap();
        loan.meta_mut().request = request;
        loan.items_mut().fill(KeyframePoint::default());
        written.push((request, loan.location().unwrap()));
        loan.send().unwrap();
        held.push(subscriber.receive().unwrap().unwrap());
    }
    let read: Vec<_> = held.iter().map(|r| (r.meta().request, r.location().unwrap())).collect();
    assert!(read == written && read[0].1 != read[1].1, "{read:?} {written:?}");
    drop((held, publisher, subscriber, own, other));
    domain.remove_all().unwrap();
}
