//! A scene: ground, labelled objects, and the poses from which it is scanned.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::assets::Assets;
use super::model::Mesh;
use super::robot::Robot;
use super::scene_file;
use super::shapes::Shape;
use super::terrain::TerrainConfig;

/// The scenes that come with the program: name and text.
const BUILTIN: [(&str, &str); 5] = [
    ("field", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/field.toml"))),
    ("plane", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/plane.toml"))),
    ("simple", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/simple.toml"))),
    ("structured", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/structured.toml"))),
    ("unstructured", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/unstructured.toml"))),
];

/// What a surface is: the truth that scores are tested against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[repr(u8)]
pub enum Label {
    /// Terrain the robot may drive on, slope permitting.
    Ground,
    /// A house.
    Building,
    /// A free-standing wall or a fence.
    Wall,
    /// Trunk or crown.
    Tree,
    /// A parked car.
    Vehicle,
    /// A low step beside a street.
    Kerb,
    /// A flight of steps.
    Stairs,
    /// An artificial slope the robot may drive on.
    Ramp,
    /// Anything else that stands in the way.
    Other,
}

impl Label {
    /// All labels, in the order of their numbers.
    pub const ALL: [Self; 9] = [
        Self::Ground,
        Self::Building,
        Self::Wall,
        Self::Tree,
        Self::Vehicle,
        Self::Kerb,
        Self::Stairs,
        Self::Ramp,
        Self::Other,
    ];

    /// The colour of such things when nothing else is said.
    #[must_use]
    pub fn colour(self) -> Colour {
        Colour(match self {
            Self::Ground => [122, 134, 92],
            Self::Building => [196, 178, 152],
            Self::Wall => [170, 166, 160],
            Self::Tree => [74, 98, 52],
            Self::Vehicle => [60, 84, 140],
            Self::Kerb => [186, 186, 182],
            Self::Stairs => [160, 150, 140],
            Self::Ramp => [150, 146, 140],
            Self::Other => [178, 122, 72],
        })
    }

    /// Whether the thing stands in the robot's way: all but ground and ramps. (The top of a kerb or a car is flat; its
    /// label is an obstacle's nevertheless.)
    #[must_use]
    pub fn is_obstacle(self) -> bool {
        !matches!(self, Self::Ground | Self::Ramp)
    }
}

/// The rectangle the robot has to explore [m], map frame: each interval from its lower to its upper end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorkArea {
    /// Along x.
    pub x_m: [f64; 2],
    /// Along y.
    pub y_m: [f64; 2],
}

impl WorkArea {
    /// Whether (x, y) lies in the area or on its edge.
    #[must_use]
    pub fn contains(&self, x: f64, y: f64) -> bool {
        (self.x_m[0]..=self.x_m[1]).contains(&x) && (self.y_m[0]..=self.y_m[1]).contains(&y)
    }
}

/// Where a scan is taken: position on the ground [m] and heading [rad]; the height follows from the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanPose {
    /// Map frame [m].
    pub x: f64,
    /// Map frame [m].
    pub y: f64,
    /// From the map's x axis towards y [rad].
    pub yaw: f64,
}

/// The colour of a surface: red, green and blue, 0 to 255. Bright surfaces return more of the laser's light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Colour(pub [u8; 3]);

impl Colour {
    /// The share of light that comes back, 0 to 1: the weighted mean of the three (ITU-R BT.601).
    #[must_use]
    pub fn reflectance(self) -> f64 {
        let [r, g, b] = self.0.map(f64::from);
        (0.299 * r + 0.587 * g + 0.114 * b) / 255.0
    }
}

/// The height at which an object's base lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Placement {
    /// So much above the ground under its middle [m]. At 0 it stands, with a foundation 1 m into the ground, so that no
    /// gap opens where the ground falls away from its middle.
    OnGround {
        /// Height of the base over the ground [m].
        above: f64,
    },
    /// At this z of the map frame [m].
    At {
        /// Height of the base [m].
        z: f64,
    },
}

/// A labelled solid, turned about z by its yaw and moved to its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneObject {
    /// What it is.
    pub label: Label,
    /// Its form.
    pub shape: Shape,
    /// Middle of its base [m].
    pub x: f64,
    /// Middle of its base [m].
    pub y: f64,
    /// Heading of its length [rad].
    pub yaw: f64,
    /// Height of its base.
    pub placement: Placement,
    /// Of its surfaces; `None` takes that of its label.
    pub colour: Option<Colour>,
}

/// A mesh from a file, put into the world.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelPlacement {
    /// The file it came from, as the world file names it.
    pub file: String,
    /// What it is.
    pub label: Label,
    /// Its triangles in the file's own frame; shared by all copies.
    pub mesh: Arc<Mesh>,
    /// Where the file's origin comes to lie: x and y [m].
    pub position: [f64; 2],
    /// The height of the file's origin.
    pub placement: Placement,
    /// Roll, pitch and yaw about the fixed axes x, y and z, in this order [rad].
    pub rotation: [f64; 3],
    /// Factors along the file's own axes.
    pub scale: [f64; 3],
    /// Instead of the colours in the file.
    pub colour: Option<Colour>,
}

/// Where a scene was read from, for errors that only show when it is built.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Origin {
    /// The world file, empty when there is none.
    pub file: String,
    /// Line of the start.
    pub start_line: usize,
    /// Line of the work area.
    pub area_line: usize,
}

