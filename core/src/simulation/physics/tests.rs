//! What the source's robot can do and what it cannot.

use super::*;
use crate::simulation::{ScanPose, Scene};

fn world(tail: &str) -> CompiledScene {
    let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-15, 15], y_m = [-15, 15] }\n";
    CompiledScene::new(Scene::from_toml(&format!("{head}{tail}"), "a.toml").unwrap()).unwrap()
}

fn robot(yaw_deg: f64) -> Robot {
    Robot { start: ScanPose { x: 0.0, y: 0.0, yaw: yaw_deg.to_radians() }, ..Robot::default() }
}

fn physics(world: &CompiledScene, yaw_deg: f64) -> Physics {
    Physics::new(world, &[robot(yaw_deg)], PhysicsConfig::default()).unwrap()
}

fn run(physics: &mut Physics, seconds: f64) {
    for _ in 0..(seconds / 0.005).round() as usize {
        physics.step();
    }
}

fn position(physics: &Physics) -> Vector3<f64> {
    physics.motion(0).unwrap().pose.translation.vector
}

fn yaw(physics: &Physics) -> f64 {
    let ahead = physics.motion(0).unwrap().pose.rotation * Vector3::x();
    ahead.y.atan2(ahead.x)
}

#[test]
fn it_stands_on_flat_ground_with_the_scanner_a_metre_up() {
    let world = world("");
    let mut physics = physics(&world, 20.0);
    run(&mut physics, 1.5);
    let motion = physics.motion(0).unwrap();
    assert!(motion.pose.translation.vector.norm() < 0.02, "{}", motion.pose.translation.vector);
    assert!(motion.linear.norm() < 5e-3 && motion.angular.norm() < 5e-3, "{motion:?}");
    assert!((yaw(&physics) - 20.0_f64.to_radians()).abs() < 0.01);
    assert!((physics.time() - 1.5).abs() < 1e-9);
}

#[test]
fn it_stands_still_on_a_slope_it_can_hold_and_slides_on_one_it_cannot() {
    for (slope, holds) in [(15.0, true), (25.0, true), (42.0, false)] {
        let world = world(&format!("terrain = {{ slope_x_deg = {slope} }}\n"));
        let mut physics = physics(&world, 0.0);
        run(&mut physics, 1.0);
        let from = position(&physics);
        run(&mut physics, 3.0);
        let moved = (position(&physics) - from).norm();
        // The friction of 0.7 holds up to 35 deg.
        assert_eq!(moved < 0.05, holds, "{slope} deg: {moved} m");
    }
}

#[test]
fn a_robot_that_stops_on_uneven_ground_comes_to_rest_within_two_seconds_and_then_does_not_creep() {
    for name in ["simple", "unstructured", "structured", "field"] {
        let world = CompiledScene::new(Scene::builtin(name).unwrap()).unwrap();
        let robot = Robot { start: world.scene().start, ..Robot::default() };
        let mut physics = Physics::new(&world, &[robot], PhysicsConfig::default()).unwrap();
        physics.settle(5.0);
        assert!(physics.is_parked() && physics.time() == 0.0, "{name}");
        for stop in 0..40 {
            // Ways and turns to both sides, on the spot too.
            let (ahead, turn) = [(0.4, 0.25), (0.4, 0.0), (0.0, -0.4), (0.5, -0.1), (0.0, 0.4)][stop % 5];
            physics.drive(0, ahead - turn, ahead + turn);
            run(&mut physics, 2.0);
            physics.drive(0, 0.0, 0.0);
            run(&mut physics, 2.0);
            assert!(physics.is_parked(), "{name}, stop {stop}: {:?}", physics.motion(0));
            let from = physics.motion(0).unwrap().pose;
            run(&mut physics, 8.0);
            assert_eq!(physics.motion(0).unwrap().pose, from, "{name}, stop {stop}");
        }
    }
}

#[test]
fn it_drives_straight_at_the_asked_speed() {
    let world = world("");
    let mut physics = physics(&world, 0.0);
    run(&mut physics, 0.5);
    physics.drive(0, 0.8, 0.8);
    run(&mut physics, 5.0);
    let at = position(&physics);
    assert!((at.x - 4.0).abs() < 0.25 && at.y.abs() < 0.1, "{at}");
    let [left, right] = physics.rolled(0);
    assert!((left - at.x).abs() < 0.1 && (right - at.x).abs() < 0.1, "{left} {right}");
    assert!(physics.motor_power(0) > 0.0);
}

