//! A scan that shares little with the one it was aligned to, aligned once more to that one and others near it as one: what the
//! older scans see together holds it where a single one leaves it to slide.

use super::attempt::Attempt;
use super::older_scans::{Accepted, OlderScans};
use super::sequential::SequentialAligner;
use super::{AlignmentRecord, HypothesisName, Rejection, TargetState};
use crate::geometry::{Pose, log};
use crate::registration::{PreparedCloud, PreparedScan};
use crate::scan::{Point, ScanView};

/// So far from the prior [standard deviations] a pose may be moved by aligning it once more: where the scans leave a direction
/// nearly open, more overlap is no proof.
const MOST_STRAIN: f64 = 3.0;

impl SequentialAligner {
    /// Aligns an accepted scan once more, from where it was found, to its target together with the accepted scans near it. The
    /// record is left as it is unless the result is accepted, overlaps more, and lies no farther from the prior than is likely.
    pub(super) fn refine(
        &mut self,
        record: &mut AlignmentRecord,
        last: Accepted,
        older: &mut dyn OlderScans,
        source: &dyn PreparedScan,
    ) {
        if self.config().submap_scans == 0 || record.overlap >= self.config().submap_below_overlap {
            return;
        }
        let Some(target_id) = record.target_id else { return };
        let found = record.map_from_scanner;
        // Scans of an earlier pass that no closed loop ties to the target may stand beside where they belong.
        let mut members = older.tied_to(self.registration(), target_id, &found, self.config().submap_scans);
        let is_last = last.0.scan_id == target_id;
        let target = if is_last { Some(last) } else { older.by_id(self.registration(), target_id) };
        let Some(target) = target.filter(|_| !members.is_empty()) else { return };
        members.push(target.clone());
        let target = &target.0;
        // What some methods need beside points cannot be made from these: then the record stays as it is.
        let Ok(together) = self.registration().prepare(ScanView::of_several(&merged(target, &members, &found))) else {
            return;
        };
        let pair_distance_m = self.config().limits.pair_distance_m;
        let (name, start) = (HypothesisName::Submap, target.map_from_scanner.inverse() * found);
        let attempt = Attempt { name, target, scan: &*together, start, pair_distance_m };
        let mut refined = record.clone();
        let accepted = self.attempt(&mut refined, &attempt, source);
        // The overlap of one that was taken back is that of where it had slid to.
        let was_held = record.hypotheses.last().is_some_and(|last| last.name == HypothesisName::Held);
        let gains = was_held || refined.overlap > record.overlap;
        if accepted && gains && self.strain(&refined) <= self.strain(record).max(MOST_STRAIN) {
            *record = refined;
            return;
        }
        // What was tried is said all the same.
        if let Some(tried) = refined.hypotheses.last_mut().filter(|_| accepted) {
            tried.rejected = Some(Rejection::NoGain { overlap: refined.overlap, before: record.overlap });
        }
        (record.hypotheses, record.iterations) = (refined.hypotheses, refined.iterations);
    }

    /// How far a pose lies from where the prior has it, in standard deviations of the prior; 0 for a prior that does not say.
    fn strain(&self, record: &AlignmentRecord) -> f64 {
        let covariance = self.prior.and_then(|prior| prior.covariance);
        let Some((guess, covariance)) = self.guess_by_prior().zip(covariance) else { return 0.0 };
        let off = log(&(guess.inverse() * record.map_from_scanner));
        covariance.cholesky().map_or(0.0, |factor| off.dot(&factor.solve(&off)).max(0.0).sqrt())
    }
}

/// The points of all scans in the frame of the target, without those on surfaces of which a scanner at `seen_from`, a guessed
/// `map_from_scanner`, sees the other side: once together, nobody can tell any more which side was seen.
fn merged(target: &TargetState, members: &[Accepted], seen_from: &Pose) -> Vec<Point> {
    let mut points = Vec::with_capacity(members.iter().map(|(_, scan)| scan.points().len()).sum());
    for (state, scan) in members {
        let target_from_scan: Pose = target.map_from_scanner.inverse() * state.map_from_scanner;
        let scanner: [f64; 3] = (state.map_from_scanner.inverse() * seen_from).translation.vector.into();
        let scanner = scanner.map(|metres| metres as f32);
        let cloud = scan.as_any().downcast_ref::<PreparedCloud>();
        let shows_its_back = |index: usize| cloud.is_some_and(|cloud| cloud.is_seen_from_behind(index, scanner));
        points.extend(scan.points().iter().enumerate().filter(|&(index, _)| !shows_its_back(index)).map(
            |(_, point)| {
                let [x, y, z] = (target_from_scan * nalgebra::Point3::from(point.map(f64::from))).coords.into();
                Point::new(x as f32, y as f32, z as f32)
            },
        ));
    }
    points
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::Covariance;
    use crate::registration::test_scenes::half_of_a_hall;
    use crate::registration::{Limits, Registration, RegistrationConfig, Registry};

    fn accepted(method: &dyn Registration, scan_id: u64, at: Pose, points: &[Point]) -> Accepted {
        let scan: Arc<dyn PreparedScan> = Arc::from(method.prepare(ScanView::unordered(points)).unwrap());
        let state = TargetState {
            scan_id,
            map_from_scanner: at,
            prior: None,
            reduced_points: scan.points().len() as u64,
            covariance: Covariance::zeros(),
        };
        (state, scan)
    }

    #[test]
    fn a_face_of_a_wall_that_the_scanner_cannot_see_is_no_part_of_the_scans_together() {
        let places =
            [Pose::translation(-4.0, 1.0, 0.0), Pose::translation(-6.0, -3.0, 0.0), Pose::translation(4.0, -1.0, 0.0)];
        let mut method = Registry::default().create("gicp", &RegistrationConfig::default()).unwrap();
        let older = |k: usize| half_of_a_hall(-0.125, &places[k], k as u64);
        let members = [0, 1].map(|k| accepted(&*method, k as u64, places[k], &older(k)));
        let source = method.prepare(ScanView::unordered(&half_of_a_hall(0.125, &places[2], 2))).unwrap();
        let truth = places[0].inverse() * places[2];

        let mut off = |together: &[Point]| {
            let target = method.prepare(ScanView::of_several(together)).unwrap();
            let found = method.align(&*target, &*source, &truth, &Limits::default()).unwrap();
            (truth.inverse() * found.target_from_source).translation.vector.norm()
        };
        let all = merged(&members[0].0, &members, &places[0]);
        let seen = merged(&members[0].0, &members, &places[2]);
        let on_face = |points: &[Point]| points.iter().filter(|p| (p.x - 3.875).abs() < 0.1 && p.z > -0.8).count();
        // Some of its points, at its rims, have no plane.
        assert!(on_face(&all) > 800 && 10 * on_face(&seen) < on_face(&all), "{} {}", on_face(&all), on_face(&seen));
        assert!(seen.len() > all.len() / 2, "what is seen from both sides stays");
        assert!(off(&all) > 0.1 && off(&seen) < 0.02, "{} {}", off(&all), off(&seen));
    }
}
