//! Simulated surveys, for tests and benches: a robot mows a hilly field lane by lane and recognises places of the lane
//! beside it.

use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal, Uniform};

use super::{Edge, EdgeKind, PoseGraph, PoseGraphConfig};
use crate::geometry::{Pose, Twist, exp};
use crate::registration::ConfigError;

/// A survey to simulate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurveyConfig {
    /// Poses in all.
    pub poses: usize,
    /// Poses of a lane.
    pub poses_per_lane: usize,
    /// Distance between poses along a lane [m].
    pub spacing_m: f64,
    /// Distance between lanes [m].
    pub lane_distance_m: f64,
    /// True edges in all: the chain first, then from each pose to the last but one, then to the lanes beside.
    pub edges: usize,
    /// Standard deviation of each measurement along each axis [m].
    pub sigma_m: f64,
    /// Standard deviation of each measurement about each axis [rad].
    pub sigma_rotation: f64,
    /// False loop closures as a share of all loop closures, 0 to 0.9.
    pub false_share: f64,
    /// Whether false closures come in pairs that agree with each other, as when a place is taken for another.
    pub false_pairs: bool,
    /// Seed of all that is random.
    pub seed: u64,
}

impl Default for SurveyConfig {
    fn default() -> Self {
        Self {
            poses: 4000,
            poses_per_lane: 100,
            spacing_m: 2.0,
            lane_distance_m: 4.0,
            edges: 12_000,
            sigma_m: 0.02,
            sigma_rotation: 0.002,
            false_share: 0.0,
            false_pairs: false,
            seed: 1,
        }
    }
}

impl SurveyConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("survey.poses", self.poses as f64, 2.0, 1e7)?;
        ConfigError::check("survey.poses_per_lane", self.poses_per_lane as f64, 2.0, 1e7)?;
        ConfigError::check("survey.edges", self.edges as f64, (self.poses - 1) as f64, 1e8)?;
        ConfigError::check("survey.sigma_m", self.sigma_m, 1e-9, 10.0)?;
        ConfigError::check("survey.sigma_rotation", self.sigma_rotation, 1e-9, 1.0)?;
        ConfigError::check("survey.false_share", self.false_share, 0.0, 0.9)
    }
}

/// A simulated survey.
#[derive(Debug, Clone)]
pub struct Survey {
    /// The true poses, `map_from_node`.
    pub truth: Vec<Pose>,
    /// The poses by the chain of measurements alone.
    pub start: Vec<Pose>,
    /// The measurements, true ones first.
    pub edges: Vec<Edge>,
    /// The index of the first false edge; as many as there are edges when there is none.
    pub first_false: usize,
}

impl Survey {
    /// Simulates a survey.
    ///
    /// # Errors
    /// The first field of the settings out of range.
    pub fn new(config: &SurveyConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        let mut random = ChaCha8Rng::seed_from_u64(config.seed);
        let truth: Vec<Pose> = (0..config.poses).map(|node| pose_on_field(config, node)).collect();
        let mut edges: Vec<Edge> = ends(config)
            .into_iter()
            .map(|(from, to, kind)| measure(config, &mut random, from, to, truth[from].inverse() * truth[to], kind))
            .collect();
        let mut start = vec![truth[0]];
        for edge in &edges[..config.poses - 1] {
            let mut next = start[edge.from] * edge.from_from_to;
            next.rotation.renormalize();
            start.push(next);
        }
        let first_false = edges.len();
        add_false(config, &mut random, &truth, &mut edges);
        Ok(Self { truth, start, edges, first_false })
    }

    /// The graph of the survey, poses at their start.
    ///
    /// # Errors
    /// The first field of the graph's settings out of range.
    pub fn graph(&self, config: PoseGraphConfig) -> Result<PoseGraph, ConfigError> {
        let mut graph = PoseGraph::new(config)?;
        self.start.iter().for_each(|pose| {
            graph.add_node(*pose);
        });
        for edge in &self.edges {
            // The generator's own edges are sound: their nodes exist and their information is diagonal and positive.
            let added = graph.add_edge(edge.clone());
            debug_assert!(added.is_ok(), "{added:?}");
        }
        Ok(graph)
    }
}

