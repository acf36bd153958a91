//! The scene file: TOML tables as they are written, and their translation to a [`Scene`].
//!
//! Every kind of solid has an array of tables of its own (`[[box]]`, `[[house]]`, ...), so that a wrong key is reported
//! with its line and with the keys that this kind knows. Angles are in degrees, lengths in metres.

use std::ops::RangeInclusive;

use nalgebra::Vector3;
use serde::Deserialize;
use toml::Spanned;

use super::scene::{Label, Placement, ScanPose, Scene, SceneObject, WorkArea};
use super::shapes::Shape;
use super::terrain::TerrainConfig;

/// What is wrong, and where in the text.
pub(super) struct Fault {
    /// Byte in the text.
    pub(super) offset: usize,
    /// What is wrong and what would be right.
    pub(super) message: String,
}

/// Reads and checks the text of a scene file.
pub(super) fn parse(text: &str) -> Result<Scene, Fault> {
    let file: SceneFile = toml::from_str(text).map_err(|error| Fault {
        offset: error.span().map_or(0, |span| span.start),
        message: error.message().to_owned(),
    })?;
    file.into_scene()
}

/// A length above zero [m].
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
struct Length(f64);

impl TryFrom<f64> for Length {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        in_range(value, 1e-3..=1e4).map(Self)
    }
}

/// A coordinate or an angle.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(try_from = "f64")]
struct Number(f64);

impl TryFrom<f64> for Number {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        in_range(value, -1e5..=1e5).map(Self)
    }
}

/// The number of steps of a flight of stairs.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "u32")]
struct Steps(u32);

impl TryFrom<u32> for Steps {
    type Error = String;

    fn try_from(value: u32) -> Result<Self, String> {
        if (1..=100).contains(&value) { Ok(Self(value)) } else { Err(format!("{value} steps, allowed are 1 to 100")) }
    }
}

/// From a lower to an upper end [m].
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "[f64; 2]")]
struct Interval([f64; 2]);

impl TryFrom<[f64; 2]> for Interval {
    type Error = String;

    fn try_from(ends: [f64; 2]) -> Result<Self, String> {
        in_range(ends[0], -1e5..=1e5)?;
        in_range(ends[1], -1e5..=1e5)?;
        if ends[1] - ends[0] >= 1.0 {
            Ok(Self(ends))
        } else {
            Err(format!("{ends:?} must be [lower, upper], at least 1 m apart"))
        }
    }
}

