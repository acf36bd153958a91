//! A scene ready for rays: all triangles under one bounding volume hierarchy.

use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use parry3d::bounding_volume::Aabb;
use parry3d::math::Vector;
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::Ray;
use thiserror::Error;

use super::scene::{Label, Placement, ScanPose, Scene, SceneObject};
use super::terrain::Terrain;
use crate::geometry::Pose;

/// How deep things that stand on the ground reach into it [m].
const FOUNDATION_M: f64 = 1.0;

/// Rays through a shared edge must hit one of its triangles in single precision: barycentric coordinates may fall
/// below zero by this much, and boxes are widened by [`BOX_MARGIN_M`].
const EDGE_TOLERANCE: f32 = 1e-6;
/// How much the triangles' boxes are widened [m].
const BOX_MARGIN_M: f32 = 1e-4;

/// Why a scene cannot be compiled. Scenes read from a file pass these checks with the file's line already.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CompileError {
    /// A field of the terrain is outside its range.
    #[error("scene {scene}: terrain.{field} {allowed}")]
    Terrain {
        /// The scene's name.
        scene: String,
        /// The field.
        field: &'static str,
        /// What would be right.
        allowed: &'static str,
    },
    /// An object's middle is not over the ground, or a size or coordinate is not finite.
    #[error("scene {scene}: the {label} at x = {x}, y = {y} must stand on the ground and have finite sizes")]
    Object {
        /// The scene's name.
        scene: String,
        /// What it is.
        label: Label,
        /// Middle of its base [m].
        x: f64,
        /// Middle of its base [m].
        y: f64,
    },
}

/// Where a ray meets the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance along the unit ray [m].
    pub range: f64,
    /// What is met.
    pub label: Label,
    /// Index of the triangle, for [`CompiledScene::normal`].
    pub triangle: u32,
}

/// A triangle as the intersection test wants it: a corner and the two edges from it [m], map frame.
#[derive(Debug, Clone, Copy)]
struct Triangle {
    corner: Vector,
    edge1: Vector,
    edge2: Vector,
}

/// The triangles of a scene, what each of them is, and the hierarchy over them. Immutable, shared between threads.
pub struct CompiledScene {
    scene: Scene,
    terrain: Terrain,
    triangles: Vec<Triangle>,
    labels: Vec<Label>,
    /// The ground's triangles come first.
    ground_triangles: usize,
    bvh: Bvh,
}

impl CompiledScene {
    /// Samples the ground, builds the objects' triangles and the hierarchy.
    ///
    /// # Errors
    /// When the terrain is out of its ranges or an object is not on it.
    pub fn new(scene: Scene) -> Result<Self, CompileError> {
        if let Some((field, allowed)) = scene.terrain.fault(&scene.area) {
            return Err(CompileError::Terrain { scene: scene.name, field, allowed });
        }
        let terrain = Terrain::new(&scene.terrain, &scene.area);
        let mut corners = Vec::new();
        terrain.triangulate(&mut corners);
        let ground_triangles = corners.len();
        let mut labels = vec![Label::Ground; ground_triangles];
        for object in &scene.objects {
            if !build_object(object, &terrain, &mut corners) {
                let &SceneObject { label, x, y, .. } = object;
                return Err(CompileError::Object { scene: scene.name.clone(), label, x, y });
            }
            labels.resize(corners.len(), object.label);
        }
        let triangles: Vec<_> = corners.iter().map(Triangle::new).collect();
        let boxes: Vec<_> = triangles.iter().map(Triangle::bounds).collect();
        let bvh = Bvh::from_leaves(BvhBuildStrategy::Ploc, &boxes);
        Ok(Self { scene, terrain, triangles, labels, ground_triangles, bvh })
    }

    /// The scene this was built from.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The ground.
    #[must_use]
    pub fn terrain(&self) -> &Terrain {
        &self.terrain
    }

