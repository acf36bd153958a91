//! A scene ready for rays: all triangles under one bounding volume hierarchy.

use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use parry3d::math::Vector;
use parry3d::query::PointQuery;
use parry3d::shape::Triangle;
use thiserror::Error;

use super::ray_tree::{Corners, NOTHING, Packet, RayTree};
use super::scene::{Colour, Label, ModelPlacement, Placement, ScanPose, Scene, SceneObject};
use super::terrain::Terrain;
use crate::geometry::Pose;
use crate::simd;

/// How deep things that stand on the ground reach into it [m].
const FOUNDATION_M: f64 = 1.0;

/// Rays that are cast together: two registers of eight.
pub(super) const LANES: usize = 16;

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

/// The triangles of a scene, what each of them is, and the hierarchy over them. Immutable, shared between threads.
pub struct CompiledScene {
    /// Tells it from every other one of the process.
    number: u64,
    scene: Scene,
    terrain: Terrain,
    triangles: Vec<Corners>,
    labels: Vec<Label>,
    colours: Vec<Colour>,
    /// The ground's triangles come first.
    ground_triangles: usize,
    tree: RayTree,
}

impl std::fmt::Debug for CompiledScene {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CompiledScene({}, {} triangles)", self.scene.name, self.triangles.len())
    }
}

/// A place in a scene: what is seen from it is always the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Viewpoint {
    scene: u64,
    map_from_sensor: Pose,
}

