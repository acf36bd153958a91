//! `.xyz32.bin` out: little-endian f32 x, y, z [m].

use super::{super::error::WriteError, CloudWriter, OutPoint, temporary::TemporaryFile};
use std::path::Path;

/// Writes positions only, empty cells as NaN.
pub struct Xyz32Writer {
    file: TemporaryFile,
    count: u64,
}

impl Xyz32Writer {
    /// Begins a file.
    ///
    /// # Errors
    /// A folder that cannot be written to.
    pub fn create(path: &Path) -> Result<Self, WriteError> {
        Ok(Self { file: TemporaryFile::create(path)?, count: 0 })
    }
}

impl CloudWriter for Xyz32Writer {
    fn write(&mut self, points: &[OutPoint]) -> Result<(), WriteError> {
        for point in points {
            for c in point.position {
                self.file.write(&(c as f32).to_le_bytes())?;
            }
        }
        self.count += points.len() as u64;
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<u64, WriteError> {
        self.file.publish()?;
        Ok(self.count)
    }
}