    /// Height of the ground at (x, y) [m], or `None` beyond its edge.
    #[must_use]
    pub fn ground_height(&self, x: f64, y: f64) -> Option<f64> {
        self.terrain.height(x, y)
    }

    /// How many triangles carry each label, in the order of [`Label::ALL`].
    #[must_use]
    pub fn label_counts(&self) -> [(Label, usize); Label::ALL.len()] {
        Label::ALL.map(|label| (label, self.labels.iter().filter(|&&l| l == label).count()))
    }

    /// The first surface a ray meets within `range_max` [m], or `None`. `direction` has unit length; both in the map
    /// frame. Surfaces are met from either side.
    #[must_use]
    pub fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>, range_max: f64) -> Option<Hit> {
        let ray = Ray::new(single(&origin.coords), single(direction));
        let test = |id: u32, nearest: f32| self.triangles.get(id as usize)?.intersect(&ray, nearest);
        let (triangle, range) = self.bvh.cast_ray(&ray, range_max as f32, test)?;
        let label = *self.labels.get(triangle as usize)?;
        Some(Hit { range: f64::from(range), label, triangle })
    }

    /// The unit normal of the surface that was hit, map frame, outward (upward for the ground).
    #[must_use]
    pub fn normal(&self, hit: &Hit) -> Vector3<f64> {
        let normal = self.triangles.get(hit.triangle as usize).map(|t| t.edge1.cross(t.edge2).normalize());
        normal.map_or_else(Vector3::zeros, |n| Vector3::new(n.x, n.y, n.z).cast())
    }

    /// The pose `map_from_scanner` of a level scanner `height` [m] over the ground, or `None` beyond the ground's edge.
    #[must_use]
    pub fn level_scanner_pose(&self, pose: &ScanPose, height: f64) -> Option<Pose> {
        let z = self.ground_height(pose.x, pose.y)? + height;
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.yaw);
        Some(Pose::from_parts(Translation3::new(pose.x, pose.y, z), yaw))
    }

    /// As [`CompiledScene::level_scanner_pose`] for a scanner fixed to a robot that leans as the ground under it does:
    /// its z axis is the ground's mean normal over a square of `footprint` [m], its x axis has the heading of `pose`.
    #[must_use]
    pub fn leaning_scanner_pose(&self, pose: &ScanPose, height: f64, footprint: f64) -> Option<Pose> {
        let half = footprint / 2.0;
        let mut up = Vector3::zeros();
        for (dx, dy) in [(-half, -half), (half, -half), (-half, half), (half, half), (0.0, 0.0)] {
            up += self.terrain.normal(pose.x + dx, pose.y + dy)?;
        }
        let up = up.normalize();
        // Ahead lies in the leaning plane, above or below the heading.
        let (sin, cos) = pose.yaw.sin_cos();
        let ahead = Vector3::new(cos, sin, -(up.x * cos + up.y * sin) / up.z).normalize();
        let axes = Rotation3::from_basis_unchecked(&[ahead, up.cross(&ahead), up]);
        let base = Vector3::new(pose.x, pose.y, self.ground_height(pose.x, pose.y)?);
        Some(Pose::from_parts(Translation3::from(base + height * up), UnitQuaternion::from_rotation_matrix(&axes)))
    }

    /// The triangles of all that stands on the ground and their labels, map frame [m].
    pub(super) fn object_triangles(&self) -> impl Iterator<Item = ([Vector3<f64>; 3], Label)> {
        let corners = self.triangles.iter().map(Triangle::corners);
        corners.zip(self.labels.iter().copied()).skip(self.ground_triangles)
    }
}

