//! Labelled scans: ray-cast scenes in which the truth of every cell of the information map is known from what the rays
//! really hit. None of these scenes was used to calibrate the scores.

use std::cell::{OnceCell, RefCell};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;

use mirador_core::analysis::{GroundHeight, PointScore, ScoreConfig, Scorer};
use mirador_core::geometry::Pose;
use mirador_core::information_map::{CellIndex, CellState, InformationMap, MapConfig};
use mirador_core::scan::{Grid, Point, ScanView};
use mirador_core::simulation::{CompiledScene, Label, ScanSeed, Scanner, ScannerConfig, Scene};
use mirador_core::surface::{SurfaceBuilder, SurfaceConfig};
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// The scenes that are judged together.
pub const SCENES: [&str; 6] = ["hill", "street", "stairs", "walls", "rough", "bridge"];

/// Scenes that were put aside before the steps were made to count, and judged once when all was chosen.
pub const FRESH: [&str; 3] = ["avenue", "terrace", "orchard"];

/// Scenes that are judged apart.
pub const APART: [&str; 2] = ["branches", "grass"];

/// Cells farther from every scanner than this are not judged [m].
const RANGE: f64 = 15.0;
/// Faces higher than this over the ground cannot touch the robot [m].
const ROBOT_HEIGHT: f64 = 1.0;
/// So many hits on an obstacle's faces make a cell an obstacle.
const FACE_HITS: u32 = 3;
/// Upper edges of the rings in which known ground is counted [m].
pub const RINGS: [f64; 3] = [5.0, 10.0, 15.0];

/// What is varied.
#[derive(Debug, Clone)]
pub struct Trial {
    pub surface: SurfaceConfig,
    pub scores: ScoreConfig,
    pub map: MapConfig,
    /// Poses of the scene that are scanned, from the first on.
    pub scans: usize,
    /// By how much the alignment's idea of the vertical is off [deg].
    pub tilt_deg: f64,
    /// The share of the returns at a depth jump that lie somewhere between both surfaces.
    pub mixed_pixels: f64,
    pub seed: u64,
}

impl Trial {
    /// The defaults, for a robot that climbs `theta_deg`.
    pub fn new(theta_deg: f64) -> Self {
        Self {
            surface: SurfaceConfig { threads: 2, ..SurfaceConfig::default() },
            scores: ScoreConfig { theta_deg, threads: 2, ..ScoreConfig::default() },
            map: MapConfig::default(),
            scans: 1,
            tilt_deg: 0.0,
            mixed_pixels: 0.0,
            seed: 1,
        }
    }
}

/// What the rays hit in a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Truth {
    /// On upright faces of obstacles under the robot's height.
    faces: u32,
    /// On anything else of an obstacle under the robot's height.
    tops: u32,
    /// On ground and ramps.
    ground: u32,
    /// Of these, on ground steeper than theta.
    steep: u32,
    /// Of these, on ground between what the calibrated scores allow (0.6 theta) and theta.
    between: u32,
    /// What the last of the faces belongs to.
    object: Option<Label>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Class {
    Navigable,
    Obstacle,
    Steep,
    /// Too few hits to tell.
    Open,
}

impl Truth {
    fn add(&mut self, hit: &Hit, theta: f64) {
        if !hit.label.is_obstacle() && hit.upright > 0.5 {
            self.ground += 1;
            self.steep += u32::from(hit.slope > theta);
            self.between += u32::from(hit.slope <= theta && hit.slope > 0.6 * theta);
        } else if hit.upright < 0.5 {
            self.faces += 1;
            self.object = Some(hit.label);
        } else {
            self.tops += 1;
        }
    }

    fn class(&self) -> Class {
        match *self {
            Self { faces, .. } if faces >= FACE_HITS => Class::Obstacle,
            Self { faces: 0, tops: 0, ground, steep, between, .. } if ground > 0 => {
                if steep == ground {
                    Class::Steep
                } else if steep + between == 0 {
                    Class::Navigable
                } else {
                    Class::Open
                }
            }
            _ => Class::Open,
        }
    }

    fn has_object(&self) -> bool {
        self.faces + self.tops > 0
    }
}

