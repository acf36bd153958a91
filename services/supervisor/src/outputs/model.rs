//! `model.ply`: every point of every scan in the map's frame, with its quality, its scan and whether that was aligned.
//!
//! Streamed: the recording is read one scan at a time, so memory does not grow with the run.

use std::path::Path;

use mirador_core::formats::{CloudWriter, OutPoint, PlyOptions, PlyWriter};
use mirador_core::geometry::Pose;
use mirador_core::odometry::MotionTable;
use mirador_core::simulation::{ModelDistance, ModelDistances};
use mirador_ipc_schema::messages::{Point, PointScore};
use mirador_ipc_schema::topics;
use mirador_recorder::RunReader;
use nalgebra::Point3;

use super::OutputError;
use super::facts::RunFacts;
use super::run_data::{RunData, ScanRecord};
use super::summary::map_from_world;

/// Beyond this distance from the origin f32 is too coarse for a millimetre, and coordinates are written as f64 [m].
const F32_REACH_M: f64 = 10_000.0;
/// Quality of a point that was not scored.
const NOT_SCORED: f32 = -1.0;

/// Writes the model; returns how far it lies from the true surfaces, where these are known.
///
/// # Errors
/// See [`OutputError`].
pub fn write_model(
    reader: &mut RunReader,
    data: &RunData,
    facts: &RunFacts,
    path: &Path,
) -> Result<Option<ModelDistance>, OutputError> {
    let (truth, mut distances) = (facts.scene.as_ref().zip(map_from_world(data, facts)), ModelDistances::default());
    let mut file: Box<dyn CloudWriter> = Box::new(PlyWriter::create(path, &options(data))?);
    let (mut points, mut scores): (Vec<Point>, Vec<PointScore>) = (Vec::new(), Vec::new());
    let mut out = Vec::new();
    for record in &data.scans {
        let (scan, Some(pose)) = (record.number(), record.pose()) else { continue };
        if reader.read_about::<topics::Scan>(scan, &mut points)?.is_none() {
            continue;
        }
        if reader.read_about::<topics::ScoredScan>(scan, &mut scores)?.is_none() {
            scores.clear();
        }
        out.clear();
        let is_aligned = record.is_aligned();
        let motion = record.scan_motion();
        for (index, point) in points.iter().enumerate() {
            let place = at_end(point, motion.as_ref());
            let placed = OutPoint { scan, is_aligned, ..in_map(point, place, &pose, scores.get(index)) };
            if placed.is_return() {
                out.push(placed);
            }
        }
        file.write(&out)?;
        if let Some((scene, map_from_world)) = truth.as_ref().filter(|_| is_aligned) {
            let world_from_map = map_from_world.inverse();
            distances.sample(scene, out.iter().map(|point| world_from_map * Point3::from(point.position)));
        }
    }
    file.finish()?;
    Ok(distances.summary())
}

/// Where the end of the scan sees a point [m, scanner frame].
fn at_end(point: &Point, motion: Option<&MotionTable>) -> [f32; 3] {
    let place = [point.x, point.y, point.z];
    motion.map_or(place, |motion| motion.end_from(f32::from(point.time) / 65535.0, place))
}

fn in_map(point: &Point, place: [f32; 3], map_from_scanner: &Pose, score: Option<&PointScore>) -> OutPoint {
    let position = map_from_scanner * Point3::from(place).cast::<f64>();
    let valid = score.filter(|s| s.flags & 1 != 0);
    OutPoint {
        position: position.coords.into(),
        quality: valid.map_or(NOT_SCORED, |s| f32::from(s.quality) / 65535.0),
        scan: 0,
        intensity: point.intensity,
        is_aligned: false,
    }
}

fn options(data: &RunData) -> PlyOptions {
    let is_far = |pose: Pose| pose.translation.vector.amax() > F32_REACH_M;
    let mut comments = vec![
        "mirador model, frame map (z up) [m]".to_owned(),
        format!("quality in 0 to 1, {NOT_SCORED} where a point was not scored"),
    ];
    let unaligned =
        |s: &ScanRecord| Some(format!("scan {} is not aligned: {}", s.number(), super::one_line(&s.reason()?)));
    comments.extend(data.scans.iter().filter_map(unaligned));
    PlyOptions { is_double: data.scans.iter().filter_map(ScanRecord::pose).any(is_far), comments }
}
