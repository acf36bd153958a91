//! Simulated drives through a town, with drifting odometry: what no recorded data set has enough of.

use mirador_core::geometry::{Pose, Twist, exp};
use mirador_core::scan::{Grid, Point};
use mirador_core::simulation::{
    CompiledScene, Label, Origin, Placement, ScanPose, ScanSeed, Scanner, ScannerConfig, Scene, SceneObject, Shape,
    TerrainConfig, Wave, WorkArea,
};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal, Uniform};

use super::RegistrationBenchError;

/// Distance between streets, from middle to middle [m]: beyond most houses, so that a street hardly sees the next.
const STREET_DISTANCE_M: f64 = 28.0;
/// Length of a street, from bend to bend [m].
const STREET_LENGTH_M: f64 = 200.0;
/// Distance between scans of the long drive [m]: those that do not follow one another shortly hardly overlap.
const DRIVE_STEP_M: f64 = 4.0;
/// Scans of the tour.
const TOUR_SCANS: usize = 15;
/// Distance within which the robot feels the ground lean [m].
const FOOTPRINT_M: f64 = 0.6;
/// Errors of the odometry from scan to scan: of the distance driven, and of the angles [rad].
const ODOMETRY_SHARE: f64 = 0.02;
const ODOMETRY_SIGMA: f64 = 0.004;

/// A drive through a simulated town. Scans are taken when they are asked for: all of them would not fit in memory.
pub struct SimulatedDrive {
    scene: CompiledScene,
    scanner: Scanner,
    /// The true `map_from_scanner`, one a scan.
    pub truth: Vec<Pose>,
    /// `map_from_scanner` by the drifting odometry, one a scan.
    pub priors: Vec<Pose>,
}

impl SimulatedDrive {
    fn new(
        scene: Scene,
        scanner: ScannerConfig,
        stations: &[ScanPose],
        seed: u64,
    ) -> Result<Self, RegistrationBenchError> {
        let height = scanner.height_m;
        let (scene, scanner) = (CompiledScene::new(scene)?, Scanner::new(scanner)?);
        let stand = |station| scene.leaning_scanner_pose(station, height, FOOTPRINT_M);
        // Every station lies inside the area by construction.
        let truth: Vec<Pose> = stations.iter().filter_map(stand).collect();
        let priors = odometry(&truth, seed);
        Ok(Self { scene, scanner, truth, priors })
    }

    /// The order of the scans.
    #[must_use]
    pub fn grid(&self) -> Grid {
        self.scanner.grid()
    }

    /// Takes scan `k` into `points`, on two threads.
    ///
    /// # Errors
    /// [`RegistrationBenchError::BadOption`] beyond the last scan.
    pub fn scan(&self, k: usize, points: &mut Vec<Point>) -> Result<(), RegistrationBenchError> {
        let pose = self.truth.get(k).ok_or_else(|| RegistrationBenchError::BadOption {
            field: "scan",
            reason: format!("{k} is beyond the last scan, {}", self.truth.len()),
        })?;
        points.resize(self.grid().cells(), Point::EMPTY);
        let seed = ScanSeed { seed: 1, scan: k as u64 };
        Ok(self.scanner.scan(&self.scene, pose, seed, 2, points, None)?)
    }
}

/// A drive of so many scans, 4 m apart, to and fro along street after street of a town. Small scans: 180 sweeps of 136
/// beams.
///
/// # Errors
/// Only if the simulation refuses its own settings.
pub fn long_drive(scans: usize) -> Result<SimulatedDrive, RegistrationBenchError> {
    let scanner = ScannerConfig { beam_step_deg: 2.0, beams: 136, sweeps: 180, ..ScannerConfig::default() };
    town_drive(scans, scanner)
}

/// The drive of [`long_drive`] with another scanner.
pub(crate) fn town_drive(scans: usize, scanner: ScannerConfig) -> Result<SimulatedDrive, RegistrationBenchError> {
    let stations: Vec<ScanPose> = (0..scans).map(|k| on_serpentine(k as f64 * DRIVE_STEP_M)).collect();
    let streets = 2 + (scans as f64 * DRIVE_STEP_M / (STREET_LENGTH_M + STREET_DISTANCE_M)) as usize;
    SimulatedDrive::new(town(streets, STREET_LENGTH_M), scanner, &stations, 1)
}

/// Fifteen scans of the source's scanner on a tour around a block of houses; the last ones see the first ones' street.
///
/// # Errors
/// Only if the simulation refuses its own settings.
pub fn tour_around_a_block() -> Result<SimulatedDrive, RegistrationBenchError> {
    // The block between street 1 and street 2, up to the bend and back by a gap between the houses.
    let length = 44.0;
    let perimeter = 2.0 * (length + STREET_DISTANCE_M);
    let stations: Vec<ScanPose> = (0..TOUR_SCANS)
        .map(|k| on_rectangle(k as f64 * perimeter / (TOUR_SCANS as f64 - 0.5), length, STREET_DISTANCE_M))
        .collect();
    SimulatedDrive::new(town(3, length), ScannerConfig::default(), &stations, 2)
}