/// Counts over the cells of one or more scenes.
#[derive(Debug, Clone, Copy, Default)]
pub struct Judgement {
    /// Cells that are navigable, and those of them that were said to be.
    pub navigable: u32,
    pub navigable_found: u32,
    /// Cells said to be navigable that are an obstacle or too steep.
    pub navigable_wrong: u32,
    pub obstacles: u32,
    pub obstacles_found: u32,
    pub obstacles_wrong: u32,
    /// Obstacle cells said to be navigable.
    pub dangerous: u32,
    /// By label: obstacle cells, those found, and those said to be navigable.
    pub by_label: [[u32; 3]; Label::ALL.len()],
    /// By ring: flat ground cells in sight, and those of them that are known.
    pub ground: [u32; 3],
    pub ground_known: [u32; 3],
}

impl Judgement {
    pub fn add(&mut self, other: &Self) {
        self.navigable += other.navigable;
        self.navigable_found += other.navigable_found;
        self.navigable_wrong += other.navigable_wrong;
        self.obstacles += other.obstacles;
        self.obstacles_found += other.obstacles_found;
        self.obstacles_wrong += other.obstacles_wrong;
        self.dangerous += other.dangerous;
        for (sum, more) in self.by_label.iter_mut().flatten().zip(other.by_label.iter().flatten()) {
            *sum += more;
        }
        for ring in 0..RINGS.len() {
            self.ground[ring] += other.ground[ring];
            self.ground_known[ring] += other.ground_known[ring];
        }
    }

    /// Precision and recall of navigable cells, then of obstacle cells.
    pub fn shares(&self) -> [f64; 4] {
        let share =
            |part: u32, rest: u32| if part + rest == 0 { 1.0 } else { f64::from(part) / f64::from(part + rest) };
        [
            share(self.navigable_found, self.navigable_wrong),
            share(self.navigable_found, self.navigable - self.navigable_found),
            share(self.obstacles_found, self.obstacles_wrong),
            share(self.obstacles_found, self.obstacles - self.obstacles_found),
        ]
    }

    /// The share of the ground in sight that is known, by ring.
    pub fn known(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| f64::from(self.ground_known[k]) / f64::from(self.ground[k].max(1)))
    }

    /// Which obstacles were found: cells of each label, found, called navigable.
    pub fn objects(&self) -> String {
        let labels = Label::ALL.into_iter().zip(self.by_label).filter(|(_, counts)| counts[0] > 0);
        labels.map(|(label, [all, found, lost])| format!("{label} {found} of {all} ({lost} nav.)  ")).collect()
    }

    /// A line of the short table: navigable cells, obstacle cells, obstacle cells called navigable.
    pub fn brief(&self, name: &str) -> String {
        let [np, nr, op, or] = self.shares();
        format!("| {name} | {np:.3} / {nr:.3} | {op:.3} / {or:.3} | {} |", self.dangerous)
    }

    /// A line of the table.
    pub fn row(&self, name: &str) -> String {
        let [np, nr, op, or] = self.shares();
        let [a, b, c] = self.known();
        format!(
            "| {name} | {np:.3} | {nr:.3} | {op:.3} | {or:.3} | {} | {} | {} | {a:.2} | {b:.2} | {c:.2} |",
            self.navigable, self.obstacles, self.dangerous
        )
    }
}

/// The head of a table of [`Judgement::row`].
pub const HEAD: &str = "| | nav. precision | nav. recall | obst. precision | obst. recall | nav. cells | obst. cells | \
obst. called nav. | ground known to 5 m | 10 m | 15 m |\n|---|---|---|---|---|---|---|---|---|---|---|";

/// Scans a labelled scene, scores it, projects it into a map, and judges every cell.
pub fn judge(scene: &str, trial: &Trial) -> Result<Judgement, Box<dyn Error>> {
    Recording::new(scene, trial.scans, trial.seed)?.judge(trial)
}

/// What one ray really hit on the ground or below the robot's height.
#[derive(Debug, Clone, Copy)]
struct Hit {
    at: Point3<f64>,
    label: Label,
    /// |n_z| of what was hit.
    upright: f64,
    /// The slope of ground and ramps [rad].
    slope: f64,
}

/// One scan and what it really hit.
struct View {
    pose: Pose,
    points: Vec<Point>,
    /// The true range of each ray, infinite without a hit.
    ranges: Vec<f64>,
    /// Whether the surface breaks off between a ray and the next of its sweep.
    breaks: Vec<bool>,
    hits: Vec<Hit>,
}

