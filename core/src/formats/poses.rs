//! Trajectories in: TUM, KITTI and 3DTK.

use super::{
    cloud_format::file_name,
    error::FormatError,
    folder::files_in_order,
    source::{Source, quoted},
    tdtk::{metres_from_tdtk, numbers},
};
use crate::geometry::{Pose, pose_from_rows};
use nalgebra::{Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::path::Path;

/// How far the norm of a quaternion may be from 1: rounding to two digits, but not another order of the columns.
const UNIT_TOLERANCE: f64 = 1e-2;

/// A pose of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedPose {
    /// Time [s] on the clock of the file; `None` where the format has none.
    pub stamp_s: Option<f64>,
    /// From the scanner's frame to the map [m].
    pub map_from_scanner: Pose,
}

/// Reads poses, in the order of the file: TUM (`timestamp tx ty tz qx qy qz qw`) or KITTI (12 numbers, the upper rows
/// of a 4x4 matrix), told apart by the number of columns, with `#` comments; a 3DTK `.pose` file (one pose); or a folder
/// of `.pose` files, in the natural order of their names. A `.gz` after the name is unpacked.
///
/// # Errors
/// File and line of a wrong number of columns, a value that is not finite, a quaternion that is not of unit length
/// within 1e-2, a matrix that is not a rotation; or that there are no poses.
pub fn read_poses(path: &Path) -> Result<Vec<StampedPose>, FormatError> {
    let poses = if path.is_dir() {
        let files = files_in_order(path)?;
        let of_3dtk = files.iter().filter(|file| is_tdtk_pose(file));
        of_3dtk.map(|file| read_tdtk_pose(file)).collect::<Result<Vec<_>, _>>()?
    } else if is_tdtk_pose(path) {
        vec![read_tdtk_pose(path)?]
    } else {
        read_pose_lines(path)?
    };
    if poses.is_empty() {
        return Err(FormatError::NoPoses { path: path.to_path_buf() });
    }
    Ok(poses)
}

fn is_tdtk_pose(path: &Path) -> bool {
    let name = file_name(path);
    name.strip_suffix(".gz").unwrap_or(&name).ends_with(".pose")
}

fn read_pose_lines(path: &Path) -> Result<Vec<StampedPose>, FormatError> {
    let mut source = Source::open(path)?;
    let mut poses = Vec::new();
    let mut columns = None;
    while source.next_data_line()? {
        let found = source.tokens().count();
        let pose = match (found, columns.unwrap_or(found)) {
            (8, 8) => tum_pose(&source)?,
            (12, 12) => kitti_pose(&source)?,
            _ => {
                let expected =
                    "8 (TUM: timestamp tx ty tz qx qy qz qw) or 12 (KITTI: three rows of four), all lines alike";
                return Err(source.malformed_line("the number of columns", found.to_string(), expected));
            }
        };
        columns = Some(found);
        poses.push(pose);
    }
    Ok(poses)
}

/// The numbers of a pose line, all finite.
fn finite<const N: usize>(source: &Source, field: &'static str, expected: &str) -> Result<[f64; N], FormatError> {
    let values = numbers::<N>(source, field, expected)?;
    match values.iter().find(|v| !v.is_finite()) {
        Some(v) => Err(source.malformed_line(field, v.to_string(), "a finite number")),
        None => Ok(values),
    }
}

fn tum_pose(source: &Source) -> Result<StampedPose, FormatError> {
    let [stamp, tx, ty, tz, qx, qy, qz, qw] = finite(source, "the pose", "timestamp tx ty tz qx qy qz qw")?;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if (quaternion.norm() - 1.0).abs() > UNIT_TOLERANCE {
        let found = format!("of length {:.4}", quaternion.norm());
        return Err(source.malformed_line(
            "the quaternion (columns 5 to 8, qw last)",
            found,
            "of length 1 within 0.01",
        ));
    }
    let map_from_scanner = Pose::from_parts(Translation3::new(tx, ty, tz), UnitQuaternion::from_quaternion(quaternion));
    Ok(StampedPose { stamp_s: Some(stamp), map_from_scanner })
}

fn kitti_pose(source: &Source) -> Result<StampedPose, FormatError> {
    let top: [f64; 12] = finite(source, "the pose", "12 numbers")?;
    let mut rows = [0.0; 16];
    for (row, value) in rows.iter_mut().zip(top.into_iter().chain([0.0, 0.0, 0.0, 1.0])) {
        *row = value;
    }
    let map_from_scanner = pose_from_rows(&rows).ok_or_else(|| {
        let found = quoted(source.line());
        source.malformed_line("the matrix", found, "a rotation with a translation as its fourth column")
    })?;
    Ok(StampedPose { stamp_s: None, map_from_scanner })
}

fn read_tdtk_pose(path: &Path) -> Result<StampedPose, FormatError> {
    let mut source = Source::open(path)?;
    let mut line = |what: &'static str, expected: &str| {
        if !source.next_data_line()? {
            return Err(source.truncated(format!("{what}: {expected}")));
        }
        finite::<3>(&source, what, expected)
    };
    let position_cm = line("the position", "x y z [cm]")?;
    let euler_deg = line("the Euler angles", "x y z [degrees]")?;
    Ok(StampedPose { stamp_s: None, map_from_scanner: pose_from_tdtk(position_cm, euler_deg) })
}

