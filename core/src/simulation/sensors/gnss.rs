//! The satellite receiver: drift, noise, outages, and no fix under a roof or between walls.

use nalgebra::{Point3, Vector3};

use super::config::GnssConfig;
use super::noise::Noise;
use crate::simulation::compiled_scene::CompiledScene;
use crate::simulation::physics::Motion;

/// Height of the antenna over the robot's origin [m].
const ANTENNA_M: f64 = 0.9;
/// Directions in which the sky is looked for, a ring at each of two elevations, and how far [m].
const RING: usize = 8;
const ELEVATIONS: [f64; 2] = [0.5, 1.0];
const SKY_M: f64 = 200.0;
/// World Geodetic System 1984: half the equator's diameter [m] and the square of the eccentricity.
const EQUATOR_M: f64 = 6_378_137.0;
const ECCENTRICITY2: f64 = 6.694_379_990_14e-3;

/// A reading. Without a fix its position and velocity are NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssReading {
    /// Simulated time [s].
    pub time: f64,
    /// Whether there is a fix.
    pub has_fix: bool,
    /// Latitude [rad].
    pub latitude: f64,
    /// Longitude [rad].
    pub longitude: f64,
    /// Over the ellipsoid [m].
    pub height: f64,
    /// East, north, up [m/s].
    pub velocity: Vector3<f64>,
    /// Standard deviations of east, north and up [m].
    pub sigma: Vector3<f64>,
    /// Satellites used.
    pub satellites: u32,
}

/// The receiver.
#[derive(Debug, Clone)]
pub struct Gnss {
    config: GnssConfig,
    noise: Noise,
    /// East, north, up [m].
    drift: Vector3<f64>,
    /// When the outage that is under way, or to come, begins and ends [s].
    outage: [f64; 2],
}

impl Gnss {
    /// Draws the first drift and outage.
    #[must_use]
    pub fn new(config: GnssConfig, mut noise: Noise) -> Self {
        let drift = noise.normal3(config.drift_sigma).component_mul(&Vector3::new(1.0, 1.0, 2.0));
        let mut gnss = Self { config, noise, drift, outage: [f64::INFINITY; 2] };
        gnss.draw_outage(0.0);
        gnss
    }

    fn draw_outage(&mut self, after: f64) {
        if self.config.outage_every > 0.0 {
            let begins = after + self.noise.waiting(self.config.outage_every);
            self.outage = [begins, begins + self.noise.waiting(self.config.outage_length)];
        }
    }

    /// The next reading.
    pub fn read(&mut self, time: f64, motion: &Motion, scene: &CompiledScene) -> GnssReading {
        while time >= self.outage[1] {
            self.draw_outage(self.outage[1]);
        }
        let config = self.config;
        let up = Vector3::new(1.0, 1.0, 2.0);
        for axis in 0..3 {
            let sigma = config.drift_sigma * up[axis];
            self.drift[axis] = self.noise.drift(self.drift[axis], sigma, config.drift_correlation, config.period);
        }
        // Drawn whether there is a fix or not, so that what blocks the sky does not shift later draws.
        let white = self.noise.normal3(config.noise_sigma).component_mul(&up);
        let white_velocity = self.noise.normal3(config.velocity_sigma);
        let antenna = motion.pose * Point3::new(0.0, 0.0, ANTENNA_M);
        let sky = free_sky(scene, &antenna);
        let has_fix = sky >= config.least_sky && !(self.outage[0]..self.outage[1]).contains(&time);
        let sigma = up * config.drift_sigma.hypot(config.noise_sigma);
        if !has_fix {
            let (nan, none) = (f64::NAN, Vector3::repeat(f64::NAN));
            return GnssReading {
                time,
                has_fix,
                latitude: nan,
                longitude: nan,
                height: nan,
                velocity: none,
                sigma: none,
                satellites: 0,
            };
        }
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), config.east_from_map_deg.to_radians());
        let [latitude, longitude, height] = geodetic(&config, &(turn * antenna.coords + self.drift + white));
        let velocity = turn * motion.linear + white_velocity;
        let satellites = (3.0 + 8.0 * sky).round() as u32;
        GnssReading { time, has_fix, latitude, longitude, height, velocity, sigma, satellites }
    }
}

/// Latitude, longitude [rad] and height [m] of a place east, north and up of the map's origin [m], on the ellipsoid's
/// tangent: good to a centimetre within a kilometre.
fn geodetic(config: &GnssConfig, enu: &Vector3<f64>) -> [f64; 3] {
    let latitude = config.latitude_deg.to_radians();
    let bulge = 1.0 - ECCENTRICITY2 * latitude.sin().powi(2);
    let meridian = EQUATOR_M * (1.0 - ECCENTRICITY2) / bulge.powf(1.5) + config.height;
    let parallel = (EQUATOR_M / bulge.sqrt() + config.height) * latitude.cos();
    [latitude + enu.y / meridian, config.longitude_deg.to_radians() + enu.x / parallel, config.height + enu.z]
}

/// The share of the directions upwards in which nothing stands in the way, 0 to 1.
fn free_sky(scene: &CompiledScene, antenna: &Point3<f64>) -> f64 {
    let mut directions = vec![Vector3::z()];
    for (ring, elevation) in ELEVATIONS.into_iter().enumerate() {
        for k in 0..RING {
            let azimuth = std::f64::consts::TAU * (k as f64 + 0.5 * ring as f64) / RING as f64;
            let level: f64 = f64::cos(elevation);
            directions.push(Vector3::new(level * azimuth.cos(), level * azimuth.sin(), f64::sin(elevation)));
        }
    }
    let mut hits = vec![None; directions.len()];
    scene.cast_all(antenna, &directions, SKY_M, &mut hits);
    hits.iter().filter(|hit| hit.is_none()).count() as f64 / hits.len() as f64
}