#[test]
fn it_climbs_fifteen_degrees() {
    let world = world("terrain = { slope_x_deg = 15 }\n");
    let mut physics = physics(&world, 0.0);
    run(&mut physics, 0.5);
    let from = position(&physics);
    physics.drive(0, 0.5, 0.5);
    run(&mut physics, 6.0);
    let climbed = position(&physics) - from;
    assert!(climbed.z > 0.55 && (climbed.z / climbed.x - 15.0_f64.to_radians().tan()).abs() < 0.02, "{climbed}");
    assert!(!physics.has_tipped(0));
}

#[test]
fn it_tips_over_sideways_beyond_its_limit_and_not_below() {
    // On a slope across its heading, with friction enough not to slide: half the track is 0.425 m, the centre of mass
    // lies at about 0.28 m, which holds to some 56 deg.
    for (slope, tips) in [(30.0, false), (59.0, true)] {
        let world = world(&format!("terrain = {{ slope_y_deg = {slope} }}\n"));
        let config = PhysicsConfig { friction: 3.0, ..PhysicsConfig::default() };
        let mut physics = Physics::new(&world, &[robot(0.0)], config).unwrap();
        let tipped = (0..800).any(|_| {
            physics.step();
            let up = physics.motion(0).unwrap().pose.rotation * Vector3::z();
            // Leaning a quarter more than the slope does.
            let slope: f64 = slope;
            up.z < (slope + 25.0).to_radians().cos()
        });
        assert_eq!(tipped, tips, "{slope} deg");
    }
}

#[test]
fn it_turns_in_place_with_slip() {
    let world = world("");
    let mut physics = physics(&world, 0.0);
    run(&mut physics, 0.5);
    physics.drive(0, -0.4, 0.4);
    let mut turned = 0.0;
    let mut last = yaw(&physics);
    for _ in 0..1000 {
        physics.step();
        let now = yaw(&physics);
        let step = now - last;
        turned += step - (step / std::f64::consts::TAU).round() * std::f64::consts::TAU;
        last = now;
    }
    // Wheels that did not slip would turn it by (0.8 m/s / 0.72 m) 5 s = 5.6 rad. Coulomb friction of wheels that carry
    // alike lets it turn at 0.71 of that: there the moments of what the end wheels scrub sideways and of what all six
    // drag ahead cancel. Their friction then takes some 170 W.
    assert!((turned / 5.56 - 0.71).abs() < 0.06, "{turned} rad");
    assert!((80.0..300.0).contains(&physics.motor_power(0)), "{} W", physics.motor_power(0));
    assert!(position(&physics).xy().norm() < 0.3, "{}", position(&physics));
    let [left, right] = physics.rolled(0);
    assert!((right - left) / 0.72 > 1.1 * turned, "the wheels turn farther than the robot: {left} {right} {turned}");
}

#[test]
fn a_wall_stops_it() {
    let world = world("[[wall]]\nfrom_m = [3, -5]\nto_m = [3, 5]\nheight_m = 1.5\nthickness_m = 0.3\n");
    let mut physics = physics(&world, 0.0);
    physics.drive(0, 0.6, 0.6);
    run(&mut physics, 10.0);
    let at = position(&physics);
    assert!((2.0..2.45).contains(&at.x) && !physics.has_tipped(0), "{at}");
    assert!(physics.motion(0).unwrap().linear.norm() < 0.1);
    assert!(physics.rolled(0)[0] > 4.0, "its wheels go on");
}

#[test]
fn a_kerb_of_five_centimetres_is_climbed() {
    let world = world("[[box]]\nlabel = \"kerb\"\nx_m = 3\ny_m = 0\nlength_m = 2\nwidth_m = 6\nheight_m = 0.05\n");
    let mut physics = physics(&world, 0.0);
    physics.drive(0, 0.6, 0.6);
    run(&mut physics, 5.0);
    let at = position(&physics);
    assert!(at.x > 2.5 && (at.z - 0.05).abs() < 0.02, "{at}");
}

