//! Clouds in: one streaming reader for every format.

use super::{
    cloud_format::CloudFormat, csv::CsvReader, error::FormatError, las::LasReader, pcd::PcdReader, ply::PlyReader,
    raw_floats::RawFloatsReader, source::Source, tdtk::TdtkReader, vtk::VtkReader,
};
use crate::scan::{Grid, Point};
use std::path::{Path, PathBuf};

/// The most points one call of [`CloudReader::next_chunk`] gives.
pub const CHUNK_POINTS: usize = 8192;

/// Beyond this [m] a coordinate is a code for "no return" (some writers use the largest float), not a place on Earth.
const FARTHEST_COORDINATE_M: f64 = 1e8;

/// From here on [m] the step of f32 exceeds half a millimetre, and the cloud gets an origin of its own.
const NEEDS_ORIGIN_M: f64 = 4096.0;

/// Origins are whole multiples of this [m], so that subtracting and adding them loses nothing.
const ORIGIN_STEP_M: f64 = 64.0;

/// How many points a file will give.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CountHint {
    /// This many, by the header or the size of the file.
    Exact(usize),
    /// No more than this: the size of the file cannot hold more.
    AtMost(usize),
}

impl CountHint {
    /// The number, exact or not.
    #[must_use]
    pub fn bound(self) -> usize {
        match self {
            Self::Exact(n) | Self::AtMost(n) => n,
        }
    }
}

/// A cloud being read in pieces of bounded size, in the order of the file.
///
/// Points are in the scanner's frame [m], as f32 relative to [`CloudReader::origin`], which is zero unless the file's
/// coordinates are too large for f32 (UTM). A position that is not finite becomes [`Point::EMPTY`], in its place.
pub trait CloudReader {
    /// What to add to the points to get the file's own coordinates [m].
    fn origin(&self) -> [f64; 3];
    /// How many points the whole file gives, empty cells included.
    fn point_count_hint(&self) -> CountHint;
    /// The order, if the file states one.
    fn grid(&self) -> Option<Grid>;
    /// Replaces the content of `out` by the next points, at most [`CHUNK_POINTS`], and returns how many; 0 at the end.
    ///
    /// # Errors
    /// What is wrong with the file, and where. After an error do not ask again.
    fn next_chunk(&mut self, out: &mut Vec<Point>) -> Result<usize, FormatError>;
}

/// A whole cloud in memory.
#[derive(Debug, Clone)]
pub struct Cloud {
    /// The points [m], relative to `origin`, in the order of the file.
    pub points: Vec<Point>,
    /// What to add to get the file's own coordinates [m].
    pub origin: [f64; 3],
    /// The order, if the file states one; then `points.len() == grid.cells()`.
    pub grid: Option<Grid>,
}

/// One point as a file has it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Record {
    /// Position [m], right-handed; not finite where there is no return.
    pub(super) position: [f64; 3],
    /// Intensity in the sensor's own scale.
    pub(super) intensity: u16,
}

impl Record {
    /// The point relative to an origin, or the empty cell.
    fn relative_to(&self, origin: [f64; 3]) -> Point {
        if !self.is_return() {
            return Point::EMPTY;
        }
        let [x, y, z] = [0, 1, 2].map(|i| (self.position[i] - origin[i]) as f32);
        Point { x, y, z, intensity: self.intensity, time: 0 }
    }

    fn is_return(&self) -> bool {
        // A comparison with NaN is false.
        self.position.iter().all(|c| c.abs() <= FARTHEST_COORDINATE_M)
    }
}

/// An intensity of unknown scale as it is stored in a point: rounded, cut to 0..=65535, 0 when it is not a number.
pub(super) fn intensity_from(value: f64) -> u16 {
    value.round() as u16
}

/// What a format has to provide: records one after the other.
pub(super) trait RecordReader {
    /// How many records the file gives.
    fn count(&self) -> CountHint;
    /// The order, if the file states one.
    fn grid(&self) -> Option<Grid> {
        None
    }
    /// The next record; `None` at the end.
    fn next(&mut self) -> Result<Option<Record>, FormatError>;
    /// The number of records still to come, by the cheapest way that is exact.
    fn count_rest(&mut self) -> Result<usize, FormatError> {
        let mut count = 0;
        while self.next()?.is_some() {
            count += 1;
        }
        Ok(count)
    }
}

/// Any format as a [`CloudReader`].
struct CloudStream<R> {
    records: R,
    origin: [f64; 3],
    /// Empty cells before the first return that have not been given out. A number, not a buffer: they are all alike.
    leading_empty: usize,
    /// The first return, until it is given out.
    first: Option<Record>,
}

impl<R: RecordReader> CloudStream<R> {
    /// Reads up to the first return, which decides the origin.
    fn new(mut records: R, path: &Path) -> Result<Self, FormatError> {
        let mut leading_empty = 0;
        while let Some(record) = records.next()? {
            if record.is_return() {
                let origin = origin_for(record.position);
                return Ok(Self { records, origin, leading_empty, first: Some(record) });
            }
            leading_empty += 1;
        }
        Err(FormatError::Empty { path: path.to_path_buf() })
    }
}

