//! A frame against the local map: pair each point with a plane, step, until the steps are small.

use nalgebra::{UnitQuaternion, Vector3};

use super::OdometryConfig;
use super::local_map::{LocalMap, LocalPose};
use super::system::{LANES, PairBlock, System};
use crate::geometry::{Pose, Twist};
use crate::registration::{Constraint, floor};
use crate::simd;

/// Blocks of pairs summed in single precision at a time. (A pass over all points takes about as long as starting a
/// thread, so it stays on one; threads share out whole alignments, and the map.)
const BLOCKS_A_RUN: usize = 64;
/// Fewer pairs than this give no step.
const LEAST_PAIRS: f64 = 20.0;
/// The kernel narrows by this factor once a step moves points by less than a share of its scale.
const NARROWING: f32 = 0.5;
const SETTLED_SHARE: f64 = 0.2;

/// The resolution at which points are paired.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Resolution {
    /// Coarse voxels only: planes are met from metres away.
    Coarse,
    /// Fine voxels, and coarse ones where the fine have no plane.
    Fine,
}

/// How one alignment goes about it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Schedule {
    pub resolution: Resolution,
    /// Scale of the kernel at the start and at the end [m].
    pub first_scale_m: f32,
    pub last_scale_m: f32,
    pub most_iterations: u32,
}

/// The points of a frame, their partners, and the buffers of their alignment.
#[derive(Debug, Default)]
pub(super) struct Frame {
    blocks: Vec<PairBlock>,
    /// The voxel each point was last paired in.
    voxels: Vec<[[i32; LANES]; 3]>,
    points: usize,
}

/// What an alignment came to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outcome {
    pub map_from_scanner: Pose,
    /// The sums at the pose, at the last scale.
    pub system: System,
    /// In the map's axes.
    pub constraint: Constraint,
    pub iterations: u32,
    pub converged: bool,
    /// The share of the frame's points that fit the map: the mean over all points of the robust fit, 0 without partner.
    pub score: f64,
}

/// Some blocks of a frame, and how many points are in them and behind.
struct Run<'a> {
    blocks: &'a mut [PairBlock],
    voxels: &'a mut [[[i32; LANES]; 3]],
    points: usize,
}

/// A voxel no point lies in.
const UNPAIRED: i32 = i32::MIN;

impl Frame {
    /// Takes the points of a frame over [m, scanner frame].
    pub fn set_points(&mut self, points: impl ExactSizeIterator<Item = [f32; 3]>) {
        self.points = points.len();
        self.blocks.clear();
        self.blocks.resize(self.points.div_ceil(LANES), PairBlock::default());
        for (index, point) in points.enumerate() {
            if let Some(block) = self.blocks.get_mut(index / LANES) {
                for (values, value) in block.point.iter_mut().zip(point) {
                    values[index % LANES] = value;
                }
            }
        }
        self.voxels.clear();
        self.voxels.resize(self.blocks.len(), [[UNPAIRED; LANES]; 3]);
    }

    /// Takes over about `most` of another frame's points, evenly.
    pub fn set_thinned(&mut self, other: &Self, most: usize) {
        let step = other.points.div_ceil(most.max(1)).max(1);
        let point = |k: usize| {
            let block = other.blocks.get(k * step / LANES);
            block.map_or([0.0; 3], |block| block.point.map(|values| values[k * step % LANES]))
        };
        self.set_points((0..other.points.div_ceil(step)).map(point));
    }

    pub fn points(&self) -> usize {
        self.points
    }

    pub fn bytes(&self) -> usize {
        self.blocks.capacity() * size_of::<PairBlock>() + self.voxels.capacity() * size_of::<[[i32; LANES]; 3]>()
    }

    /// The share of the points that fit the map at a pose, as in [`Outcome`].
    pub fn score(&mut self, map: &LocalMap, pose: &Pose, scale_m: f32) -> f64 {
        self.forget_partners();
        self.pass(map, pose, Resolution::Fine, scale_m).fit / self.points.max(1) as f64
    }

