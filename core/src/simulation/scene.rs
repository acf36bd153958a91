//! A scene: ground, labelled objects, and the poses from which it is scanned.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::scene_file;
use super::shapes::Shape;
use super::terrain::TerrainConfig;

/// The scenes that come with the program: name and text.
const BUILTIN: [(&str, &str); 2] = [
    ("plane", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/plane.toml"))),
    ("simple", include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/simple.toml"))),
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
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Reads a scene from text; `file` is what error messages call it.
    ///
    /// # Errors
    /// When the text is not a valid scene; the message names `file`, line, key and what is allowed.
    pub fn from_toml(text: &str, file: &str) -> Result<Self, SceneError> {
        scene_file::parse(text).map_err(|fault| {
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
        Self::from_toml(text, &format!("built-in scene {name}"))
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
fn line_at(text: &str, offset: usize) -> (usize, &str) {
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
        assert!(message.contains("`moon`") && message.contains("plane, simple"), "{message}");
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = Scene::load(Path::new("no/such/scene.toml")).unwrap_err().to_string();
        assert!(message.starts_with("no/such/scene.toml: cannot read"), "{message}");
    }

    #[test]
    fn a_scene_file_on_disk_is_the_scene_in_its_text() {
        let text = BUILTIN[1].1;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hill.toml");
        std::fs::write(&path, text).unwrap();
        assert_eq!(Scene::load(&path).unwrap(), Scene::builtin("simple").unwrap());
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