/// Where the robot truly is: to and fro along the lanes, over hills of half a metre, tilted by them.
fn pose_on_field(config: &SurveyConfig, node: usize) -> Pose {
    let (lane, along) = (node / config.poses_per_lane, node % config.poses_per_lane);
    let is_back = lane % 2 == 1;
    let place = if is_back { config.poses_per_lane - 1 - along } else { along };
    let (x, y) = (place as f64 * config.spacing_m, lane as f64 * config.lane_distance_m);
    let height = 0.5 * ((0.05 * x).sin() + (0.07 * y).cos());
    let (pitch, roll) = (-(0.025 * (0.05 * x).cos()).atan(), (-0.035 * (0.07 * y).sin()).atan());
    let heading = if is_back { std::f64::consts::PI } else { 0.0 } + 0.05 * (0.9 * node as f64).sin();
    let turn = |axis: Vector3<f64>, angle| UnitQuaternion::from_scaled_axis(axis * angle);
    let rotation = turn(Vector3::x(), roll) * turn(Vector3::y(), pitch) * turn(Vector3::z(), heading);
    Pose::from_parts(Vector3::new(x, y, height).into(), rotation)
}

/// The ends of the true edges.
fn ends(config: &SurveyConfig) -> Vec<(usize, usize, EdgeKind)> {
    let (count, lane) = (config.poses, config.poses_per_lane);
    let chain = (1..count).map(|node| (node - 1, node, EdgeKind::Sequential));
    let overlaps = (2..count).map(|node| (node - 2, node, EdgeKind::Overlap));
    // The pose beside it on the lane before, and those beyond, as long as more edges are asked for.
    let beside = (0..lane).flat_map(move |aside| {
        (lane..count).filter_map(move |node| {
            let mirrored = node / lane * lane - 1 - node % lane;
            Some((mirrored.checked_sub(aside)?, node, EdgeKind::LoopClosure))
        })
    });
    chain.chain(overlaps).chain(beside).take(config.edges).collect()
}

/// A measurement of the motion with noise.
fn measure(
    config: &SurveyConfig,
    random: &mut ChaCha8Rng,
    from: usize,
    to: usize,
    from_from_to: Pose,
    kind: EdgeKind,
) -> Edge {
    let sigmas = Twist::from_fn(|k, _| if k < 3 { config.sigma_m } else { config.sigma_rotation });
    let noise = Twist::from_fn(|k, _| {
        let value: f64 = StandardNormal.sample(random);
        sigmas[k] * value
    });
    let mut measured = from_from_to * exp(&noise);
    measured.rotation.renormalize();
    let information = Matrix6::from_diagonal(&sigmas.map(|sigma| 1.0 / (sigma * sigma)));
    Edge { from, to, from_from_to: measured, information, kind }
}

/// Appends the false closures: places far from each other taken for neighbours, metres and tens of degrees wrong.
fn add_false(config: &SurveyConfig, random: &mut ChaCha8Rng, truth: &[Pose], edges: &mut Vec<Edge>) {
    let closures = edges.iter().filter(|edge| edge.kind == EdgeKind::LoopClosure).count() as f64;
    let wanted = (closures * config.false_share / (1.0 - config.false_share)).round() as usize + edges.len();
    let mut uniform = |low: f64, high: f64| Uniform::new(low, high).map_or(low, |range| range.sample(random));
    let mut drawn = Vec::new();
    let pair = 1 + usize::from(config.false_pairs);
    while edges.len() + drawn.len() < wanted {
        let most = (truth.len() - pair) as f64;
        let (a, b) = (uniform(0.0, most) as usize, uniform(0.0, most) as usize);
        if a.abs_diff(b) < 10 {
            continue;
        }
        // Where `b` seems to be: beside `a`.
        let beside = exp(&Twist::from_fn(|k, _| if k < 3 { uniform(-3.0, 3.0) } else { uniform(-0.3, 0.3) }));
        let seeming = truth[a] * beside * truth[b].inverse();
        for k in 0..pair {
            drawn.push((a + k, b + k, truth[a + k].inverse() * seeming * truth[b + k]));
        }
    }
    for (from, to, motion) in drawn {
        let edge = measure(config, random, from, to, motion, EdgeKind::LoopClosure);
        edges.push(edge);
    }
}
