//! The driver in closed loop with the simulated robot, by the true pose and by the filter's.

use super::*;
use crate::geometry::Pose;
use crate::localization::test_ride::{Ride, stamp};
use crate::simulation::{Scene, SensorKind};

/// Half of what the wheels' speeds differ by for each rad/s of turning [m].
const HALF_TRACK: f64 = 0.515;

/// What came of a drive.
#[derive(Debug)]
struct Outcome {
    state: DriveState,
    /// Largest distance of the true robot from its path [m].
    off: f64,
    /// Of the true robot from the target at the end [m].
    to_goal: f64,
    at: [f64; 2],
}

fn feed(surroundings: &mut Surroundings, ride: &Ride) {
    let robot = ride.simulator.robots().next().unwrap().clone();
    let mounts =
        crate::simulation::Rangers::new(Default::default(), crate::simulation::Noise::new(0, 0)).mounts().to_vec();
    for sweep in &ride.readings[0].planar {
        let sensor = &robot.sensors[sweep.sensor];
        let SensorKind::Laser2d { resolution, field_of_view, .. } = sensor.kind else { continue };
        let ranges: Vec<f32> = sweep.beams.iter().map(|beam| beam.range).collect();
        surroundings.laser(&LaserView {
            stamp_ns: stamp(sweep.time),
            first_angle: -0.5 * field_of_view,
            angle_step: resolution,
            mount_xyz: sensor.position,
            mount_yaw: sensor.rotation[2],
            ranges: &ranges,
        });
    }
    for reading in &ride.readings[0].rangers {
        let mount = mounts[reading.sensor];
        surroundings.echo(Echo {
            stamp_ns: stamp(reading.time),
            sensor: reading.sensor as u32,
            mount_xyz: mount.position.into(),
            yaw_pitch: mount.yaw_pitch,
            aperture: 20.0_f64.to_radians(),
            range: reading.range,
        });
    }
}

/// Drives a path; by the filter's pose if asked to, else by the truth.
fn drive(ride: &mut Ride, waypoints: &[[f64; 3]], by_filter: bool, config: &NavigationConfig) -> Outcome {
    drive_until(ride, waypoints, by_filter, config, f64::INFINITY)
}

/// The same; behind `blocked_x` the wheels no longer turn, whatever is asked of them.
fn drive_until(
    ride: &mut Ride,
    waypoints: &[[f64; 3]],
    by_filter: bool,
    config: &NavigationConfig,
    blocked_x: f64,
) -> Outcome {
    let mut driver = Driver::new(Path::new(waypoints).unwrap());
    drive_on(ride, &mut driver, by_filter, config, blocked_x)
}

fn drive_on(
    ride: &mut Ride,
    driver: &mut Driver,
    by_filter: bool,
    config: &NavigationConfig,
    blocked_x: f64,
) -> Outcome {
    let path = driver.path().clone();
    let mut around = Surroundings::default();
    let mut command = [0.0; 2];
    let mut off = 0.0_f64;
    for _ in 0..6000 {
        let estimate = ride.control(command[0] - HALF_TRACK * command[1], command[0] + HALF_TRACK * command[1]);
        feed(&mut around, ride);
        let truth = ride.truth();
        let (map_from_robot, linear) = if by_filter {
            (estimate.map_from_robot, estimate.linear)
        } else {
            (truth.pose, (truth.pose.rotation.inverse() * truth.linear).x)
        };
        let now = RobotNow { stamp_ns: ride.now_ns(), map_from_robot, linear, is_lost: false };
        let drive = driver.step(&now, &around, None, config);
        let grip = if truth.pose.translation.x < blocked_x { 1.0 } else { 0.0 };
        command = [grip * drive.linear, grip * drive.angular];
        let true_at = nalgebra::Vector2::new(truth.pose.translation.x, truth.pose.translation.y);
        off = off.max(path.project(&true_at, 0.0, path.length()).off);
        if matches!(drive.state, DriveState::Arrived | DriveState::GaveUp(_)) {
            break;
        }
    }
    ride.go(0.0, 0.0, 0.5);
    let end: Pose = ride.truth().pose;
    let at = [end.translation.x, end.translation.y];
    let to_goal = (path.goal() - nalgebra::Vector2::from(at)).norm();
    Outcome { state: driver.state(), off, to_goal, at }
}

fn ground(ride: &Ride, places: &[[f64; 2]]) -> Vec<[f64; 3]> {
    let height = |p: &[f64; 2]| ride.simulator.scene().ground_height(p[0], p[1]).unwrap();
    places.iter().map(|p| [p[0], p[1], height(p)]).collect()
}

fn flat(tail: &str) -> Ride {
    let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-15, 15], y_m = [-15, 15] }\n";
    Ride::new(Scene::from_toml(&format!("{head}{tail}"), "t").unwrap(), 3, |_| {})
}

