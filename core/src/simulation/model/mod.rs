//! Meshes from files: ply, dae, off, 3ds and obj.

mod dae;
mod error;
mod mesh;
mod obj;
mod off;
mod ply;
#[cfg(test)]
mod tests;
mod three_ds;

pub use error::{ModelError, Place};
pub use mesh::Mesh;

use std::path::Path;

/// The endings of the formats that can be read.
const KNOWN: &str = "ply, dae, off, 3ds, obj";

/// Files beside a model, for materials: gives the text of the file of a name, if there is one.
pub(super) type Beside<'a> = &'a dyn Fn(&str) -> Option<Vec<u8>>;

impl Mesh {
    /// Reads a mesh file; its ending tells the format. Polygons are cut into triangles, faces keep the diffuse colour of
    /// their material or the mean colour of their vertices. dae files are turned so that z is up and scaled to metres,
    /// as they say themselves; all others are taken as they are.
    ///
    /// # Errors
    /// When the file cannot be read, is damaged, or has a coordinate that is not finite or a face without area.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        let name = path.display().to_string();
        let bytes = std::fs::read(path).map_err(|source| ModelError::Read { file: name.clone(), source })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mesh = Self::from_bytes(&bytes, &name, &|beside| std::fs::read(folder.join(beside)).ok())?;
        mesh.checked(&name)
    }

    /// Reads a mesh from the bytes of a file, not yet checked; `file` tells the format and is what errors call it.
    pub(super) fn from_bytes(bytes: &[u8], file: &str, beside: Beside<'_>) -> Result<Self, ModelError> {
        let ending = file.rsplit_once('.').map_or(String::new(), |(_, ending)| ending.to_ascii_lowercase());
        let read = match ending.as_str() {
            "ply" => ply::read(bytes),
            "dae" => dae::read(bytes),
            "off" => off::read(bytes),
            "3ds" => three_ds::read(bytes),
            "obj" => obj::read(bytes, beside),
            _ => return Err(ModelError::UnknownFormat { file: file.to_owned(), known: KNOWN }),
        };
        read.map_err(|fault| ModelError::Malformed { file: file.to_owned(), at: fault.at, reason: fault.reason })
    }
}
