//! The solids of a scene as triangles, in their own frame: x along the length, z up, the middle of the base at the
//! origin.

use nalgebra::Vector3;

/// Sides of a trunk and of a crown: a trunk of 0.3 m radius is within 3 mm of the round one.
const ROUND_SIDES: usize = 24;
/// Rings of a sphere between its poles.
const SPHERE_RINGS: usize = 12;

/// A solid, its sizes in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A cuboid.
    Box {
        /// Along x, y and z.
        size: Vector3<f64>,
    },
    /// An upright cylinder of 24 sides, closed at the top: a tree trunk, a post.
    Cylinder {
        /// Distance of the corners from the axis.
        radius: f64,
        /// Along z.
        height: f64,
    },
    /// An upright cone of 24 sides, closed below: the crown of a conifer.
    Cone {
        /// Of the base.
        radius: f64,
        /// Along z.
        height: f64,
    },
    /// A sphere of 24 by 13 faces that touches its base: the crown of a broad-leaved tree.
    Sphere {
        /// Distance of the corners from the middle.
        radius: f64,
    },
    /// Four walls and a gable roof whose ridge runs along x, without eaves.
    House {
        /// Along x.
        length: f64,
        /// Along y.
        width: f64,
        /// From the base to the eaves.
        wall_height: f64,
        /// From the eaves to the ridge.
        roof_height: f64,
    },
    /// A wedge that rises along x.
    Ramp {
        /// Along x.
        length: f64,
        /// Along y.
        width: f64,
        /// At the upper end.
        height: f64,
    },
}

impl Shape {
    /// Appends the shape's triangles. Its lower rim is drawn down by `foundation` [m], so that on uneven ground no gap
    /// opens under it; cones and spheres have no rim.
    pub(super) fn triangulate(&self, foundation: f64, triangles: &mut Vec<[Vector3<f64>; 3]>) {
        match *self {
            Self::Box { size } => prism(&rectangle(size.x, size.y), -foundation, size.z, triangles),
            Self::Cylinder { radius, height } => {
                let rim: Vec<_> = (0..ROUND_SIDES).map(|k| on_circle(k, radius)).collect();
                prism(&rim, -foundation, height, triangles);
            }
            Self::Cone { radius, height } => cone(radius, height, triangles),
            Self::Sphere { radius } => sphere(radius, triangles),
            Self::House { length, width, wall_height, roof_height } => {
                prism(&rectangle(length, width), -foundation, wall_height, triangles);
                roof(length, width, wall_height, roof_height, triangles);
            }
            Self::Ramp { length, width, height } => ramp(length, width, height, foundation, triangles),
        }
    }
}

/// The corners of a rectangle about the origin, counter-clockwise.
fn rectangle(length: f64, width: f64) -> [[f64; 2]; 4] {
    let (x, y) = (length / 2.0, width / 2.0);
    [[-x, -y], [x, -y], [x, y], [-x, y]]
}

/// Corner `k` of the regular polygon that stands for a circle.
fn on_circle(k: usize, radius: f64) -> [f64; 2] {
    let (sin, cos) = (std::f64::consts::TAU * k as f64 / ROUND_SIDES as f64).sin_cos();
    [radius * cos, radius * sin]
}

/// The quadrilateral a b c d as two triangles.
fn quad(corners: [Vector3<f64>; 4], triangles: &mut Vec<[Vector3<f64>; 3]>) {
    let [a, b, c, d] = corners;
    triangles.push([a, b, c]);
    triangles.push([a, c, d]);
}

/// A convex rim (counter-clockwise) drawn from `bottom` to `top`, both ends closed.
fn prism(rim: &[[f64; 2]], bottom: f64, top: f64, triangles: &mut Vec<[Vector3<f64>; 3]>) {
    let at = |corner: [f64; 2], z: f64| Vector3::new(corner[0], corner[1], z);
    for (k, &corner) in rim.iter().enumerate() {
        let next = rim[(k + 1) % rim.len()];
        quad([at(corner, bottom), at(next, bottom), at(next, top), at(corner, top)], triangles);
        if k >= 1 && k + 1 < rim.len() {
            triangles.push([at(rim[0], top), at(corner, top), at(next, top)]);
            triangles.push([at(rim[0], bottom), at(next, bottom), at(corner, bottom)]);
        }
    }
}

fn cone(radius: f64, height: f64, triangles: &mut Vec<[Vector3<f64>; 3]>) {
    let (middle, apex) = (Vector3::zeros(), Vector3::new(0.0, 0.0, height));
    for k in 0..ROUND_SIDES {
        let (a, b) = (on_circle(k, radius), on_circle(k + 1, radius));
        let (a, b) = (Vector3::new(a[0], a[1], 0.0), Vector3::new(b[0], b[1], 0.0));
        triangles.push([a, b, apex]);
        triangles.push([b, a, middle]);
    }
}