#[test]
fn straight_ways_zigzags_and_tight_corners_are_kept_to_a_handbreadth() {
    let ways: [(&str, &[[f64; 2]], f64); 3] = [
        ("straight", &[[0.0, 0.0], [8.0, 0.0]], 0.05),
        ("zigzag", &[[0.0, 0.0], [2.0, 0.8], [4.0, -0.8], [6.0, 0.8], [8.0, 0.0]], 0.15),
        ("corners", &[[0.0, 0.0], [3.0, 0.0], [3.0, 1.2], [0.5, 1.2], [0.5, 2.5], [3.0, 4.0]], 0.15),
    ];
    for (name, places, bound) in ways {
        for by_filter in [false, true] {
            let mut ride = flat("");
            ride.go(0.0, 0.0, 1.0);
            let way = ground(&ride, places);
            let outcome = drive(&mut ride, &way, by_filter, &NavigationConfig::default());
            println!("{name} {by_filter}: {outcome:.3?}");
            let slack = if by_filter { 0.1 } else { 0.0 };
            assert!(outcome.state == DriveState::Arrived && outcome.off < bound + slack, "{name}: {outcome:?}");
            assert!(outcome.to_goal < 0.2 + slack, "{name}: {outcome:?}");
        }
    }
}

#[test]
fn slopes_up_and_down_are_driven() {
    for by_filter in [false, true] {
        let mut ride = Ride::builtin("unstructured", 2);
        ride.go(0.0, 0.0, 1.0);
        let way = ground(&ride, &[[-27.0, -27.0], [-21.0, -24.5], [-14.5, -26.0], [-13.0, -17.0]]);
        let outcome = drive(&mut ride, &way, by_filter, &NavigationConfig::default());
        println!("slopes {by_filter}: {outcome:.3?}");
        let slack = if by_filter { 0.5 } else { 0.0 };
        assert!(outcome.state == DriveState::Arrived && outcome.off < 0.25 + slack, "{outcome:?}");
    }
}

#[test]
fn a_box_that_the_planner_did_not_know_of_stops_the_robot_short_of_it() {
    for (height, size) in [(1.0, 0.6), (0.3, 0.6)] {
        let tail = format!(
            "[[box]]\nlabel = \"other\"\nx_m = 4\ny_m = 0.1\nlength_m = {size}\nwidth_m = {size}\nheight_m = {height}\n"
        );
        let mut ride = flat(&tail);
        ride.go(0.0, 0.0, 1.0);
        let outcome = drive(&mut ride, &[[0.0; 3], [8.0, 0.0, 0.0]], false, &NavigationConfig::default());
        println!("box {height}: {outcome:.3?}");
        assert!(matches!(outcome.state, DriveState::GaveUp(GiveUp::Blocked { .. })), "{outcome:?}");
        // The box begins at 3.7 m, the robot's front is 0.52 m ahead of its middle.
        assert!(outcome.at[0] > 2.0 && outcome.at[0] < 3.7 - 0.52 - 0.1, "{outcome:?}");
    }
}

#[test]
fn a_robot_that_gives_up_at_an_edge_first_goes_back_to_where_it_can_turn() {
    let edge =
        "[terrain]\nheights = { file = \"edge.txt\", cell_m = 0.25, x_m = -8, y_m = -8, low_m = 0, high_m = 1 }\n";
    let dir = tempfile::tempdir().unwrap();
    let row: String = (0..65).map(|k| if k <= 48 { "0 " } else { "-1.5 " }).collect();
    std::fs::write(dir.path().join("edge.txt"), format!("{row}\n").repeat(65)).unwrap();
    let world = dir.path().join("edge.toml");
    let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-7, 7], y_m = [-7, 7] }\n";
    std::fs::write(&world, format!("{head}{edge}")).unwrap();
    let mut ride = Ride::new(Scene::load(&world).unwrap(), 3, |_| {});
    ride.go(0.0, 0.0, 1.0);
    let config = NavigationConfig::default();
    let mut driver = Driver::new(Path::new(&[[0.0; 3], [6.0, 0.0, 0.0]]).unwrap());
    let outcome = drive_on(&mut ride, &mut driver, false, &config, f64::INFINITY);
    // The ground falls away from x = 4 m on; the robot's corners are 0.67 m from its middle.
    assert!(outcome.state == DriveState::GaveUp(GiveUp::Edge) && outcome.at[0] < 4.0 - 1.2, "{outcome:?}");
    assert!(driver.take_obstruction().is_some());
    let [x, y] = outcome.at;
    let mut next = Driver::after(Some(&driver), Path::new(&[[x, y, 0.0], [x, y + 3.0, 0.0]]).unwrap());
    let outcome = drive_on(&mut ride, &mut next, false, &config, f64::INFINITY);
    assert!(outcome.state == DriveState::Arrived && outcome.off < 0.2, "{outcome:?}");
}

