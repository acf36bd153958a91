//! Where the points of a scan are, in units relative to its summary's anchor: one array an axis, so that many are worked out
//! at a time.

use super::condense::Frame;
use super::item::{HEIGHT_LIMIT, PLACE_LIMIT, Place};
use crate::analysis::PointScore;
use crate::scan::Point;

/// Points worked on together. So many that their loops stay loops for the compiler: unrolled ones it leaves scalar.
const WIDE: usize = 32;

/// The x of a point without a place.
const NOWHERE: i32 = i32::MIN;

/// The places of all points of a scan, by axis.
#[derive(Debug, Default)]
pub(super) struct Places {
    x: Vec<i32>,
    y: Vec<i32>,
    z: Vec<i32>,
}

/// Some consecutive places, by axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct SomePlaces<'a> {
    pub x: &'a [i32],
    pub y: &'a [i32],
    pub z: &'a [i32],
}

/// Some consecutive places to be worked out, by axis.
#[derive(Debug)]
pub(super) struct PlacesMut<'a> {
    x: &'a mut [i32],
    y: &'a mut [i32],
    z: &'a mut [i32],
}

/// What became of some points.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Found {
    /// Points with a place.
    pub counted: usize,
    /// Returns without a score.
    pub without_score: usize,
    /// Returns with a score that are too far away.
    pub outside: usize,
}

impl Places {
    /// Makes room for so many points; what the places are is left open.
    pub fn resize(&mut self, points: usize) {
        for axis in [&mut self.x, &mut self.y, &mut self.z] {
            axis.resize(points, NOWHERE);
        }
    }

    /// The first `count` places and the others, to be worked out.
    #[inline(always)]
    pub fn split_mut(&mut self, count: usize) -> [PlacesMut<'_>; 2] {
        let ((x, x_rest), (y, y_rest)) = (self.x.split_at_mut(count), self.y.split_at_mut(count));
        let (z, z_rest) = self.z.split_at_mut(count);
        [PlacesMut { x, y, z }, PlacesMut { x: x_rest, y: y_rest, z: z_rest }]
    }

    /// All places.
    #[inline(always)]
    pub fn all(&self) -> SomePlaces<'_> {
        SomePlaces { x: &self.x, y: &self.y, z: &self.z }
    }
}

impl<'a> SomePlaces<'a> {
    /// The place of a point; `None` where it has none.
    #[inline(always)]
    pub fn get(&self, index: usize) -> Option<Place> {
        let x = *self.x.get(index).filter(|x| **x != NOWHERE)?;
        Some(Place { x, y: *self.y.get(index)?, z: *self.z.get(index)? })
    }

    /// Those of a range.
    #[inline(always)]
    pub fn slice(&self, from: usize, to: usize) -> SomePlaces<'a> {
        SomePlaces { x: &self.x[from..to], y: &self.y[from..to], z: &self.z[from..to] }
    }
}

impl PlacesMut<'_> {
    /// Works out where points are: returns with a score have a place unless they are too far away.
    #[inline(always)]
    pub fn locate(&mut self, points: &[Point], scores: &[PointScore], frame: &Frame) -> Found {
        let mut found = Found::default();
        let count = points.len().min(scores.len()).min(self.x.len());
        for first in (0..count).step_by(WIDE) {
            let last = (first + WIDE).min(count);
            let given = Given::of(&points[first..last], &scores[first..last]);
            let [x, y, z] = given.places(frame, &mut found);
            let width = last - first;
            self.x[first..last].copy_from_slice(&x[..width]);
            self.y[first..last].copy_from_slice(&y[..width]);
            self.z[first..last].copy_from_slice(&z[..width]);
        }
        found
    }
}

/// Some points by quantity.
struct Given {
    at: [[f32; WIDE]; 3],
    /// One for a point with a score.
    has_score: [u32; WIDE],
}

impl Given {
    #[inline(always)]
    fn of(points: &[Point], scores: &[PointScore]) -> Self {
        let mut given = Self { at: [[f32::NAN; WIDE]; 3], has_score: [0; WIDE] };
        match (points.first_chunk::<WIDE>(), scores.first_chunk::<WIDE>()) {
            // So many are known to be there: no end has to be looked for.
            (Some(points), Some(scores)) => given.fill(points, scores),
            _ => given.fill(points, scores),
        }
        given
    }