    /// Aligns the frame from a start.
    pub fn align(&mut self, map: &LocalMap, start: &Pose, schedule: &Schedule, config: &OdometryConfig) -> Outcome {
        let threshold = config.constrained_eigenvalue;
        self.forget_partners();
        let mut pose = *start;
        let mut scale = schedule.first_scale_m.max(schedule.last_scale_m);
        let mut iterations = 0;
        let mut converged = false;
        loop {
            let system = self.pass(map, &pose, schedule.resolution, scale);
            let constraint = system.constraint(threshold);
            if converged && scale <= schedule.last_scale_m
                || iterations >= schedule.most_iterations
                || system.pairs < LEAST_PAIRS
            {
                let system = if scale > schedule.last_scale_m {
                    self.pass(map, &pose, schedule.resolution, schedule.last_scale_m)
                } else {
                    system
                };
                let score = system.fit / self.points.max(1) as f64;
                return Outcome { map_from_scanner: pose, system, constraint, iterations, converged, score };
            }
            let step = system.step(&constraint);
            pose = moved(&pose, &step);
            iterations += 1;
            let (shift, turn) = (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm());
            if scale > schedule.last_scale_m {
                if shift + turn * constraint.length_m < SETTLED_SHARE * f64::from(scale) {
                    scale = (scale * NARROWING).max(schedule.last_scale_m);
                }
            } else {
                converged = shift < config.translation_tolerance_m && turn < config.rotation_tolerance;
            }
        }
    }

    /// Points are paired anew in the next pass: after another map, resolution, or points.
    fn forget_partners(&mut self) {
        self.voxels.fill([[UNPAIRED; LANES]; 3]);
    }

    /// Pairs the points at a pose and sums the pairs.
    fn pass(&mut self, map: &LocalMap, pose: &Pose, resolution: Resolution, scale: f32) -> System {
        let local = map.local(pose);
        let runs = self.blocks.chunks_mut(BLOCKS_A_RUN).zip(self.voxels.chunks_mut(BLOCKS_A_RUN));
        let mut total = System::default();
        for (run, (blocks, voxels)) in runs.enumerate() {
            // The last block's padding lies behind all points.
            let points = self.points.saturating_sub(run * BLOCKS_A_RUN * LANES);
            total.merge(&pass_over(&mut Run { blocks, voxels, points }, map, &local, resolution, scale));
        }
        total
    }
}

/// The pose after a motion in the map's axes about the scanner's place.
fn moved(pose: &Pose, step: &Twist) -> Pose {
    let mut next = *pose;
    next.translation.vector += Vector3::new(step[0], step[1], step[2]);
    next.rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5])) * next.rotation;
    next.rotation.renormalize();
    next
}

/// One pass over a run of blocks, on the widest vectors the machine has.
fn pass_over(run: &mut Run<'_>, map: &LocalMap, pose: &LocalPose, resolution: Resolution, scale: f32) -> System {
    simd::widest(|| pass_over_portable(run, map, pose, resolution, scale))
}

#[inline(always)]
fn pass_over_portable(
    run: &mut Run<'_>,
    map: &LocalMap,
    pose: &LocalPose,
    resolution: Resolution,
    scale: f32,
) -> System {
    let level = if resolution == Resolution::Fine { &map.fine } else { &map.coarse };
    let per_metre = level.per_metre();
    for (k, (block, voxels)) in run.blocks.iter_mut().zip(&mut *run.voxels).enumerate() {
        let moved = moved_lanes(block, voxels, pose, per_metre);
        if moved != 0 {
            let filled = run.points.saturating_sub(k * LANES).min(LANES);
            pair(map, pose, resolution, block, voxels, moved, filled);
        }
    }
    System::of(run.blocks, pose, scale)
}

/// Which points of a block have left the voxel in which they were paired: a bit each. Their new voxels are written.
#[inline(always)]
fn moved_lanes(block: &PairBlock, voxels: &mut [[i32; LANES]; 3], pose: &LocalPose, per_metre: f32) -> u32 {
    let [x, y, z] = &block.point;
    let mut differ = [0_i32; LANES];
    for ((r, t), voxels) in pose.rotation.iter().zip(pose.translation).zip(voxels) {
        for l in 0..LANES {
            let place = r[0] * x[l] + r[1] * y[l] + r[2] * z[l] + t;
            let voxel = floor(place * per_metre);
            differ[l] |= voxel ^ voxels[l];
            voxels[l] = voxel;
        }
    }
    let mut moved = 0;
    for (l, differ) in differ.iter().enumerate() {
        moved |= u32::from(*differ != 0) << l;
    }
    moved
}

/// Pairs the points of a block that have moved, of the first `filled`, with the planes at their places.
#[inline(never)]
fn pair(
    map: &LocalMap,
    pose: &LocalPose,
    resolution: Resolution,
    block: &mut PairBlock,
    voxels: &[[i32; LANES]; 3],
    moved: u32,
    filled: usize,
) {
    for l in (0..filled).filter(|l| moved >> l & 1 == 1) {
        let voxel = [voxels[0][l], voxels[1][l], voxels[2][l]];
        let place = pose.transform([block.point[0][l], block.point[1][l], block.point[2][l]]);
        let found = match resolution {
            Resolution::Fine => fine_plane(map, voxel, place),
            Resolution::Coarse => coarse_plane(map, voxel).or_else(|| coarse_plane_nearby(map, voxel, place)),
        };
        let (normal, distance, weight) = found.unwrap_or_default();
        for (values, value) in block.normal.iter_mut().zip(normal) {
            values[l] = value;
        }
        block.distance[l] = distance;
        block.weight[l] = weight;
    }
}

