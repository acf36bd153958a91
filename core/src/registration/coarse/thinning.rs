//! Thinning to one point a cube, and the planes through its neighbours.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use crate::registration::{KdTree, Neighbours};
use crate::threads;

/// Added to a cube's coordinate to make it positive; 21 bits an axis.
const AXIS_OFFSET: i64 = 1 << 20;
/// Neighbours from which a plane is fitted, the point itself included.
const PLANE_NEIGHBOURS: usize = 10;
/// Fewer than this span no plane.
const LEAST_NEIGHBOURS: usize = 5;
/// The middle eigenvalue is at least this share of the largest, or the neighbours lie on a line.
const LEAST_WIDTH: f64 = 0.05;
/// The least eigenvalue is at most this share of the middle one, or the neighbours fill space, as leaves do.
const MOST_THICKNESS: f64 = 0.2;
/// Points a thread works on at a time.
const BLOCK: usize = 256;

/// The centroids [m] of the cubes of edge `cell_m` that hold a finite point nearer than `max_range_m`, sorted by cube.
pub(super) fn thin(points: &[[f32; 3]], cell_m: f64, max_range_m: f64) -> Vec<[f32; 3]> {
    let max_sq = (max_range_m * max_range_m) as f32;
    let per_metre = (1.0 / cell_m) as f32;
    let mut keyed: Vec<(u64, u32)> = Vec::with_capacity(points.len());
    for (index, p) in points.iter().enumerate() {
        // A comparison with NaN is false.
        if p[0] * p[0] + p[1] * p[1] + p[2] * p[2] <= max_sq {
            let axis = |v: f32| ((v * per_metre).floor() as i64 + AXIS_OFFSET) as u64;
            keyed.push((axis(p[0]) << 42 | axis(p[1]) << 21 | axis(p[2]), index as u32));
        }
    }
    keyed.sort_unstable();
    let centroid = |cube: &[(u64, u32)]| {
        let mut sum = [0.0_f64; 3];
        for p in cube.iter().filter_map(|(_, index)| points.get(*index as usize)) {
            for axis in 0..3 {
                sum[axis] += f64::from(p[axis]);
            }
        }
        sum.map(|s| (s / cube.len() as f64) as f32)
    };
    keyed.chunk_by(|a, b| a.0 == b.0).map(centroid).collect()
}

/// The unit normals of the tree's points, turned towards the scanner at the origin; zero where the neighbours within
/// `radius_m` span no plane.
pub(super) fn normals(tree: &KdTree, radius_m: f64, threads: usize) -> Vec<[f32; 3]> {
    let points = tree.points();
    let mut normals = vec![[0.0_f32; 3]; points.len()];
    let radius_sq = (radius_m * radius_m) as f32;
    let workers = threads.min(points.len().div_ceil(BLOCK));
    threads::for_each(normals.chunks_mut(BLOCK).enumerate(), workers, |(block, normals)| {
        let mut neighbours = Neighbours::new(PLANE_NEIGHBOURS);
        for (normal, point) in normals.iter_mut().zip(points.iter().skip(block * BLOCK)) {
            tree.nearest_many(*point, radius_sq, &mut neighbours);
            *normal = plane(points, *point, &neighbours).unwrap_or([0.0; 3]);
        }
    });
    normals
}

/// The normal of the plane through the neighbours.
fn plane(points: &[[f32; 3]], point: [f32; 3], neighbours: &Neighbours) -> Option<[f32; 3]> {
    if neighbours.found().len() < LEAST_NEIGHBOURS {
        return None;
    }
    let own = Vector3::from(point.map(f64::from));
    let (mut sum, mut squares) = (Vector3::zeros(), Matrix3::zeros());
    for (_, index) in neighbours.found() {
        let offset = Vector3::from(points.get(*index as usize)?.map(f64::from)) - own;
        sum += offset;
        squares += offset * offset.transpose();
    }
    let count = neighbours.found().len() as f64;
    let eigen = SymmetricEigen::new(squares / count - sum * sum.transpose() / (count * count));
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let [least, middle, most] = order.map(|k| eigen.eigenvalues[k]);
    if !(middle > LEAST_WIDTH * most && least < MOST_THICKNESS * middle) {
        return None;
    }
    let normal = eigen.eigenvectors.column(order[0]).into_owned();
    let towards_scanner = if normal.dot(&own) > 0.0 { -normal } else { normal };
    Some([towards_scanner.x as f32, towards_scanner.y as f32, towards_scanner.z as f32])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_one_cube_become_their_centroid_and_far_ones_are_left_out() {
        let points = [[0.1, 0.1, 0.1], [-3.0, 0.0, 0.0], [0.3, 0.3, 0.3], [99.0, 0.0, 0.0], [f32::NAN; 3]];
        let thinned = thin(&points, 0.5, 50.0);
        assert_eq!(thinned.len(), 2);
        assert_eq!(thinned[0], [-3.0, 0.0, 0.0]);
        assert!((thinned[1][2] - 0.2).abs() < 1e-6);
    }

    #[test]
    fn a_wall_has_normals_towards_the_scanner_a_wire_and_a_bush_have_none() {
        let wall: Vec<[f32; 3]> = (0..400).map(|i| [5.0, (i % 20) as f32 * 0.5 - 2.0, (i / 20) as f32 * 0.5]).collect();
        for normal in normals(&KdTree::new(wall), 2.0, 2) {
            assert!((normal[0] + 1.0).abs() < 1e-6, "{normal:?}");
        }
        let wire: Vec<[f32; 3]> = (0..40).map(|i| [5.0, i as f32 * 0.2, 1.0]).collect();
        assert!(normals(&KdTree::new(wire), 2.0, 1).iter().all(|n| *n == [0.0; 3]));
        let bush: Vec<[f32; 3]> = (0..27).map(|i| [5.0 + (i % 3) as f32, (i / 3 % 3) as f32, (i / 9) as f32]).collect();
        let middle = normals(&KdTree::new(bush), 2.0, 1);
        assert!(middle.iter().filter(|n| **n == [0.0; 3]).count() >= 1);
    }
}
