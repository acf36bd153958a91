//! Conversion from every format to every format that is written.

use super::*;
use crate::scan::Grid;

#[test]
fn every_format_converts_to_every_other_and_keeps_its_points() {
    let folder = tempfile::tempdir().unwrap();
    let points = spiral(CHUNK_POINTS + 100);
    for case in CASES {
        let input = file_with(folder.path(), case.name, &(case.encode)(&points));
        for out in ["out.ply", "out.pcd", "out.las", "out.laz", "out.xyz32.bin"] {
            let output = folder.path().join(out);
            let mut seen = Vec::new();
            let summary = convert(&input, &output, None, &mut |n| seen.push(n)).unwrap();
            assert_eq!(
                (summary.read, summary.written, summary.empty_cells),
                (points.len() as u64, points.len() as u64, 0)
            );
            assert_eq!(seen, [CHUNK_POINTS as u64, points.len() as u64]);
            let has_intensity = case.keeps.contains(&Keeps::Intensity) && out != "out.xyz32.bin";
            let keeps: &[Keeps] = if has_intensity { &[Keeps::Intensity] } else { &[] };
            let both = Case { keeps, tolerance_m: case.tolerance_m + 1e-3, ..*case };
            assert_same(&both, &points, &read_cloud(&output).unwrap().points);
            assert_eq!(count_points(&output).unwrap(), points.len());
        }
    }
}

#[test]
fn empty_cells_and_the_grid_reach_a_pcd_and_las_leaves_them_out() {
    let folder = tempfile::tempdir().unwrap();
    let points = with_empty_cells(12);
    let case = CASES.iter().find(|case| case.name == "four.3d").unwrap();
    let input = file_with(folder.path(), case.name, &(case.encode)(&points));
    let grid = Grid { rows: 3, cols: 4 };
    let pcd = folder.path().join("ordered.pcd");
    assert_eq!(convert(&input, &pcd, Some(grid), &mut |_| {}).unwrap().empty_cells, 4);
    let cloud = read_cloud(&pcd).unwrap();
    assert_eq!(cloud.grid, Some(grid));
    assert_same(case, &points, &cloud.points);
    // The order of the input is kept without being asked for.
    let again = folder.path().join("again.pcd");
    assert_eq!(convert(&pcd, &again, None, &mut |_| {}).unwrap().grid, Some(grid));
    assert_eq!(fs::read(&pcd).unwrap(), fs::read(&again).unwrap());
    let las = folder.path().join("a.las");
    let summary = convert(&pcd, &las, None, &mut |_| {}).unwrap();
    assert_eq!((summary.read, summary.written), (12, 8));
    assert_eq!(count_points(&las).unwrap(), 8);
}

#[test]
fn what_cannot_be_converted_is_refused_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let input = file_with(folder.path(), "a.csv", b"1 2 3\n4 5 6\n7 8\n");
    let good = file_with(folder.path(), "b.csv", b"1 2 3\n4 5 6\n");
    let far = file_with(folder.path(), "far.csv", b"500000 5800000 3\n");
    let grid = Some(Grid { rows: 2, cols: 2 });
    let to = |name: &str| folder.path().join(name);
    let run = |from: &PathBuf, out: &str, grid| convert(from, &to(out), grid, &mut |_| {});
    assert!(matches!(run(&input, "a.ply", None), Err(ConvertError::Read(FormatError::Malformed { .. }))));
    assert!(matches!(run(&input, "a.laz", None), Err(ConvertError::Read(FormatError::Malformed { .. }))));
    assert!(matches!(run(&good, "b.pcd", grid), Err(ConvertError::Write(WriteError::GridMismatch { points: 2, .. }))));
    assert!(matches!(run(&good, "b.ply", grid), Err(ConvertError::GridNeedsPcd { .. })));
    assert!(matches!(run(&good, "b.csv", None), Err(ConvertError::SameFile { .. })));
    assert!(matches!(run(&good, "b.e57", None), Err(ConvertError::Write(WriteError::UnknownExtension { .. }))));
    assert!(matches!(run(&good, "b.ply.gz", None), Err(ConvertError::Write(WriteError::UnknownExtension { .. }))));
    assert!(matches!(run(&good, "no/such/b.ply", None), Err(ConvertError::Write(WriteError::Io { .. }))));
    assert!(matches!(run(&far, "far.xyz32.bin", None), Err(ConvertError::TooFarForF32 { .. })));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3, "only the three inputs are there");
}

#[test]
fn poses_convert_to_tum_and_back() {
    let folder = tempfile::tempdir().unwrap();
    let kitti = file_with(folder.path(), "00.txt", b"1 0 0 7 0 1 0 8 0 0 1 9\n0 -1 0 1 1 0 0 2 0 0 1 3\n");
    let tum = folder.path().join("a.tum");
    let summary = convert(&kitti, &tum, None, &mut |_| {}).unwrap();
    assert_eq!((summary.read, summary.written), (2, 2));
    let (before, after) = (read_poses(&kitti).unwrap(), read_poses(&tum).unwrap());
    for (i, (b, a)) in before.iter().zip(&after).enumerate() {
        assert_eq!(a.stamp_s, Some(i as f64));
        assert!((b.map_from_scanner.to_homogeneous() - a.map_from_scanner.to_homogeneous()).norm() < 1e-9);
    }
}

/// A sparse file of 3 GiB takes no disk and no memory: every read is a chunk, and only the first few are taken.
#[test]
fn a_file_larger_than_a_buffer_is_read_through_buffers_of_fixed_size() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.xyz32.bin");
    let points = 1_usize << 28;
    fs::File::create(&path).unwrap().set_len(12 * points as u64).unwrap();
    assert_eq!(count_points(&path).unwrap(), points);
    let mut reader = open_cloud(&path).unwrap();
    assert_eq!(reader.point_count_hint(), CountHint::Exact(points));
    let mut chunk = Vec::new();
    for _ in 0..200 {
        assert_eq!(reader.next_chunk(&mut chunk).unwrap(), CHUNK_POINTS);
        assert!(chunk.capacity() <= 2 * CHUNK_POINTS);
    }
}