    #[inline(always)]
    fn fill(&mut self, points: &[Point], scores: &[PointScore]) {
        let count = points.len().min(scores.len()).min(WIDE);
        for (k, point) in points[..count].iter().enumerate() {
            (self.at[0][k], self.at[1][k], self.at[2][k]) = (point.x, point.y, point.z);
        }
        for (k, score) in scores[..count].iter().enumerate() {
            self.has_score[k] = u32::from(score.flags & PointScore::VALID);
        }
    }

    /// The places by axis.
    #[inline(always)]
    fn places(&self, frame: &Frame, found: &mut Found) -> [[i32; WIDE]; 3] {
        const _: () = assert!(PointScore::VALID == 1, "the flag is taken for a number");
        let mut units = [[0i32; WIDE]; 3];
        let mut is_near = [1u32; WIDE];
        let limits = [f64::from(PLACE_LIMIT), f64::from(PLACE_LIMIT), f64::from(HEIGHT_LIMIT)];
        for axis in 0..3 {
            let ([a, b, c], offset, rounding) = frame.row(axis);
            for k in 0..WIDE {
                let (x, y, z) = (f64::from(self.at[0][k]), f64::from(self.at[1][k]), f64::from(self.at[2][k]));
                let value = a * x + b * y + c * z + offset + rounding;
                is_near[k] &= u32::from(value.abs() < limits[axis]);
                units[axis][k] = low_bits(value.floor());
            }
        }
        let (mut returns, mut scored, mut placed) = (0, 0, 0);
        for k in 0..WIDE {
            let sum = self.at[0][k] + self.at[1][k] + self.at[2][k];
            let is_return = u32::from(sum.abs() <= f32::MAX);
            let has_score = is_return & self.has_score[k];
            let has_place = has_score & is_near[k];
            returns += is_return;
            scored += has_score;
            placed += has_place;
            for axis in &mut units {
                axis[k] = if has_place != 0 { axis[k] } else { NOWHERE };
            }
        }
        found.counted += placed as usize;
        found.without_score += (returns - scored) as usize;
        found.outside += (scored - placed) as usize;
        units
    }
}

/// A whole number within the limits of an `i32`; of others, whatever comes out. Added to 1.5 * 2^52 a number has its value in
/// its low bits: several at a time, where a conversion would have to look for numbers that do not fit.
#[inline(always)]
fn low_bits(whole: f64) -> i32 {
    (whole + 6_755_399_441_055_744.0).to_bits() as u32 as i32
}

#[cfg(test)]
mod tests {
    use super::super::config::MapConfig;
    use super::*;
    use crate::geometry::Pose;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn whole_numbers_keep_their_value(value in -(1 << 23)..(1 << 23)) {
            prop_assert_eq!(low_bits(f64::from(value)), value);
        }

        #[test]
        fn a_point_is_in_the_unit_that_contains_it(
            at in prop::array::uniform3(-60.0..60.0f32), shift in prop::array::uniform3(-200.0..200.0f64), count in 1..70usize,
        ) {
            let pose = Pose::translation(shift[0], shift[1], shift[2]);
            let frame = Frame::new(&pose, &MapConfig::default());
            let points: Vec<_> = (0..count).map(|k| Point::new(at[0] + 0.1 * k as f32, at[1], at[2])).collect();
            let scores = vec![PointScore { flags: PointScore::VALID, ..PointScore::NONE }; count];
            let mut places = Places::default();
            places.resize(count);
            let found = places.split_mut(count)[0].locate(&points, &scores, &frame);
            prop_assert_eq!(found, Found { counted: count, ..Found::default() });
            for (k, point) in points.iter().enumerate() {
                let place = places.all().get(k).unwrap();
                let expected = frame.exact(point);
                for (got, exact) in [place.x, place.y, place.z].into_iter().zip(expected) {
                    prop_assert!(f64::from(got) <= exact + 1e-6 && exact < f64::from(got) + 1.0 + 1e-6);
                }
            }
        }
    }

    #[test]
    fn what_is_no_return_or_has_no_score_or_is_too_far_has_no_place() {
        let frame = Frame::new(&Pose::identity(), &MapConfig::default());
        let scored = PointScore { flags: PointScore::VALID, ..PointScore::NONE };
        let points =
            [Point::EMPTY, Point::new(1.0, 2.0, 3.0), Point::new(1e6, 0.0, 0.0), Point::new(f32::INFINITY, 0.0, 0.0)];
        let scores = [scored, PointScore::NONE, scored, scored];
        let mut places = Places::default();
        places.resize(4);
        let found = places.split_mut(4)[0].locate(&points, &scores, &frame);
        assert_eq!(found, Found { counted: 0, without_score: 1, outside: 1 });
        assert!((0..5).all(|k| places.all().get(k).is_none()));
    }
}