fn in_range(value: f64, range: RangeInclusive<f64>) -> Result<f64, String> {
    if range.contains(&value) {
        Ok(value)
    } else {
        Err(format!("{value} is out of range, allowed are {} to {}", range.start(), range.end()))
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    name: String,
    area: AreaTable,
    terrain: Option<Spanned<TerrainConfig>>,
    start: Spanned<PoseTable>,
    #[serde(default)]
    poses: Vec<Spanned<PoseTable>>,
    #[serde(default, rename = "box")]
    boxes: Vec<Spanned<BoxTable>>,
    #[serde(default, rename = "cylinder")]
    cylinders: Vec<Spanned<CylinderTable>>,
    #[serde(default, rename = "cone")]
    cones: Vec<Spanned<ConeTable>>,
    #[serde(default, rename = "sphere")]
    spheres: Vec<Spanned<SphereTable>>,
    #[serde(default, rename = "tree")]
    trees: Vec<Spanned<TreeTable>>,
    #[serde(default, rename = "house")]
    houses: Vec<Spanned<HouseTable>>,
    #[serde(default, rename = "wall")]
    walls: Vec<Spanned<WallTable>>,
    #[serde(default, rename = "ramp")]
    ramps: Vec<Spanned<RampTable>>,
    #[serde(default, rename = "stairs")]
    stairs: Vec<Spanned<StairsTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AreaTable {
    x_m: Interval,
    y_m: Interval,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseTable {
    x_m: Number,
    y_m: Number,
    #[serde(default)]
    yaw_deg: Number,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BoxTable {
    label: Label,
    x_m: Number,
    y_m: Number,
    z_m: Option<Number>,
    #[serde(default)]
    yaw_deg: Number,
    length_m: Length,
    width_m: Length,
    height_m: Length,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RoundTable {
    label: Label,
    x_m: Number,
    y_m: Number,
    z_m: Option<Number>,
    radius_m: Length,
    height_m: Length,
}

#[derive(Deserialize)]
#[serde(transparent)]
struct CylinderTable(RoundTable);

#[derive(Deserialize)]
#[serde(transparent)]
struct ConeTable(RoundTable);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SphereTable {
    label: Label,
    x_m: Number,
    y_m: Number,
    z_m: Option<Number>,
    radius_m: Length,
}

/// The form of a tree's crown.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Crown {
    /// A broad-leaved tree: the trunk ends in the middle of the crown.
    #[default]
    Sphere,
    /// A conifer: the trunk ends at the crown's base.
    Cone,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TreeTable {
    x_m: Number,
    y_m: Number,
    trunk_radius_m: Length,
    trunk_height_m: Length,
    crown_radius_m: Length,
    #[serde(default)]
    crown: Crown,
    /// Of a cone only; twice the radius unless given.
    crown_height_m: Option<Length>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HouseTable {
    x_m: Number,
    y_m: Number,
    #[serde(default)]
    yaw_deg: Number,
    length_m: Length,
    width_m: Length,
    wall_height_m: Length,
    roof_height_m: Length,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WallTable {
    from_m: [Number; 2],
    to_m: [Number; 2],
    height_m: Length,
    thickness_m: Length,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RampTable {
    x_m: Number,
    y_m: Number,
    #[serde(default)]
    yaw_deg: Number,
    length_m: Length,
    width_m: Length,
    height_m: Length,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StairsTable {
    /// Middle of the first riser.
    x_m: Number,
    y_m: Number,
    /// Upwards.
    #[serde(default)]
    yaw_deg: Number,
    width_m: Length,
    tread_m: Length,
    riser_m: Length,
    steps: Steps,
}

impl PoseTable {
    fn pose(&self) -> ScanPose {
        ScanPose { x: self.x_m.0, y: self.y_m.0, yaw: self.yaw_deg.0.to_radians() }
    }
}

/// What a table places in the scene.
trait Place {
    /// The objects, in the order in which they are built.
    fn place(&self, objects: &mut Vec<SceneObject>);
}

fn placement(z: Option<Number>) -> Placement {
    z.map_or(Placement::OnGround { above: 0.0 }, |z| Placement::At { z: z.0 })
}

impl Place for BoxTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let size = Vector3::new(self.length_m.0, self.width_m.0, self.height_m.0);
        objects.push(SceneObject {
            label: self.label,
            shape: Shape::Box { size },
            x: self.x_m.0,
            y: self.y_m.0,
            yaw: self.yaw_deg.0.to_radians(),
            placement: placement(self.z_m),
        });
    }
}

impl RoundTable {
    fn object(&self, shape: Shape) -> SceneObject {
        let (x, y) = (self.x_m.0, self.y_m.0);
        SceneObject { label: self.label, shape, x, y, yaw: 0.0, placement: placement(self.z_m) }
    }
}

impl Place for CylinderTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let (radius, height) = (self.0.radius_m.0, self.0.height_m.0);
        objects.push(self.0.object(Shape::Cylinder { radius, height }));
    }
}

impl Place for ConeTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let (radius, height) = (self.0.radius_m.0, self.0.height_m.0);
        objects.push(self.0.object(Shape::Cone { radius, height }));
    }
}

impl Place for SphereTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let shape = Shape::Sphere { radius: self.radius_m.0 };
        let (x, y) = (self.x_m.0, self.y_m.0);
        objects.push(SceneObject { label: self.label, shape, x, y, yaw: 0.0, placement: placement(self.z_m) });
    }
}

impl Place for TreeTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let (trunk, radius) = (self.trunk_height_m.0, self.crown_radius_m.0);
        let mut put = |shape, above| {
            let placement = Placement::OnGround { above };
            objects.push(SceneObject { label: Label::Tree, shape, x: self.x_m.0, y: self.y_m.0, yaw: 0.0, placement });
        };
        put(Shape::Cylinder { radius: self.trunk_radius_m.0, height: trunk }, 0.0);
        match self.crown {
            Crown::Sphere => put(Shape::Sphere { radius }, trunk - radius),
            Crown::Cone => {
                put(Shape::Cone { radius, height: self.crown_height_m.map_or(2.0 * radius, |h| h.0) }, trunk);
            }
        }
    }
}

