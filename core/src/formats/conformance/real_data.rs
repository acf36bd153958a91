//! Real recordings, where they are at hand (`MIRADOR_DATA`, else `../shared/data` beside the workspace).

use super::*;
use crate::geometry::{Pose, pose_from_rows};
use nalgebra::{Point3, Vector3};
use std::env;

/// The folder of a data set, or `None` after saying that the test is skipped.
fn data_set(test: &str, name: &str) -> Option<PathBuf> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let folder = PathBuf::from(env::var("MIRADOR_DATA").unwrap_or_else(|_| default.into())).join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(env::var("MIRADOR_DATA_REQUIRED").as_deref() != Ok("1"), "{test}: no data at {}", folder.display());
    println!("SKIPPED: {test}: no data at {}", folder.display());
    None
}

/// The mean distance from sampled points of `source`, moved by `target_from_source`, to their nearest in `target` [m];
/// each counts 0.3 m at most, as not everything overlaps.
fn mean_gap(target: &[Point], source: &[Point], target_from_source: &Pose) -> f64 {
    let usable = |p: &&Point| p.is_return() && p.range() > 0.5 && p.range() < 25.0;
    let target: Vec<Point3<f64>> = target.iter().filter(usable).step_by(4).map(Point::position).collect();
    let gaps = source.iter().filter(usable).step_by(151).map(|p| {
        let moved = target_from_source * p.position();
        target.iter().map(|q| (q - moved).norm_squared()).fold(f64::INFINITY, f64::min).sqrt().min(0.3)
    });
    let gaps: Vec<f64> = gaps.collect();
    gaps.iter().sum::<f64>() / gaps.len() as f64
}

/// How far ahead [m], in steps of 0.1, the source has to be moved to fit best, all else as in `pose`, and the gap there.
fn best_ahead(target: &[Point], source: &[Point], pose: &Pose) -> (f64, f64) {
    let tried = (-25..=45).map(|step| {
        let ahead = f64::from(step) * 0.1;
        let mut moved = *pose;
        moved.translation.x = ahead;
        (ahead, mean_gap(target, source, &moved))
    });
    tried.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
}

#[test]
fn the_3dtk_scans_have_their_points_and_their_poses_bring_them_together() {
    let Some(folder) = data_set("3dtk", "3dtk_dat") else { return };
    let scans = list_scans(&folder).unwrap();
    assert_eq!((scans.format, scans.files.len()), (CloudFormat::Tdtk, 3));
    let poses = read_poses(&folder).unwrap();
    assert_eq!(poses.len(), 3);
    let clouds: Vec<Cloud> = scans.files.iter().map(|file| read_cloud(file).unwrap()).collect();
    for (cloud, file) in clouds.iter().zip(&scans.files) {
        assert_eq!(cloud.points.len(), 226 * 360);
        assert_eq!(count_points(file).unwrap(), 226 * 360);
        // The file does not say no return as NaN but by a range of 32.77 m.
        let coded = cloud.points.iter().filter(|p| (p.range() - 32.77).abs() < 0.01).count();
        assert!((1000..2000).contains(&coded), "{coded}");
    }
    // The first pair, ahead first: (10.0996, -0.0662149, 0.0581712) cm is x right, y up, z ahead.
    let second = clouds[0].points[1].vector();
    assert!((second - Vector3::new(0.000_581_712, -0.100_996, -0.000_662_149)).norm() < 1e-6);
    // Along the corridor the walls fit anywhere, so the way ahead is searched: it must be the one to which 3DTK itself
    // converges, and the rotation of the pose must fit better there than its inverse.
    for (i, converged_m) in [(1, 1.436_47), (2, 3.175_26)] {
        let pose = poses[i].map_from_scanner;
        let (ahead, gap) = best_ahead(&clouds[0].points, &clouds[i].points, &pose);
        let turned_back = Pose::from_parts(pose.translation, pose.rotation.inverse());
        let (_, wrong_gap) = best_ahead(&clouds[0].points, &clouds[i].points, &turned_back);
        println!(
            "3dtk scan{i:03}: best {ahead:.1} m ahead, gap {gap:.4} m, {wrong_gap:.4} m with the rotation inverted"
        );
        assert!((ahead - converged_m).abs() < 0.25, "{ahead}");
        assert!((pose.translation.x - converged_m).abs() < 0.25, "{pose}");
        assert!(gap < 0.9 * wrong_gap, "{gap} {wrong_gap}");
    }
}

