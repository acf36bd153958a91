//! The odometry over a folder of scans, with the time each frame took.
//!
//!     cargo run --release -p mirador-core --example odometry -- FOLDER [threads] [voxel_m] [max_range_m] [repetitions]
//!
//! Prints one line a frame: status, position [m], score, steps, and the median time over the repetitions [ms].

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use mirador_core::formats::{list_scans, read_cloud};
use mirador_core::odometry::{FrameRecord, Odometry, OdometryConfig};
use mirador_core::scan::ScanView;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let number = |k: usize, default: f64| arguments.get(k).map_or(Ok(default), |text| text.parse());
    let folder = arguments.get(1).ok_or("which folder?")?;
    let defaults = OdometryConfig::default();
    let config = OdometryConfig {
        threads: number(2, 1.0)? as usize,
        voxel_m: number(3, defaults.voxel_m)?,
        max_range_m: number(4, defaults.max_range_m)?,
        ..defaults
    };
    let files = list_scans(Path::new(folder))?.files;
    let clouds = files.iter().map(|file| read_cloud(file)).collect::<Result<Vec<_>, _>>()?;
    let mut times = vec![Vec::new(); clouds.len()];
    let mut records: Vec<FrameRecord> = Vec::new();
    let mut bytes = 0;
    for _ in 0..number(5, 5.0)?.max(1.0) as usize {
        let mut odometry = Odometry::new(config.clone())?;
        records.clear();
        for (cloud, times) in clouds.iter().zip(&mut times) {
            let begin = Instant::now();
            records.push(odometry.register_frame(ScanView::unordered(&cloud.points), None, None));
            times.push(begin.elapsed().as_secs_f64() * 1e3);
        }
        bytes = odometry.bytes();
    }
    let mut medians = Vec::new();
    for ((k, record), times) in records.iter().enumerate().zip(&mut times) {
        times.sort_by(f64::total_cmp);
        let ms = times.get(times.len() / 2).copied().unwrap_or_default();
        medians.push(ms);
        let t = record.map_from_scanner.translation.vector;
        println!(
            "{k:4} {:?} {:?} ({:.3}, {:.3}, {:.3}) m, score {:.3}, overlap {:.3}, {} steps, {} points, {} searched, {ms:.2} ms",
            record.status,
            record.start,
            t.x,
            t.y,
            t.z,
            record.score,
            record.overlap,
            record.iterations,
            record.points,
            record.searched,
        );
    }
    let mean = medians.iter().sum::<f64>() / medians.len().max(1) as f64;
    medians.sort_by(f64::total_cmp);
    println!("median {:.2} ms, mean {mean:.2} ms a frame, {bytes} bytes", medians[medians.len() / 2]);
    Ok(())
}
