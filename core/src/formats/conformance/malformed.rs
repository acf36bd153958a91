//! Damaged files of every format: an error that helps, never a panic, never memory on the word of a header.

use super::*;
use proptest::prelude::*;

/// Reads as far as it goes and returns how many points came.
fn points_before_the_end(path: &Path) -> usize {
    let mut total = 0;
    // An error is the expected answer here; what matters is what came before it.
    let _ = read_cloud_into(path, &mut |chunk| total += chunk.len());
    total
}

#[test]
fn a_file_cut_at_any_byte_gives_no_more_points_than_it_had() {
    let folder = tempfile::tempdir().unwrap();
    let points = spiral(5);
    for case in CASES {
        let content = (case.encode)(&points);
        for (name, bytes) in [(case.name.to_owned(), content.clone()), (format!("{}.gz", case.name), gzipped(&content))]
        {
            for cut in 0..bytes.len() {
                let path = file_with(folder.path(), &name, &bytes[..cut]);
                assert!(points_before_the_end(&path) <= 5, "{name} cut at {cut}");
                if let Ok(count) = count_points(&path) {
                    assert!((1..=5).contains(&count), "{name} cut at {cut} counts {count}");
                }
            }
        }
    }
}

#[test]
fn a_binary_file_that_lost_its_last_point_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    for (name, tail) in
        [("binary.pcd", 1), ("little.ply", 1 + 4 + 10), ("packed.pcd", 1), ("raw.xyz32.bin", 1), ("a.las", 1)]
    {
        let case = CASES.iter().find(|case| case.name == name).unwrap();
        let content = (case.encode)(&spiral(40));
        let path = file_with(folder.path(), name, &content[..content.len() - tail]);
        let message = read_cloud(&path).unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    }
}

#[test]
fn an_absurd_count_in_a_header_is_refused_before_memory_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let huge = "4000000000000000";
    let pcd = |data: &str| {
        format!(
            "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {huge}\nHEIGHT 1\nPOINTS {huge}\nDATA {data}\n1 2 3\n"
        )
    };
    let ply = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {huge}\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
        )
    };
    let vtk =
        |kind: &str| format!("# vtk DataFile Version 3.0\nt\n{kind}\nDATASET POLYDATA\nPOINTS {huge} float\n1 2 3\n");
    let files = [
        ("ascii.pcd", pcd("ascii")),
        ("binary.pcd", pcd("binary")),
        ("packed.pcd", pcd("binary_compressed\n        ")),
        ("ascii.ply", ply("ascii")),
        ("binary.ply", ply("binary_big_endian")),
        ("ascii.vtk", vtk("ASCII")),
        ("binary.vtk", vtk("BINARY")),
        ("wide.pcd", "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 99999999999\nWIDTH 1\nDATA binary\n".into()),
        ("overflow.pcd", format!("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {huge}\nHEIGHT {huge}\nDATA binary\n")),
    ];
    for (name, content) in files {
        let plain = file_with(folder.path(), name, content.as_bytes());
        let packed = file_with(folder.path(), &format!("{name}.gz"), &gzipped(content.as_bytes()));
        for path in [plain, packed] {
            let error = open_cloud(&path).err().unwrap();
            assert!(matches!(error, FormatError::Truncated { .. } | FormatError::Malformed { .. }), "{name}: {error}");
            assert!(count_points(&path).is_err(), "{name}");
        }
    }
}

