//! Files in and out: clouds, poses, folders of scans.
//!
//! Everything streams: a file larger than the memory is read, converted and written in pieces of bounded size. Nothing
//! is allocated on the word of a header, and damaged input is an error that names file, place and field, never a panic.

mod capture;
mod cloud_format;
mod cloud_reader;
mod csv;
mod error;
mod folder;
mod g2o;
mod las;
mod las_guard;
mod lzf;
mod pcd;
mod ply;
mod poses;
mod raw_floats;
mod scalar;
mod source;
mod tdtk;
mod vtk;

mod convert;
mod writers;

#[cfg(test)]
mod conformance;

pub use capture::{Capture, CaptureError, Revolution};
pub use cloud_format::CloudFormat;
pub use cloud_reader::{
    CHUNK_POINTS, Cloud, CloudReader, CountHint, count_points, open_cloud, read_cloud, read_cloud_into,
};
pub use convert::{ConvertError, ConvertSummary, convert};
pub use error::{At, FormatError, WriteError};
pub use folder::{ScanFiles, list_scans};
pub use g2o::{G2oGraph, g2o_chi2, read_g2o, write_g2o};
pub use poses::{StampedPose, read_poses};
pub use writers::{
    CloudWriter, LasWriter, OutPoint, PcdOptions, PcdWriter, PlyOptions, PlyWriter, TumWriter, Xyz32Writer,
};