/// Zero for coordinates that f32 holds to half a millimetre, else a round place near the point.
fn origin_for(position: [f64; 3]) -> [f64; 3] {
    if position.iter().all(|c| c.abs() < NEEDS_ORIGIN_M) {
        return [0.0; 3];
    }
    position.map(|c| (c / ORIGIN_STEP_M).round() * ORIGIN_STEP_M)
}

impl<R: RecordReader> CloudReader for CloudStream<R> {
    fn origin(&self) -> [f64; 3] {
        self.origin
    }

    fn point_count_hint(&self) -> CountHint {
        self.records.count()
    }

    fn grid(&self) -> Option<Grid> {
        self.records.grid()
    }

    fn next_chunk(&mut self, out: &mut Vec<Point>) -> Result<usize, FormatError> {
        out.clear();
        out.reserve(CHUNK_POINTS);
        while out.len() < CHUNK_POINTS {
            if self.leading_empty > 0 {
                self.leading_empty -= 1;
                out.push(Point::EMPTY);
                continue;
            }
            let record = match self.first.take() {
                Some(record) => Some(record),
                None => self.records.next()?,
            };
            match record {
                Some(record) => out.push(record.relative_to(self.origin)),
                None => break,
            }
        }
        Ok(out.len())
    }
}

/// What to do with the record reader of a file, whatever its format.
trait RecordTask {
    type Output;
    fn run<R: RecordReader + 'static>(self, records: R) -> Result<Self::Output, FormatError>;
}

/// Opens the file by its format and hands its reader to the task.
fn with_records<T: RecordTask>(path: &Path, task: T) -> Result<T::Output, FormatError> {
    let format = CloudFormat::of_path(path)?;
    let source = Source::open(path)?;
    match format {
        CloudFormat::Tdtk => task.run(TdtkReader::new(source)?),
        CloudFormat::Xyz32 => task.run(RawFloatsReader::<3>::new(source)?),
        CloudFormat::KittiBin => task.run(RawFloatsReader::<4>::new(source)?),
        CloudFormat::Pcd => task.run(PcdReader::new(source)?),
        CloudFormat::Ply => task.run(PlyReader::new(source)?),
        CloudFormat::Las => task.run(LasReader::new(source)?),
        CloudFormat::Csv => task.run(CsvReader::new(source)?),
        CloudFormat::Vtk => task.run(VtkReader::new(source)?),
    }
}

/// Opens a cloud for streaming, at bounded memory whatever its size.
///
/// One exception, by the nature of the format: a PCD of `DATA binary_compressed` is one packed block (under 4 GiB) that
/// stores its fields one after the other, so it is unpacked whole.
///
/// # Errors
/// Unknown ending, missing or unreadable file, damaged header, or no return in the whole file.
pub fn open_cloud(path: &Path) -> Result<Box<dyn CloudReader>, FormatError> {
    struct Open(PathBuf);
    impl RecordTask for Open {
        type Output = Box<dyn CloudReader>;
        fn run<R: RecordReader + 'static>(self, records: R) -> Result<Self::Output, FormatError> {
            Ok(Box::new(CloudStream::new(records, &self.0)?))
        }
    }
    with_records(path, Open(path.to_path_buf()))
}

/// Reads a cloud piece by piece into `sink` and returns the number of points. Positions are relative to the reader's
/// origin; use [`open_cloud`] where that may not be zero.
///
/// # Errors
/// As [`open_cloud`], and whatever is wrong further on; pieces before the error have been handed out.
pub fn read_cloud_into(path: &Path, sink: &mut dyn FnMut(&[Point])) -> Result<usize, FormatError> {
    let mut reader = open_cloud(path)?;
    let mut chunk = Vec::new();
    let mut total = 0;
    while reader.next_chunk(&mut chunk)? > 0 {
        total += chunk.len();
        sink(&chunk);
    }
    Ok(total)
}

/// Reads a whole cloud.
///
/// # Errors
/// As [`read_cloud_into`].
pub fn read_cloud(path: &Path) -> Result<Cloud, FormatError> {
    let mut reader = open_cloud(path)?;
    // The hint is bounded by the file, but a bound of packed data may be far too high: grow beyond a million points.
    let mut points = Vec::with_capacity(reader.point_count_hint().bound().min(1 << 20));
    let mut chunk = Vec::new();
    while reader.next_chunk(&mut chunk)? > 0 {
        points.extend_from_slice(&chunk);
    }
    Ok(Cloud { points, origin: reader.origin(), grid: reader.grid() })
}

/// The number of points that reading the file to its end gives, empty cells included. Cheap: from the header or the
/// size of a plain file, by counting the lines of text without a count, by unpacking gzipped files. The bound of memory
/// for a scan can be taken from it; whether every value is in order shows only when the file is read.
///
/// # Errors
/// As [`open_cloud`].
pub fn count_points(path: &Path) -> Result<usize, FormatError> {
    struct Count;
    impl RecordTask for Count {
        type Output = usize;
        fn run<R: RecordReader + 'static>(self, mut records: R) -> Result<usize, FormatError> {
            match records.count() {
                CountHint::Exact(count) => Ok(count),
                CountHint::AtMost(_) => records.count_rest(),
            }
        }
    }
    match with_records(path, Count)? {
        0 => Err(FormatError::Empty { path: path.to_path_buf() }),
        count => Ok(count),
    }
}
