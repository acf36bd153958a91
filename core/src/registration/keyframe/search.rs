//! The nearest centroid, by the voxels around a query.

use super::voxels::{Brick, Voxels, floor};
use super::windows::window;

/// The brick in which the last query fell: most often also that of the next.
#[derive(Debug, Clone, Copy)]
pub(in crate::registration) struct LastBrick {
    place: [i32; 3],
    number: u32,
}

impl Default for LastBrick {
    fn default() -> Self {
        Self { place: [i32::MIN; 3], number: Voxels::NOWHERE }
    }
}

impl LastBrick {
    /// The number of the brick; past the end of all when there is none.
    pub fn number(&self) -> u32 {
        self.number
    }
}

/// The nearest centroid so far.
struct Best {
    index: u32,
    distance_sq: f32,
}

impl Voxels {
    /// The index and squared distance [m^2] of the centroid nearest to `query` among those closer than
    /// `sqrt(bound_sq)`. Of centroids at the same distance it returns the same one every time.
    #[inline(always)]
    pub fn nearest(
        &self,
        points: &[[f32; 3]],
        query: [f32; 3],
        bound_sq: f32,
        last: &mut LastBrick,
    ) -> Option<(u32, f32)> {
        let mut best = Best { index: u32::MAX, distance_sq: bound_sq };
        let cell =
            [floor(query[0] * self.per_metre), floor(query[1] * self.per_metre), floor(query[2] * self.per_metre)];
        let place = [cell[0] >> 2, cell[1] >> 2, cell[2] >> 2];
        if place != last.place {
            *last = LastBrick { place, number: self.number_at(place) };
        }
        // The voxel the query falls into mostly holds something near, which narrows the search to few others.
        if let Some(brick) = self.bricks.get(last.number as usize) {
            let bit = 1_u64 << ((cell[0] & 3) | (cell[1] & 3) << 2 | (cell[2] & 3) << 4);
            if brick.mask & bit != 0 {
                best.offer(points, query, brick.voxel(bit));
            }
        }
        let near = self.voxel_m * self.voxel_m;
        if best.index == u32::MAX && near < bound_sq {
            // Most others have a partner within a voxel's edge, and then nothing beyond needs a look.
            best.distance_sq = near;
            self.look(points, query, last, &mut best);
            if best.index == u32::MAX {
                best.distance_sq = bound_sq;
                self.look(points, query, last, &mut best);
            }
        } else {
            self.look(points, query, last, &mut best);
        }
        (best.index != u32::MAX).then_some((best.index, best.distance_sq))
    }

    /// Looks at every voxel that may hold something closer.
    #[inline(always)]
    fn look(&self, points: &[[f32; 3]], query: [f32; 3], last: &LastBrick, best: &mut Best) {
        let reach = best.distance_sq.sqrt();
        let (mut low, mut high) = ([0; 3], [0; 3]);
        for k in 0..3 {
            low[k] = floor((query[k] - reach) * self.per_metre);
            high[k] = floor((query[k] + reach) * self.per_metre);
        }
        for z in low[2] >> 2..=high[2] >> 2 {
            for y in low[1] >> 2..=high[1] >> 2 {
                for x in low[0] >> 2..=high[0] >> 2 {
                    let number = if [x, y, z] == last.place { last.number } else { self.number_at([x, y, z]) };
                    if let Some(brick) = self.bricks.get(number as usize) {
                        look_into(brick, points, query, low, high, best);
                    }
                }
            }
        }
    }
}

impl Best {
    #[inline(always)]
    fn offer(&mut self, points: &[[f32; 3]], query: [f32; 3], index: u32) {
        let point = points[index as usize];
        let (x, y, z) = (query[0] - point[0], query[1] - point[1], query[2] - point[2]);
        let distance_sq = x * x + y * y + z * z;
        if distance_sq < self.distance_sq {
            *self = Self { index, distance_sq };
        }
    }
}

#[inline(always)]
fn look_into(brick: &Brick, points: &[[f32; 3]], query: [f32; 3], low: [i32; 3], high: [i32; 3], best: &mut Best) {
    let (mut from, mut to) = ([0; 3], [0; 3]);
    for k in 0..3 {
        from[k] = low[k].wrapping_sub(4 * brick.place[k]);
        to[k] = high[k].wrapping_sub(4 * brick.place[k]);
    }
    let mut rest = brick.mask & window(from, to);
    while rest != 0 {
        let bit = rest & rest.wrapping_neg();
        best.offer(points, query, brick.voxel(bit));
        rest ^= bit;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::registration::PreparationConfig;
    use crate::registration::keyframe::voxels::thin;
    use crate::scan::{Point, ScanView};

    proptest! {
        #[test]
        fn it_finds_what_looking_at_every_centroid_finds(
            points in prop::collection::vec(prop::array::uniform3(-4.0f32..4.0), 1..300),
            queries in prop::collection::vec(prop::array::uniform3(-5.0f32..5.0), 1..40),
            bound in 0.01f32..3.0,
        ) {
            let points: Vec<Point> = points.iter().map(|p| Point::new(p[0], p[1], p[2])).collect();
            let config = PreparationConfig { min_range_m: 0.0, ..PreparationConfig::default() };
            let thinned = thin(ScanView::unordered(&points), &config);
            let centroids = thinned.centroids();
            let mut last = LastBrick::default();
            for query in queries {
                let found = thinned.voxels.nearest(&centroids, query, bound * bound, &mut last).map(|found| found.1);
                let distances = centroids.iter().map(|c| (0..3).map(|k| (query[k] - c[k]).powi(2)).sum::<f32>());
                let expected = distances.filter(|d| *d < bound * bound).min_by(f32::total_cmp);
                prop_assert_eq!(found.is_some(), expected.is_some());
                if let (Some(found), Some(expected)) = (found, expected) {
                    prop_assert!((found - expected).abs() < 1e-5, "{} {}", found, expected);
                }
            }
        }
    }
}
