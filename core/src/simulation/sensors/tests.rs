//! Every sensor against the truth it is drawn from.

use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use super::*;
use crate::geometry::Pose;
use crate::simulation::{CompiledScene, Motion, ScannerConfig, Scene};

fn world(tail: &str) -> CompiledScene {
    let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-20, 20], y_m = [-20, 20] }\n";
    CompiledScene::new(Scene::from_toml(&format!("{head}{tail}"), "t").unwrap()).unwrap()
}

fn at(x: f64, y: f64, yaw: f64) -> Motion {
    let pose = Pose::from_parts(Translation3::new(x, y, 0.0), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw));
    Motion { pose, linear: Vector3::zeros(), angular: Vector3::zeros() }
}

#[test]
fn odometry_follows_an_arc_and_counts_what_the_wheels_roll() {
    let config = OdometryConfig { track: 0.8, ..OdometryConfig::default() };
    let mut odometry = WheelOdometry::new(config);
    // A quarter of a circle of 2 m radius.
    let quarter = std::f64::consts::FRAC_PI_2;
    let mut last = None;
    for step in 0..=500 {
        let angle = quarter * f64::from(step) / 500.0;
        last = Some(odometry.read(0.02 * f64::from(step), [angle * 1.6, angle * 2.4]));
    }
    let last = last.unwrap();
    assert!((last.pose[0] - 2.0).abs() < 0.02 && (last.pose[1] - 2.0).abs() < 0.02, "{last:?}");
    assert!((last.pose[2] - quarter).abs() < 0.01 && (last.distance - 2.0 * quarter).abs() < 0.01);
    assert!((last.linear - 2.0 * quarter / 10.0).abs() < 0.1);
}

#[test]
fn the_inertial_unit_feels_gravity_turning_and_its_own_bias() {
    let config = ImuConfig::default();
    let lean = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -0.2);
    let angular = lean.inverse() * Vector3::new(0.0, 0.0, 0.3);
    let motion = |time: f64| {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3 * time) * lean;
        // What the robot does at the moment of a reading is not what it has done since the last.
        let trembling = Vector3::new(0.0, 0.0, 2.0);
        Motion { pose: Pose::from_parts(Translation3::identity(), rotation), angular: trembling, ..at(0.0, 0.0, 0.0) }
    };
    let mut imu = Imu::new(config, Noise::new(4, 1));
    let times = (0..=2000).map(|k| 0.01 * f64::from(k));
    let readings: Vec<_> = times.map(|time| imu.read(time, &motion(time))).skip(1).collect();
    let n = readings.len() as f64;
    let felt = readings.iter().map(|r| r.acceleration).sum::<Vector3<f64>>() / n;
    // Nose up: gravity's counter-force points forwards.
    let expected = Vector3::new(9.81 * 0.2_f64.sin(), 0.0, 9.81 * 0.2_f64.cos());
    assert!((felt - expected).norm() < 5.0 * config.acceleration_bias, "{felt}");
    let turning = readings.iter().map(|r| r.angular_velocity).sum::<Vector3<f64>>() / n;
    assert!((turning - angular).norm() < 0.004, "{turning}");
    let spread = readings.iter().map(|r| (r.angular_velocity.z - turning.z).powi(2)).sum::<f64>() / n;
    assert!((spread.sqrt() - config.angular_sigma).abs() < 0.0005, "{}", spread.sqrt());
}

#[test]
fn an_accelerating_robot_is_felt() {
    let config = ImuConfig { acceleration_sigma: 0.0, acceleration_bias: 0.0, ..ImuConfig::default() };
    let mut imu = Imu::new(config, Noise::new(1, 1));
    imu.read(0.0, &at(0.0, 0.0, 1.0));
    let (sin, cos) = 1.0_f64.sin_cos();
    let moving = Motion { linear: Vector3::new(0.02 * cos, 0.02 * sin, 0.0), ..at(0.0, 0.0, 1.0) };
    let reading = imu.read(0.01, &moving);
    assert!((reading.acceleration - Vector3::new(2.0, 0.0, 9.81)).norm() < 1e-9, "{reading:?}");
}