#[test]
fn the_same_commands_give_the_same_bits() {
    let world = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let drive = || {
        let robot = Robot { start: world.scene().start, ..Robot::default() };
        let mut physics = Physics::new(&world, &[robot], PhysicsConfig::default()).unwrap();
        for step in 0..600 {
            physics.drive(0, 0.5 + 0.001 * f64::from(step), 0.7);
            physics.step();
        }
        let pose = physics.motion(0).unwrap().pose;
        let t = pose.translation.vector;
        [t.x, t.y, t.z, pose.rotation.i, pose.rotation.j, pose.rotation.k].map(f64::to_bits)
    };
    assert_eq!(drive(), drive());
}

#[test]
fn casters_follow_and_steered_wheels_turn_the_robot() {
    let wheel = |kind, x, y| Wheel { kind, radius: 0.1, width: 0.06, mount: [x, y, 0.1] };
    use crate::simulation::{
        Wheel,
        WheelKind::{Caster, Driven, Free, Steered},
    };
    let two = Robot {
        wheels: vec![wheel(Driven, 0.2, 0.3), wheel(Driven, 0.2, -0.3), wheel(Caster, -0.4, 0.0)],
        ..robot(0.0)
    };
    let world = world("");
    let mut physics = Physics::new(&world, &[two], PhysicsConfig::default()).unwrap();
    physics.drive(0, 0.3, 0.5);
    run(&mut physics, 4.0);
    // Without skidding it turns as two wheels 0.6 m apart do: 0.2 / 0.6 rad/s.
    assert!((yaw(&physics) - 1.33).abs() < 0.25, "{}", yaw(&physics));
    let car = Robot {
        wheels: vec![
            wheel(Steered, 0.4, 0.3),
            wheel(Steered, 0.4, -0.3),
            wheel(Free, -0.4, 0.3),
            wheel(Free, -0.4, -0.3),
        ],
        ..robot(0.0)
    };
    let mut physics = Physics::new(&world, &[car], PhysicsConfig::default()).unwrap();
    physics.steer(0, 0.3);
    physics.drive(0, 0.5, 0.5);
    run(&mut physics, 4.0);
    assert!(yaw(&physics) > 0.4, "{}", yaw(&physics));
}

#[test]
fn two_robots_do_not_pass_through_one_another() {
    let world = world("");
    let at = |name: &str, x, yaw| Robot { name: name.into(), start: ScanPose { x, y: 0.0, yaw }, ..Robot::default() };
    let pair = [at("a", -2.0, 0.0), at("b", 2.0, std::f64::consts::PI)];
    let mut physics = Physics::new(&world, &pair, PhysicsConfig::default()).unwrap();
    for robot in 0..2 {
        physics.drive(robot, 0.5, 0.5);
    }
    run(&mut physics, 6.0);
    let gap = physics.motion(1).unwrap().pose.translation.x - physics.motion(0).unwrap().pose.translation.x;
    assert!((0.9..1.2).contains(&gap), "{gap}");
}

#[test]
fn a_start_in_a_wall_or_off_the_terrain_names_file_line_and_robot() {
    let text = |x: f64| {
        format!(
            "name = \"t\"\nstart = {{ x_m = 0, y_m = 0 }}\narea = {{ x_m = [-15, 15], y_m = [-15, 15] }}\n\
             [[wall]]\nfrom_m = [3, -5]\nto_m = [3, 5]\nheight_m = 1.5\nthickness_m = 0.3\n\
             [[robot]]\nname = \"base\"\nx_m = {x}\ny_m = 0\n"
        )
    };
    let error = |x| {
        let scene = CompiledScene::new(Scene::from_toml(&text(x), "a.toml").unwrap()).unwrap();
        let robots = scene.scene().robots.clone();
        Physics::new(&scene, &robots, PhysicsConfig::default()).err().map(|error| error.to_string())
    };
    assert_eq!(error(0.0), None);
    let wall = error(3.3).unwrap();
    assert_eq!(wall, "a.toml, line 9: robot `base` starts at x = 3.3, y = 0, where it touches a wall; move x_m, y_m");
    let off = error(40.0).unwrap();
    assert!(off.starts_with("a.toml, line 9: robot `base` starts at x = 40, y = 0, which is off the terrain"), "{off}");
}
