//! The filter on the simulated robot in the built-in worlds.

mod faults;
pub(crate) mod ride;

use ride::{Ride, size};

use crate::simulation::Scene;

/// The prior of a scan against the truth.
#[derive(Debug, Clone, Copy)]
struct PriorError {
    metres: f64,
    degrees: f64,
    /// Squared distance in standard deviations, six degrees of freedom (normalised estimation error squared).
    nees: f64,
}

/// Drives the tour of a world with a scan at each pose, about ten metres apart.
fn tour(world: &str, seed: u64, poses: usize) -> Vec<PriorError> {
    let mut ride = Ride::builtin(world, seed);
    ride.scan(3.0);
    let places: Vec<_> = Scene::builtin(world).unwrap().poses.iter().skip(1).take(poses).copied().collect();
    let mut priors = Vec::new();
    for place in places {
        ride.drive_to(place.x, place.y);
        let (off, covariance) = ride.scan(5.0);
        let nees = off.dot(&(covariance.try_inverse().unwrap() * off));
        let (metres, degrees) = size(&off);
        priors.push(PriorError { metres, degrees, nees });
    }
    priors
}

#[test]
fn priors_after_about_ten_metres_are_good_enough_for_alignment_and_as_good_as_they_say() {
    let mut all = Vec::new();
    for (world, poses) in [("simple", 4), ("structured", 4), ("unstructured", 3)] {
        for seed in 1..=2 {
            all.extend(tour(world, seed, poses));
        }
    }
    let mean = |of: fn(&PriorError) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
    let (metres, degrees, nees) = (mean(|p| p.metres), mean(|p| p.degrees), mean(|p| p.nees));
    println!("{metres:.3} m, {degrees:.2} deg, NEES {nees:.1}");
    assert!(metres < 0.2 && degrees < 0.5, "{metres} m, {degrees} deg");
    assert!(all.iter().all(|p| p.metres < 0.5 && p.degrees < 1.5), "{all:?}");
    // Six when the covariance tells the truth; far less and it would be too modest to be of use.
    assert!((1.5..12.0).contains(&nees), "{nees}");
}

/// A kerb in front that the laser looks over, and walls around that it sees.
const YARD: &str = r#"
name = "yard"
[area]
x_m = [-10, 10]
y_m = [-10, 10]
[start]
x_m = 0
y_m = 0
[terrain]
margin_m = 5
[[box]]
label = "kerb"
x_m = 2
y_m = 0
length_m = 0.4
width_m = 6
height_m = 0.3
[[wall]]
from_m = [7, -8]
to_m = [7, 8]
height_m = 2
thickness_m = 0.3
[[wall]]
from_m = [-5, 6]
to_m = [7, 6]
height_m = 2
thickness_m = 0.3
"#;

#[test]
fn a_robot_that_stands_against_a_kerb_knows_that_it_does_whatever_its_wheels_say() {
    let drive = |is_used: bool| {
        let scene = Scene::from_toml(YARD, "yard.toml").unwrap();
        let mut ride = Ride::new(scene, 2, |config| config.laser.is_used = is_used);
        ride.scan(1.0);
        ride.go(0.3, 0.3, 14.0);
        let (metres, _) = size(&ride.off());
        assert!(ride.truth().pose.translation.x < 2.0, "the kerb holds it");
        (metres, ride.localizer.counters().slips)
    };
    let (metres, slips) = drive(true);
    assert!(metres < 0.15 && slips > 5, "{metres} m, {slips} pieces");
    let (metres, slips) = drive(false);
    assert!(metres > 1.0 && slips == 0, "by the wheels: {metres} m, {slips}");
}

#[test]
fn a_robot_that_gets_on_is_not_taken_for_one_that_is_stuck() {
    for world in ["structured", "unstructured"] {
        let mut ride = Ride::new(Scene::builtin(world).unwrap(), 3, |config| config.laser.is_used = true);
        for place in Scene::builtin(world).unwrap().poses.iter().skip(1).take(3) {
            ride.drive_to(place.x, place.y);
        }
        let slips = ride.localizer.counters().slips;
        assert!(ride.driven > 20.0 && slips == 0, "{world}: {slips} pieces over {} m", ride.driven);
    }
}

/// An even slope of 14 deg along x.
const SLOPE: &str = r#"
name = "slope"
[area]
x_m = [-10, 10]
y_m = [-10, 10]
[start]
x_m = 0
y_m = 0
[terrain]
margin_m = 5
slope_x_deg = 14
"#;

#[test]
fn a_robot_that_turns_on_a_slope_knows_that_it_slides_downhill() {
    let turned = |turning_slide_m: f64| {
        let scene = Scene::from_toml(SLOPE, "slope.toml").unwrap();
        let mut ride = Ride::new(scene, 5, |config| config.wheels.turning_slide_m = turning_slide_m);
        // Only what wheels and gyroscopes say.
        ride.tamper = Some(Box::new(|readings| readings.gnss.clear()));
        ride.scan(3.0);
        let from = ride.truth().pose.translation.x;
        ride.go(-0.4, 0.4, 6.0);
        (ride.truth().pose.translation.x - from, size(&ride.off()).0)
    };
    let (slid, metres) = turned(super::LocalizationConfig::default().wheels.turning_slide_m);
    assert!(slid < -0.2, "it slides: {slid} m");
    let (_, unaware) = turned(0.0);
    assert!(metres < 0.6 * unaware, "{metres} m, {unaware} m without");
}

#[test]
fn a_robot_between_walls_keeps_its_heading_better_by_its_laser_than_by_gyroscopes_alone() {
    let mean_deg = |is_used: bool| {
        let errors = (1..=2).flat_map(|seed| {
            let mut ride =
                Ride::new(Scene::builtin("structured").unwrap(), seed, |config| config.laser.is_used = is_used);
            ride.scan(3.0);
            let places = Scene::builtin("structured").unwrap().poses;
            let off = |place: &crate::simulation::ScanPose| {
                ride.drive_to(place.x, place.y);
                ride.off()[5].abs().to_degrees()
            };
            places.iter().skip(1).take(4).map(off).collect::<Vec<f64>>()
        });
        errors.sum::<f64>() / 8.0
    };
    let (with, without) = (mean_deg(true), mean_deg(false));
    assert!(with < 0.25 && with < 0.5 * without, "{with} deg, {without} deg without");
}

#[test]
fn a_robot_that_turns_on_the_spot_knows_by_its_gyroscopes_how_far() {
    let turn = |seed: u64, side: f64| {
        let mut ride = Ride::new(Scene::builtin("structured").unwrap(), seed, |config| config.laser.is_used = false);
        ride.scan(5.0);
        let before = ride.off()[5];
        ride.go(-0.36 * side, 0.36 * side, 4.0);
        ride.go(0.0, 0.0, 1.0);
        (ride.off()[5] - before).abs().to_degrees()
    };
    let errors = [turn(1, 1.0), turn(1, -1.0), turn(2, 1.0), turn(2, -1.0)];
    // The noise of the gyroscopes makes 0.06 deg of it.
    assert!(errors.iter().sum::<f64>() / 4.0 < 0.2, "{errors:?} deg");
}
