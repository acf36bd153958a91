//! The tangent plane of every voxel, from the returns in it and around it: sums over neighbours, no search.

use nalgebra::Vector3;

use super::moments::Moments;
use super::voxels::{Brick, Voxels, bits};
use super::windows::window;
use crate::{simd, threads};

/// Bricks a thread works on at a time.
const BLOCK: usize = 64;
/// The middle eigenvalue must be at least this share of the largest, or the returns lie on a line, about which the
/// plane could turn freely.
const LEAST_WIDTH: f32 = 0.02;
/// Fewer returns than this give no plane.
const LEAST_RETURNS: f32 = 6.0;
/// How many voxels around a voxel count, tried in this order until its returns span a plane.
const REACHES: [i32; 2] = [1, 2];
/// A scanner is behind a plane when it lies so far on its other side, as a share of its distance from the point there: at a
/// smaller angle the plane's direction is not known well enough.
const BEHIND: f32 = 0.1;

/// The plane through the returns around a voxel's centroid: `normal . x = offset`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(in crate::registration) struct Plane {
    /// Unit normal towards the scanner; zero where there is no plane.
    pub normal: [f32; 3],
    /// The distance of the plane from the scanner along the normal [m].
    pub offset: f32,
    /// The mean squared distance of the returns from it [m^2].
    pub variance: f32,
}

impl Plane {
    /// Whether a second scanner stands behind the plane that the first, at the origin, has seen at `point`: then what it sees there
    /// is the other side of something thin, as a wall or a car, and no pair. Along streets these are many, and pull scans together
    /// by the thickness of the walls. `arm` leads from the second scanner to what it sees there.
    #[inline(always)]
    pub(in crate::registration) fn is_seen_from_behind(
        &self,
        point: &[f32; 3],
        scanner: &[f32; 3],
        arm: &[f32; 3],
    ) -> bool {
        let square = |v: &[f32; 3]| v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
        let [x, y, z] = *scanner;
        let second = self.normal[0] * x + self.normal[1] * y + self.normal[2] * z - self.offset;
        let is_clear = |distance: f32, to_point: f32| distance * distance > BEHIND * BEHIND * to_point;
        second < 0.0 && is_clear(second, square(arm)) && is_clear(self.offset, square(point))
    }
}

/// The planes of all voxels, under their indices.
pub(super) fn fit(voxels: &Voxels, moments: &[Moments], threads: usize) -> Vec<Plane> {
    let mut planes = vec![Plane::default(); moments.len()];
    let bricks = &voxels.bricks;
    let mut parts = Vec::with_capacity(bricks.len().div_ceil(BLOCK));
    let mut rest = planes.as_mut_slice();
    for block in bricks.chunks(BLOCK) {
        let count = block.iter().map(|b| b.mask.count_ones() as usize).sum();
        let (own, others) = rest.split_at_mut(count);
        parts.push((block, own));
        rest = others;
    }
    let most = threads.min(parts.len());
    threads::for_each(parts.into_iter(), most, |(block, planes)| {
        simd::widest(|| fit_block(voxels, moments, block, planes));
    });
    planes
}

/// The planes of the voxels of some bricks.
#[inline(always)]
fn fit_block(voxels: &Voxels, moments: &[Moments], block: &[Brick], planes: &mut [Plane]) {
    let mut planes = planes.iter_mut();
    for brick in block {
        let around = Around::new(voxels, moments, brick);
        for (index, plane) in bits(brick.mask).zip(planes.by_ref()) {
            *plane = around.plane(index).unwrap_or_default();
        }
    }
}

/// A brick and its 26 neighbours.
struct Around<'a> {
    moments: &'a [Moments],
    centre: [f32; 3],
    bricks: [Option<&'a Brick>; 27],
    brick_m: f32,
}

impl<'a> Around<'a> {
    #[inline(always)]
    fn new(voxels: &'a Voxels, moments: &'a [Moments], brick: &'a Brick) -> Self {
        let mut bricks = [None; 27];
        for (k, found) in bricks.iter_mut().enumerate() {
            let step = step_of(k);
            let place = [brick.place[0] + step[0], brick.place[1] + step[1], brick.place[2] + step[2]];
            *found = if k == 13 { Some(brick) } else { voxels.brick_at(place) };
        }
        Self { moments, centre: voxels.centre(brick), bricks, brick_m: Voxels::brick_m(voxels) }
    }

    /// The plane about one of the brick's voxels.
    #[inline(always)]
    fn plane(&self, index: u32) -> Option<Plane> {
        let cell = [(index & 3) as i32, (index >> 2 & 3) as i32, (index >> 4) as i32];
        REACHES.iter().find_map(|reach| self.plane_of(&self.sum(cell, *reach))).or_else(|| self.plane_of(&self.all()))
    }

