//! Real registration whose chain is made to drift: loops are then so far off that coarse alignment must find them.

use std::any::Any;

use nalgebra::Vector3;

use super::*;
use crate::geometry::{Covariance, Twist, exp};
use crate::registration::test_scenes::{Rectangle, scan_of};
use crate::registration::{AlignError, Alignment, Limits, PrepareError, PreparedScan, RegistrationConfig, Registry};
use crate::scan::Grid;

/// The default method.
pub fn method(threads: usize) -> Box<dyn Registration> {
    let config = RegistrationConfig { threads, ..RegistrationConfig::default() };
    Registry::default().create("point_to_plane", &config).unwrap()
}

/// Errs by this twist, one way or the other, at every pair of scans as they came (ordered); pairs of stored keyframes
/// are right.
struct Drifting {
    method: Box<dyn Registration>,
    error: Twist,
    pairs: u32,
}

struct Tagged {
    prepared: Box<dyn PreparedScan>,
    is_original: bool,
}

impl PreparedScan for Tagged {
    fn points(&self) -> &[[f32; 3]] {
        self.prepared.points()
    }

    fn bytes(&self) -> usize {
        self.prepared.bytes()
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

impl Registration for Drifting {
    fn name(&self) -> &str {
        "drifting"
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        let prepared = self.method.prepare(ScanView::unordered(scan.points))?;
        Ok(Box::new(Tagged { prepared, is_original: scan.grid.is_some() }))
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        start: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let [target, source] = [target, source].map(|scan| scan.as_any().downcast_ref::<Tagged>().unwrap());
        let mut alignment = self.method.align(&*target.prepared, &*source.prepared, start, limits)?;
        if target.is_original && source.is_original {
            self.pairs += 1;
            // More one way than the other, as the errors of a few dozen pairs are.
            let sign = if self.pairs.is_multiple_of(3) { -1.0 } else { 1.0 };
            alignment.target_from_source *= exp(&(self.error * sign));
            alignment.covariance += Covariance::from_diagonal(&self.error.component_mul(&self.error));
        }
        Ok(alignment)
    }
}

/// A block of houses with a street around it, and things in the street that differ from place to place.
pub fn block() -> Vec<Rectangle> {
    let mut scene: Vec<Rectangle> = vec![([-22.0, -22.0, -1.0], [44.0, 0.0, 0.0], [0.0, 44.0, 0.0])];
    let mut wall = |x: f64, y: f64, dx: f64, dy: f64, height: f64| {
        scene.push(([x, y, -1.0], [dx, dy, 0.0], [0.0, 0.0, height]));
    };
    for (low, high, height) in [(-10.0, 10.0, 5.0), (-22.0, 22.0, 4.0)] {
        let side = high - low;
        wall(low, low, side, 0.0, height);
        wall(low, high, side, 0.0, height);
        wall(low, low, 0.0, side, height);
        wall(high, low, 0.0, side, height);
    }
    // Boxes, each of its own size, at irregular places along the street.
    let places = [(-15.0, -19.0), (-3.0, -13.0), (6.0, -18.5), (17.5, -9.0), (13.0, 3.5), (18.0, 14.0)];
    let more = [(8.0, 17.0), (-2.5, 19.0), (-12.0, 14.0), (-18.0, 6.0), (-13.0, -2.0), (-19.0, -11.0)];
    for (k, (x, y)) in places.into_iter().chain(more).enumerate() {
        let (a, b, height) = (1.0 + 0.3 * (k % 4) as f64, 0.8 + 0.4 * (k % 3) as f64, 1.0 + 0.5 * (k % 5) as f64);
        wall(x, y, a, 0.2 * a, height);
        wall(x, y, -0.2 * b, b, height);
        wall(x + a, y + 0.2 * a, -0.2 * b, b, height);
        wall(x - 0.2 * b, y + b, a, 0.2 * a, height);
    }
    scene
}

/// Around the block, two metres at a time, and a little further than where it began.
fn around() -> Vec<Pose> {
    let corners = [[-16.0, -16.0], [16.0, -16.0], [16.0, 16.0], [-16.0, 16.0]];
    let mut walk = Vec::new();
    for side in 0..5 {
        let (from, to) = (Vector3::from([corners[side % 4][0], corners[side % 4][1], 0.0]), corners[(side + 1) % 4]);
        let ahead = Vector3::new(to[0] - from.x, to[1] - from.y, 0.0).normalize();
        let steps = if side == 4 { 4 } else { 16 };
        walk.extend(
            (0..steps).map(|k| Pose::new(from + ahead * 2.0 * f64::from(k), Vector3::z() * ahead.y.atan2(ahead.x))),
        );
    }
    walk
}

#[test]
fn a_loop_far_off_is_found_by_coarse_alignment_and_closed() {
    let (scene, truth) = (block(), around());
    let error = Twist::new(0.0, 0.03, 0.0, 0.0, 0.0, 0.012);
    // No pairs with scans shortly before, which would see through it.
    let config = GlobalConfig { overlaps_per_scan: 0, ..GlobalConfig::default() };
    let mut aligner = aligner(Box::new(Drifting { method: method(2), error, pairs: 0 }), &config);
    let mut off = Vec::new();
    let mut closed = 0;
    for (k, pose) in truth.iter().enumerate() {
        let points = scan_of(&scene, pose, 6.0, k as u64 + 1);
        let scan = ScanView::ordered(&points, Grid { rows: 1, cols: points.len() }).unwrap();
        let record = aligner.align_next(k as u64, scan, Some(*pose));
        off.push((record.map_from_scanner.translation.vector - pose.translation.vector).norm());
        let record = aligner.correct(&|| false).unwrap();
        for pair in record.pairs.iter().filter(|p| p.kind == PairKind::Loop) {
            println!(
                "{k} with {}: {:?}, sigma {:.2} m {:.3}, overlap {:.2}, {:.1} sigmas: {:?}",
                pair.target_id,
                pair.start,
                pair.predicted_sigma_m,
                pair.predicted_sigma_rotation,
                pair.overlap,
                pair.sigmas,
                pair.rejected
            );
            closed += usize::from(pair.start == PairStart::Coarse && pair.rejected.is_none());
        }
        if let Some(relaxation) = record.relaxation {
            println!("{k}: {relaxation:?}, {} moved, off {:.2} m", record.corrections.len(), off[k]);
        }
    }
    let end = largest_error(&poses(&aligner), &truth);
    let drift = off.iter().fold(0.0_f64, |a, b| a.max(*b));
    println!("drift {drift:.2} m, at the end {end:.3} m; {closed} loops by coarse alignment");
    assert!(drift > 1.5 && end < 0.3 * drift, "{drift} {end}");
    assert!(closed > 0);
}