/// Normal, distance from the local origin, weight.
type Plane = ([f32; 3], f32, f32);

/// The plane of the fine voxel at a place, or of the coarse one around it.
fn fine_plane(map: &LocalMap, voxel: [i32; 3], place: [f32; 3]) -> Option<Plane> {
    if let Some(surfel) = map.fine_surfel(voxel).filter(|surfel| surfel.weight > 0.0) {
        return Some(plane(surfel, map.fine.corner(voxel)));
    }
    coarse_plane(map, map.coarse.voxel(place))
}

/// The plane of a coarse voxel.
fn coarse_plane(map: &LocalMap, voxel: [i32; 3]) -> Option<Plane> {
    let surfel = map.coarse_surfel(voxel).filter(|surfel| surfel.weight > 0.0)?;
    Some(plane(surfel, map.coarse.corner(voxel)))
}

/// Of the planes in the six coarse voxels beside a voxel the one whose middle is nearest to a place.
fn coarse_plane_nearby(map: &LocalMap, voxel: [i32; 3], place: [f32; 3]) -> Option<Plane> {
    let mut nearest = f32::INFINITY;
    let mut found = None;
    for k in 0..6 {
        let mut neighbour = voxel;
        neighbour[k / 2] += if k % 2 == 0 { -1 } else { 1 };
        let Some(surfel) = map.coarse_surfel(neighbour).filter(|surfel| surfel.weight > 0.0) else { continue };
        let corner = map.coarse.corner(neighbour);
        let apart = |k: usize| (place[k] - corner[k] - surfel.mean[k]).powi(2);
        let distance_sq = apart(0) + apart(1) + apart(2);
        if distance_sq < nearest {
            nearest = distance_sq;
            found = Some(plane(surfel, corner));
        }
    }
    found
}

fn plane(surfel: &super::surfel::Surfel, corner: [f32; 3]) -> Plane {
    let n = surfel.normal;
    let m = surfel.mean;
    let distance = n[0] * (corner[0] + m[0]) + n[1] * (corner[1] + m[1]) + n[2] * (corner[2] + m[2]);
    (n, distance, surfel.weight)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::test_scenes::{YARD, scan_of};

    /// The yard's map, and a frame of it that is not a whole number of blocks.
    fn yard() -> (LocalMap, Frame) {
        let points = |seed| -> Vec<[f32; 3]> {
            scan_of(&YARD, &Pose::identity(), 30.0, seed).iter().map(|p| [p.x, p.y, p.z]).collect()
        };
        let mut map = LocalMap::new(0.6, 30.0, 5000);
        map.insert(&points(1), &Pose::identity(), 1);
        let mut frame = Frame::default();
        let mut seen = points(2);
        seen.truncate(seen.len() / LANES * LANES - 3);
        frame.set_points(seen.into_iter());
        (map, frame)
    }

    #[test]
    fn wide_vectors_give_the_bits_of_the_portable_ones() {
        let (map, mut frame) = yard();
        let pose = map.local(&Pose::new(Vector3::new(0.1, -0.05, 0.02), Vector3::new(0.01, 0.0, 0.05)));
        for resolution in [Resolution::Fine, Resolution::Coarse] {
            let mut pass = |work: fn(&mut Run<'_>, &LocalMap, &LocalPose, Resolution, f32) -> System| {
                frame.forget_partners();
                let Frame { blocks, voxels, points } = &mut frame;
                work(&mut Run { blocks, voxels, points: *points }, &map, &pose, resolution, 0.3)
            };
            let wide = pass(pass_over);
            assert!(wide.pairs > 1000.0);
            assert_eq!(wide, pass(pass_over_portable));
        }
    }

    #[test]
    fn partners_that_are_kept_are_those_that_would_be_found() {
        let (map, mut frame) = yard();
        let config = OdometryConfig::default();
        let schedule = Schedule {
            resolution: Resolution::Fine,
            first_scale_m: 0.3,
            last_scale_m: 0.1,
            most_iterations: config.max_iterations,
        };
        let start = Pose::new(Vector3::new(0.2, -0.1, 0.0), Vector3::new(0.0, 0.0, 0.03));
        let outcome = frame.align(&map, &start, &schedule, &config);
        assert!(outcome.converged && outcome.map_from_scanner.translation.vector.norm() < 0.01);
        assert_eq!(frame.score(&map, &outcome.map_from_scanner, 0.1), outcome.score);
    }
}
