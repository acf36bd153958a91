//! Hand-made points and scores for the tests of the map.

use super::*;
use crate::analysis::PointScore;
use crate::geometry::Pose;
use crate::scan::{Point, ScanView};
use nalgebra::Vector3;

pub(super) fn empty_map() -> InformationMap {
    InformationMap::new(MapConfig::default()).unwrap()
}

pub(super) fn score(navigable: f32, obstacle: f32, normal: Vector3<f32>) -> PointScore {
    let mut score = PointScore::NONE;
    score.flags = PointScore::VALID | PointScore::REACHABLE;
    score.navigable = PointScore::quantise(navigable);
    score.obstacle = PointScore::quantise(obstacle);
    score.quality = PointScore::quantise(0.5);
    score.set_normal(&normal);
    score
}

pub(super) fn ground() -> PointScore {
    score(0.95, 0.0, Vector3::z())
}

pub(super) fn wall() -> PointScore {
    score(0.0, 0.95, Vector3::x())
}

/// Neither ground nor obstacle: out of the robot's reach.
pub(super) fn crown() -> PointScore {
    PointScore { flags: PointScore::VALID, ..score(0.0, 0.0, Vector3::z()) }
}

/// Points of one kind at the centres of the cells from `x0` to `x1` by `y0` to `y1`, ends included, all at height `z`.
pub(super) fn sheet(
    (x0, x1): (i32, i32),
    (y0, y1): (i32, i32),
    z: impl Fn(i32, i32) -> f32,
    score: PointScore,
) -> Vec<(Point, PointScore)> {
    let cells = (x0..=x1).flat_map(|x| (y0..=y1).map(move |y| (x, y)));
    let centre = |i: i32| 0.3 * (i as f32 + 0.5);
    cells.map(|(x, y)| (Point::new(centre(x), centre(y), z(x, y)), score)).collect()
}

pub(super) fn map_of(points: &[(Point, PointScore)]) -> InformationMap {
    let (points, scores): (Vec<_>, Vec<_>) = points.iter().copied().unzip();
    let mut map = empty_map();
    map.insert(ScanView::unordered(&points), &scores, &Pose::identity()).unwrap();
    map
}
