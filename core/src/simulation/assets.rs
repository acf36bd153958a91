//! Files that a world file names: beside it, or built into the program.

use std::path::{Path, PathBuf};

use super::model::{Mesh, ModelError};

macro_rules! built_in {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../worlds/", $name)))),*]
    };
}

/// The files of the built-in worlds.
const BUILT_IN: &[(&str, &[u8])] = built_in![
    "models/car.obj",
    "models/car.mtl",
    "models/bridge.dae",
    "models/bush.ply",
    "models/fountain.off",
    "models/bench.3ds",
    "models/hills.png",
];

/// Where the files of a world are.
pub(super) enum Assets {
    /// In this folder.
    Folder(PathBuf),
    /// In the program.
    BuiltIn,
}

impl Assets {
    /// Those beside a world file.
    pub(super) fn beside(world: &Path) -> Self {
        Self::Folder(world.parent().unwrap_or(Path::new("")).to_path_buf())
    }

    /// The bytes of a file, and what errors call it.
    pub(super) fn read(&self, name: &str) -> Result<(Vec<u8>, String), std::io::Error> {
        match self {
            Self::Folder(folder) => {
                let path = folder.join(name);
                Ok((std::fs::read(&path)?, path.display().to_string()))
            }
            Self::BuiltIn => {
                let found = BUILT_IN.iter().find(|(known, _)| *known == name);
                let (_, bytes) = found.ok_or_else(|| std::io::Error::from(std::io::ErrorKind::NotFound))?;
                Ok((bytes.to_vec(), name.to_owned()))
            }
        }
    }

    /// A mesh, its faces checked, or with those without area left out.
    pub(super) fn mesh(&self, name: &str, drop_degenerate: bool) -> Result<Mesh, ModelError> {
        let (bytes, file) = self.read(name).map_err(|source| ModelError::Read { file: name.to_owned(), source })?;
        let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
        let beside = |other: &str| {
            let path = if folder.is_empty() { other.to_owned() } else { format!("{folder}/{other}") };
            self.read(&path).ok().map(|(bytes, _)| bytes)
        };
        let mesh = Mesh::from_bytes(&bytes, &file, &beside)?;
        let mesh = if drop_degenerate { mesh.without_degenerate() } else { mesh };
        mesh.checked(&file)
    }
}