impl Place for HouseTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        objects.push(SceneObject {
            label: Label::Building,
            shape: Shape::House {
                length: self.length_m.0,
                width: self.width_m.0,
                wall_height: self.wall_height_m.0,
                roof_height: self.roof_height_m.0,
            },
            x: self.x_m.0,
            y: self.y_m.0,
            yaw: self.yaw_deg.0.to_radians(),
            placement: placement(None),
        });
    }
}

impl Place for WallTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let ([x0, y0], [x1, y1]) = (self.from_m.map(|n| n.0), self.to_m.map(|n| n.0));
        objects.push(SceneObject {
            label: Label::Wall,
            shape: Shape::Box { size: Vector3::new((x1 - x0).hypot(y1 - y0), self.thickness_m.0, self.height_m.0) },
            x: (x0 + x1) / 2.0,
            y: (y0 + y1) / 2.0,
            yaw: (y1 - y0).atan2(x1 - x0),
            placement: placement(None),
        });
    }
}

impl Place for RampTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        objects.push(SceneObject {
            label: Label::Ramp,
            shape: Shape::Ramp { length: self.length_m.0, width: self.width_m.0, height: self.height_m.0 },
            x: self.x_m.0,
            y: self.y_m.0,
            yaw: self.yaw_deg.0.to_radians(),
            placement: placement(None),
        });
    }
}

impl Place for StairsTable {
    fn place(&self, objects: &mut Vec<SceneObject>) {
        let yaw = self.yaw_deg.0.to_radians();
        for step in 0..self.steps.0 {
            // Each step is a block from its riser to the end of its tread.
            let ahead = (f64::from(step) + 0.5) * self.tread_m.0;
            let size = Vector3::new(self.tread_m.0, self.width_m.0, f64::from(step + 1) * self.riser_m.0);
            objects.push(SceneObject {
                label: Label::Stairs,
                shape: Shape::Box { size },
                x: self.x_m.0 + ahead * yaw.cos(),
                y: self.y_m.0 + ahead * yaw.sin(),
                yaw,
                placement: placement(None),
            });
        }
    }
}

/// Places every table of one kind; each object must stand on the ground.
fn place_all<T: Place>(tables: &[Spanned<T>], ground: &WorkArea, objects: &mut Vec<SceneObject>) -> Result<(), Fault> {
    for table in tables {
        let first = objects.len();
        table.get_ref().place(objects);
        if let Some(lost) = objects.iter().skip(first).find(|o| !ground.contains(o.x, o.y)) {
            let message = format!(
                "an object at x = {:.3}, y = {:.3} stands beyond the ground, which ends at x = {:?}, y = {:?} \
                 (area and terrain.margin_m)",
                lost.x, lost.y, ground.x_m, ground.y_m
            );
            return Err(Fault { offset: table.span().start, message });
        }
    }
    Ok(())
}

/// The pose of a table, which must lie in the area.
fn pose_in(area: &WorkArea, table: &Spanned<PoseTable>) -> Result<ScanPose, Fault> {
    let pose = table.get_ref().pose();
    if area.contains(pose.x, pose.y) {
        return Ok(pose);
    }
    let message =
        format!("x_m = {}, y_m = {} must lie in the area, x = {:?}, y = {:?}", pose.x, pose.y, area.x_m, area.y_m);
    Err(Fault { offset: table.span().start, message })
}

