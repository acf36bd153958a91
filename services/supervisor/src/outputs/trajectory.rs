//! `trajectory.tum`: one line a pose, `timestamp tx ty tz qx qy qz qw`.

use std::io::{self, Write};

use super::run_data::RunData;

/// Writes the poses map_from_scanner of the aligned scans; those that are not stand in comments.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_tum(data: &RunData, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "# timestamp[s] tx ty tz[m] qx qy qz qw, map_from_scanner")?;
    for record in &data.scans {
        if let Some(reason) = record.reason() {
            writeln!(out, "# scan {} is not aligned: {}", record.number(), super::one_line(&reason))?;
            continue;
        }
        let Some(pose) = record.pose() else { continue };
        let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
        let stamp = record.scan.header.stamp_ns;
        let sign = if stamp < 0 { "-" } else { "" };
        let (seconds, rest) = (stamp.unsigned_abs() / 1_000_000_000, stamp.unsigned_abs() % 1_000_000_000);
        writeln!(
            out,
            "{sign}{seconds}.{rest:09} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            t.x, t.y, t.z, q.i, q.j, q.k, q.w
        )?;
    }
    Ok(())
}
