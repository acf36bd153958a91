//! PCD out: binary.

use super::{
    super::error::WriteError,
    CloudWriter, OutPoint,
    temporary::{TemporaryFile, padded_region},
};
use crate::scan::Grid;
use std::path::Path;

/// Room for WIDTH to POINTS, whatever the numbers.
const SIZE_REGION: usize = 160;

/// What the header of a PCD file says.
#[derive(Debug, Clone, Copy, Default)]
pub struct PcdOptions {
    /// Coordinates as f64 instead of f32: for positions too large for f32 (an origin that is not zero).
    pub is_double: bool,
    /// The order of the points: HEIGHT rows of WIDTH columns. Without one the cloud is a single row.
    pub grid: Option<Grid>,
}

/// Writes the fields x, y, z (F 4 or F 8), intensity (F 4, as other readers expect), quality (F 4), scan (U 4) and
/// aligned (U 1) of every point, empty cells as NaN.
pub struct PcdWriter {
    file: TemporaryFile,
    options: PcdOptions,
    count: u64,
    size_at: u64,
    buffer: Vec<u8>,
}

impl PcdWriter {
    /// Begins a file.
    ///
    /// # Errors
    /// A folder that cannot be written to.
    pub fn create(path: &Path, options: &PcdOptions) -> Result<Self, WriteError> {
        let mut file = TemporaryFile::create(path)?;
        let c = if options.is_double { 8 } else { 4 };
        let head = format!(
            "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity quality scan aligned\n\
             SIZE {c} {c} {c} 4 4 4 1\nTYPE F F F F F U U\nCOUNT 1 1 1 1 1 1 1\n"
        );
        let size_at = head.len() as u64;
        file.write(head.as_bytes())?;
        file.write(size_region(0, 1, 0).as_bytes())?;
        file.write(b"DATA binary\n")?;
        Ok(Self { file, options: *options, count: 0, size_at, buffer: Vec::new() })
    }
}

fn size_region(width: u64, height: u64, points: u64) -> String {
    let lines = format!("WIDTH {width}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\n");
    padded_region("#", &lines, SIZE_REGION)
}

impl CloudWriter for PcdWriter {
    fn write(&mut self, points: &[OutPoint]) -> Result<(), WriteError> {
        for point in points {
            self.buffer.clear();
            for c in point.position {
                if self.options.is_double {
                    self.buffer.extend_from_slice(&c.to_le_bytes());
                } else {
                    self.buffer.extend_from_slice(&(c as f32).to_le_bytes());
                }
            }
            self.buffer.extend_from_slice(&f32::from(point.intensity).to_le_bytes());
            self.buffer.extend_from_slice(&point.quality.to_le_bytes());
            self.buffer.extend_from_slice(&point.scan.to_le_bytes());
            self.buffer.push(u8::from(point.is_aligned));
            self.file.write(&self.buffer)?;
        }
        self.count += points.len() as u64;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<u64, WriteError> {
        let (width, height) = match self.options.grid {
            None => (self.count, 1),
            Some(Grid { rows, cols }) => {
                if (rows as u64).checked_mul(cols as u64) != Some(self.count) {
                    let path = self.file.path().to_path_buf();
                    return Err(WriteError::GridMismatch { path, points: self.count, rows, cols });
                }
                (cols as u64, rows as u64)
            }
        };
        self.file.patch(self.size_at, size_region(width, height, self.count).as_bytes())?;
        self.file.publish()?;
        Ok(self.count)
    }
}
