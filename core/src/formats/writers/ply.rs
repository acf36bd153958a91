//! PLY out: binary, little-endian.

use super::{
    super::error::WriteError,
    CloudWriter, OutPoint,
    temporary::{TemporaryFile, padded_region},
};
use std::path::Path;

/// Room for the line with the count, whatever the count.
const COUNT_REGION: usize = 64;

/// What the header of a PLY file says.
#[derive(Debug, Clone, Default)]
pub struct PlyOptions {
    /// Coordinates as f64 instead of f32: for positions too large for f32 (an origin that is not zero).
    pub is_double: bool,
    /// Comment lines; line breaks in them become blanks.
    pub comments: Vec<String>,
}

/// Writes the properties x, y, z (float or double), quality (float), scan (uint), intensity (ushort) and aligned
/// (uchar) of every point, empty cells as NaN.
pub struct PlyWriter {
    file: TemporaryFile,
    is_double: bool,
    count: u64,
    count_at: u64,
    buffer: Vec<u8>,
}

impl PlyWriter {
    /// Begins a file.
    ///
    /// # Errors
    /// A folder that cannot be written to.
    pub fn create(path: &Path, options: &PlyOptions) -> Result<Self, WriteError> {
        let mut file = TemporaryFile::create(path)?;
        let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
        for comment in &options.comments {
            header.push_str(&format!("comment {}\n", comment.replace(['\n', '\r'], " ")));
        }
        let count_at = header.len() as u64;
        header.push_str(&count_region(0));
        let kind = if options.is_double { "double" } else { "float" };
        for axis in ["x", "y", "z"] {
            header.push_str(&format!("property {kind} {axis}\n"));
        }
        header.push_str(
            "property float quality\nproperty uint scan\nproperty ushort intensity\nproperty uchar aligned\n",
        );
        header.push_str("end_header\n");
        file.write(header.as_bytes())?;
        Ok(Self { file, is_double: options.is_double, count: 0, count_at, buffer: Vec::new() })
    }
}

fn count_region(count: u64) -> String {
    padded_region("comment", &format!("element vertex {count}\n"), COUNT_REGION)
}

impl CloudWriter for PlyWriter {
    fn write(&mut self, points: &[OutPoint]) -> Result<(), WriteError> {
        for point in points {
            self.buffer.clear();
            for c in point.position {
                if self.is_double {
                    self.buffer.extend_from_slice(&c.to_le_bytes());
                } else {
                    self.buffer.extend_from_slice(&(c as f32).to_le_bytes());
                }
            }
            self.buffer.extend_from_slice(&point.quality.to_le_bytes());
            self.buffer.extend_from_slice(&point.scan.to_le_bytes());
            self.buffer.extend_from_slice(&point.intensity.to_le_bytes());
            self.buffer.push(u8::from(point.is_aligned));
            self.file.write(&self.buffer)?;
        }
        self.count += points.len() as u64;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<u64, WriteError> {
        self.file.patch(self.count_at, count_region(self.count).as_bytes())?;
        self.file.publish()?;
        Ok(self.count)
    }
}
