//! Poses, path, candidates and zones as rows of coloured points, for viewers that draw nothing but clouds.

use foxglove::messages::PointCloud;
use mirador_core::geometry::Pose;
use mirador_ipc_schema::messages::{CANDIDATE_OPEN, CandidateView, ViewPlanMeta, Waypoint, Zone};

use crate::Stamps;
use crate::colour::{CHOSEN, Colour, TRAJECTORY, ZONE};
use crate::points::dots;
use crate::scene::candidate_colours;

/// Distance between the dots of a line [m].
const SPACING_M: f64 = 0.1;
/// Most dots of one line.
const MOST_OF_LINE: f64 = 200.0;
/// Length of a pose's axes [m].
const AXIS_M: f64 = 0.6;

type Dots = Vec<([f64; 3], Colour)>;

/// The way from scan to scan, and at each the axes x, y, z of the scanner in red, green, blue.
pub(crate) fn poses<'a>(stamps: Stamps, poses: impl Iterator<Item = &'a Pose>) -> PointCloud {
    let mut all = Dots::new();
    let mut before: Option<[f64; 3]> = None;
    for pose in poses {
        let here: [f64; 3] = pose.translation.vector.into();
        if let Some(before) = before {
            line(&mut all, before, here, TRAJECTORY);
        }
        for (axis, colour) in [[255, 0, 0], [0, 170, 0], [0, 80, 255]].into_iter().enumerate() {
            let mut tip = nalgebra::Vector3::zeros();
            tip[axis] = AXIS_M;
            line(&mut all, here, (pose * nalgebra::Point3::from(tip)).coords.into(), colour);
        }
        before = Some(here);
    }
    dots(stamps, all.into_iter())
}

pub(crate) fn path(stamps: Stamps, waypoints: &[Waypoint]) -> PointCloud {
    let mut all = Dots::new();
    for leg in waypoints.windows(2) {
        line(&mut all, leg[0].position, leg[1].position, CHOSEN);
    }
    dots(stamps, all.into_iter())
}

/// Candidates that were valued as short lines in their direction, rejected ones as one dot; over the chosen one a mast.
pub(crate) fn candidates(stamps: Stamps, plan: &ViewPlanMeta, candidates: &[CandidateView]) -> PointCloud {
    let mut all = Dots::new();
    for (k, (candidate, colour)) in candidates.iter().zip(candidate_colours(plan, candidates)).enumerate() {
        let [x, y, z] = candidate.position;
        let (sin, cos) = candidate.heading.sin_cos();
        if candidate.status == CANDIDATE_OPEN {
            line(&mut all, [x, y, z], [x + 0.5 * cos, y + 0.5 * sin, z], colour);
        } else {
            all.push(([x, y, z], colour));
        }
        if k == plan.chosen as usize {
            line(&mut all, [x, y, z], [x, y, z + 2.0], colour);
        }
    }
    dots(stamps, all.into_iter())
}

/// A line from the centre of every zone along its normal, as long as the zone is wide.
pub(crate) fn zones(stamps: Stamps, zones: &[Zone]) -> PointCloud {
    let mut all = Dots::new();
    for zone in zones {
        let (centre, normal) = (zone.centre.map(f64::from), nalgebra::Vector3::from(zone.normal.map(f64::from)));
        let length = f64::from(zone.area.max(0.0).sqrt().clamp(0.1, 3.0));
        let tip = normal.try_normalize(1e-9).map_or(nalgebra::Vector3::zeros(), |n| n * length);
        line(&mut all, centre, std::array::from_fn(|c| centre[c] + tip[c]), ZONE);
    }
    dots(stamps, all.into_iter())
}

/// Dots from `from` to `to`, both included; nothing where one of them is nowhere.
fn line(all: &mut Dots, from: [f64; 3], to: [f64; 3], colour: Colour) {
    let length = from.iter().zip(&to).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    if length.is_finite() {
        let steps = (length / SPACING_M).ceil().clamp(1.0, MOST_OF_LINE);
        let place = |k: u32| std::array::from_fn(|c| from[c] + (to[c] - from[c]) * f64::from(k) / steps);
        all.extend((0..=steps as u32).map(|k| (place(k), colour)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_both_its_ends_and_even_steps() {
        let mut all = Dots::new();
        line(&mut all, [1.0, 0.0, 0.0], [1.0, 0.35, 0.0], CHOSEN);
        let y: Vec<f64> = all.iter().map(|d| d.0[1]).collect();
        assert_eq!((y.len(), y[0], y[4]), (5, 0.0, 0.35));
        assert!(y.windows(2).all(|w| (w[1] - w[0] - 0.0875).abs() < 1e-12), "{y:?}");
        line(&mut all, [0.0; 3], [f64::NAN, 0.0, 0.0], CHOSEN);
        line(&mut all, [0.0; 3], [1e9, 0.0, 0.0], CHOSEN);
        assert_eq!(all.len(), 5 + 201);
    }
}