/// The right-handed pose [m] of a 3DTK pose. In 3DTK's left-handed axes it maps p to R p + t with
/// R = Rx(a) Ry(b) Rz(c); with C the change of axes (x ahead = z, y left = -x, z up = y) it is C R C^T, C t / 100.
/// C turns the handedness, which the product does twice: the result is a rotation again.
fn pose_from_tdtk(position_cm: [f64; 3], euler_deg: [f64; 3]) -> Pose {
    let [a, b, c] = euler_deg.map(f64::to_radians);
    let turn = |axis: Vector3<f64>, angle: f64| Rotation3::from_scaled_axis(axis * angle);
    let tdtk = turn(Vector3::x(), a) * turn(Vector3::y(), b) * turn(Vector3::z(), c);
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
    let rotation = Rotation3::from_matrix_unchecked(axes * tdtk.matrix() * axes.transpose());
    let translation = Translation3::from(Vector3::from(metres_from_tdtk(position_cm)));
    Pose::from_parts(translation, UnitQuaternion::from_rotation_matrix(&rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::fs;

    fn read(name: &str, text: &[u8]) -> Result<Vec<StampedPose>, FormatError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        read_poses(&path)
    }

    #[test]
    fn a_tum_file_gives_stamps_and_poses_and_leaves_comments_out() {
        let poses = read("a.tum", b"# stamp t q\n1.5 1 2 3 0 0 0 1\n\n2.5 4 5 6 0 0 0.7071068 0.7071068\n").unwrap();
        assert_eq!(poses.len(), 2);
        assert_eq!(poses[0].stamp_s, Some(1.5));
        assert_eq!(poses[1].map_from_scanner.translation.vector, Vector3::new(4.0, 5.0, 6.0));
        let ahead = poses[1].map_from_scanner.rotation * Vector3::x();
        assert!((ahead - Vector3::y()).norm() < 1e-6);
    }

    #[test]
    fn a_kitti_file_gives_poses_without_stamps() {
        let poses = read("00.txt", b"1 0 0 7 0 1 0 8 0 0 1 9\n").unwrap();
        assert_eq!(poses[0].stamp_s, None);
        assert_eq!(poses[0].map_from_scanner, Pose::translation(7.0, 8.0, 9.0));
    }

    #[test]
    fn wrong_poses_are_refused_with_their_line() {
        let cases: [(&str, &[u8], &str); 7] = [
            ("a.tum", b"0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 2\n", "line 2"),
            ("a.tum", b"0 0 0 0 0 0 0\n", "line 1"),
            ("a.tum", b"0 0 0 0 0 0 0 1\n0 0 0 NaN 0 0 0 1\n", "line 2"),
            ("a.tum", b"0 0 0 0 0 0 0 1\n1 0 0 0 0 1 0 0 0 0 1 0\n", "line 2"),
            ("a.txt", b"1 0 0 7 0 1 0 8 0 0 2 9\n", "line 1"),
            ("a.txt", b"1 0 0 seven 0 1 0 8 0 0 1 9\n", "seven"),
            ("a.pose", b"1 2 3\n0 zero 0\n", "line 2"),
        ];
        for (name, text, place) in cases {
            let message = read(name, text).unwrap_err().to_string();
            assert!(message.contains(place) && message.contains(name), "{message}");
        }
        assert!(matches!(read("a.tum", b"# nothing\n"), Err(FormatError::NoPoses { .. })));
        assert!(matches!(read("a.pose", b"1 2 3\n"), Err(FormatError::Truncated { .. })));
    }

    #[test]
    fn the_3dtk_angles_turn_about_the_right_axes() {
        // Left-handed, x right, y up, z ahead: a positive turn about y (up) takes ahead (z) to the right (x).
        let yaw = pose_from_tdtk([0.0; 3], [0.0, 90.0, 0.0]);
        assert!((yaw.rotation * Vector3::x() - -Vector3::y()).norm() < 1e-12);
        // A positive turn about x (right) takes up (y) to ahead (z).
        let pitch = pose_from_tdtk([0.0; 3], [90.0, 0.0, 0.0]);
        assert!((pitch.rotation * Vector3::z() - Vector3::x()).norm() < 1e-12);
        // A positive turn about z (ahead) takes right (x) to up (y).
        let roll = pose_from_tdtk([0.0; 3], [0.0, 0.0, 90.0]);
        assert!((roll.rotation * -Vector3::y() - Vector3::z()).norm() < 1e-12);
        let moved = pose_from_tdtk([100.0, 200.0, 300.0], [0.0; 3]);
        assert_eq!(moved.translation.vector, Vector3::new(3.0, -1.0, 2.0));
    }

    proptest! {
        #[test]
        fn a_3dtk_pose_is_the_left_handed_one_in_other_axes(
            t in prop::array::uniform3(-900.0..900.0f64),
            e in prop::array::uniform3(-180.0..180.0f64),
            p in prop::array::uniform3(-900.0..900.0f64),
        ) {
            // The matrix of 3DTK's own convention, written out by its entries.
            let [(sx, cx), (sy, cy), (sz, cz)] = e.map(|a| a.to_radians().sin_cos());
            let r = Matrix3::new(
                cy * cz, -cy * sz, sy,
                sx * sy * cz + cx * sz, -sx * sy * sz + cx * cz, -sx * cy,
                -cx * sy * cz + sx * sz, cx * sy * sz + sx * cz, cx * cy,
            );
            let moved = r * Vector3::from(p) + Vector3::from(t);
            let direct = Vector3::from(metres_from_tdtk(moved.into()));
            let through = pose_from_tdtk(t, e) * nalgebra::Point3::from(metres_from_tdtk(p));
            prop_assert!((through.coords - direct).norm() < 1e-9);
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), kind in 0..2_usize) {
            let name = ["a.tum", "a.pose"][kind];
            if let Ok(poses) = read(name, &bytes) {
                prop_assert!(!poses.is_empty());
            }
        }
    }
}