#[test]
fn absurd_sizes_in_a_las_header_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let of = |name: &str| (CASES.iter().find(|case| case.name == name).unwrap().encode)(&spiral(300));
    // The legacy count of points.
    let mut las = of("a.las");
    las[107..111].copy_from_slice(&u32::MAX.to_le_bytes());
    // One extended record of 2^62 bytes behind the points of a LAS 1.4 file.
    let mut extended = of("layered.laz");
    let end = extended.len() as u64;
    extended[235..243].copy_from_slice(&end.to_le_bytes());
    extended[243..247].copy_from_slice(&1_u32.to_le_bytes());
    extended.extend([0; 60]);
    extended[end as usize + 20..][..8].copy_from_slice(&(1_u64 << 62).to_le_bytes());
    // The number of chunks, and the size of the first layer.
    let start = |bytes: &[u8]| u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    let mut chunks = of("classic.laz");
    let table = u64::from_le_bytes(chunks[start(&chunks)..][..8].try_into().unwrap()) as usize;
    chunks[table + 4..][..4].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut layers = of("layered.laz");
    let first_layer = start(&layers) + 8 + 30 + 4;
    layers[first_layer..][..4].copy_from_slice(&u32::MAX.to_le_bytes());
    for (name, bytes) in [("a.las", las), ("extended.laz", extended), ("chunks.laz", chunks), ("layers.laz", layers)] {
        let error = read_cloud(&file_with(folder.path(), name, &bytes)).unwrap_err();
        assert!(matches!(error, FormatError::Las { .. }), "{name}: {error}");
    }
}

#[test]
fn a_wrong_value_is_an_error_that_names_file_line_and_field() {
    let folder = tempfile::tempdir().unwrap();
    let ply =
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let pcd = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nDATA ascii\n";
    let cases: &[(&str, String, &[&str])] = &[
        ("a.3d", "1 2 3\n1 two 3\n".into(), &["line 2", "y", "\"two\"", "a number"]),
        ("a.3d", "1 2 3\n1 2\n".into(), &["line 2", "columns", "2"]),
        ("a.3d", "1 2 3\n1 2 3 4\n".into(), &["line 2", "columns"]),
        ("a.3d", "1 2 x3\n".into(), &["line 1", "\"x3\""]),
        ("a.csv", "x,y,z\n1,2,3\n1,,3\n".into(), &["line 3", "y"]),
        ("a.csv", "x,y,z\n1,2,3\n1,2\n".into(), &["line 3", "columns"]),
        ("a.csv", "reading, gT00, gT01\n".into(), &["line 1", "header", "x, y and z"]),
        ("a.ply", format!("{ply}1 2 3\n1 2 z\n"), &["line 9", "\"z\""]),
        ("a.ply", format!("{ply}1 2 3\n1 2 3 4\n"), &["line 9", "one value a property"]),
        ("a.ply", format!("{ply}1 2 3\n"), &["ends too early", "vertices"]),
        ("a.ply", ply.replace("float z", "float w"), &["x, y and z"]),
        ("a.ply", ply.replace("float z", "half z"), &["line 6", "known type"]),
        ("a.pcd", format!("{pcd}1 2 3\n1 2 z\n"), &["line 8", "\"z\""]),
        ("a.pcd", format!("{pcd}1 2 3\n1 2 3\n1 2 3\n"), &["line 9", "2 points"]),
        ("a.pcd", format!("{pcd}1 2 3\n"), &["ends too early", "2 points"]),
        ("a.pcd", pcd.replace("HEIGHT 1", "HEIGHT 1\nPOINTS 3"), &["WIDTH x HEIGHT"]),
        ("a.pcd", pcd.replace("SIZE 4 4 4", "SIZE 4 4 3"), &["F 3", "F 4|8"]),
        (
            "a.vtk",
            "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 2 float\n1 2 3\n4 5 q\n".into(),
            &["line 7", "\"q\""],
        ),
        ("a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nDATASET RECTILINEAR_GRID\n".into(), &["line 4", "POLYDATA"]),
    ];
    for (name, content, parts) in cases {
        let path = file_with(folder.path(), name, content.as_bytes());
        let message = read_cloud(&path).unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
        for part in *parts {
            assert!(message.contains(part), "{message:?} should say {part:?}");
        }
    }
}

#[test]
fn a_path_that_cannot_be_read_is_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(read_cloud(&folder.path().join("gone.ply")), Err(FormatError::Missing { .. })));
    fs::create_dir(folder.path().join("b.ply")).unwrap();
    assert!(matches!(read_cloud(&folder.path().join("b.ply")), Err(FormatError::Io { .. })));
    let not_gzip = file_with(folder.path(), "c.ply.gz", b"ply\n");
    assert!(read_cloud(&not_gzip).is_err());
}