impl CompiledScene {
    /// A place from which it is looked at.
    pub(super) fn viewpoint(&self, map_from_sensor: &Pose) -> Viewpoint {
        Viewpoint { scene: self.number, map_from_sensor: *map_from_sensor }
    }

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
        let mut colours = vec![scene.ground_colour; ground_triangles];
        for object in &scene.objects {
            if !build_object(object, &terrain, &mut corners) {
                let &SceneObject { label, x, y, .. } = object;
                return Err(CompileError::Object { scene: scene.name.clone(), label, x, y });
            }
            labels.resize(corners.len(), object.label);
            colours.resize(corners.len(), object.colour.unwrap_or_else(|| object.label.colour()));
        }
        for model in &scene.models {
            if !build_model(model, &terrain, &mut corners) {
                let &ModelPlacement { label, position: [x, y], .. } = model;
                return Err(CompileError::Object { scene: scene.name.clone(), label, x, y });
            }
            let own = model.colour.unwrap_or_else(|| model.label.colour());
            let of_face = |face| model.colour.or_else(|| model.mesh.colour(face)).unwrap_or(own);
            colours.extend((0..model.mesh.triangles().len()).map(of_face));
            labels.resize(corners.len(), model.label);
        }
        let triangles: Vec<Corners> = corners.iter().map(|corners| corners.map(|v| v.cast::<f32>().into())).collect();
        let tree = RayTree::new(&triangles);
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Ok(Self { number, scene, terrain, triangles, labels, colours, ground_triangles, tree })
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
    /// frame. Surfaces are met from either side. Many rays from one place: [`CompiledScene::cast_all`].
    #[must_use]
    pub fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>, range_max: f64) -> Option<Hit> {
        let mut packet = Packet::<1>::new(origin.coords.into());
        packet.set(0, (*direction).into(), range_max as f32);
        self.tree.trace(&mut packet, &mut Vec::with_capacity(64));
        self.hit(origin, direction, packet.triangle[0], packet.nearest[0])
    }

    /// As [`CompiledScene::cast`] for many rays from one origin, one hit a direction; neighbours in the slice should be
    /// neighbours in direction. The hits do not depend on who is cast together.
    pub fn cast_all(
        &self,
        origin: &Point3<f64>,
        directions: &[Vector3<f64>],
        range_max: f64,
        hits: &mut [Option<Hit>],
    ) {
        let mut stack = Vec::with_capacity(64);
        for (directions, hits) in directions.chunks(LANES).zip(hits.chunks_mut(LANES)) {
            let mut packet = Packet::<LANES>::new(origin.coords.into());
            for (lane, direction) in directions.iter().enumerate() {
                packet.set(lane, (*direction).into(), range_max as f32);
            }
            self.trace(&mut packet, &mut stack);
            for (lane, (hit, direction)) in hits.iter_mut().zip(directions).enumerate() {
                *hit = self.hit(origin, direction, packet.triangle[lane], packet.nearest[lane]);
            }
        }
    }

    /// Finds the nearest triangle of every ray of a packet.
    #[inline]
    pub(super) fn trace(&self, packet: &mut Packet<LANES>, stack: &mut Vec<u32>) {
        simd::widest(|| self.tree.trace(packet, stack));
    }

    /// The hit on a triangle that a ray was found to meet at about `near` [m], or `None` for [`NOTHING`]. The range is
    /// that to the triangle's plane in double precision.
    pub(super) fn hit(&self, origin: &Point3<f64>, direction: &Vector3<f64>, triangle: u32, near: f32) -> Option<Hit> {
        let label = *self.labels.get(triangle as usize).filter(|_| triangle != NOTHING)?;
        let [a, b, c] = self.corners(triangle)?;
        let normal = (b - a).cross(&(c - a));
        let exact = normal.dot(&(a - origin.coords)) / normal.dot(direction);
        let near = f64::from(near);
        // Along the surface the quotient means nothing.
        let range = if (exact - near).abs() <= 1e-3 * (1.0 + near) { exact.max(0.0) } else { near };
        Some(Hit { range, label, triangle })
    }

    /// The unit normal of the surface that was hit, map frame, outward (upward for the ground).
    #[must_use]
    pub fn normal(&self, hit: &Hit) -> Vector3<f64> {
        self.corners(hit.triangle).map_or_else(Vector3::zeros, |[a, b, c]| (b - a).cross(&(c - a)).normalize())
    }

    /// Height of the plane of a hit over a point, along its unit `normal` [m].
    pub(super) fn plane_height(&self, hit: &Hit, normal: &Vector3<f64>, point: &Point3<f64>) -> f64 {
        self.corners(hit.triangle).map_or(0.0, |[a, ..]| normal.dot(&(a - point.coords)))
    }

    /// The colour of the surface that was hit.
    #[must_use]
    pub fn colour(&self, hit: &Hit) -> Colour {
        self.colours.get(hit.triangle as usize).copied().unwrap_or_default()
    }

    /// Distance from a point of the map to the nearest surface, within `reach` [m], or `None` beyond. This is the truth
    /// that points of a model are measured against.
    #[must_use]
    pub fn distance_to_surface(&self, point: &Point3<f64>, reach: f64) -> Option<f64> {
        let at = Vector::new(point.x as f32, point.y as f32, point.z as f32);
        let project = |id: u32, _nearest: f32| {
            let [a, b, c] = self.triangles.get(id as usize)?.map(Vector::from);
            Some(Triangle::new(a, b, c).project_local_point(at, false))
        };
        let (_, (distance, _)) = self.tree.bvh().project_point(at, reach as f32, project)?;
        Some(f64::from(distance))
    }

    /// The corners of a triangle in double precision [m].
    fn corners(&self, triangle: u32) -> Option<[Vector3<f64>; 3]> {
        let corners = self.triangles.get(triangle as usize)?;
        Some([double(&corners[0]), double(&corners[1]), double(&corners[2])])
    }

    /// All triangles with their labels, map frame [m]; the ground's come first.
    pub(super) fn labelled_triangles(&self) -> impl Iterator<Item = ([Vector3<f64>; 3], Label)> {
        let corners = self.triangles.iter().map(|corners| corners.map(|corner| double(&corner)));
        corners.zip(self.labels.iter().copied())
    }

    /// The triangles of all that stands on the ground and their labels, map frame [m].
    pub(super) fn object_triangles(&self) -> impl Iterator<Item = ([Vector3<f64>; 3], Label)> {
        self.labelled_triangles().skip(self.ground_triangles)
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

/// Appends a model's triangles in the map frame; `false` when it is not over the ground or not finite.
fn build_model(model: &ModelPlacement, terrain: &Terrain, triangles: &mut Vec<[Vector3<f64>; 3]>) -> bool {
    let [x, y] = model.position;
    let z = match (model.placement, terrain.height(x, y)) {
        (Placement::At { z }, _) => z,
        (Placement::OnGround { above }, Some(ground)) => ground + above,
        (Placement::OnGround { .. }, None) => return false,
    };
    let [roll, pitch, yaw] = model.rotation;
    let turn = Rotation3::from_euler_angles(roll, pitch, yaw);
    let (scale, shift) = (Vector3::from(model.scale), Vector3::new(x, y, z));
    let placed = |vertex: &[f64; 3]| turn * Vector3::from(*vertex).component_mul(&scale) + shift;
    let vertices: Vec<_> = model.mesh.vertices().iter().map(placed).collect();
    let at = |index: u32| vertices.get(index as usize).copied().unwrap_or_default();
    // A mirror turns faces inside out.
    let mirrored = model.scale.iter().product::<f64>() < 0.0;
    triangles.extend(model.mesh.triangles().iter().map(|&[a, b, c]| {
        let (b, c) = if mirrored { (c, b) } else { (b, c) };
        [at(a), at(b), at(c)]
    }));
    vertices.iter().all(|v| v.iter().all(|c| c.is_finite()))
}

fn double(v: &[f32; 3]) -> Vector3<f64> {
    Vector3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))
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
