//! From one file format to another, at fixed memory.

use super::{
    cloud_format::{CloudFormat, file_name},
    cloud_reader::{CHUNK_POINTS, CloudReader, open_cloud},
    error::{FormatError, WriteError},
    poses::read_poses,
    writers::{CloudWriter, LasWriter, OutPoint, PcdOptions, PcdWriter, PlyOptions, PlyWriter, TumWriter, Xyz32Writer},
};
use crate::scan::{Grid, Point};
use std::{fs, path::Path};

/// The endings of names that clouds can be written to, for messages.
const KNOWN_OUT: &str = ".ply, .pcd, .las, .laz, .xyz32.bin for clouds, .tum for poses";

/// What a conversion did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConvertSummary {
    /// Points or poses read.
    pub read: u64,
    /// Points or poses in the new file; less than read where the format cannot hold empty cells.
    pub written: u64,
    /// Empty cells among the points read.
    pub empty_cells: u64,
    /// The origin the points were read around [m], zero for scans near theirs.
    pub origin: [f64; 3],
    /// The order written, if the new format holds one.
    pub grid: Option<Grid>,
}

/// Why a conversion failed. No output file is left behind.
#[derive(Debug, thiserror::Error)]
pub enum ConvertError {
    /// The input.
    #[error(transparent)]
    Read(#[from] FormatError),
    /// The output.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The output would overwrite the input while it is read.
    #[error("{path}: input and output are the same file; choose another name for the output")]
    SameFile {
        /// The file.
        path: std::path::PathBuf,
    },
    /// An order was asked of a format that has none.
    #[error("{path}: only .pcd holds a grid of rows and columns; choose a .pcd output or leave the grid out")]
    GridNeedsPcd {
        /// The output file.
        path: std::path::PathBuf,
    },
    /// `.xyz32.bin` holds f32 only.
    #[error("{path}: coordinates of {largest_m:.0} m do not fit f32 without loss; write .ply, .pcd, .las or .laz")]
    TooFarForF32 {
        /// The output file.
        path: std::path::PathBuf,
        /// The largest coordinate of the origin [m].
        largest_m: f64,
    },
}

/// Converts a cloud (any [`CloudFormat`]) to `.ply`, `.pcd`, `.las`, `.laz` or `.xyz32.bin`, or poses (as
/// [`read_poses`] takes them) to `.tum`, where poses without time get their number (0, 1, 2, ...) for a stamp.
///
/// `grid` is the order of the points if the input does not say it (only `.pcd` keeps it). `progress` is called with the
/// number of points so far. An output that exists is replaced once the new one is complete.
///
/// # Errors
/// What is wrong with the input or the output; then no output is left behind.
pub fn convert(
    input: &Path,
    output: &Path,
    grid: Option<Grid>,
    progress: &mut dyn FnMut(u64),
) -> Result<ConvertSummary, ConvertError> {
    if let (Ok(a), Ok(b)) = (fs::canonicalize(input), fs::canonicalize(output))
        && a == b
    {
        return Err(ConvertError::SameFile { path: output.to_path_buf() });
    }
    if file_name(output).ends_with(".tum") {
        return convert_poses(input, output, grid);
    }
    // The output's name is checked before the input, which may be large, is read.
    let kind = writable_format(output)?;
    if grid.is_some() && kind != CloudFormat::Pcd {
        return Err(ConvertError::GridNeedsPcd { path: output.to_path_buf() });
    }
    let mut reader = open_cloud(input)?;
    let grid = if kind == CloudFormat::Pcd { grid.or(reader.grid()) } else { None };
    let writer = create_writer(kind, input, output, reader.origin(), grid)?;
    let summary = copy_points(reader.as_mut(), writer, progress)?;
    Ok(ConvertSummary { grid, ..summary })
}

fn writable_format(output: &Path) -> Result<CloudFormat, WriteError> {
    let unknown = || WriteError::UnknownExtension { path: output.to_path_buf(), known: KNOWN_OUT };
    let format = CloudFormat::of_path(output).map_err(|_| unknown())?;
    let is_writable = matches!(format, CloudFormat::Ply | CloudFormat::Pcd | CloudFormat::Las | CloudFormat::Xyz32);
    if !is_writable || file_name(output).ends_with(".gz") {
        return Err(unknown());
    }
    Ok(format)
}

fn create_writer(
    kind: CloudFormat,
    input: &Path,
    output: &Path,
    origin: [f64; 3],
    grid: Option<Grid>,
) -> Result<Box<dyn CloudWriter>, ConvertError> {
    let largest_m = origin.iter().fold(0.0_f64, |largest, c| largest.max(c.abs()));
    let is_double = largest_m > 0.0;
    Ok(match kind {
        CloudFormat::Las => Box::new(LasWriter::create(output, origin)?),
        CloudFormat::Pcd => Box::new(PcdWriter::create(output, &PcdOptions { is_double, grid })?),
        CloudFormat::Xyz32 if is_double => {
            return Err(ConvertError::TooFarForF32 { path: output.to_path_buf(), largest_m });
        }
        CloudFormat::Xyz32 => Box::new(Xyz32Writer::create(output)?),
        _ => {
            let comments = vec![format!("converted by mirador from {}", file_name(input))];
            Box::new(PlyWriter::create(output, &PlyOptions { is_double, comments })?)
        }
    })
}

/// Passes every point on, through two buffers that are reused.
fn copy_points(
    reader: &mut dyn CloudReader,
    mut writer: Box<dyn CloudWriter>,
    progress: &mut dyn FnMut(u64),
) -> Result<ConvertSummary, ConvertError> {
    let origin = reader.origin();
    let mut chunk: Vec<Point> = Vec::with_capacity(CHUNK_POINTS);
    let mut out: Vec<OutPoint> = Vec::with_capacity(CHUNK_POINTS);
    let mut read = 0;
    let mut empty_cells = 0;
    while reader.next_chunk(&mut chunk)? > 0 {
        out.clear();
        out.extend(chunk.iter().map(|point| OutPoint::from_point(point, origin)));
        writer.write(&out)?;
        read += chunk.len() as u64;
        empty_cells += chunk.iter().filter(|point| !point.is_return()).count() as u64;
        progress(read);
    }
    let written = writer.finish()?;
    Ok(ConvertSummary { read, written, empty_cells, origin, grid: None })
}

fn convert_poses(input: &Path, output: &Path, grid: Option<Grid>) -> Result<ConvertSummary, ConvertError> {
    if grid.is_some() {
        return Err(ConvertError::GridNeedsPcd { path: output.to_path_buf() });
    }
    let poses = read_poses(input)?;
    let mut writer = TumWriter::create(output)?;
    for (number, pose) in poses.iter().enumerate() {
        writer.write(pose.stamp_s.unwrap_or(number as f64), &pose.map_from_scanner)?;
    }
    let written = writer.finish()?;
    Ok(ConvertSummary { read: poses.len() as u64, written, empty_cells: 0, origin: [0.0; 3], grid: None })
}