/// The scans of a scene with their truth: scanned once, judged with any settings.
pub struct Recording {
    scene: CompiledScene,
    grid: Grid,
    views: Vec<View>,
    /// Bare ground in sight of the first scanner, with its ring.
    in_sight: OnceCell<Vec<(CellIndex, usize)>>,
    /// Whether nothing stands on or over a cell, as far as it was asked.
    bare: RefCell<BTreeMap<CellIndex, bool>>,
}

impl Recording {
    /// Scans a labelled scene from its first `scans` poses.
    pub fn new(scene: &str, scans: usize, seed: u64) -> Result<Self, Box<dyn Error>> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../worlds/labelled").join(format!("{scene}.toml"));
        let scene = CompiledScene::new(Scene::load(&path)?)?;
        let scanner = Scanner::new(ScannerConfig::default())?;
        let mut views = Vec::new();
        for (number, place) in scene.scene().poses.iter().take(scans).enumerate() {
            let pose =
                scene.level_scanner_pose(place, scanner.config().height_m).ok_or("no ground under the scanner")?;
            let mut points = vec![Point::EMPTY; scanner.grid().cells()];
            scanner.scan(&scene, &pose, ScanSeed { seed, scan: number as u64 }, 2, &mut points, None)?;
            let (ranges, breaks, hits) = hits_of(&scene, &scanner, &pose);
            views.push(View { pose, points, ranges, breaks, hits });
        }
        Ok(Self { scene, grid: scanner.grid(), views, in_sight: OnceCell::new(), bare: RefCell::default() })
    }

    /// Scores the scans, projects them into a map, and judges every cell.
    pub fn judge(&self, trial: &Trial) -> Result<Judgement, Box<dyn Error>> {
        let mut map = InformationMap::new(trial.map)?;
        let mut truths = BTreeMap::new();
        let (mut builder, mut scorer) = (SurfaceBuilder::new(), Scorer::new());
        let mut positions = Vec::new();
        for view in self.views.iter().take(trial.scans) {
            for hit in &view.hits {
                if let Some(cell) = map.cell_containing(hit.at.x, hit.at.y) {
                    truths.entry(cell).or_insert_with(Truth::default).add(hit, trial.scores.theta_deg.to_radians());
                }
            }
            let mut points = view.points.clone();
            mix_pixels(&mut points, view, trial.mixed_pixels);
            let mut scores = vec![PointScore::NONE; points.len()];
            let tilt = UnitQuaternion::from_euler_angles(trial.tilt_deg.to_radians(), 0.0, 0.0);
            let believed = Pose::from_parts(view.pose.translation, view.pose.rotation * tilt);
            let scan = ScanView::ordered(&points, self.grid).ok_or("not a grid")?;
            let surface = builder.build(scan, &trial.surface)?;
            let ground = GroundHeight::resolve(&trial.scores, scan, surface, &believed.rotation);
            scorer.score(scan, surface, &believed.rotation, ground, &trial.scores, &mut scores)?;
            map.insert(scan, &scores, &believed)?;
            positions.push(view.pose.translation.vector);
        }
        self.add_ground_between(&map, &positions, &mut truths);
        let mut judgement = count(&map, &truths, &positions);
        self.count_known(&map, &mut judgement);
        Ok(judgement)
    }

    /// Cells that the map knows without a hit: navigable when nothing but ground lies under them.
    fn add_ground_between(
        &self,
        map: &InformationMap,
        positions: &[Vector3<f64>],
        truths: &mut BTreeMap<CellIndex, Truth>,
    ) {
        for (cell, _) in map.known_cells() {
            if !truths.contains_key(&cell) && distance(map, cell, positions) < RANGE && self.is_bare(map, cell) {
                truths.insert(cell, Truth { ground: 1, ..Truth::default() });
            }
        }
    }

    /// Whether nothing stands on or over a cell.
    fn is_bare(&self, map: &InformationMap, cell: CellIndex) -> bool {
        *self.bare.borrow_mut().entry(cell).or_insert_with(|| is_bare(&self.scene, map, cell))
    }

    /// Counts the bare ground in sight of the first scanner, and what of it is known.
    fn count_known(&self, map: &InformationMap, judgement: &mut Judgement) {
        let Some(view) = self.views.first() else { return };
        let position = view.pose.translation.vector;
        for &(cell, ring) in self.in_sight.get_or_init(|| ground_in_sight(&self.scene, map, &position)) {
            judgement.ground[ring] += 1;
            judgement.ground_known[ring] += u32::from(matches!(map.state(cell), CellState::Known(_)));
        }
    }
}

