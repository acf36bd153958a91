//! The surface of a scan without an order: normals, areas and qualities from each point's nearest neighbours.

use super::config::SurfaceConfig;
use super::neighbours::{Entry, NeighbourList, Search, Tree};
use super::quality::{QualityScale, incidence_quality};
use super::view::{Surface, SurfacePoint};
use crate::scan::Point;
use crate::threads::for_blocks2;

/// Fewer neighbours than this span no plane.
const NEIGHBOURS_MIN: usize = 3;

/// Neighbours whose second variance is below this share of the first lie on a line, which has no normal.
const LINE_SHARE: f64 = 1e-3;

/// Buffers of the search, reused from scan to scan.
#[derive(Debug, Default)]
pub(super) struct Cloud {
    tree: Tree,
    slot_points: Vec<SurfacePoint>,
}

impl Cloud {
    /// Fills `surface` for the points of a scan without an order.
    pub(super) fn build(&mut self, points: &[Point], config: &SurfaceConfig, surface: &mut Surface) {
        let least = config.range_min_m as f32;
        let is_used = |p: &Point| p.is_return() && p.range() >= least;
        self.tree.rebuild(
            points
                .iter()
                .enumerate()
                .filter(|(_, p)| is_used(p))
                .map(|(index, p)| Entry { position: [p.x, p.y, p.z], index: index as u32 }),
        );
        let used = self.tree.entries.len();
        self.slot_points.resize(used, SurfacePoint::default());
        surface.lists.resize(used, NeighbourList::default());
        let (tree, fit) = (&self.tree, PlaneFit::new(config));
        // In the tree's order the neighbours of consecutive points lie together in memory.
        for_blocks2(&mut self.slot_points, &mut surface.lists, 1, config.threads, |first, points, lists| {
            let mut search = Search::new(config.neighbours);
            for (offset, (point, list)) in points.iter_mut().zip(lists).enumerate() {
                let slot = first + offset;
                search.radius2 = fit.radius2(&tree.entries[slot].position);
                tree.nearest(slot, &mut search);
                *list = NeighbourList::of_slots(search.slots(), &tree.entries);
                *point = fit.point(tree, slot, &search);
            }
        });
        surface.points.fill(SurfacePoint::default());
        surface.list_of_point.clear();
        surface.list_of_point.resize(points.len(), u32::MAX);
        for (slot, (entry, point)) in self.tree.entries.iter().zip(&self.slot_points).enumerate() {
            surface.points[entry.index as usize] = *point;
            surface.list_of_point[entry.index as usize] = slot as u32;
        }
    }
}

/// Fits a plane to a neighbourhood.
struct PlaneFit {
    radius: f32,
    radius_per_m: f32,
    quality: QualityScale,
}

impl PlaneFit {
    fn new(config: &SurfaceConfig) -> Self {
        let (radius, radius_per_m) = (config.neighbour_radius_m as f32, config.neighbour_radius_per_m as f32);
        Self { radius, radius_per_m, quality: QualityScale::new(config) }
    }

    fn radius2(&self, p: &[f32; 3]) -> f32 {
        let radius = self.radius + self.radius_per_m * norm(p);
        radius * radius
    }

    /// The geometry of the point in `slot`; none when its neighbours are too few or on a line.
    fn point(&self, tree: &Tree, slot: usize, search: &Search) -> SurfacePoint {
        let centre = tree.entries[slot].position;
        if search.slots().len() < NEIGHBOURS_MIN {
            return SurfacePoint::default();
        }
        let offsets = search.slots().iter().map(|s| {
            let p = tree.entries[*s as usize].position;
            [0, 1, 2].map(|axis| f64::from(p[axis] - centre[axis]))
        });
        let Some(mut normal) = plane_normal(offsets) else { return SurfacePoint::default() };
        if normal[0] * centre[0] + normal[1] * centre[1] + normal[2] * centre[2] > 0.0 {
            normal = normal.map(|c| -c);
        }
        let range = norm(&centre);
        let incidence = incidence_quality(centre.map(|c| c / range), normal);
        let area = area_share(search.distances2());
        SurfacePoint { normal, incidence, area, quality: self.quality.of(area, incidence) }
    }
}