#[test]
fn the_receiver_drifts_slowly_around_the_truth_and_falls_out_at_times() {
    let world = world("");
    let config = GnssConfig::default();
    let mut gnss = Gnss::new(config, Noise::new(9, 2));
    let (mut errors, mut lost, mut steps) = (Vec::new(), 0, Vec::new());
    for k in 0..40_000 {
        let reading = gnss.read(0.25 * f64::from(k), &at(3.0, -5.0, 0.0), &world);
        if !reading.has_fix {
            assert!(reading.latitude.is_nan() && reading.satellites == 0);
            lost += 1;
            continue;
        }
        // Metres from the map's origin, by the lengths of a degree at 42.17 deg north.
        let north = (reading.latitude - config.latitude_deg.to_radians()).to_degrees() * 111_083.0 + 5.0;
        if let Some(last) = errors.last() {
            steps.push(north - last);
        }
        errors.push(north);
    }
    let sigma = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
    assert!((1.0..2.2).contains(&sigma(&errors)), "{}", sigma(&errors));
    assert!(sigma(&steps) < 0.6, "drift is slow: {}", sigma(&steps));
    let share = f64::from(lost) / 40_000.0;
    assert!((0.02..0.2).contains(&share), "{share}");
}

#[test]
fn there_is_no_fix_under_a_roof() {
    let roof = "[[box]]\nlabel = \"other\"\nx_m = 0\ny_m = 0\nz_m = 2\nlength_m = 12\nwidth_m = 12\nheight_m = 0.2\n";
    let world = world(roof);
    let mut gnss = Gnss::new(GnssConfig { outage_every: 0.0, ..GnssConfig::default() }, Noise::new(1, 1));
    assert!(!gnss.read(0.0, &at(0.0, 0.0, 0.0), &world).has_fix);
    assert!(gnss.read(1.0, &at(15.0, 15.0, 0.0), &world).has_fix);
}

#[test]
fn the_magnetometer_points_north() {
    let config = MagnetometerConfig { bias: 0.0, sigma: 0.0, declination_deg: 0.0, ..MagnetometerConfig::default() };
    let mut magnetometer = Magnetometer::new(config, 0.0, Noise::new(1, 1));
    // Facing east, north is to the left; facing north, ahead.
    let east = magnetometer.read(0.0, &at(0.0, 0.0, 0.0)).field;
    assert!((east - Vector3::new(0.0, 24e-6, -38e-6)).norm() < 1e-12, "{east}");
    let north = magnetometer.read(0.0, &at(0.0, 0.0, std::f64::consts::FRAC_PI_2)).field;
    assert!((north - Vector3::new(24e-6, 0.0, -38e-6)).norm() < 1e-12, "{north}");
    let mut turned = Magnetometer::new(config, std::f64::consts::FRAC_PI_2, Noise::new(1, 1));
    // The map's x axis points north: so does the robot.
    assert!((turned.read(0.0, &at(0.0, 0.0, 0.0)).field - north).norm() < 1e-12);
}

#[test]
fn rangers_hear_the_ground_and_a_wall_before_it() {
    let open = world("");
    let config = RangerConfig { sigma: 0.0, ..RangerConfig::default() };
    let mut rangers = Rangers::new(config, Noise::new(1, 1));
    assert_eq!(rangers.mounts().len(), 6);
    assert!(rangers.mounts()[0].position.y > 0.2 && rangers.mounts()[3].position.y < -0.2);
    let mut heard = Vec::new();
    rangers.read(0.0, &at(0.0, 0.0, 0.0).pose, &open, &mut heard);
    // The lower edge of the cone meets the ground 35 deg below the horizon: at 0.36 m / sin(35 deg).
    for reading in &heard {
        assert!((reading.range - 0.63).abs() < 0.03, "{reading:?}");
    }
    let wall = world("[[wall]]\nfrom_m = [0.9, -3]\nto_m = [0.9, 3]\nheight_m = 1\nthickness_m = 0.1\n");
    heard.clear();
    rangers.read(0.0, &at(0.0, 0.0, 0.0).pose, &wall, &mut heard);
    assert!((0.3..0.4).contains(&heard[1].range), "{heard:?}");
    assert!(heard[4].range > 0.6, "nothing behind: {heard:?}");
    let high = Pose::translation(0.0, 0.0, 8.0);
    heard.clear();
    rangers.read(0.0, &high, &open, &mut heard);
    assert!(heard.iter().all(|reading| reading.range.is_nan()));
}

#[test]
fn the_battery_runs_down_with_what_is_drawn_until_it_is_low() {
    let config = BatteryConfig { capacity: 1.0e5, ..BatteryConfig::default() };
    let mut battery = Battery::new(config, 1.0);
    battery.draw(60.0, 100.0);
    let reading = battery.read(100.0);
    // 90 W and 60 W / 0.6 for 100 s, and a little in the battery itself.
    assert!((reading.charge - 0.81).abs() < 0.005, "{reading:?}");
    assert!((reading.current - 190.0 / 25.6).abs() < 0.1 && reading.voltage < 25.2 && !reading.is_low);
    for _ in 0..100 {
        battery.draw(60.0, 10.0);
    }
    assert!(battery.read(0.0).is_low && battery.read(0.0).charge == 0.0);
}

