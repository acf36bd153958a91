//! Paths that the map moves under.

use nalgebra::Vector2;

use super::*;

const SCANNED: RobotWord = RobotWord { scanning: false, scans: 1, emergency_stop: false, tipped: false };

fn robot(stamp_ns: i64) -> RobotNow {
    RobotNow { stamp_ns, map_from_robot: Pose::identity(), linear: 0.0, is_lost: false }
}

/// A mission whose first scan is taken and planned: a path of 4 m along x.
fn planned() -> Mission {
    let mut mission = Mission::new(NavigationConfig::default());
    mission.robot(SCANNED);
    mission.plan(0, Decision::Go, "best_utility");
    mission.path(0, vec![[0.0; 3], [4.0, 0.0, 0.0]]);
    mission
}

fn goal(mission: &Mission) -> Vector2<f64> {
    mission.driver().expect("it drives").path().goal()
}

#[test]
fn a_path_moves_along_with_the_scan_it_was_planned_at_before_and_while_it_is_driven() {
    let mut mission = planned();
    // Another scan's correction is nothing to it; two of its own add up.
    mission.moved(7, &Pose::translation(9.0, 9.0, 0.0));
    mission.moved(0, &Pose::translation(0.5, 0.0, 0.0));
    mission.moved(0, &Pose::translation(0.0, 0.25, 0.0));
    assert_eq!(mission.step(&robot(0)), MissionStep::Wait, "what became of older scans is not known yet");
    mission.corrected(0);
    let first = mission.step(&robot(0));
    assert_eq!(first, stand(None), "the pose at hand is older than the alignment");
    assert_eq!(mission.state(), &MissionState::Driving { scan: 0 });
    assert!((goal(&mission) - Vector2::new(4.5, 0.25)).norm() < 1e-12, "{}", goal(&mission));
    mission.moved(0, &Pose::translation(-0.5, 0.0, 0.0));
    mission.moved(1, &Pose::translation(5.0, 0.0, 0.0));
    assert!((goal(&mission) - Vector2::new(4.0, 0.25)).norm() < 1e-12, "{}", goal(&mission));
}

#[test]
fn a_scan_is_asked_for_when_the_robot_has_stood_for_a_second_and_at_the_latest_after_three() {
    let asked_after = |is_moving: fn(i64) -> bool| {
        let mut mission = Mission::new(NavigationConfig::default());
        mission.robot(RobotWord { scans: 0, ..SCANNED });
        let step_ns = 50_000_000;
        let asks = |k: &i64| {
            let now = RobotNow { linear: if is_moving(*k) { 0.1 } else { 0.0 }, ..robot(k * step_ns) };
            matches!(mission.step(&now), MissionStep::Answer { request: Some(0), .. })
        };
        (0..200).find(asks).map(|k| k as f64 * 0.05)
    };
    assert_eq!(asked_after(|_| false), Some(1.0));
    assert_eq!(asked_after(|k| k <= 10), Some(1.5));
    assert_eq!(asked_after(|_| true), Some(3.0));
    // It rocks on its wheels for a while: half a degree to both sides.
    let mut mission = Mission::new(NavigationConfig::default());
    mission.robot(RobotWord { scans: 0, ..SCANNED });
    let asks = |k: &i64| {
        let roll = if *k <= 12 { 0.01 * (f64::from(*k as i32) * 0.8).sin() } else { 0.0 };
        let map_from_robot = Pose::new(nalgebra::Vector3::zeros(), nalgebra::Vector3::new(roll, 0.0, 0.0));
        let now = RobotNow { map_from_robot, ..robot(k * 50_000_000) };
        matches!(mission.step(&now), MissionStep::Answer { request: Some(0), .. })
    };
    let asked = (0..200).find(asks).map(|k| k as f64 * 0.05);
    assert!(asked.is_some_and(|after| (1.6..=1.7).contains(&after)), "{asked:?}");
}
