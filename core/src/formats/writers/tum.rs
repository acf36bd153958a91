//! TUM trajectories out: `timestamp tx ty tz qx qy qz qw` a line.

use super::{super::error::WriteError, temporary::TemporaryFile};
use crate::geometry::Pose;
use std::path::Path;

/// Writes a trajectory.
pub struct TumWriter {
    file: TemporaryFile,
    count: u64,
}

impl TumWriter {
    /// Begins a file with a comment line that names the columns.
    ///
    /// # Errors
    /// A folder that cannot be written to.
    pub fn create(path: &Path) -> Result<Self, WriteError> {
        let mut file = TemporaryFile::create(path)?;
        file.write(b"# timestamp tx ty tz qx qy qz qw (map_from_scanner)\n")?;
        Ok(Self { file, count: 0 })
    }

    /// Appends a pose at a time [s]. Nine decimals: nanometres and nanoseconds.
    ///
    /// # Errors
    /// The disk.
    pub fn write(&mut self, stamp_s: f64, map_from_scanner: &Pose) -> Result<(), WriteError> {
        let t = &map_from_scanner.translation.vector;
        let q = map_from_scanner.rotation.quaternion();
        let line =
            format!("{stamp_s:.9} {:.9} {:.9} {:.9} {:.12} {:.12} {:.12} {:.12}\n", t.x, t.y, t.z, q.i, q.j, q.k, q.w);
        self.count += 1;
        self.file.write(line.as_bytes())
    }

    /// Gives the file its name and returns the number of poses in it.
    ///
    /// # Errors
    /// The disk.
    pub fn finish(self) -> Result<u64, WriteError> {
        self.file.publish()?;
        Ok(self.count)
    }
}