#[test]
fn a_header_line_may_be_absent_or_present() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("a.3d", "a header of five words\n100 200 300\n"),
        ("b.3d", "# comment\n100 200 300\n"),
        ("c.3d", "\n100 200 300"),
        ("d.csv", "//X,Y,Z\n3,-1,2\n"),
        ("e.csv", "# x y z\n3 -1 2\n"),
        ("f.csv", "  3e0   -1.0   2\n"),
        ("g.csv", "3;-1;2;0.5;0.5\n"),
    ] {
        let cloud = read_cloud(&file_with(folder.path(), name, text.as_bytes())).unwrap();
        assert_eq!(cloud.points, [Point::new(3.0, -1.0, 2.0)], "{name}");
    }
}

#[test]
fn a_pcd_of_several_rows_is_a_grid() {
    let folder = tempfile::tempdir().unwrap();
    let text = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 3\nHEIGHT 2\nDATA ascii\n1 0 0\nnan nan nan\n3 0 0\n4 0 0\n5 0 nan\n6 0 0\n";
    let cloud = read_cloud(&file_with(folder.path(), "a.pcd", text.as_bytes())).unwrap();
    assert_eq!(cloud.grid, Some(crate::scan::Grid { rows: 2, cols: 3 }));
    let returns: Vec<bool> = cloud.points.iter().map(Point::is_return).collect();
    assert_eq!(returns, [true, false, true, true, false, true]);
    assert_eq!(cloud.points[3].x, 4.0);
}

/// Beginnings that lead arbitrary bytes deep into each parser.
const BEGINNINGS: &[(&str, &str)] = &[
    ("a.3d", ""),
    ("a.3d", "1 2 3\n"),
    ("a.csv", ""),
    ("a.csv", "x,y,z\n"),
    ("a.ply", "ply\nformat ascii 1.0\n"),
    (
        "a.ply",
        "ply\nformat ascii 1.0\nelement a 2\nproperty list char int l\nelement vertex 3\nproperty float x\nproperty float y\nproperty list int8 double q\nproperty float z\nend_header\n",
    ),
    (
        "a.ply",
        "ply\nformat binary_big_endian 1.0\nelement a 2\nproperty list char int l\nelement vertex 3\nproperty float x\nproperty float y\nproperty list int8 double q\nproperty float z\nend_header\n",
    ),
    ("a.pcd", "FIELDS x y z\n"),
    ("a.pcd", "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 3\nHEIGHT 1\nDATA ascii\n"),
    ("a.pcd", "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 3\nHEIGHT 1\nDATA binary_compressed\n"),
    ("a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\n"),
    ("a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 3 double\n"),
    ("a.las", "LASF"),
    ("a.ply.gz", ""),
];

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300), which in 0..BEGINNINGS.len()) {
        let folder = tempfile::tempdir().unwrap();
        let (name, beginning) = BEGINNINGS[which];
        let path = file_with(folder.path(), name, &[beginning.as_bytes(), &bytes].concat());
        prop_assert!(points_before_the_end(&path) <= beginning.len() + bytes.len());
    }

    #[test]
    fn arbitrary_text_never_panics(text in "[-0-9 .,;enaxyzif#\n]{0,200}", which in 0..BEGINNINGS.len()) {
        let folder = tempfile::tempdir().unwrap();
        let (name, beginning) = BEGINNINGS[which];
        let path = file_with(folder.path(), name, &[beginning.as_bytes(), text.as_bytes()].concat());
        let read = points_before_the_end(&path);
        if let (Ok(cloud), Ok(count)) = (read_cloud(&path), count_points(&path)) {
            prop_assert_eq!(cloud.points.len(), count);
            prop_assert_eq!(read, count);
        }
    }

    #[test]
    fn a_file_with_one_changed_byte_never_panics(which in 0..CASES.len(), at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let folder = tempfile::tempdir().unwrap();
        let case = &CASES[which];
        let mut content = (case.encode)(&spiral(20));
        let at = at.index(content.len());
        content[at] = byte;
        let path = file_with(folder.path(), case.name, &content);
        prop_assert!(points_before_the_end(&path) <= content.len() * 50_000);
    }
}