/// A scene as read from a file; [`super::CompiledScene`] is what rays are cast against.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Its name.
    pub name: String,
    /// The rectangle to explore.
    pub area: WorkArea,
    /// The ground.
    pub terrain: TerrainConfig,
    /// Everything that stands on it. A tree is two objects, stairs are one a step.
    pub objects: Vec<SceneObject>,
    /// Meshes from files.
    pub models: Vec<ModelPlacement>,
    /// The robots, each with its sensors. Empty when the file names none: [`Robot::default`] at the start is meant.
    pub robots: Vec<Robot>,
    /// Of the ground.
    pub ground_colour: Colour,
    /// Where it was read from.
    pub origin: Origin,
    /// Where an exploration begins.
    pub start: ScanPose,
    /// The poses that a fixed tour visits, in order.
    pub poses: Vec<ScanPose>,
}

/// Why a scene could not be had.
#[derive(Debug, Error)]
pub enum SceneError {
    /// The file is missing or not readable.
    #[error("{}: cannot read the scene file: {source}", path.display())]
    Read {
        /// The file asked for.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The text is not TOML, a key is unknown or missing, or a value is out of its range.
    #[error("{file}, line {line}: {message} (the line reads: `{text}`)")]
    Invalid {
        /// File, or name of the text.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key, what is wrong with it, and what would be right.
        message: String,
        /// The line's text.
        text: String,
    },
    /// No such scene comes with the program.
    #[error("no built-in scene is called `{name}`; there are: {}", Scene::builtin_names().join(", "))]
    UnknownBuiltin {
        /// The name asked for.
        name: String,
    },
}

impl Scene {
    /// Reads a scene file.
    ///
    /// # Errors
    /// When the file cannot be read or is not a valid scene; the message names file, line, key and what is allowed.
    pub fn load(path: &Path) -> Result<Self, SceneError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| SceneError::Read { path: path.to_path_buf(), source })?;
        Self::parse(&text, &path.display().to_string(), &Assets::beside(path))
    }

    /// Reads a scene from text; `file` is what error messages call it. Files that it names are looked for in the current
    /// folder.
    ///
    /// # Errors
    /// When the text is not a valid scene; the message names `file`, line, key and what is allowed.
    pub fn from_toml(text: &str, file: &str) -> Result<Self, SceneError> {
        Self::parse(text, file, &Assets::beside(Path::new("")))
    }

    fn parse(text: &str, file: &str, assets: &Assets) -> Result<Self, SceneError> {
        let parsed = scene_file::parse(text, file, assets);
        parsed.map_err(|fault| {
            let (line, text) = line_at(text, fault.offset);
            SceneError::Invalid { file: file.to_owned(), line, message: fault.message, text: text.trim().to_owned() }
        })
    }

    /// A scene that comes with the program.
    ///
    /// # Errors
    /// When there is none of this name.
    pub fn builtin(name: &str) -> Result<Self, SceneError> {
        let found = BUILTIN.iter().find(|(known, _)| *known == name);
        let (name, text) = found.ok_or_else(|| SceneError::UnknownBuiltin { name: name.to_owned() })?;
        Self::parse(text, &format!("built-in scene {name}"), &Assets::BuiltIn)
    }

    /// The names [`Scene::builtin`] knows, in alphabetical order.
    #[must_use]
    pub fn builtin_names() -> Vec<&'static str> {
        BUILTIN.iter().map(|(name, _)| *name).collect()
    }
}

impl fmt::Display for Label {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ground => "ground",
            Self::Building => "building",
            Self::Wall => "wall",
            Self::Tree => "tree",
            Self::Vehicle => "vehicle",
            Self::Kerb => "kerb",
            Self::Stairs => "stairs",
            Self::Ramp => "ramp",
            Self::Other => "other",
        })
    }
}

/// The number (from 1) and the text of the line in which byte `offset` lies.
pub(super) fn line_at(text: &str, offset: usize) -> (usize, &str) {
    let before = text.bytes().take(offset).filter(|&b| b == b'\n').count();
    (before + 1, text.lines().nth(before).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_builtin_scene_can_be_read() {
        for name in Scene::builtin_names() {
            let scene = Scene::builtin(name).unwrap();
            assert_eq!(scene.name, name);
            assert!(!scene.poses.is_empty());
        }
    }

    #[test]
    fn an_unknown_builtin_scene_is_answered_with_the_known_names() {
        let message = Scene::builtin("moon").unwrap_err().to_string();
        assert!(
            message.contains("`moon`") && message.contains("field, plane, simple, structured, unstructured"),
            "{message}"
        );
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = Scene::load(Path::new("no/such/scene.toml")).unwrap_err().to_string();
        assert!(message.starts_with("no/such/scene.toml: cannot read"), "{message}");
    }

    #[test]
    fn a_scene_file_on_disk_is_the_scene_in_its_text() {
        let text = BUILTIN[2].1;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hill.toml");
        std::fs::write(&path, text).unwrap();
        let loaded = Scene::load(&path).unwrap();
        assert_eq!(loaded.origin.file, path.display().to_string());
        let builtin = Scene::builtin("simple").unwrap();
        assert_eq!(Scene { origin: builtin.origin.clone(), ..loaded }, builtin);
    }

    #[test]
    fn only_ground_and_ramps_are_no_obstacles() {
        let free: Vec<_> = Label::ALL.into_iter().filter(|label| !label.is_obstacle()).collect();
        assert_eq!(free, [Label::Ground, Label::Ramp]);
    }

    #[test]
    fn labels_are_numbered_in_their_order() {
        for (number, label) in Label::ALL.into_iter().enumerate() {
            assert_eq!(label as usize, number);
        }
    }
}
