//! Keypoints and what surrounds them, described so that neither place nor direction of the scanner matters.

use std::f32::consts::PI;

use nalgebra::Vector3;

use super::GlobalConfig;
use super::neighbourhood::Neighbourhoods;
use crate::registration::coarse::CoarseScan;
use crate::threads;

/// Bins of each of the three angles.
const BINS: usize = 11;
/// Length of a descriptor.
pub(super) const LENGTH: usize = 3 * BINS;
/// Points a thread works on at a time.
const BLOCK: usize = 128;
/// A point with fewer neighbours is not described.
const LEAST_NEIGHBOURS: usize = 8;

/// How the surface turns about a point.
pub(super) type Descriptor = [f32; LENGTH];

/// The keypoints of a scan: those whose surroundings differ most from the scan's average, so that a plane has none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Features {
    /// Positions [m, scanner frame].
    pub(super) points: Vec<[f32; 3]>,
    /// Unit normals.
    pub(super) normals: Vec<[f32; 3]>,
    /// Descriptors.
    pub(super) descriptors: Vec<Descriptor>,
}

impl Features {
    /// Describes a scan: fast point feature histograms (Rusu et al. 2009) over the points of its cubes.
    #[must_use]
    pub fn new(scan: &CoarseScan, config: &GlobalConfig) -> Self {
        let (points, normals) = (scan.points(), scan.normals());
        let neighbourhoods = Neighbourhoods::new(points, config.feature_radius_m as f32);
        let simple = for_every(points.len(), config.threads, |index, neighbours: &mut Vec<(u32, f32)>| {
            neighbourhoods.find(index, neighbours);
            simple_histogram(points, normals, index, neighbours)
        });
        let full = for_every(points.len(), config.threads, |index, neighbours: &mut Vec<(u32, f32)>| {
            neighbourhoods.find(index, neighbours);
            full_histogram(&simple, index, neighbours)
        });
        let chosen = most_distinctive(&full, config.keypoints);
        let of = |index: &u32| *index as usize;
        Self {
            points: chosen.iter().map(|index| points[of(index)]).collect(),
            normals: chosen.iter().map(|index| normals[of(index)]).collect(),
            descriptors: chosen.iter().filter_map(|index| full[of(index)]).collect(),
        }
    }

    /// The number of keypoints.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the scan has none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The memory it holds [bytes]: 156 a keypoint.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.points.capacity() * (2 * size_of::<[f32; 3]>() + size_of::<Descriptor>())
    }
}

/// `work` for every index, each thread with a buffer of its own.
fn for_every<T: Send + Clone, B: Default>(
    count: usize,
    threads: usize,
    work: impl Fn(usize, &mut B) -> Option<T> + Sync,
) -> Vec<Option<T>> {
    let mut results = vec![None; count];
    threads::for_each(results.chunks_mut(BLOCK).enumerate(), threads, |(block, results)| {
        let mut buffer = B::default();
        for (offset, result) in results.iter_mut().enumerate() {
            *result = work(block * BLOCK + offset, &mut buffer);
        }
    });
    results
}

/// The angles between a point's normal and its neighbours', counted; `None` without normal or neighbours.
fn simple_histogram(
    points: &[[f32; 3]],
    normals: &[[f32; 3]],
    index: usize,
    neighbours: &[(u32, f32)],
) -> Option<Descriptor> {
    let (point, normal) = (Vector3::from(points[index]), Vector3::from(normals[index]));
    if normal == Vector3::zeros() {
        return None;
    }
    let mut histogram = [0.0_f32; LENGTH];
    let mut count = 0_u32;
    for (other, distance) in neighbours {
        let other_normal = Vector3::from(normals[*other as usize]);
        if other_normal == Vector3::zeros() || *distance < 1e-3 {
            continue;
        }
        let direction = (Vector3::from(points[*other as usize]) - point) / *distance;
        let Some(v) = normal.cross(&direction).try_normalize(1e-4) else { continue };
        let w = normal.cross(&v);
        let angles = [
            0.5 * (v.dot(&other_normal) + 1.0),
            0.5 * (normal.dot(&direction) + 1.0),
            w.dot(&other_normal).atan2(normal.dot(&other_normal)) / (2.0 * PI) + 0.5,
        ];
        for (k, angle) in angles.into_iter().enumerate() {
            histogram[k * BINS + ((angle * BINS as f32).max(0.0) as usize).min(BINS - 1)] += 1.0;
        }
        count += 1;
    }
    (count as usize >= LEAST_NEIGHBOURS).then(|| histogram.map(|h| h / count as f32))
}

/// A point's own histogram and its neighbours', the nearer the heavier; each angle's bins sum to one.
fn full_histogram(simple: &[Option<Descriptor>], index: usize, neighbours: &[(u32, f32)]) -> Option<Descriptor> {
    let own = simple[index]?;
    let mut around = [0.0_f32; LENGTH];
    let mut weights = 0.0;
    for (other, distance) in neighbours {
        let Some(histogram) = &simple[*other as usize] else { continue };
        let weight = 1.0 / distance.max(0.1);
        weights += weight;
        for (sum, value) in around.iter_mut().zip(histogram) {
            *sum += weight * value;
        }
    }
    if weights == 0.0 {
        return None;
    }
    // The root of a histogram compares by the Hellinger distance, under which rare bins count.
    Some(std::array::from_fn(|k| (0.5 * (own[k] + around[k] / weights)).sqrt()))
}

/// The indices, ascending, of up to `most` points whose descriptors are farthest from the average one.
fn most_distinctive(descriptors: &[Option<Descriptor>], most: usize) -> Vec<u32> {
    let mut mean = [0.0_f64; LENGTH];
    let count = descriptors.iter().flatten().count().max(1) as f64;
    for descriptor in descriptors.iter().flatten() {
        for (sum, value) in mean.iter_mut().zip(descriptor) {
            *sum += f64::from(*value) / count;
        }
    }
    let mean = mean.map(|m| m as f32);
    let mut ranked: Vec<(f32, u32)> = descriptors
        .iter()
        .enumerate()
        .filter_map(|(index, descriptor)| Some((distance_sq(descriptor.as_ref()?, &mean), index as u32)))
        .collect();
    ranked.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    ranked.truncate(most);
    let mut chosen: Vec<u32> = ranked.into_iter().map(|(_, index)| index).collect();
    chosen.sort_unstable();
    chosen
}

/// The squared distance of two descriptors.
#[inline]
pub(super) fn distance_sq(a: &Descriptor, b: &Descriptor) -> f32 {
    // Lanes summed apart, so that the loop runs side by side whatever the order of additions.
    let mut lanes = [0.0_f32; BINS];
    for k in 0..3 {
        for lane in 0..BINS {
            let difference = a[k * BINS + lane] - b[k * BINS + lane];
            lanes[lane] += difference * difference;
        }
    }
    lanes.iter().sum()
}