/// The true ranges of all rays of a scan, where they break, and what those hit that matter to the robot.
fn hits_of(scene: &CompiledScene, scanner: &Scanner, pose: &Pose) -> (Vec<f64>, Vec<bool>, Vec<Hit>) {
    let origin = Point3::from(pose.translation.vector);
    let grid = scanner.grid();
    let (mut ranges, mut breaks, mut hits) = (Vec::new(), vec![false; grid.cells()], Vec::new());
    // Direction, range and normal of the ray before.
    let mut last: Option<(Vector3<f64>, f64, Vector3<f64>)> = None;
    for index in 0..grid.cells() {
        let direction = scanner.ray(index / grid.cols, index % grid.cols).map(|ray| pose.rotation * ray);
        let hit = direction.and_then(|direction| scene.cast(&origin, &direction, scanner.config().range_max_m));
        let (Some(direction), Some(hit)) = (direction, hit) else {
            ranges.push(f64::INFINITY);
            last = None;
            continue;
        };
        ranges.push(hit.range);
        let normal = scene.normal(&hit);
        let here = (direction, hit.range, normal);
        if let Some(last) = last.filter(|_| index % grid.cols > 0) {
            breaks[index - 1] = is_break(&last, &here);
        }
        last = Some(here);
        let at = origin + hit.range * direction;
        let Some(ground) = scene.ground_height(at.x, at.y) else { continue };
        if at.z - ground > ROBOT_HEIGHT {
            continue;
        }
        let upright = normal.z.abs();
        // Roughness below the size of the robot is no slope: the terrain's own is taken over a metre.
        let slope = if hit.label == Label::Ground { broad_slope(scene, &at) } else { upright.min(1.0).acos() };
        hits.push(Hit { at, label: hit.label, upright, slope });
    }
    (ranges, breaks, hits)
}

/// Whether two surfaces, each a plane with a ray's direction, range and normal, do not meet between their rays: the
/// nearer one, prolonged, lies before the farther one, and the farther one behind the nearer. Surfaces that meet in an
/// edge each lie on the same side of the other's prolongation.
fn is_break(a: &(Vector3<f64>, f64, Vector3<f64>), b: &(Vector3<f64>, f64, Vector3<f64>)) -> bool {
    let prolonged = |of: &(Vector3<f64>, f64, Vector3<f64>), to: &Vector3<f64>| {
        let range = of.1 * of.2.dot(&of.0) / of.2.dot(to);
        if range > 0.0 { range } else { f64::INFINITY }
    };
    let (beyond_a, beyond_b) = (prolonged(a, &b.0) - b.1, prolonged(b, &a.0) - a.1);
    (a.1 - b.1).abs() > 0.3 && beyond_a * beyond_b < 0.0 && beyond_a.abs().min(beyond_b.abs()) > 0.3
}

/// The slope of the ground over a metre [rad].
fn broad_slope(scene: &CompiledScene, at: &Point3<f64>) -> f64 {
    let height = |dx: f64, dy: f64| scene.ground_height(at.x + dx, at.y + dy);
    let along = |a: Option<f64>, b: Option<f64>| a.zip(b).map_or(0.0, |(a, b)| b - a);
    let (x, y) = (along(height(-0.5, 0.0), height(0.5, 0.0)), along(height(0.0, -0.5), height(0.0, 0.5)));
    x.hypot(y).atan()
}

