//! A data source: one cloud file, or a folder of them.

use super::{
    cloud_format::{CloudFormat, file_name},
    csv::CsvReader,
    error::FormatError,
    source::Source,
};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// The scans of a data source, all of one format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScanFiles {
    /// The format of every file.
    pub format: CloudFormat,
    /// The files, in the natural order of their names (scan2 before scan10).
    pub files: Vec<PathBuf>,
}

/// The scans at `path`: the file itself, or the cloud files of the folder in natural order. Hidden files, folders and
/// files with other endings (poses, README, times) are passed over. As `.csv` is the ending of any table, a CSV file in
/// a folder counts only when its first line has columns x, y, z or numbers.
///
/// # Errors
/// A path that is missing or unreadable, an unknown ending, a folder without scans, with scans of two formats, or with
/// the same scan plain and packed.
pub fn list_scans(path: &Path) -> Result<ScanFiles, FormatError> {
    let metadata = fs::metadata(path).map_err(|e| FormatError::io(path, e))?;
    if !metadata.is_dir() {
        let format = CloudFormat::of_path(path)?;
        Source::open(path)?;
        return Ok(ScanFiles { format, files: vec![path.to_path_buf()] });
    }
    let mut files: Vec<PathBuf> = Vec::new();
    let mut first: Option<CloudFormat> = None;
    for file in files_in_order(path)? {
        let Ok(format) = CloudFormat::of_path(&file) else { continue };
        if format == CloudFormat::Csv && !is_cloud_table(&file)? {
            continue;
        }
        if let Some(previous) = files.last() {
            let both = (shown(previous), shown(&file));
            if first != Some(format) {
                return Err(FormatError::TwoFormats { path: path.into(), first: both.0, second: both.1 });
            }
            if without_gz(previous) == without_gz(&file) {
                return Err(FormatError::SameScanTwice { path: path.into(), first: both.0, second: both.1 });
            }
        }
        first = Some(format);
        files.push(file);
    }
    let format = first.ok_or_else(|| FormatError::NoScans { path: path.into(), known: CloudFormat::KNOWN })?;
    Ok(ScanFiles { format, files })
}

/// The files of a folder that are not hidden, in natural order; names that the order holds for equal (`1` and `01`) go
/// by their bytes, so that the order is always the same.
pub(super) fn files_in_order(folder: &Path) -> Result<Vec<PathBuf>, FormatError> {
    let fail = |e| FormatError::io(folder, e);
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        if !file_name(&path).starts_with('.') && path.is_file() {
            files.push(path);
        }
    }
    files.sort_by(|a, b| natord::compare(&shown(a), &shown(b)).then_with(|| a.cmp(b)));
    Ok(files)
}

fn shown(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

fn without_gz(path: &Path) -> String {
    let name = file_name(path);
    name.strip_suffix(".gz").unwrap_or(&name).to_owned()
}

/// Whether a CSV file begins like a cloud. What cannot be read is an error, not another kind of table.
fn is_cloud_table(path: &Path) -> Result<bool, FormatError> {
    match CsvReader::new(Source::open(path)?) {
        Ok(reader) => Ok(reader.has_points()),
        Err(FormatError::Malformed { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_with(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in files {
            fs::write(folder.path().join(name), content).unwrap();
        }
        folder
    }

    fn names(scans: &ScanFiles) -> Vec<String> {
        scans.files.iter().map(|file| shown(file)).collect()
    }

    #[test]
    fn scans_come_in_natural_order_and_other_files_are_passed_over() {
        let folder = folder_with(&[
            ("scan10.3d", "1 2 3\n"),
            ("scan2.3d", "1 2 3\n"),
            ("scan2.pose", "0 0 0\n0 0 0\n"),
            ("README", "hello"),
            ("times.txt", "a 1\n"),
            ("poses.tum", ""),
            ("._scan2.pcd", ""),
        ]);
        fs::create_dir(folder.path().join("more.ply")).unwrap();
        let scans = list_scans(folder.path()).unwrap();
        assert_eq!(scans.format, CloudFormat::Tdtk);
        assert_eq!(names(&scans), ["scan2.3d", "scan10.3d"]);
    }

    #[test]
    fn a_table_that_is_no_cloud_may_lie_beside_the_scans() {
        let table = ("list.csv", "reading, gT00, gT01\na.csv, 1, 0\n");
        let folder = folder_with(&[table, ("a.vtk", ""), ("empty.csv", "")]);
        assert_eq!(names(&list_scans(folder.path()).unwrap()), ["a.vtk"]);
        let folder = folder_with(&[table, ("a.csv", "x,y,z\n1,2,3\n"), ("b.csv", "1 2 3\n")]);
        assert_eq!(names(&list_scans(folder.path()).unwrap()), ["a.csv", "b.csv"]);
    }

    #[test]
    fn what_cannot_be_meant_is_refused_by_name() {
        let two = folder_with(&[("a.ply", ""), ("b.pcd", "")]);
        let message = list_scans(two.path()).unwrap_err().to_string();
        assert!(message.contains("a.ply") && message.contains("b.pcd"), "{message}");
        let twice = folder_with(&[("a.ply", ""), ("a.ply.gz", "")]);
        assert!(matches!(list_scans(twice.path()), Err(FormatError::SameScanTwice { .. })));
        let none = folder_with(&[("README", "")]);
        assert!(matches!(list_scans(none.path()), Err(FormatError::NoScans { .. })));
        assert!(matches!(list_scans(&none.path().join("gone")), Err(FormatError::Missing { .. })));
        assert!(matches!(list_scans(&none.path().join("README")), Err(FormatError::UnknownExtension { .. })));
    }

    #[test]
    fn a_table_that_cannot_be_read_is_not_passed_over() {
        let folder = folder_with(&[("a.csv.gz", "no gzip"), ("b.ply", "")]);
        assert!(list_scans(folder.path()).is_err());
    }

    #[test]
    fn las_and_laz_are_one_format() {
        let folder = folder_with(&[("a.las", ""), ("b.laz", "")]);
        assert_eq!(list_scans(folder.path()).unwrap().files.len(), 2);
    }
}