/// The place after so many metres on the way up the first street, across, down the second, and so on. Bends are arcs, so
/// that no two scans are a right angle apart.
fn on_serpentine(metres: f64) -> ScanPose {
    let half_turn = std::f64::consts::PI * STREET_DISTANCE_M / 2.0;
    let lap = STREET_LENGTH_M + half_turn;
    let street = (metres / lap).floor();
    let along = metres - street * lap;
    let is_up = (street as u64).is_multiple_of(2);
    let (ahead, x0) = (if is_up { 1.0 } else { -1.0 }, if is_up { 0.0 } else { STREET_LENGTH_M });
    let y = street * STREET_DISTANCE_M;
    if along <= STREET_LENGTH_M {
        return ScanPose { x: x0 + ahead * along, y, yaw: if is_up { 0.0 } else { std::f64::consts::PI } };
    }
    let angle = (along - STREET_LENGTH_M) / (STREET_DISTANCE_M / 2.0);
    let radius = STREET_DISTANCE_M / 2.0;
    let end = x0 + ahead * STREET_LENGTH_M;
    let yaw = if is_up { angle } else { std::f64::consts::PI - angle };
    ScanPose { x: end + ahead * radius * angle.sin(), y: y + radius * (1.0 - angle.cos()), yaw }
}

/// The place after so many metres on the way around a rectangle, counter-clockwise from its first corner.
fn on_rectangle(metres: f64, length: f64, width: f64) -> ScanPose {
    let quarter = std::f64::consts::FRAC_PI_2;
    let legs = [(length, 0.0), (width, quarter), (length, 2.0 * quarter), (width, 3.0 * quarter)];
    let (mut x, mut y, mut left) = (0.0, 0.0, metres);
    for (leg, yaw) in legs {
        let step = left.min(leg);
        x += step * f64::cos(yaw);
        y += step * f64::sin(yaw);
        left -= step;
        if left <= 0.0 {
            return ScanPose { x, y, yaw };
        }
    }
    ScanPose { x, y, yaw: 0.0 }
}

/// Houses along both sides of parallel streets, with trees before them and cars at the kerb, on gently uneven ground.
fn town(streets: usize, length: f64) -> Scene {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut objects = Vec::new();
    // A row of houses before the first street, between any two, and behind the last.
    for row in 0..=streets {
        let y = (row as f64 - 0.5) * STREET_DISTANCE_M;
        let mut x = 0.0;
        while x < length - 8.0 {
            x += house(&mut random, &mut objects, x, y);
        }
    }
    // Walls beyond the bends keep the ends from being open ground.
    let far = (streets as f64 - 0.5) * STREET_DISTANCE_M;
    for (k, end) in [-0.9, 1.0].into_iter().enumerate() {
        let x = if k == 0 { end * STREET_DISTANCE_M } else { length + 0.9 * end * STREET_DISTANCE_M };
        let size = Vector3::new(0.4, far + STREET_DISTANCE_M, 2.2);
        objects.push(standing(Label::Wall, Shape::Box { size }, x, far / 2.0 - STREET_DISTANCE_M / 4.0, 0.0));
    }
    let margin = 1.2 * STREET_DISTANCE_M;
    Scene {
        name: "town".into(),
        area: WorkArea { x_m: [-margin, length + margin], y_m: [-margin, far + margin] },
        terrain: TerrainConfig {
            cell_m: 2.0,
            waves: vec![
                Wave { amplitude_m: 0.15, wavelength_m: 23.0, heading_deg: 25.0, phase_deg: 0.0 },
                Wave { amplitude_m: 0.3, wavelength_m: 61.0, heading_deg: 110.0, phase_deg: 60.0 },
            ],
            ..TerrainConfig::default()
        },
        objects,
        models: Vec::new(),
        robots: Vec::new(),
        ground_colour: Label::Ground.colour(),
        origin: Origin::default(),
        start: ScanPose { x: 0.0, y: 0.0, yaw: 0.0 },
        poses: Vec::new(),
    }
}