/// Puts some of the returns beside a depth jump anywhere between the two surfaces, as a beam that meets both does.
fn mix_pixels(points: &mut [Point], view: &View, share: f64) {
    if share <= 0.0 {
        return;
    }
    let breaks = (0..points.len()).filter(|index| view.breaks[*index]);
    for index in breaks {
        let (here, beside) = (view.ranges[index], view.ranges[index + 1]);
        // Two draws from a counter, so that the same beam draws the same.
        let draw = |k: u64| {
            let hash = (index as u64 + k).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((hash ^ (hash >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f64 / f64::from(1u32 << 24)
        };
        if draw(0) < share {
            let scale = ((here + draw(1 << 40) * (beside - here)) / here) as f32;
            let p = points[index];
            points[index] = Point { x: p.x * scale, y: p.y * scale, z: p.z * scale, ..p };
        }
    }
}

/// Whether nothing stands on or over a cell.
fn is_bare(scene: &CompiledScene, map: &InformationMap, cell: CellIndex) -> bool {
    let [x, y] = map.centre_of(cell);
    let half = 0.5 * map.cell_m();
    [-1.0, -0.5, 0.0, 0.5, 1.0].iter().all(|dx| {
        [-1.0, -0.5, 0.0, 0.5, 1.0].iter().all(|dy| {
            let from = Point3::new(x + dx * half, y + dy * half, 40.0);
            scene.cast(&from, &-Vector3::z(), 80.0).is_some_and(|hit| hit.label == Label::Ground)
        })
    })
}

fn distance(map: &InformationMap, cell: CellIndex, positions: &[Vector3<f64>]) -> f64 {
    let [x, y] = map.centre_of(cell);
    positions.iter().map(|p| (p.x - x).hypot(p.y - y)).fold(f64::INFINITY, f64::min)
}

fn count(map: &InformationMap, truths: &BTreeMap<CellIndex, Truth>, positions: &[Vector3<f64>]) -> Judgement {
    let mut judgement = Judgement::default();
    let around =
        |cell: CellIndex| (-1..=1).flat_map(move |x| (-1..=1).map(move |y| CellIndex { x: cell.x + x, y: cell.y + y }));
    for (&cell, truth) in truths {
        let far = distance(map, cell, positions);
        let CellState::Known(navigability) = map.state(cell) else { continue };
        let class = truth.class();
        // Ground beside an object belongs to the border between the classes.
        let is_border = around(cell).any(|c| truths.get(&c).is_some_and(Truth::has_object));
        if far > RANGE || class == Class::Open || (class != Class::Obstacle && is_border) {
            continue;
        }
        let (says_navigable, says_obstacle) = (navigability > 0.7, navigability < 0.5);
        match class {
            Class::Navigable => {
                judgement.navigable += 1;
                judgement.navigable_found += u32::from(says_navigable);
                judgement.obstacles_wrong += u32::from(says_obstacle);
            }
            Class::Obstacle => {
                judgement.obstacles += 1;
                judgement.obstacles_found += u32::from(says_obstacle);
                judgement.navigable_wrong += u32::from(says_navigable);
                judgement.dangerous += u32::from(says_navigable);
                if let Some(counts) = truth.object.and_then(|label| judgement.by_label.get_mut(label as usize)) {
                    counts[0] += 1;
                    counts[1] += u32::from(says_obstacle);
                    counts[2] += u32::from(says_navigable);
                }
            }
            _ => {
                judgement.navigable_wrong += u32::from(says_navigable);
                judgement.obstacles_wrong += u32::from(says_obstacle);
            }
        }
    }
    judgement
}

/// The cells of bare ground in sight from a place, each with its ring.
fn ground_in_sight(scene: &CompiledScene, map: &InformationMap, position: &Vector3<f64>) -> Vec<(CellIndex, usize)> {
    let reach = (RANGE / map.cell_m()) as i32 + 1;
    let Some(centre) = map.cell_containing(position.x, position.y) else { return Vec::new() };
    let mut found = Vec::new();
    for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
        let cell = CellIndex { x: centre.x + dx, y: centre.y + dy };
        let [x, y] = map.centre_of(cell);
        let far = (x - position.x).hypot(y - position.y);
        // Under the scanner, where its fan is blind, nothing can be known.
        let Some(ring) = RINGS.iter().position(|ring| far < *ring).filter(|_| far > 1.3) else { continue };
        let Some(ground) = scene.ground_height(x, y).filter(|_| is_bare(scene, map, cell)) else { continue };
        let from = Point3::from(*position);
        let ray = Vector3::new(x, y, ground) - position;
        let hit = scene.cast(&from, &ray.normalize(), 100.0);
        if hit.is_some_and(|hit| (hit.range - ray.norm()).abs() < 0.2) {
            found.push((cell, ring));
        }
    }
    found
}
