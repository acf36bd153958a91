//! The scene file: TOML tables as they are written, and their translation to a [`Scene`].
//!
//! Every kind of solid has an array of tables of its own (`[[box]]`, `[[house]]`, ...), so that a wrong key is reported
//! with its line and with the keys that this kind knows. Angles are in degrees, lengths in metres.

use serde::Deserialize;
use toml::Spanned;

use super::assets::Assets;
use super::file_values::{Interval, Number};
use super::model_tables::{self, ModelTable};
use super::object_tables::{
    BoxTable, ConeTable, CylinderTable, HouseTable, Place, RampTable, SphereTable, StairsTable, TreeTable, WallTable,
};
use super::robot_tables::{self, RobotTable};
use super::scene::{Colour, Label, Origin, ScanPose, Scene, SceneObject, WorkArea, line_at};
use super::terrain::TerrainConfig;

/// What is wrong, and where in the text.
pub(super) struct Fault {
    /// Byte in the text.
    pub(super) offset: usize,
    /// What is wrong and what would be right.
    pub(super) message: String,
}

/// Reads and checks the text of a scene file.
pub(super) fn parse(text: &str, name: &str, assets: &Assets) -> Result<Scene, Fault> {
    let file: SceneFile = toml::from_str(text).map_err(|error| Fault {
        offset: error.span().map_or(0, |span| span.start),
        message: error.message().to_owned(),
    })?;
    file.into_scene(text, name, assets)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    name: String,
    area: Spanned<AreaTable>,
    terrain: Option<Spanned<TerrainConfig>>,
    ground_colour: Option<Colour>,
    start: Spanned<PoseTable>,
    #[serde(default)]
    poses: Vec<Spanned<PoseTable>>,
    #[serde(default, rename = "model")]
    models: Vec<Spanned<ModelTable>>,
    #[serde(default, rename = "robot")]
    robots: Vec<Spanned<RobotTable>>,
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

impl PoseTable {
    fn pose(&self) -> ScanPose {
        ScanPose { x: self.x_m.0, y: self.y_m.0, yaw: self.yaw_deg.0.to_radians() }
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
    fn into_scene(self, text: &str, name: &str, assets: &Assets) -> Result<Scene, Fault> {
        let line = |offset| line_at(text, offset).0;
        let origin = Origin {
            file: name.to_owned(),
            start_line: line(self.start.span().start),
            area_line: line(self.area.span().start),
        };
        let area = self.area.into_inner();
        let area = WorkArea { x_m: area.x_m.0, y_m: area.y_m.0 };
        let terrain_offset = self.terrain.as_ref().map_or(0, |t| t.span().start);
        let mut terrain = self.terrain.map(Spanned::into_inner).unwrap_or_default();
        if let Some(heights) = &mut terrain.heights {
            let message = |reason| format!("terrain.heights: {reason}");
            heights.load(assets).map_err(|reason| Fault { offset: terrain_offset, message: message(reason) })?;
        }
        if let Some((field, allowed)) = terrain.fault(&area) {
            return Err(Fault { offset: terrain_offset, message: format!("terrain.{field} {allowed}") });
        }
        let [x_m, y_m] = terrain.extent(&area);
        let ground = WorkArea { x_m, y_m };

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

        let models = model_tables::models(self.models, &ground, assets)?;

        let start = pose_in(&area, &self.start)?;
        let robots = robot_tables::robots(self.robots, &start, assets, line)?;
        let poses = self.poses.iter().map(|table| pose_in(&area, table)).collect::<Result<_, _>>()?;
        let ground_colour = self.ground_colour.unwrap_or_else(|| Label::Ground.colour());
        Ok(Scene { name: self.name, area, terrain, objects, models, robots, ground_colour, origin, start, poses })
    }
}

#[cfg(test)]
mod tests;
