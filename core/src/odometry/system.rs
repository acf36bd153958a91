//! The normal equations of a frame's points against the planes of the map.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::local_map::LocalPose;
use crate::geometry::{Pose, Twist};
use crate::registration::{Constraint, constraint_of};

/// Points worked on side by side.
pub(super) const LANES: usize = 8;
/// Entries of the upper triangle of a 6x6 matrix.
const UPPER: usize = 21;

/// Eight points of a frame and the planes they are paired with.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PairBlock {
    /// Scanner frame [m], an array a coordinate.
    pub point: [[f32; LANES]; 3],
    /// Unit normals, map axes.
    pub normal: [[f32; LANES]; 3],
    /// Distance of the plane from the local origin, along the normal [m].
    pub distance: [f32; LANES],
    /// 0 where a point has no partner.
    pub weight: [f32; LANES],
}

/// `H delta = -b` for a motion of the scanner in the map's axes, about the scanner's own place: translation, then
/// rotation vector. So points far from the map's origin lose nothing, and a rotation of the axes makes it the
/// perturbation on the right.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct System {
    upper: [f64; UPPER],
    gradient: [f64; 6],
    /// Sum of the weights.
    pub weight: f64,
    /// Weighted sum of squared residuals [m^2].
    pub residual_sq: f64,
    /// Weighted sum of squared ranges [m^2].
    range_sq: f64,
    /// Sum over the pairs of how well they fit, from 1 for no residual down to 0.
    pub fit: f64,
    /// Points with a partner.
    pub pairs: f64,
}

/// The sums of one run of blocks, a lane each.
struct Lanes {
    upper: [[f32; LANES]; UPPER],
    gradient: [[f32; LANES]; 6],
    weight: [f32; LANES],
    residual_sq: [f32; LANES],
    range_sq: [f32; LANES],
    fit: [f32; LANES],
    pairs: [f32; LANES],
}

#[inline(always)]
pub(super) fn lanes(value: impl Fn(usize) -> f32) -> [f32; LANES] {
    // Not `array::from_fn`, which is not inlined here, at ten times the cost.
    let mut out = [0.0; LANES];
    for (lane, out) in out.iter_mut().enumerate() {
        *out = value(lane);
    }
    out
}

impl Lanes {
    fn new() -> Self {
        let none = [0.0; LANES];
        Self {
            upper: [none; UPPER],
            gradient: [none; 6],
            weight: none,
            residual_sq: none,
            range_sq: none,
            fit: none,
            pairs: none,
        }
    }

    #[inline(always)]
    fn add(&mut self, pose: &LocalPose, per_scale_sq: f32, block: &PairBlock) {
        let (r, t) = (&pose.rotation, &pose.translation);
        let [px, py, pz] = &block.point;
        let [nx, ny, nz] = &block.normal;
        // From the scanner, in map axes.
        let cx = lanes(|l| r[0][0] * px[l] + r[0][1] * py[l] + r[0][2] * pz[l]);
        let cy = lanes(|l| r[1][0] * px[l] + r[1][1] * py[l] + r[1][2] * pz[l]);
        let cz = lanes(|l| r[2][0] * px[l] + r[2][1] * py[l] + r[2][2] * pz[l]);
        let residual =
            lanes(|l| nx[l] * (cx[l] + t[0]) + ny[l] * (cy[l] + t[1]) + nz[l] * (cz[l] + t[2]) - block.distance[l]);
        // Geman and McClure: rho = r^2 / (k^2 + r^2), weight (k^2 / (k^2 + r^2))^2.
        let fit = lanes(|l| 1.0 / (1.0 + residual[l] * residual[l] * per_scale_sq));
        let weight = lanes(|l| block.weight[l] * fit[l] * fit[l]);
        let j = [
            *nx,
            *ny,
            *nz,
            lanes(|l| cy[l] * nz[l] - cz[l] * ny[l]),
            lanes(|l| cz[l] * nx[l] - cx[l] * nz[l]),
            lanes(|l| cx[l] * ny[l] - cy[l] * nx[l]),
        ];
        let mut k = 0;
        for row in 0..6 {
            let weighted = lanes(|l| weight[l] * j[row][l]);
            for l in 0..LANES {
                self.gradient[row][l] += weighted[l] * residual[l];
            }
            for column in &j[row..] {
                for l in 0..LANES {
                    self.upper[k][l] += weighted[l] * column[l];
                }
                k += 1;
            }
        }
        for l in 0..LANES {
            let paired = f32::from(u8::from(block.weight[l] > 0.0));
            self.weight[l] += weight[l];
            self.residual_sq[l] += weight[l] * residual[l] * residual[l];
            self.range_sq[l] += weight[l] * (cx[l] * cx[l] + cy[l] * cy[l] + cz[l] * cz[l]);
            self.fit[l] += paired * fit[l];
            self.pairs[l] += paired;
        }
    }