fn sphere(radius: f64, triangles: &mut Vec<[Vector3<f64>; 3]>) {
    // Ring 0 is the lower pole, ring SPHERE_RINGS + 1 the upper one.
    let at = |ring: usize, k: usize| {
        let (sin, cos) = (std::f64::consts::PI * ring as f64 / (SPHERE_RINGS + 1) as f64).sin_cos();
        let [x, y] = on_circle(k, radius * sin);
        Vector3::new(x, y, radius - radius * cos)
    };
    for ring in 0..=SPHERE_RINGS {
        for k in 0..ROUND_SIDES {
            let corners = [at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)];
            if ring > 0 {
                triangles.push([corners[0], corners[1], corners[2]]);
            }
            if ring < SPHERE_RINGS {
                triangles.push([corners[0], corners[2], corners[3]]);
            }
        }
    }
}

/// Two slopes and two gables above the walls.
fn roof(length: f64, width: f64, eaves: f64, rise: f64, triangles: &mut Vec<[Vector3<f64>; 3]>) {
    let [a, b, c, d] = rectangle(length, width).map(|[x, y]| Vector3::new(x, y, eaves));
    let ridge_low = Vector3::new(-length / 2.0, 0.0, eaves + rise);
    let ridge_high = Vector3::new(length / 2.0, 0.0, eaves + rise);
    quad([a, b, ridge_high, ridge_low], triangles);
    quad([c, d, ridge_low, ridge_high], triangles);
    triangles.push([b, c, ridge_high]);
    triangles.push([d, a, ridge_low]);
}

fn ramp(length: f64, width: f64, height: f64, foundation: f64, triangles: &mut Vec<[Vector3<f64>; 3]>) {
    let [a, b, c, d] = rectangle(length, width).map(|[x, y]| Vector3::new(x, y, -foundation));
    let up = |corner: Vector3<f64>, z: f64| Vector3::new(corner.x, corner.y, z);
    let (a1, b1, c1, d1) = (up(a, 0.0), up(b, height), up(c, height), up(d, 0.0));
    quad([a1, b1, c1, d1], triangles);
    for corners in [[a, b, b1, a1], [b, c, c1, b1], [c, d, d1, c1], [d, a, a1, d1]] {
        quad(corners, triangles);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Volume by the divergence theorem: right only when the surface is closed and its triangles face outward.
    fn volume(shape: Shape) -> f64 {
        let mut triangles = Vec::new();
        shape.triangulate(0.0, &mut triangles);
        triangles.iter().map(|[a, b, c]| a.dot(&b.cross(c)) / 6.0).sum()
    }

    #[test]
    fn a_box_encloses_its_volume() {
        assert!((volume(Shape::Box { size: Vector3::new(2.0, 3.0, 4.0) }) - 24.0).abs() < 1e-9);
    }

    #[test]
    fn round_shapes_enclose_nearly_the_round_volume() {
        let pi = std::f64::consts::PI;
        let cases = [
            (Shape::Cylinder { radius: 0.5, height: 3.0 }, pi * 0.25 * 3.0),
            (Shape::Cone { radius: 2.0, height: 3.0 }, pi * 4.0),
            (Shape::Sphere { radius: 2.0 }, pi * 32.0 / 3.0),
        ];
        for (shape, round) in cases {
            let ratio = volume(shape) / round;
            assert!((0.95..1.0).contains(&ratio), "{shape:?}: {ratio}");
        }
    }

    #[test]
    fn a_roof_over_level_zero_encloses_half_its_box() {
        // The roof is open below; at level 0 the missing face adds nothing to the integral.
        let mut triangles = Vec::new();
        roof(4.0, 2.0, 0.0, 1.0, &mut triangles);
        let enclosed: f64 = triangles.iter().map(|[a, b, c]| a.dot(&b.cross(c)) / 6.0).sum();
        assert!((enclosed - 4.0).abs() < 1e-12, "{enclosed}");
    }

    #[test]
    fn a_ramp_is_half_a_box() {
        assert!((volume(Shape::Ramp { length: 4.0, width: 3.0, height: 1.0 }) - 6.0).abs() < 1e-9);
    }

    #[test]
    fn a_foundation_reaches_below_the_base() {
        for shape in
            [Shape::Box { size: Vector3::new(1.0, 1.0, 1.0) }, Shape::Ramp { length: 2.0, width: 1.0, height: 1.0 }]
        {
            let mut triangles = Vec::new();
            shape.triangulate(0.7, &mut triangles);
            let bottom = triangles.iter().flatten().map(|v| v.z).fold(f64::MAX, f64::min);
            assert!((bottom + 0.7).abs() < 1e-12);
        }
    }
}