/// Appends an object's triangles in the map frame; `false` when it is not over the ground or not finite.
fn build_object(object: &SceneObject, terrain: &Terrain, triangles: &mut Vec<[Vector3<f64>; 3]>) -> bool {
    let Some(ground) = terrain.height(object.x, object.y) else { return false };
    let (z, foundation) = match object.placement {
        Placement::At { z } => (z, 0.0),
        Placement::OnGround { above } if above > 0.0 => (ground + above, 0.0),
        Placement::OnGround { above } => (ground + above, FOUNDATION_M),
    };
    let first = triangles.len();
    object.shape.triangulate(foundation, triangles);
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), object.yaw);
    let shift = Vector3::new(object.x, object.y, z);
    for corner in triangles.iter_mut().skip(first).flatten() {
        *corner = turn * *corner + shift;
    }
    triangles.iter().skip(first).flatten().all(|corner| corner.iter().all(|v| v.is_finite()))
}

fn single(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

impl Triangle {
    fn new(corners: &[Vector3<f64>; 3]) -> Self {
        let [a, b, c] = corners.map(|v| single(&v));
        Self { corner: a, edge1: b - a, edge2: c - a }
    }

    fn corners(&self) -> [Vector3<f64>; 3] {
        [self.corner, self.corner + self.edge1, self.corner + self.edge2]
            .map(|v| Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z)))
    }

    fn bounds(&self) -> Aabb {
        let corners = [self.corner, self.corner + self.edge1, self.corner + self.edge2];
        let low = corners.iter().fold(self.corner, |low, &v| low.min(v));
        let high = corners.iter().fold(self.corner, |high, &v| high.max(v));
        Aabb::new(low - Vector::splat(BOX_MARGIN_M), high + Vector::splat(BOX_MARGIN_M))
    }

    /// Range along the ray to this triangle when it is below `nearest`: Moller and Trumbore 1997, from both sides.
    #[inline]
    fn intersect(&self, ray: &Ray, nearest: f32) -> Option<f32> {
        let p = ray.dir.cross(self.edge2);
        let determinant = self.edge1.dot(p);
        if determinant == 0.0 {
            return None;
        }
        let inverse = 1.0 / determinant;
        let from_corner = ray.origin - self.corner;
        let u = from_corner.dot(p) * inverse;
        if !(-EDGE_TOLERANCE..=1.0 + EDGE_TOLERANCE).contains(&u) {
            return None;
        }
        let q = from_corner.cross(self.edge1);
        let v = ray.dir.dot(q) * inverse;
        if v < -EDGE_TOLERANCE || u + v > 1.0 + EDGE_TOLERANCE {
            return None;
        }
        let range = self.edge2.dot(q) * inverse;
        (range >= 0.0 && range < nearest).then_some(range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn scene(tail: &str) -> CompiledScene {
        let head = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-20, 20], y_m = [-20, 20] }\n";
        CompiledScene::new(Scene::from_toml(&format!("{head}{tail}"), "test").unwrap()).unwrap()
    }

    #[test]
    fn triangles_are_counted_by_label() {
        let world = scene("[[tree]]\nx_m = 3\ny_m = 3\ntrunk_radius_m = 0.2\ntrunk_height_m = 3\ncrown_radius_m = 1\n");
        let counts = world.label_counts();
        assert_eq!(counts[0], (Label::Ground, 2));
        assert_eq!(counts[Label::Tree as usize].1 + 2, world.triangles.len());
        assert_eq!(counts[Label::Vehicle as usize].1, 0);
    }

    #[test]
    fn an_object_off_the_ground_or_without_a_size_is_refused() {
        let mut built = Scene::builtin("simple").unwrap();
        built.objects[0].x = 300.0;
        let message = CompiledScene::new(built.clone()).err().unwrap().to_string();
        assert!(message.contains("simple") && message.contains("x = 300"), "{message}");
        built.objects[0] =
            SceneObject { x: 0.0, shape: crate::simulation::Shape::Sphere { radius: f64::NAN }, ..built.objects[0] };
        assert!(matches!(CompiledScene::new(built.clone()), Err(CompileError::Object { .. })));
        built.terrain.cell_m = f64::NAN;
        assert!(matches!(CompiledScene::new(built), Err(CompileError::Terrain { field: "cell_m", .. })));
    }

    #[test]
    fn a_ray_meets_the_near_face_of_a_turned_box() {
        let world = scene(
            "[[box]]\nlabel = \"vehicle\"\nx_m = 8\ny_m = 0\nyaw_deg = 90\nlength_m = 4\nwidth_m = 2\nheight_m = 1.5\n",
        );
        let hit = world.cast(&Point3::new(0.0, 0.3, 1.0), &Vector3::x(), 50.0).unwrap();
        assert_eq!(hit.label, Label::Vehicle);
        assert!((hit.range - 7.0).abs() < 1e-4);
        assert!((world.normal(&hit) + Vector3::x()).norm() < 1e-5);
        assert_eq!(world.cast(&Point3::new(0.0, 0.3, 1.0), &Vector3::x(), 6.9), None);
        assert_eq!(world.cast(&Point3::new(0.0, 0.3, 1.6), &Vector3::x(), 50.0), None);
    }

    #[test]
    fn a_leaning_scanner_stands_square_on_the_slope() {
        let world = scene("terrain = { slope_x_deg = 10 }\n");
        let pose = ScanPose { x: 2.0, y: -1.0, yaw: 0.7 };
        let leaning = world.leaning_scanner_pose(&pose, 1.0, 1.0).unwrap();
        let up = leaning.rotation * Vector3::z();
        assert!((up.z - 10.0f64.to_radians().cos()).abs() < 1e-9);
        let ahead = leaning.rotation * Vector3::x();
        assert!((ahead.y.atan2(ahead.x) - 0.7).abs() < 1e-9);
        assert!(ahead.cross(&(leaning.rotation * Vector3::y())).dot(&up) > 0.999);
        let level = world.level_scanner_pose(&pose, 1.0).unwrap();
        assert!((level.translation.z - 1.0 - world.ground_height(2.0, -1.0).unwrap()).abs() < 1e-12);
        assert!(world.level_scanner_pose(&ScanPose { x: 90.0, ..pose }, 1.0).is_none());
    }

    #[test]
    fn no_ray_slips_between_the_triangles_of_the_ground() {
        let world = scene("terrain = { cell_m = 0.5, waves = [{ amplitude_m = 0.2, wavelength_m = 8 }] }\n");
        for k in -300..300 {
            // Straight down onto nodes, edges and diagonals, where single precision could miss both neighbours.
            let at = 0.05 * f64::from(k);
            for (x, y) in [(at, at), (at, 0.5), (-2.0, at)] {
                let hit = world.cast(&Point3::new(x, y, 5.0), &-Vector3::z(), 50.0).unwrap();
                assert!((5.0 - hit.range - world.ground_height(x, y).unwrap()).abs() < 1e-4);
            }
        }
    }

    proptest! {
        #[test]
        fn rays_meet_an_inclined_plane_where_the_formula_says(
            x in -5.0..5.0f64, y in -5.0..5.0f64, height in 0.5..3.0f64,
            azimuth in -3.1..3.1f64, elevation in -1.5..-0.1f64,
            slope_x in -4.0..4.0f64, slope_y in -4.0..4.0f64,
        ) {
            let world = scene(&format!(
                "terrain = {{ slope_x_deg = {slope_x}, slope_y_deg = {slope_y}, margin_m = 60 }}\n"
            ));
            let normal = Vector3::new(-slope_x.to_radians().tan(), -slope_y.to_radians().tan(), 1.0).normalize();
            let origin = Point3::new(x, y, world.ground_height(x, y).unwrap() + height);
            let direction = Vector3::new(
                elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin(),
            );
            let towards = -direction.dot(&normal);
            let expected = origin.coords.dot(&normal) / towards;
            match world.cast(&origin, &direction, 50.0) {
                Some(hit) => {
                    let point = origin + hit.range * direction;
                    prop_assert!(point.coords.dot(&normal).abs() < 1e-3);
                    prop_assert!((hit.range - expected).abs() * towards < 1e-3);
                }
                None => prop_assert!(towards <= 0.0 || expected > 49.99),
            }
        }
    }
}