fn norm(p: &[f32; 3]) -> f32 {
    (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt()
}

/// The share of the surface of a point with neighbours at these squared distances [m^2]: k points spread evenly over a
/// disc have a mean distance of two thirds of its radius, and the disc is shared with the point itself.
fn area_share(distances2: &[f32]) -> f32 {
    let count = distances2.len() as f32;
    let mean = distances2.iter().map(|d| d.sqrt()).sum::<f32>() / count;
    let radius = 1.5 * mean;
    std::f32::consts::PI * radius * radius / (count + 1.0)
}

/// The unit normal of the plane through points at these offsets from a point that is one of them: the direction of
/// least variance. `None` when they lie on a line or on one spot.
fn plane_normal(offsets: impl Iterator<Item = [f64; 3]>) -> Option<[f32; 3]> {
    let (mut sum, mut products, mut count) = ([0.0; 3], [0.0; 6], 1.0);
    for [x, y, z] in offsets {
        for (total, value) in sum.iter_mut().zip([x, y, z]) {
            *total += value;
        }
        for (total, value) in products.iter_mut().zip([x * x, x * y, x * z, y * y, y * z, z * z]) {
            *total += value;
        }
        count += 1.0;
    }
    let [mx, my, mz] = sum.map(|s| s / count);
    let central = [mx * mx, mx * my, mx * mz, my * my, my * mz, mz * mz];
    let c: [f64; 6] = std::array::from_fn(|i| products[i] / count - central[i]);
    let [least, middle, most] = eigenvalues(&c)?;
    if middle <= LINE_SHARE * most || most <= 0.0 {
        return None;
    }
    eigenvector(&c, least)
}

/// The eigenvalues of the symmetric matrix xx, xy, xz, yy, yz, zz, rising, by the trigonometric solution of its cubic.
fn eigenvalues(c: &[f64; 6]) -> Option<[f64; 3]> {
    let [xx, xy, xz, yy, yz, zz] = *c;
    let mean = (xx + yy + zz) / 3.0;
    let off = xy * xy + xz * xz + yz * yz;
    let (dx, dy, dz) = (xx - mean, yy - mean, zz - mean);
    let spread = ((dx * dx + dy * dy + dz * dz + 2.0 * off) / 6.0).sqrt();
    if !(spread > 0.0 && spread.is_finite()) {
        return None;
    }
    let determinant = dx * (dy * dz - yz * yz) - xy * (xy * dz - yz * xz) + xz * (xy * yz - dy * xz);
    let angle = (determinant / (2.0 * spread * spread * spread)).clamp(-1.0, 1.0).acos() / 3.0;
    let most = mean + 2.0 * spread * angle.cos();
    let least = mean + 2.0 * spread * (angle + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    Some([least, 3.0 * mean - most - least, most])
}

/// The unit eigenvector of a simple eigenvalue: the largest cross product of two rows of C - lambda I.
fn eigenvector(c: &[f64; 6], lambda: f64) -> Option<[f32; 3]> {
    let [xx, xy, xz, yy, yz, zz] = *c;
    let rows = [[xx - lambda, xy, xz], [xy, yy - lambda, yz], [xz, yz, zz - lambda]];
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let square = |v: &[f64; 3]| v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let candidates = [cross(rows[0], rows[1]), cross(rows[0], rows[2]), cross(rows[1], rows[2])];
    let best = candidates.into_iter().fold([0.0; 3], |best, v| if square(&v) > square(&best) { v } else { best });
    let length = square(&best).sqrt();
    (length > 0.0).then(|| best.map(|v| (v / length) as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_eigenvalues_are_those_of_the_library(v in prop::array::uniform6(-2.0..2.0f64)) {
            let m = Matrix3::new(v[0], v[1], v[2], v[1], v[3], v[4], v[2], v[4], v[5]);
            let mut theirs: Vec<f64> = m.symmetric_eigenvalues().iter().copied().collect();
            theirs.sort_by(f64::total_cmp);
            if let Some(ours) = eigenvalues(&v) {
                for (a, b) in ours.iter().zip(&theirs) { prop_assert!((a - b).abs() < 1e-6, "{ours:?} {theirs:?}"); }
            }
        }

        #[test]
        fn the_normal_of_points_on_a_plane_is_the_planes(n in prop::array::uniform3(-1.0..1.0f64), uv in prop::collection::vec((-1.0..1.0f64, -1.0..1.0f64), 8..12)) {
            let n = Vector3::from(n);
            prop_assume!(n.norm() > 0.1);
            let n = n.normalize();
            let u = n.cross(&if n.x.abs() < 0.5 { Vector3::x() } else { Vector3::y() }).normalize();
            let v = n.cross(&u);
            if let Some(found) = plane_normal(uv.iter().map(|(a, b)| (u * *a + v * *b).into())) {
                prop_assert!(Vector3::from(found.map(f64::from)).dot(&n).abs() > 0.9999);
            }
        }
    }

    #[test]
    fn points_on_a_line_have_no_normal() {
        assert_eq!(plane_normal((0..8).map(|k| [f64::from(k), 2.0 * f64::from(k), 0.0])), None);
        assert_eq!(plane_normal((0..8).map(|_| [0.0; 3])), None);
    }

    #[test]
    fn the_share_of_a_point_of_a_square_lattice_is_about_one_square() {
        let root = 2f32.sqrt();
        let distances = [1.0, 1.0, 1.0, 1.0, root, root, root, root, 2.0, 2.0, 2.0, 2.0];
        let share = area_share(&distances.map(|d: f32| d * d));
        assert!((share - 1.0).abs() < 0.25, "{share}");
    }
}