impl SceneFile {
    fn into_scene(self) -> Result<Scene, Fault> {
        let area = WorkArea { x_m: self.area.x_m.0, y_m: self.area.y_m.0 };
        let terrain_offset = self.terrain.as_ref().map_or(0, |t| t.span().start);
        let terrain = self.terrain.map(Spanned::into_inner).unwrap_or_default();
        if let Some((field, allowed)) = terrain.fault(&area) {
            return Err(Fault { offset: terrain_offset, message: format!("terrain.{field} {allowed}") });
        }
        let widen = |[low, high]: [f64; 2]| [low - terrain.margin_m, high + terrain.margin_m];
        let ground = WorkArea { x_m: widen(area.x_m), y_m: widen(area.y_m) };

        let mut objects = Vec::new();
        place_all(&self.boxes, &ground, &mut objects)?;
        place_all(&self.cylinders, &ground, &mut objects)?;
        place_all(&self.cones, &ground, &mut objects)?;
        place_all(&self.spheres, &ground, &mut objects)?;
        place_all(&self.trees, &ground, &mut objects)?;
        place_all(&self.houses, &ground, &mut objects)?;
        place_all(&self.walls, &ground, &mut objects)?;
        place_all(&self.ramps, &ground, &mut objects)?;
        place_all(&self.stairs, &ground, &mut objects)?;

        let start = pose_in(&area, &self.start)?;
        let poses = self.poses.iter().map(|table| pose_in(&area, table)).collect::<Result<_, _>>()?;
        Ok(Scene { name: self.name, area, terrain, objects, start, poses })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEAD: &str = "name = \"t\"\n[area]\nx_m = [-5, 5]\ny_m = [-5, 5]\n[start]\nx_m = 0\ny_m = 0\n";

    fn message(tail: &str) -> String {
        Scene::from_toml(&format!("{HEAD}{tail}"), "a.toml").unwrap_err().to_string()
    }

    #[test]
    fn the_smallest_scene_is_flat_and_empty() {
        let scene = Scene::from_toml(HEAD, "a.toml").unwrap();
        assert!(scene.objects.is_empty() && scene.poses.is_empty());
        assert_eq!(scene.terrain, TerrainConfig::default());
    }

    #[test]
    fn an_unknown_key_is_reported_with_its_line_and_the_known_keys() {
        let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = 1\ny_m = 1\nradios_m = 2\n");
        assert!(text.starts_with("a.toml, line 12: unknown field `radios_m`"), "{text}");
        assert!(text.contains("`radius_m`"), "{text}");
    }

    #[test]
    fn an_unknown_kind_of_object_is_answered_with_the_known_kinds() {
        let text = message("[[pyramid]]\nx_m = 1\n");
        assert!(text.contains("line 8") && text.contains("`pyramid`") && text.contains("`house`"), "{text}");
    }

    #[test]
    fn an_unknown_label_is_answered_with_the_known_labels() {
        let text = message("[[sphere]]\nlabel = \"dragon\"\nx_m = 1\ny_m = 1\nradius_m = 2\n");
        assert!(text.contains("line 9") && text.contains("`dragon`") && text.contains("`vehicle`"), "{text}");
    }

    #[test]
    fn a_value_out_of_range_is_reported_with_line_key_and_range() {
        let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = 1\ny_m = 1\nradius_m = -2\n");
        assert!(text.starts_with("a.toml, line 12: -2 is out of range, allowed are 0.001 to 10000"), "{text}");
        assert!(text.contains("radius_m = -2"), "{text}");
        let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = nan\ny_m = 1\nradius_m = 2\n");
        assert!(text.contains("line 10") && text.contains("x_m = nan"), "{text}");
    }

    #[test]
    fn a_missing_key_is_named() {
        let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = 1\nradius_m = 2\n");
        assert!(text.contains("line 8") && text.contains("`y_m`"), "{text}");
    }

    #[test]
    fn a_terrain_value_out_of_range_is_named() {
        let text = message("[terrain]\ncell_m = -1\n");
        assert!(text.contains("line 8") && text.contains("terrain.cell_m must be above 0"), "{text}");
    }

    #[test]
    fn a_pose_outside_the_area_and_an_object_beyond_the_ground_are_refused() {
        let text = message("[[poses]]\nx_m = 1\ny_m = 1\n[[poses]]\nx_m = 7\ny_m = 1\n");
        assert!(text.contains("line 11") && text.contains("x_m = 7"), "{text}");
        let text = message("[[sphere]]\nlabel = \"tree\"\nx_m = 70\ny_m = 1\nradius_m = 2\n");
        assert!(text.contains("line 8") && text.contains("beyond the ground"), "{text}");
    }

    #[test]
    fn stairs_climb_along_their_heading() {
        let tail =
            "[[stairs]]\nx_m = 1\ny_m = 0\nyaw_deg = 90\nwidth_m = 2\ntread_m = 0.3\nriser_m = 0.16\nsteps = 3\n";
        let scene = Scene::from_toml(&format!("{HEAD}{tail}"), "a.toml").unwrap();
        assert_eq!(scene.objects.len(), 3);
        let last = scene.objects[2];
        assert!((last.x - 1.0).abs() < 1e-12 && (last.y - 0.75).abs() < 1e-12);
        assert!(matches!(last.shape, Shape::Box { size } if (size.z - 0.48).abs() < 1e-12));
    }

    proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(tail in "[\\[\\]a-z_=\"0-9\n. -]{0,80}") {
            let _ = Scene::from_toml(&format!("{HEAD}{tail}"), "a.toml");
            let _ = Scene::from_toml(&tail, "a.toml");
        }
    }
}
