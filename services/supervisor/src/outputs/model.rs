//! `model.ply`: every point of every scan in the map's frame, with its quality, its scan and whether that was aligned.
//!
//! Streamed: the recording is read one scan at a time, so memory does not grow with the run. The number of points is
//! known at the end and written into the place that the header keeps for it.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

use mirador_core::geometry::Pose;
use mirador_ipc_schema::messages::{Point, PointScore};
use mirador_ipc_schema::topics;
use mirador_recorder::RunReader;
use nalgebra::Point3;

use super::OutputError;
use super::run_data::RunData;

/// Beyond this distance from the origin f32 is too coarse for a millimetre, and coordinates are written as f64 [m].
const F32_REACH_M: f64 = 10_000.0;
/// Quality of a point that was not scored.
const NOT_SCORED: f32 = -1.0;
/// Digits of the largest number of points.
const DIGITS: usize = 20;

/// Writes the model; returns its number of points.
///
/// # Errors
/// See [`OutputError`].
pub fn write_model(reader: &mut RunReader, data: &RunData, path: &Path) -> Result<u64, OutputError> {
    let io = |source| OutputError::Write { path: path.into(), source };
    let mut ply = Ply::create(path, data).map_err(io)?;
    let (mut points, mut scores): (Vec<Point>, Vec<PointScore>) = (Vec::new(), Vec::new());
    for record in &data.scans {
        let (scan, Some(pose)) = (record.number(), record.pose()) else { continue };
        if reader.read_about::<topics::Scan>(scan, &mut points)?.is_none() {
            continue;
        }
        if reader.read_about::<topics::ScoredScan>(scan, &mut scores)?.is_none() {
            scores.clear();
        }
        ply.write_scan(&pose, &points, &scores, scan, record.is_aligned()).map_err(io)?;
    }
    ply.finish().map_err(io)
}

/// A binary PLY file in the making.
struct Ply {
    file: BufWriter<File>,
    header: Header,
    buffer: Vec<u8>,
    points: u64,
}

/// What the header says besides the number of points.
struct Header {
    wide: bool,
    comments: Vec<String>,
}

impl Header {
    /// The header; its length does not depend on the number of points.
    fn text(&self, points: u64) -> String {
        let number = points.to_string();
        let padding = ".".repeat(DIGITS.saturating_sub(number.len()));
        let comments: String = self.comments.iter().map(|c| format!("comment {c}\n")).collect();
        let coordinate = if self.wide { "double" } else { "float" };
        format!(
            "ply\nformat binary_little_endian 1.0\ncomment mirador model, frame map (z up) [m]\n\
             comment quality in 0 to 1, {NOT_SCORED} where a point was not scored\n{comments}comment {padding}\n\
             element vertex {number}\n\
             property {coordinate} x\nproperty {coordinate} y\nproperty {coordinate} z\n\
             property ushort intensity\nproperty float quality\nproperty uint scan\nproperty uchar aligned\nend_header\n"
        )
    }
}

impl Ply {
    fn create(path: &Path, data: &RunData) -> io::Result<Self> {
        let is_far = |pose: Pose| pose.translation.vector.amax() > F32_REACH_M;
        let wide = data.scans.iter().filter_map(super::run_data::ScanRecord::pose).any(is_far);
        let unaligned = |s: &super::run_data::ScanRecord| {
            Some(format!("scan {} is not aligned: {}", s.number(), super::one_line(&s.reason()?)))
        };
        let header = Header { wide, comments: data.scans.iter().filter_map(unaligned).collect() };
        let mut file = BufWriter::with_capacity(1 << 20, File::create(path)?);
        file.write_all(header.text(0).as_bytes())?;
        Ok(Self { file, header, buffer: Vec::new(), points: 0 })
    }

    /// Writes the returns of a scan; without scores their quality is unknown.
    fn write_scan(
        &mut self,
        map_from_scanner: &Pose,
        points: &[Point],
        scores: &[PointScore],
        scan: u32,
        aligned: bool,
    ) -> io::Result<()> {
        self.buffer.clear();
        for (k, point) in points.iter().enumerate() {
            if !(point.x.is_finite() && point.y.is_finite() && point.z.is_finite()) {
                continue;
            }
            let p = map_from_scanner * Point3::new(f64::from(point.x), f64::from(point.y), f64::from(point.z));
            let valid = scores.get(k).filter(|s| s.flags & 1 != 0);
            let quality = valid.map_or(NOT_SCORED, |s| f32::from(s.quality) / 65535.0);
            for value in [p.x, p.y, p.z] {
                if self.header.wide {
                    self.buffer.extend_from_slice(&value.to_le_bytes());
                } else {
                    self.buffer.extend_from_slice(&(value as f32).to_le_bytes());
                }
            }
            self.buffer.extend_from_slice(&point.intensity.to_le_bytes());
            self.buffer.extend_from_slice(&quality.to_le_bytes());
            self.buffer.extend_from_slice(&scan.to_le_bytes());
            self.buffer.push(u8::from(aligned));
            self.points += 1;
        }
        self.file.write_all(&self.buffer)
    }

    fn finish(mut self) -> io::Result<u64> {
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(self.header.text(self.points).as_bytes())?;
        self.file.flush()?;
        Ok(self.points)
    }
}
