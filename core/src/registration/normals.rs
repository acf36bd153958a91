//! Normals of unordered points: the direction in which the nearest points spread least.

use nalgebra::{Matrix3, Vector3};

use super::PreparationConfig;
use super::kdtree::{KdTree, Neighbours};
use crate::threads;

/// Points a thread works on at a time.
const BLOCK: usize = 512;
/// The middle eigenvalue must be at least this share of the largest, or the neighbours lie on a line, about which the
/// normal could turn freely.
const LEAST_WIDTH: f64 = 0.01;

/// The unit normals of the tree's points, turned towards the scanner at the origin, under the same indices. A point
/// without enough neighbours, or whose neighbours lie on a line, has the normal zero.
pub(super) fn estimate(tree: &KdTree, config: &PreparationConfig, threads: usize) -> Vec<[f32; 3]> {
    let points = tree.points();
    let mut normals = vec![[0.0_f32; 3]; points.len()];
    let radius_sq = (config.normal_radius_m * config.normal_radius_m) as f32;
    let most = threads.min(points.len().div_ceil(BLOCK));
    threads::for_each(normals.chunks_mut(BLOCK).enumerate(), most, |(block, normals)| {
        let mut neighbours = Neighbours::new(config.normal_neighbours);
        for (normal, point) in normals.iter_mut().zip(points.iter().skip(block * BLOCK)) {
            tree.nearest_many(*point, radius_sq, &mut neighbours);
            *normal = fit(points, *point, &neighbours).unwrap_or([0.0; 3]);
        }
    });
    normals
}

/// The normal of the plane through the neighbours, or `None` when they do not span one.
fn fit(points: &[[f32; 3]], point: [f32; 3], neighbours: &Neighbours) -> Option<[f32; 3]> {
    if neighbours.found().len() < 5 {
        return None;
    }
    let own = Vector3::from(point.map(f64::from));
    let mut sum = Vector3::zeros();
    let mut squares = Matrix3::zeros();
    for (_, index) in neighbours.found() {
        // Relative to the point, so that no digits are lost far from the origin.
        let offset = Vector3::from(points.get(*index as usize)?.map(f64::from)) - own;
        sum += offset;
        squares += offset * offset.transpose();
    }
    let count = neighbours.found().len() as f64;
    let normal = least_direction(&(squares / count - sum * sum.transpose() / (count * count)))?;
    let towards_scanner = if normal.dot(&own) > 0.0 { -normal } else { normal };
    Some([towards_scanner.x as f32, towards_scanner.y as f32, towards_scanner.z as f32])
}

/// The unit eigenvector of the least eigenvalue of a symmetric positive 3x3 matrix, in closed form, or `None` when the
/// matrix has (nearly) rank one and the vector is arbitrary.
fn least_direction(matrix: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let scale = matrix.trace();
    if !(scale.is_finite() && scale > 1e-12) {
        return None;
    }
    let m = matrix / scale;
    let mean = 1.0 / 3.0;
    let deviation = m - Matrix3::identity() * mean;
    let spread = (deviation.norm_squared() / 6.0).sqrt();
    if spread < 1e-9 {
        return None;
    }
    // The trigonometric solution of the characteristic cubic (Smith 1961).
    let angle = ((deviation / spread).determinant() / 2.0).clamp(-1.0, 1.0).acos() / 3.0;
    let greatest = mean + 2.0 * spread * angle.cos();
    let least = mean + 2.0 * spread * (angle + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    if 1.0 - greatest - least < LEAST_WIDTH * greatest {
        return None;
    }
    // Rows of m - least I span the plane of the other two eigenvectors; take the best conditioned pair.
    let shifted = m - Matrix3::identity() * least;
    let rows = [shifted.row(0).transpose(), shifted.row(1).transpose(), shifted.row(2).transpose()];
    let crosses = [rows[0].cross(&rows[1]), rows[1].cross(&rows[2]), rows[2].cross(&rows[0])];
    let longest = crosses.iter().fold(crosses[0], |a, b| if b.norm_squared() > a.norm_squared() { *b } else { a });
    longest.try_normalize(1e-14)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_least_direction_is_an_eigenvector(r in prop::array::uniform3(-3.0..3.0f64), e in prop::array::uniform3(0.0..1.0f64)) {
            let values = Vector3::new(0.1 * e[0], 0.2 + e[1], 1.3 + e[2]);
            let rotation = nalgebra::Rotation3::new(Vector3::from(r));
            let matrix = rotation * Matrix3::from_diagonal(&values) * rotation.inverse();
            let direction = least_direction(&matrix).unwrap();
            prop_assert!((matrix * direction - direction * values[0]).norm() < 1e-6);
        }
    }

    #[test]
    fn a_wall_has_normals_towards_the_scanner_and_a_wire_has_none() {
        let config = PreparationConfig::default();
        let wall: Vec<[f32; 3]> = (0..400).map(|i| [5.0, (i % 20) as f32 * 0.2 - 2.0, (i / 20) as f32 * 0.2]).collect();
        for normal in estimate(&KdTree::new(wall), &config, 2) {
            assert!((normal[0] + 1.0).abs() < 1e-6, "{normal:?}");
        }
        let wire: Vec<[f32; 3]> = (0..40).map(|i| [5.0, i as f32 * 0.2, 1.0]).collect();
        assert!(estimate(&KdTree::new(wire), &config, 1).iter().all(|n| *n == [0.0; 3]));
    }
}
