//! LAS and LAZ out, version 1.4, point format 6.

use super::{
    super::{cloud_format::file_name, error::WriteError},
    CloudWriter, OutPoint,
    temporary::{create_beside, publish},
};
use las::{Builder, Transform, Vector, Version, point::Format};
use std::{
    fs::File,
    io::{self, BufWriter, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};
use tempfile::TempPath;

/// Step of the stored coordinates [m]: a tenth of a millimetre reaches 214 km around the origin.
const SCALE_M: f64 = 1e-4;

/// Writes position (in steps of 0.1 mm around the origin), intensity, the scan's id as point source id (65535 for any
/// larger), and quality * 255 as user data. LAS has
/// no empty cells: they are left out.
pub struct LasWriter {
    path: PathBuf,
    origin: [f64; 3],
    /// `None` once it is finished.
    writer: Option<las::Writer<Output>>,
    is_abandoned: Arc<AtomicBool>,
    name: Option<TempPath>,
    count: u64,
}

/// The file under the encoder. The encoder completes its file when it is dropped and panics if it cannot (a full disk):
/// an output that is given up takes everything and keeps nothing.
struct Output {
    file: BufWriter<File>,
    is_abandoned: Arc<AtomicBool>,
    /// Where the encoder believes to be after the output was given up.
    position: u64,
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.is_abandoned.load(Ordering::Relaxed) {
            self.position = self.position.saturating_add(bytes.len() as u64);
            return Ok(bytes.len());
        }
        let written = self.file.write(bytes)?;
        self.position += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.is_abandoned.load(Ordering::Relaxed) { Ok(()) } else { self.file.flush() }
    }
}

impl Seek for Output {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.position = match to {
            _ if !self.is_abandoned.load(Ordering::Relaxed) => self.file.seek(to)?,
            SeekFrom::Start(position) => position,
            SeekFrom::Current(step) | SeekFrom::End(step) => self.position.saturating_add_signed(step),
        };
        Ok(self.position)
    }
}

impl LasWriter {
    /// Begins a file; it is compressed when its name ends in `.laz`. Coordinates are stored around `origin` [m].
    ///
    /// # Errors
    /// A folder that cannot be written to.
    pub fn create(path: &Path, origin: [f64; 3]) -> Result<Self, WriteError> {
        let fail = |e: las::Error| WriteError::Las { path: path.to_path_buf(), reason: e.to_string() };
        let mut builder = Builder::default();
        builder.version = Version::new(1, 4);
        builder.point_format = Format::new(6).map_err(fail)?;
        builder.point_format.is_compressed = file_name(path).ends_with(".laz");
        let [x, y, z] = origin.map(|offset| Transform { scale: SCALE_M, offset });
        builder.transforms = Vector { x, y, z };
        builder.generating_software = "mirador".into();
        // No date: the same points give the same bytes.
        builder.date = None;
        let header = builder.into_header().map_err(fail)?;
        let (file, name) = create_beside(path)?;
        let is_abandoned = Arc::new(AtomicBool::new(false));
        let file = BufWriter::with_capacity(1 << 16, file);
        let output = Output { file, is_abandoned: Arc::clone(&is_abandoned), position: 0 };
        let writer = Some(las::Writer::new(output, header).map_err(fail)?);
        Ok(Self { path: path.to_path_buf(), origin, writer, is_abandoned, name: Some(name), count: 0 })
    }

    /// The encoder counts a point before it finds that it cannot store it, and the file could not be completed then.
    fn check_reach(&self, position: [f64; 3]) -> Result<(), WriteError> {
        let reach = f64::from(i32::MAX) * SCALE_M;
        if position.iter().zip(self.origin).all(|(c, origin)| (c - origin).abs() < reach) {
            return Ok(());
        }
        let reason = format!("{position:?} is farther than {reach:.0} m from {:?}", self.origin);
        Err(WriteError::Las { path: self.path.clone(), reason })
    }

    fn fail(&self, error: &las::Error) -> WriteError {
        WriteError::Las { path: self.path.clone(), reason: error.to_string() }
    }
}

impl Drop for LasWriter {
    fn drop(&mut self) {
        self.is_abandoned.store(true, Ordering::Relaxed);
    }
}

impl CloudWriter for LasWriter {
    fn write(&mut self, points: &[OutPoint]) -> Result<(), WriteError> {
        for point in points.iter().filter(|point| point.is_return()) {
            let [x, y, z] = point.position;
            self.check_reach(point.position)?;
            let record = las::Point {
                x,
                y,
                z,
                intensity: point.intensity,
                return_number: 1,
                number_of_returns: 1,
                user_data: (point.quality.clamp(0.0, 1.0) * 255.0).round() as u8,
                point_source_id: u16::try_from(point.scan).unwrap_or(u16::MAX),
                gps_time: Some(0.0),
                ..Default::default()
            };
            let Some(writer) = &mut self.writer else { break };
            writer.write_point(record).map_err(|e| self.fail(&e))?;
            self.count += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<u64, WriteError> {
        let Some(writer) = &mut self.writer else { return Ok(self.count) };
        writer.close().map_err(|e| self.fail(&e))?;
        if let (Some(writer), Some(name)) = (self.writer.take(), self.name.take()) {
            let output = writer.into_inner().map_err(|e| self.fail(&e))?;
            let file = output.file.into_inner().map_err(|e| WriteError::io(&self.path, e.into_error()))?;
            publish(&self.path, &file, name)?;
        }
        Ok(self.count)
    }
}
