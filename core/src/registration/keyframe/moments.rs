//! How many points there are, where, and how they spread: sums that add up over voxels.

use nalgebra::Vector3;

/// Count, first and second moments of points about a reference the caller knows [m], [m^2].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Moments {
    pub count: f32,
    pub sum: [f32; 3],
    /// xx, xy, xz, yy, yz, zz.
    pub squares: [f32; 6],
}

/// The spread of a set of points about their mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spread {
    /// The mean, from the reference [m].
    pub mean: [f32; 3],
    /// Covariance xx, xy, xz, yy, yz, zz [m^2].
    pub covariance: [f32; 6],
}

impl Moments {
    /// Adds a point at `offset` from the reference.
    #[inline(always)]
    pub fn add(&mut self, [x, y, z]: [f32; 3]) {
        self.count += 1.0;
        self.sum[0] += x;
        self.sum[1] += y;
        self.sum[2] += z;
        let products = [x * x, x * y, x * z, y * y, y * z, z * z];
        for k in 0..6 {
            self.squares[k] += products[k];
        }
    }

    /// Adds the points of another set about the same reference.
    #[inline(always)]
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        for k in 0..3 {
            self.sum[k] += other.sum[k];
        }
        for k in 0..6 {
            self.squares[k] += other.squares[k];
        }
    }

    /// The same points, each offset growing by `by`: about a reference that lies `by` further back.
    #[inline(always)]
    pub fn shifted(&self, [x, y, z]: [f32; 3]) -> Self {
        let (n, [sx, sy, sz]) = (self.count, self.sum);
        let grown = [
            2.0 * sx * x + n * x * x,
            sx * y + sy * x + n * x * y,
            sx * z + sz * x + n * x * z,
            2.0 * sy * y + n * y * y,
            sy * z + sz * y + n * y * z,
            2.0 * sz * z + n * z * z,
        ];
        let mut squares = self.squares;
        for k in 0..6 {
            squares[k] += grown[k];
        }
        Self { count: n, sum: [sx + n * x, sy + n * y, sz + n * z], squares }
    }

    /// Mean and covariance; not finite without points.
    #[inline(always)]
    pub fn spread(&self) -> Spread {
        let per_point = 1.0 / self.count;
        let [x, y, z] = [self.sum[0] * per_point, self.sum[1] * per_point, self.sum[2] * per_point];
        let mut covariance = [x * x, x * y, x * z, y * y, y * z, z * z];
        for k in 0..6 {
            covariance[k] = self.squares[k] * per_point - covariance[k];
        }
        Spread { mean: [x, y, z], covariance }
    }
}

impl Spread {
    /// The eigenvalues, least first [m^2], and the unit eigenvector of the least, in closed form (Smith 1961); `None`
    /// when all points coincide or lie on one line, about which the vector could turn freely.
    #[inline]
    pub fn least_direction(&self, least_width: f32) -> Option<([f32; 3], Vector3<f32>)> {
        let [xx, xy, xz, yy, yz, zz] = self.covariance;
        let scale = xx + yy + zz;
        if !(scale > 1e-10 && scale.is_finite()) {
            return None;
        }
        let per_scale = 1.0 / scale;
        let (xx, xy, xz) = (xx * per_scale, xy * per_scale, xz * per_scale);
        let (yy, yz, zz) = (yy * per_scale, yz * per_scale, zz * per_scale);
        let mean = 1.0 / 3.0;
        let (a, b, c) = (xx - mean, yy - mean, zz - mean);
        let spread = ((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0).sqrt();
        if spread < 1e-6 {
            return None;
        }
        let determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz);
        let cosine = determinant / (2.0 * spread * spread * spread);
        let angle = cosine.clamp(-1.0, 1.0).acos() / 3.0;
        let greatest = mean + 2.0 * spread * angle.cos();
        let least = mean + 2.0 * spread * (angle + 2.0 * std::f32::consts::FRAC_PI_3).cos();
        let middle = 1.0 - greatest - least;
        if middle < least_width * greatest {
            return None;
        }
        // Rows of the shifted matrix span the plane of the other two eigenvectors; take the best conditioned pair.
        let rows =
            [Vector3::new(xx - least, xy, xz), Vector3::new(xy, yy - least, yz), Vector3::new(xz, yz, zz - least)];
        let crosses = [rows[0].cross(&rows[1]), rows[1].cross(&rows[2]), rows[2].cross(&rows[0])];
        let longest = crosses.iter().fold(crosses[0], |a, b| if b.norm_squared() > a.norm_squared() { *b } else { a });
        let direction = longest.try_normalize(1e-9)?;
        Some(([least.max(0.0) * scale, middle * scale, greatest * scale], direction))
    }
}