#[test]
fn the_handheld_scans_come_in_order_and_with_their_trajectory() {
    let Some(folder) = data_set("handheld", "handheld") else { return };
    let scans = list_scans(&folder).unwrap();
    assert_eq!((scans.format, scans.files.len()), (CloudFormat::Xyz32, 45));
    assert!(scans.files[0].ends_with("scan000.xyz32.bin") && scans.files[44].ends_with("scan176.xyz32.bin"));
    let poses = read_poses(&folder.join("poses.tum")).unwrap();
    assert_eq!(poses.len(), 45);
    assert_eq!(poses[1].stamp_s, Some(1_630_577_760.569_062));
    let path: f64 = poses
        .windows(2)
        .map(|p| (p[1].map_from_scanner.translation.vector - p[0].map_from_scanner.translation.vector).norm())
        .sum();
    assert!((70.0..78.0).contains(&path), "{path} m");
    let total: usize = scans.files.iter().map(|file| read_cloud(file).unwrap().points.len()).sum();
    let counted: usize = scans.files.iter().map(|file| count_points(file).unwrap()).sum();
    assert_eq!(total, counted);
    assert!((25_000..35_000).contains(&(total / 45)), "{total}");
}

#[test]
fn the_gzipped_clouds_of_libpointmatcher_are_read() {
    let Some(folder) = data_set("libpointmatcher", "libpointmatcher") else { return };
    for (name, points) in
        [("cloud.00000", 24_989), ("cloud.00001", 25_193), ("cloud.00002", 24_154), ("cloud_0", 36_674)]
    {
        let path = folder.join(format!("{name}.vtk.gz"));
        assert_eq!(read_cloud(&path).unwrap().points.len(), points);
        assert_eq!(count_points(&path).unwrap(), points);
    }
    // The one has names and commas, the other neither.
    let [first, second] =
        ["car_cloud400.csv.gz", "car_cloud401.csv.gz"].map(|name| read_cloud(&folder.join(name)).unwrap().points);
    assert!(first.len() > 20_000 && second.len() > 20_000);
    assert!((first[0].vector() - Vector3::new(-3.5376, 0.639_553, -1.376_78)).norm() < 1e-6);
    // The list of poses is a table of its own kind; its last line is the pose of 401 in 400.
    let list = fs::read_to_string(folder.join("carCloudList.csv")).unwrap();
    let last = list.lines().last().unwrap();
    let values: Vec<f64> = last.split(',').skip(1).map(|v| v.trim().parse().unwrap()).collect();
    let pose = pose_from_rows(&values.try_into().unwrap()).unwrap();
    let (with, without) = (mean_gap(&first, &second, &pose), mean_gap(&first, &second, &Pose::identity()));
    println!("car pair: gap {with:.4} m with its pose, {without:.4} without");
    assert!(with < 0.5 * without, "{with} {without}");
    // Clouds of two formats in one folder; the list is not counted as a cloud.
    let error = list_scans(&folder).unwrap_err();
    let FormatError::TwoFormats { first, second, .. } = &error else { panic!("{error}") };
    assert!(first.ends_with(".csv.gz") && second.ends_with(".vtk.gz"), "{error}");
}

#[test]
fn the_ply_pair_of_small_gicp_is_read_with_its_intensity() {
    let Some(folder) = data_set("small_gicp", "small_gicp") else { return };
    let scans = list_scans(&folder).unwrap();
    assert_eq!((scans.format, scans.files.len()), (CloudFormat::Ply, 2));
    let cloud = read_cloud(&scans.files[0]).unwrap();
    assert_eq!(cloud.points.len(), 69_792);
    assert_eq!(cloud.points.iter().take(1).map(|p| p.intensity).collect::<Vec<_>>(), [70]);
    assert!(cloud.points.iter().all(|p| p.is_return() && p.range() < 300.0));
}

#[test]
fn the_kitti_scans_are_read() {
    let Some(folder) = data_set("kitti", "kitti00_first6") else { return };
    let scans = list_scans(&folder).unwrap();
    assert_eq!(scans.files.len(), 6);
    for file in &scans.files {
        let points = read_cloud(file).unwrap().points;
        assert!((123_000..125_000).contains(&points.len()), "{}", points.len());
        assert!(points.iter().all(|p| p.is_return() && p.range() < 120.0));
    }
    let poses = read_poses(&folder.join("poses_lidar_gt.txt")).unwrap();
    assert_eq!(poses.len(), 6);
    assert!((poses[1].map_from_scanner.translation.x - 0.858_767_840_3).abs() < 1e-9);
}