    /// The returns up to `reach` voxels away, about the centre of the brick.
    #[inline(always)]
    fn sum(&self, cell: [i32; 3], reach: i32) -> Moments {
        let mut total = Moments::default();
        let (mut low, mut high) = ([0; 3], [0; 3]);
        for k in 0..3 {
            (low[k], high[k]) = ((cell[k] - reach) >> 2, (cell[k] + reach) >> 2);
        }
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let Some(brick) = self.bricks[((x + 1) + 3 * (y + 1) + 9 * (z + 1)) as usize] else { continue };
                    let step = [x, y, z];
                    let (mut from, mut to) = ([0; 3], [0; 3]);
                    for k in 0..3 {
                        (from[k], to[k]) = (cell[k] - reach - 4 * step[k], cell[k] + reach - 4 * step[k]);
                    }
                    let mut part = Moments::default();
                    let mut rest = brick.mask & window(from, to);
                    while rest != 0 {
                        let bit = rest & rest.wrapping_neg();
                        part.merge(&self.moments[brick.voxel(bit) as usize]);
                        rest ^= bit;
                    }
                    if step == [0; 3] {
                        total.merge(&part);
                    } else {
                        let along = |k: usize| step[k] as f32 * self.brick_m;
                        total.merge(&part.shifted([along(0), along(1), along(2)]));
                    }
                }
            }
        }
        total
    }

    /// All returns of the brick and its neighbours.
    fn all(&self) -> Moments {
        self.sum([2, 2, 2], 4)
    }

    /// The plane through a set of returns.
    #[inline(always)]
    fn plane_of(&self, moments: &Moments) -> Option<Plane> {
        if moments.count < LEAST_RETURNS {
            return None;
        }
        let spread = moments.spread();
        let ([least, ..], normal) = spread.least_direction(LEAST_WIDTH)?;
        let offset = normal.dot(&(Vector3::from(self.centre) + Vector3::from(spread.mean)));
        let sign = if offset > 0.0 { -1.0 } else { 1.0 };
        Some(Plane { normal: (normal * sign).into(), offset: offset * sign, variance: least })
    }
}

/// The steps to the bricks around, x fastest.
fn step_of(k: usize) -> [i32; 3] {
    [(k % 3) as i32 - 1, (k / 3 % 3) as i32 - 1, (k / 9) as i32 - 1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::PreparationConfig;
    use crate::registration::keyframe::voxels::thin;
    use crate::scan::{Point, ScanView};

    fn planes(points: &[Point], threads: usize) -> Vec<Plane> {
        let thinned = thin(ScanView::unordered(points), &PreparationConfig::default());
        fit(&thinned.voxels, &thinned.moments, threads)
    }

    #[test]
    fn a_tilted_wall_has_its_plane_everywhere_and_towards_the_scanner() {
        let normal = Vector3::new(-0.6_f32, 0.0, 0.8);
        let (along, across) = (Vector3::new(0.8, 0.0, 0.6), Vector3::y());
        let points: Vec<Point> = (0..40_000)
            .map(|k| normal * -7.0 + along * ((k % 200) as f32 * 0.05 - 5.0) + across * ((k / 200) as f32 * 0.05 - 5.0))
            .map(|p| Point::new(p.x, p.y, p.z))
            .collect();
        for plane in planes(&points, 2) {
            assert!((Vector3::from(plane.normal) - normal).norm() < 1e-3, "{plane:?}");
            assert!((plane.offset + 7.0).abs() < 1e-3 && plane.variance < 1e-6, "{plane:?}");
        }
    }

    #[test]
    fn sparse_returns_take_their_plane_from_farther_away_and_a_wire_has_none() {
        let floor: Vec<Point> =
            (0..900).map(|k| Point::new((k % 30) as f32 * 0.7 - 10.0, (k / 30) as f32 * 0.7 - 10.0, -1.0)).collect();
        let up = planes(&floor, 1).iter().filter(|p| p.normal[2] > 0.999).count();
        assert!(up > 850, "{up}");
        let wire: Vec<Point> = (0..400).map(|k| Point::new(5.0, k as f32 * 0.02, 1.0)).collect();
        assert!(planes(&wire, 1).iter().all(|p| *p == Plane::default()));
    }

    #[test]
    fn any_number_of_threads_fits_the_same_planes() {
        let points: Vec<Point> = (0..20_000)
            .map(|k| k as f32 * 0.37)
            .map(|t| Point::new(8.0 * t.sin(), 8.0 * (1.7 * t).cos(), (0.3 * t).sin()))
            .collect();
        let expected = planes(&points, 1);
        for threads in [2, 3, 8] {
            assert_eq!(planes(&points, threads), expected);
        }
    }
}