/// Builds one house with what stands before it, and returns how far the next one is [m].
fn house(random: &mut ChaCha8Rng, objects: &mut Vec<SceneObject>, x: f64, y: f64) -> f64 {
    let mut between = |low: f64, high: f64| low + (high - low) * uniform(random);
    let (length, width) = (between(7.0, 13.0), between(6.0, 9.0));
    let middle = x + length / 2.0;
    let (wall_height, roof_height) = (between(3.2, 6.5), between(1.5, 3.0));
    let shape = Shape::House { length, width, wall_height, roof_height };
    objects.push(standing(Label::Building, shape, middle, y + between(-1.5, 1.5), between(-0.08, 0.08)));
    for side in [-1.0, 1.0] {
        let garden = y + side * (width / 2.0 + between(2.0, 3.5));
        if between(0.0, 1.0) < 0.6 {
            let (tree, radius) = (middle + between(-4.0, 4.0), between(0.12, 0.3));
            let height = between(2.2, 3.5);
            objects.push(standing(Label::Tree, Shape::Cylinder { radius, height }, tree, garden, 0.0));
            let crown = SceneObject {
                placement: Placement::OnGround { above: height - 0.3 },
                ..standing(Label::Tree, Shape::Sphere { radius: between(0.8, 1.6) }, tree, garden, 0.0)
            };
            objects.push(crown);
        }
        if between(0.0, 1.0) < 0.5 {
            let (kerb, size) = (y + side * (STREET_DISTANCE_M / 2.0 - 2.6), Vector3::new(4.3, 1.8, 1.45));
            objects.push(standing(
                Label::Vehicle,
                Shape::Box { size },
                middle + between(-3.0, 3.0),
                kerb,
                between(-0.05, 0.05),
            ));
        }
    }
    length + between(2.0, 6.0)
}

fn standing(label: Label, shape: Shape, x: f64, y: f64, yaw: f64) -> SceneObject {
    SceneObject { label, shape, x, y, yaw, placement: Placement::OnGround { above: 0.0 }, colour: None }
}

fn uniform(random: &mut ChaCha8Rng) -> f64 {
    // The bounds are sound, so the distribution exists.
    Uniform::new(0.0, 1.0).map_or(0.5, |uniform| uniform.sample(random))
}

/// The true motions, each with an error of its own: in proportion to its length, and in its angles.
fn odometry(truth: &[Pose], seed: u64) -> Vec<Pose> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut priors: Vec<Pose> = truth.first().copied().into_iter().collect();
    for (before, after) in truth.iter().zip(truth.iter().skip(1)) {
        let motion = before.inverse() * after;
        let length = motion.translation.vector.norm();
        let error = Twist::from_fn(|axis, _| {
            let sigma = if axis < 3 { ODOMETRY_SHARE * length } else { ODOMETRY_SIGMA };
            let normal: f64 = StandardNormal.sample(&mut random);
            sigma * normal
        });
        let last = priors.last().copied().unwrap_or_else(Pose::identity);
        let mut next = last * motion * exp(&error);
        next.rotation.renormalize();
        priors.push(next);
    }
    priors
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_serpentine_has_no_jumps() {
        for k in 0..2000_u32 {
            let (a, b) = (on_serpentine(f64::from(k)), on_serpentine(f64::from(k) + 1.0));
            let distance = (a.x - b.x).hypot(a.y - b.y);
            assert!((0.98..=1.000_001).contains(&distance), "{k}: {distance}");
            // It goes where it looks.
            let ahead = (b.x - a.x) * a.yaw.cos() + (b.y - a.y) * a.yaw.sin();
            assert!(ahead > 0.95, "{k}: {ahead}");
        }
    }

    #[test]
    fn a_drive_starts_at_its_truth_and_drifts() {
        let drive = long_drive(30).unwrap();
        assert_eq!((drive.truth.len(), drive.priors.len()), (30, 30));
        assert_eq!(drive.truth[0], drive.priors[0]);
        assert!((drive.truth[29].translation.vector - drive.priors[29].translation.vector).norm() > 0.01);
    }

    #[test]
    fn scans_are_the_same_whenever_they_are_taken() {
        let drive = long_drive(12).unwrap();
        let (mut first, mut again) = (Vec::new(), Vec::new());
        drive.scan(11, &mut first).unwrap();
        drive.scan(3, &mut again).unwrap();
        drive.scan(11, &mut again).unwrap();
        let bits =
            |points: &[Point]| -> Vec<[u32; 3]> { points.iter().map(|p| [p.x, p.y, p.z].map(f32::to_bits)).collect() };
        assert_eq!(bits(&first), bits(&again));
        let returns = first.iter().filter(|p| p.is_return()).count();
        assert!(returns > 3000, "{returns} of {}", first.len());
        assert!(drive.scan(12, &mut again).is_err());
    }

    #[test]
    fn the_tour_comes_back_to_where_it_began() {
        let tour = tour_around_a_block().unwrap();
        assert_eq!(tour.truth.len(), TOUR_SCANS);
        let gap = (tour.truth[0].inverse() * tour.truth[14]).translation.vector.norm();
        assert!((1.0..12.0).contains(&gap), "{gap}");
    }
}