    fn total(&self) -> System {
        let sum = |lanes: &[f32; LANES]| lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
        System {
            upper: self.upper.each_ref().map(sum),
            gradient: self.gradient.each_ref().map(sum),
            weight: sum(&self.weight),
            residual_sq: sum(&self.residual_sq),
            range_sq: sum(&self.range_sq),
            fit: sum(&self.fit),
            pairs: sum(&self.pairs),
        }
    }
}

impl System {
    /// Sums the pairs at a pose, with the robust kernel of Geman and McClure (1987) at the residual `scale_m`.
    /// Few enough blocks that single precision carries their sums: the caller merges.
    #[inline(always)]
    pub fn of(blocks: &[PairBlock], pose: &LocalPose, scale_m: f32) -> Self {
        let mut sums = Lanes::new();
        let per_scale_sq = 1.0 / (scale_m * scale_m);
        for block in blocks {
            sums.add(pose, per_scale_sq, block);
        }
        sums.total()
    }

    /// Adds the sums of other blocks.
    pub fn merge(&mut self, other: &Self) {
        self.upper.iter_mut().zip(&other.upper).for_each(|(a, b)| *a += b);
        self.gradient.iter_mut().zip(&other.gradient).for_each(|(a, b)| *a += b);
        self.weight += other.weight;
        self.residual_sq += other.residual_sq;
        self.range_sq += other.range_sq;
        self.fit += other.fit;
        self.pairs += other.pairs;
    }

    /// Which directions the pairs constrain, in the map's axes.
    pub fn constraint(&self, threshold: f64) -> Constraint {
        let mut hessian = Matrix6::zeros();
        let mut k = 0;
        for row in 0..6 {
            for column in row..6 {
                hessian[(row, column)] = self.upper[k];
                hessian[(column, row)] = self.upper[k];
                k += 1;
            }
        }
        constraint_of(&hessian, self.weight, self.range_sq, threshold)
    }

    /// The Gauss-Newton step within the constrained directions; the others keep the prediction (Zhang, Kaess, Singh
    /// 2016). In the map's axes.
    pub fn step(&self, constraint: &Constraint) -> Twist {
        let scale = constraint.scale();
        let gradient = Vector6::from(self.gradient).component_div(&scale) / self.weight;
        let mut step = Twist::zeros();
        for k in (0..6).filter(|k| constraint.is_constrained(*k)) {
            let direction = constraint.directions.column(k);
            step -= direction * (direction.dot(&gradient) / constraint.eigenvalues[k]);
        }
        step.component_div(&scale)
    }
}

/// The constraint with its directions turned from the map's axes to the scanner's: those of the perturbation on the
/// right.
pub(super) fn in_scanner_axes(constraint: &Constraint, map_from_scanner: &Pose) -> Constraint {
    let turn: Matrix3<f64> = map_from_scanner.rotation.inverse().to_rotation_matrix().into_inner();
    let mut turned = *constraint;
    for mut direction in turned.directions.column_iter_mut() {
        let (upper, lower): (Vector3<f64>, Vector3<f64>) =
            (direction.fixed_rows::<3>(0).into(), direction.fixed_rows::<3>(3).into());
        direction.fixed_rows_mut::<3>(0).copy_from(&(turn * upper));
        direction.fixed_rows_mut::<3>(3).copy_from(&(turn * lower));
    }
    turned
}
