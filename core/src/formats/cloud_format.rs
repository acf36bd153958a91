//! Which cloud format a file has, from its name.

use super::error::FormatError;
use std::path::Path;

/// The cloud formats that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum CloudFormat {
    /// 3DTK `.3d`: text, centimetres, left-handed.
    Tdtk,
    /// `.xyz32.bin`: little-endian f32 x, y, z [m].
    Xyz32,
    /// KITTI `.bin`: little-endian f32 x, y, z [m], intensity in [0, 1].
    KittiBin,
    /// `.pcd` of the Point Cloud Library.
    Pcd,
    /// `.ply`, the polygon file format.
    Ply,
    /// ASPRS `.las` and its compressed form `.laz`.
    Las,
    /// `.csv`: columns x, y, z and perhaps intensity.
    Csv,
    /// Legacy `.vtk`: the points of a POLYDATA or UNSTRUCTURED_GRID data set.
    Vtk,
}

impl CloudFormat {
    /// The endings of file names that are known, for messages.
    pub const KNOWN: &'static str = ".3d, .xyz32.bin, .bin (KITTI), .pcd, .ply, .las, .laz, .csv, .vtk";

    /// Every format, for loops over all of them.
    pub const ALL: [Self; 8] =
        [Self::Tdtk, Self::Xyz32, Self::KittiBin, Self::Pcd, Self::Ply, Self::Las, Self::Csv, Self::Vtk];

    /// The format of a file by the ending of its name, in any case, a `.gz` after it left out.
    ///
    /// # Errors
    /// [`FormatError::UnknownExtension`] with the known endings.
    pub fn of_path(path: &Path) -> Result<Self, FormatError> {
        Self::of_name(&file_name(path))
            .ok_or_else(|| FormatError::UnknownExtension { path: path.to_path_buf(), known: Self::KNOWN })
    }

    /// The format by the lower-cased file name.
    fn of_name(name: &str) -> Option<Self> {
        let name = name.strip_suffix(".gz").unwrap_or(name);
        let endings = [
            (".xyz32.bin", Self::Xyz32),
            (".bin", Self::KittiBin),
            (".3d", Self::Tdtk),
            (".pcd", Self::Pcd),
            (".ply", Self::Ply),
            (".las", Self::Las),
            (".laz", Self::Las),
            (".csv", Self::Csv),
            (".vtk", Self::Vtk),
        ];
        endings.iter().find(|(ending, _)| name.ends_with(ending)).map(|&(_, format)| format)
    }
}

/// The lower-cased name of a file, without its folder.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_format_follows_from_the_name_and_gz_is_left_out() {
        let of = |name: &str| CloudFormat::of_path(Path::new(name)).ok();
        assert_eq!(of("a/scan000.3d"), Some(CloudFormat::Tdtk));
        assert_eq!(of("a.xyz32.bin.gz"), Some(CloudFormat::Xyz32));
        assert_eq!(of("000000.bin"), Some(CloudFormat::KittiBin));
        assert_eq!(of("A.LAZ"), Some(CloudFormat::Las));
        assert_eq!(of("a.las"), Some(CloudFormat::Las));
        assert_eq!(of("c.vtk.gz"), Some(CloudFormat::Vtk));
        assert_eq!(of("c.gz"), None);
        assert_eq!(of("scan.pose"), None);
    }

    #[test]
    fn an_unknown_ending_is_told_the_known_ones() {
        let message = CloudFormat::of_path(Path::new("a.e57")).unwrap_err().to_string();
        assert!(message.contains("a.e57") && message.contains(".laz"), "{message}");
    }
}