#[test]
fn a_path_that_begins_with_a_piece_back_is_begun_backwards_and_not_with_a_turn() {
    let mut ride = flat("");
    ride.go(0.0, 0.0, 1.0);
    let config = NavigationConfig::default();
    let mut driver = Driver::new(Path::new(&[[0.0; 3], [4.0, 0.0, 0.0]]).unwrap());
    let [x, y] = drive_on(&mut ride, &mut driver, false, &config, f64::INFINITY).at;
    let begin = |waypoints: &[[f64; 3]], before: Option<&Driver>, pose: Pose| {
        let mut next = Driver::after(before, Path::new(waypoints).unwrap());
        let now = RobotNow { stamp_ns: 0, map_from_robot: pose, linear: 0.0, is_lost: false };
        let first = next.step(&now, &Surroundings::default(), None, &config);
        let second = next.step(&RobotNow { stamp_ns: 50_000_000, ..now }, &Surroundings::default(), None, &config);
        (first.state, second.linear, second.angular)
    };
    let back = [[x, y, 0.0], [x - 1.5, y, 0.0], [x - 1.5, y + 3.0, 0.0]];
    let here = ride.truth().pose;
    let (state, linear, angular) = begin(&back, Some(&driver), here);
    assert!(state == DriveState::Recovering && linear < 0.0 && angular.abs() < 0.1, "{state:?} {linear} {angular}");
    // Where it has not come from there, it turns, and so it does where nothing follows the way back.
    assert!(begin(&back, None, here).2.abs() > 0.1);
    assert!(begin(&back[..2], Some(&driver), here).2.abs() > 0.1);

    let mut next = Driver::after(Some(&driver), Path::new(&back).unwrap());
    let outcome = drive_on(&mut ride, &mut next, false, &config, f64::INFINITY);
    assert!(outcome.state == DriveState::Arrived && outcome.off < 0.2, "{outcome:?}");
}

#[test]
fn a_robot_that_does_not_get_on_backs_up_once_and_gives_the_target_up() {
    let mut ride = flat("");
    ride.go(0.0, 0.0, 1.0);
    let config = NavigationConfig::default();
    let outcome = drive_until(&mut ride, &[[0.0; 3], [6.0, 0.0, 0.0]], false, &config, 2.0);
    assert_eq!(outcome.state, DriveState::GaveUp(GiveUp::Stuck), "{outcome:?}");
    assert!((outcome.at[0] - 2.0).abs() < 0.2, "{outcome:?}");
}

#[test]
fn a_robot_that_is_lifted_while_it_backs_up_goes_forwards_again_and_gives_the_target_up() {
    // Before it a wall, behind it a bank that came there after it: it leans more the farther it backs up.
    let config = NavigationConfig::default();
    let (mut driver, mut now) = standing_driver();
    let mut around = Surroundings::default();
    let (mut x, mut most_deg) = (0.0_f64, 0.0_f64);
    for _ in 0..1200 {
        now.stamp_ns += 50_000_000;
        around.laser(&LaserView {
            stamp_ns: now.stamp_ns,
            first_angle: -0.02,
            angle_step: 0.005,
            mount_xyz: [0.5, 0.0, 0.42],
            mount_yaw: 0.0,
            ranges: &[(1.0 - x) as f32; 9],
        });
        let drive = driver.step(&now, &around, None, &config);
        x += 0.05 * drive.linear;
        now.linear = drive.linear;
        let pitch_deg = if driver.retreat.attempts > 0 { (60.0 * (0.7 - x)).clamp(0.0, 45.0) } else { 0.0 };
        most_deg = most_deg.max(pitch_deg);
        let leaning = nalgebra::Vector3::new(0.0, pitch_deg.to_radians(), 0.0);
        now.map_from_robot = Pose::new(nalgebra::Vector3::new(x, 0.0, 0.0), leaning);
        if matches!(driver.state(), DriveState::GaveUp(_)) {
            break;
        }
    }
    assert!(matches!(driver.state(), DriveState::GaveUp(GiveUp::Blocked { .. })), "{:?}", driver.state());
    assert!(most_deg > 10.0 && most_deg < 15.0 && x > 0.6, "{most_deg} {x}");
}

/// A driver on a straight path of 5 m, for what needs no world.
fn standing_driver() -> (Driver, RobotNow) {
    let driver = Driver::new(Path::new(&[[0.0; 3], [5.0, 0.0, 0.0]]).unwrap());
    (driver, RobotNow { stamp_ns: 0, map_from_robot: Pose::identity(), linear: 0.0, is_lost: false })
}

