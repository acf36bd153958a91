use nalgebra::Vector3;

use super::*;
use crate::simulation::Scene;

fn simulator(name: &str) -> Simulator {
    let scene = CompiledScene::new(Scene::builtin(name).unwrap()).unwrap();
    Simulator::new(scene, SimulatorConfig { seed: 5, ..SimulatorConfig::default() }).unwrap()
}

#[test]
fn every_sensor_speaks_at_its_rate() {
    let mut simulator = simulator("simple");
    simulator.drive(0, 0.4, 0.4).unwrap();
    simulator.start_scan(0).unwrap();
    let mut readings = vec![Readings::default()];
    for _ in 0..400 {
        simulator.step(&mut readings);
    }
    let r = &readings[0];
    assert!((simulator.time() - 2.0).abs() < 1e-9);
    let counts = [r.odometry.len(), r.imu.len(), r.gnss.len(), r.magnetometer.len(), r.rangers.len()];
    assert_eq!(counts, [100, 200, 8, 100, 120]);
    assert_eq!((r.battery.len(), r.planar.len(), r.sweeps.len(), r.ticks.len()), (2, 40, 100, 201));
    assert_eq!(r.planar[0].beams.len(), 361);
    assert!(r.battery[1].charge < r.battery[0].charge && r.battery[1].current > 3.0);
    assert!(simulator.is_scanning(0));
    let felt = r.imu.iter().skip(100).map(|i| i.acceleration.norm()).sum::<f64>() / 100.0;
    assert!((felt - 9.81).abs() < 0.3, "{felt}");
    readings[0].clear();
    assert_eq!(readings[0], Readings::default());
}

#[test]
fn odometry_is_right_ahead_and_wrong_in_turns() {
    let scene = CompiledScene::new(Scene::builtin("field").unwrap()).unwrap();
    // It believes in the true distance of its wheels.
    let mut config = SimulatorConfig { seed: 5, ..SimulatorConfig::default() };
    config.sensors.odometry.track = 0.72;
    let mut simulator = Simulator::new(scene, config).unwrap();
    let mut readings = vec![Readings::default()];
    let mut run = |simulator: &mut Simulator, left: f64, right: f64, steps: usize| {
        simulator.drive(0, left, right).unwrap();
        for _ in 0..steps {
            simulator.step(&mut readings);
        }
        (simulator.truth(0).unwrap().pose, *readings[0].odometry.last().unwrap())
    };
    run(&mut simulator, 0.0, 0.0, 200);
    let (from, odometry_from) = run(&mut simulator, 0.5, 0.5, 200);
    let (to, odometry_to) = run(&mut simulator, 0.5, 0.5, 800);
    let driven = (to.translation.vector - from.translation.vector).norm();
    assert!((odometry_to.distance - odometry_from.distance - driven).abs() < 0.05 * driven, "{driven}");
    let heading = |pose: &Pose| {
        let ahead = pose.rotation * Vector3::x();
        ahead.y.atan2(ahead.x)
    };
    let (turned, odometry_turned) = run(&mut simulator, -0.3, 0.3, 400);
    let truth = heading(&turned) - heading(&to);
    let told = odometry_turned.pose[2] - odometry_to.pose[2];
    assert!(truth > 0.2 && told > 1.2 * truth, "skidding deceives it: {truth} {told}");
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_one_others() {
    let run = |seed| {
        let scene = CompiledScene::new(Scene::builtin("structured").unwrap()).unwrap();
        let mut simulator = Simulator::new(scene, SimulatorConfig { seed, ..SimulatorConfig::default() }).unwrap();
        simulator.drive(0, 0.6, 0.5).unwrap();
        let mut readings = vec![Readings::default()];
        for _ in 0..300 {
            simulator.step(&mut readings);
        }
        format!("{readings:?}")
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn the_camera_shows_the_world_and_missing_things_are_named() {
    let mut simulator = simulator("simple");
    let image = simulator.image(0, "camera", 2).unwrap();
    assert_eq!((image.width, image.height), (640, 480));
    let mut colours: Vec<_> = image.rgb.chunks_exact(3).collect();
    colours.sort_unstable();
    colours.dedup();
    assert!(colours.len() > 50, "{}", colours.len());
    let message = simulator.image(0, "eye", 1).unwrap_err().to_string();
    assert_eq!(message, "robot `robot` has no camera called `eye`");
    assert_eq!(simulator.drive(3, 0.0, 0.0).unwrap_err().to_string(), "there is no robot 3; this world has 1");
}

#[test]
fn the_robot_drives_through_every_world_from_its_start() {
    for name in Scene::builtin_names() {
        let mut simulator = simulator(name);
        simulator.drive(0, 0.5, 0.5).unwrap();
        let from = simulator.truth(0).unwrap().pose.translation.vector;
        let mut readings = vec![Readings::default()];
        for _ in 0..400 {
            simulator.step(&mut readings);
        }
        let moved = (simulator.truth(0).unwrap().pose.translation.vector - from).norm();
        assert!(!simulator.has_tipped(0) && (0.6..1.2).contains(&moved), "{name}: {moved}");
    }
}

#[test]
fn the_sweeps_of_a_scan_have_the_same_bits_on_any_number_of_threads() {
    let run = |threads| {
        let mut simulator = simulator("structured");
        simulator.set_threads(threads);
        let mut readings = vec![Readings::default()];
        for _ in 0..200 {
            simulator.step(&mut readings);
        }
        readings[0].clear();
        simulator.start_scan(0).unwrap();
        for _ in 0..600 {
            simulator.step(&mut readings);
        }
        format!("{:?}", readings[0].sweeps)
    };
    let one = run(1);
    assert!(one == run(2) && one == run(3));
}

#[test]
fn a_robot_that_stands_is_parked_and_drives_on_as_soon_as_it_is_asked_to() {
    let mut simulator = simulator("unstructured");
    let mut readings = vec![Readings::default()];
    for _ in 0..600 {
        simulator.step(&mut readings);
    }
    let parked = simulator.truth(0).unwrap();
    assert_eq!(parked.linear.norm() + parked.angular.norm(), 0.0, "it stands within three seconds");
    for _ in 0..200 {
        simulator.step(&mut readings);
    }
    assert_eq!(simulator.truth(0).unwrap(), parked);
    simulator.drive(0, 0.5, 0.5).unwrap();
    for _ in 0..200 {
        simulator.step(&mut readings);
    }
    let moved = simulator.truth(0).unwrap().pose.translation.vector - parked.pose.translation.vector;
    assert!((0.3..0.6).contains(&moved.norm()), "{moved}");
}