#[test]
fn a_planar_laser_sees_from_right_to_left() {
    let world = world("[[wall]]\nfrom_m = [-5, 4]\nto_m = [5, 4]\nheight_m = 2\nthickness_m = 0.2\n");
    let half_turn = std::f64::consts::PI;
    let mut laser = PlanarLaser::new(30.0, 0.0, half_turn / 180.0, half_turn, Noise::new(1, 1));
    assert_eq!(laser.beams(), 181);
    let mut beams = Vec::new();
    laser.sweep(&world, &Pose::translation(0.0, 0.0, 0.5), &mut beams);
    assert!(beams[0].range.is_nan() && beams[90].range.is_nan());
    assert!((beams[180].range - 3.9).abs() < 1e-4 && (beams[135].range - 3.9 * 2.0_f32.sqrt()).abs() < 1e-3);
    assert_eq!((beams[0].time, beams[180].time), (0, 65535));
    let mut one = PlanarLaser::new(30.0, 0.0, 1.0, 0.0, Noise::new(1, 1));
    let left = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), half_turn / 2.0);
    beams.clear();
    one.sweep(&world, &Pose::from_parts(Translation3::new(0.0, 0.0, 0.5), left), &mut beams);
    assert!(beams.len() == 1 && (beams[0].range - 3.9).abs() < 1e-4);
}

#[test]
fn sweeps_and_ticks_put_together_give_points_on_the_surfaces() {
    let world = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let config = ScannerConfig { beam_step_deg: 5.0, beams: 55, ..ScannerConfig::default() }.noise_free();
    let mut laser = TurningLaser::new(config.clone(), Noise::new(1, 1)).unwrap();
    let map_from_scanner = world.level_scanner_pose(&world.scene().start, 1.0).unwrap();
    let (mut sweeps, mut ticks) = (Vec::new(), Vec::new());
    assert!(!laser.is_scanning());
    laser.start(100.0);
    let mut time = 100.0;
    while laser.is_scanning() {
        time += 0.005;
        laser.advance(time, &world, &map_from_scanner, &mut sweeps, &mut ticks);
        assert!(time < 120.0);
    }
    // 720 sweeps of 20 ms, a tick every 10 ms and one behind the last beam.
    assert_eq!((sweeps.len(), ticks.len()), (720, 1441));
    assert!(ticks[0].is_home && !ticks[100].is_home);
    assert!((sweeps[0].duration - 0.02 * 0.75).abs() < 1e-9);
    assert!((sweeps[1].time - sweeps[0].time - 0.02).abs() < 1e-9);
    // The azimuth of each beam lies between the two ticks that bracket its time.
    let mut worst: f64 = 0.0;
    for sweep in sweeps.iter().step_by(7) {
        for (k, beam) in sweep.beams.iter().enumerate().filter(|(_, beam)| !beam.range.is_nan()) {
            let time = sweep.time + sweep.duration * f64::from(beam.time) / 65535.0;
            let at = (time - ticks[0].time) / 0.01;
            let (before, share) = (at as usize, at.fract());
            let angle = ticks[before].angle + share * (ticks[before + 1].angle - ticks[before].angle);
            let azimuth = config.first_sweep_deg.to_radians() + angle;
            let elevation = sweep.first_angle + sweep.angle_step * k as f64;
            let level = f64::from(beam.range) * elevation.cos();
            let point =
                Point3::new(level * azimuth.cos(), level * azimuth.sin(), f64::from(beam.range) * elevation.sin());
            let distance = world.distance_to_surface(&(map_from_scanner * point), 1.0).unwrap();
            // Half a count of the encoder, 0.4 mrad, at this range, and the turning while the laser sweeps.
            worst = worst.max(distance / f64::from(beam.range).max(1.0));
        }
    }
    assert!(worst < 1e-3, "{worst}");
    let fast = ScannerConfig { sweeps: 60, ..config };
    let error = TurningLaser::new(fast, Noise::new(1, 1)).unwrap_err().to_string();
    assert!(error.contains("360 deg in 60 sweeps"), "{error}");
}

#[test]
fn the_same_seed_gives_the_same_readings_and_sensors_do_not_share_draws() {
    let draw = |seed, sensor| {
        let mut imu = Imu::new(ImuConfig::default(), Noise::new(seed, sensor));
        (0..50).map(|k| imu.read(0.01 * f64::from(k), &at(0.0, 0.0, 0.0))).collect::<Vec<_>>()
    };
    assert_eq!(draw(1, 1), draw(1, 1));
    assert_ne!(draw(1, 1), draw(2, 1));
    assert_ne!(draw(1, 1), draw(1, 2));
}