#[test]
fn a_robot_off_its_path_leaning_or_lost_says_so() {
    let config = NavigationConfig::default();
    let around = Surroundings::default();
    // So far aside at every step; what comes of the last.
    let aside = |metres: &[f64]| {
        let (mut driver, mut now) = standing_driver();
        for y in metres {
            now.map_from_robot = Pose::translation(1.0, *y, 0.0);
            now.stamp_ns += 50_000_000;
            driver.step(&now, &around, None, &config);
        }
        driver.state()
    };
    let is_off = |state: &DriveState| matches!(state, DriveState::GaveUp(GiveUp::OffPath { off_m }) if *off_m > 0.85);
    let state = aside(&[0.0, 0.9, 0.9]);
    assert!(is_off(&state), "{state:?}");
    // A path may begin beside a robot that stands where no path leads.
    assert_eq!(aside(&[0.9, 0.9, 0.9]), DriveState::Driving);
    let state = aside(&[0.9, 1.6, 1.6]);
    assert!(is_off(&state), "{state:?}");

    let (mut driver, mut now) = standing_driver();
    now.map_from_robot = Pose::new(nalgebra::Vector3::zeros(), nalgebra::Vector3::new(0.7, 0.0, 0.0));
    let state = driver.step(&now, &around, None, &config).state;
    assert!(matches!(state, DriveState::GaveUp(GiveUp::Tilted { .. })), "{state:?}");

    let (mut driver, mut now) = standing_driver();
    now.is_lost = true;
    for _ in 0..100 {
        now.stamp_ns += 50_000_000;
        let drive = driver.step(&now, &around, None, &config);
        assert_eq!((drive.linear, drive.angular), (0.0, 0.0));
    }
    assert_eq!(driver.state(), DriveState::GaveUp(GiveUp::Lost));
}

#[test]
fn rising_ground_slows_the_robot_and_a_wall_as_near_stops_it() {
    let config = NavigationConfig::default();
    let step = |range: f32, waypoints: &[[f64; 3]]| {
        let mut around = Surroundings::default();
        let ranges = [range; 9];
        let mount_xyz = [0.5, 0.0, 0.42];
        let view = LaserView {
            stamp_ns: 1,
            first_angle: -0.02,
            angle_step: 0.005,
            mount_xyz,
            mount_yaw: 0.0,
            ranges: &ranges,
        };
        around.laser(&view);
        let mut driver = Driver::new(Path::new(waypoints).unwrap());
        let map_from_robot = Pose::identity();
        let mut last = None;
        for k in 0..20 {
            let now = RobotNow { stamp_ns: 1 + k * 50_000_000, map_from_robot, linear: 0.0, is_lost: false };
            last = Some(driver.step(&now, &around, None, &config));
        }
        last.unwrap()
    };
    let level = [[0.0; 3], [5.0, 0.0, 0.0]];
    let rising = [[0.0; 3], [5.0, 0.0, 2.0]];
    let far = step(3.5, &level);
    let doubtful = step(0.7, &level);
    let known = step(0.9, &rising);
    let wall = step(0.2, &rising);
    assert!(far.linear > 0.5, "{far:?}");
    assert!(doubtful.state == DriveState::Driving && doubtful.linear < 0.4, "{doubtful:?}");
    assert!(known.linear > 0.5, "the path rises there: {known:?}");
    assert!(wall.state == DriveState::Blocked && wall.linear == 0.0, "{wall:?}");
}

#[test]
fn an_edge_is_driven_to_carefully_and_not_over() {
    let config = NavigationConfig::default();
    let mut around = Surroundings::default();
    let (mut driver, mut now) = standing_driver();
    let mut fastest = 0.0_f64;
    for k in 0..200 {
        now.stamp_ns += 50_000_000;
        for sensor in 0..3 {
            let yaw = 0.35 * (1.0 - f64::from(sensor));
            around.echo(Echo {
                stamp_ns: now.stamp_ns,
                sensor,
                mount_xyz: [0.52, 0.25 * (1.0 - f64::from(sensor)), 0.36],
                yaw_pitch: [yaw, 0.436],
                aperture: 0.349,
                range: if k < 20 { 0.63 } else { f64::NAN },
            });
        }
        let drive = driver.step(&now, &around, None, &config);
        if drive.state != DriveState::Driving {
            assert_eq!(drive.state, DriveState::Blocked);
            break;
        }
        fastest = if k > 20 { fastest.max(drive.linear) } else { 0.0 };
        now.linear = drive.linear;
        now.map_from_robot = Pose::translation(now.map_from_robot.translation.x + 0.05 * drive.linear, 0.0, 0.0);
    }
    assert!(driver.state() == DriveState::Blocked && fastest <= 0.2 + 1e-9, "{:?} {fastest}", driver.state());
}
