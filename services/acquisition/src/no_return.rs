//! Points that are no returns although the file has coordinates for them.

use mirador_core::scan::Point;

/// Points that must share the farthest range before it is taken for a code.
const CODE_COUNT: usize = 100;
/// The share of the scan they must make up.
const CODE_SHARE: f64 = 0.002;
/// Ranges within this of each other are the same code: what rounding of coordinates in text leaves [m].
const CODE_TOLERANCE_M: f32 = 2e-3;
/// A sensor has several codes, which are its largest numbers: a SICK LMS uses some of its last nine, in millimetres, one
/// for each reason why nothing was measured. Where the last one is a code, all this far below it are [m].
const CODE_BAND_M: f32 = 8e-3 + CODE_TOLERANCE_M;

/// Empties the points outside `[range_min_m, range_max_m]`, and those at the sensor's code for "no return" when asked.
/// Returns how many were emptied.
///
/// Many sensors report their largest number where nothing came back (a SICK LMS: 32.767 m), and files keep it as a
/// point. No real surface puts hundreds of points at one exact range that is also the farthest of the scan.
pub(crate) fn empty_no_returns(points: &mut [Point], range_min_m: f32, range_max_m: f32, drop_code: bool) -> usize {
    let code = if drop_code { no_return_code(points) } else { None };
    let limit = code.map_or(range_max_m, |code| range_max_m.min(code - CODE_BAND_M));
    let mut emptied = 0;
    for point in points.iter_mut().filter(|p| p.is_return()) {
        if !(range_min_m..=limit).contains(&point.range()) {
            *point = Point::EMPTY;
            emptied += 1;
        }
    }
    emptied
}

fn no_return_code(points: &[Point]) -> Option<f32> {
    let farthest = points.iter().filter(|p| p.is_return()).map(Point::range).fold(0.0, f32::max);
    let at_farthest = points.iter().filter(|p| p.is_return() && p.range() >= farthest - CODE_TOLERANCE_M).count();
    let needed = CODE_COUNT.max((points.len() as f64 * CODE_SHARE) as usize);
    (at_farthest >= needed).then_some(farthest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rarer_codes_just_below_the_last_one_are_emptied_with_it() {
        let mut points: Vec<_> = [(32.767, 549), (32.765, 91), (32.763, 765), (32.759, 76), (32.382, 2)]
            .into_iter()
            .flat_map(|(range, n)| circle(range, n))
            .collect();
        assert_eq!(empty_no_returns(&mut points, 0.0, 100.0, true), 549 + 91 + 765 + 76);
    }

    fn circle(radius: f32, n: usize) -> Vec<Point> {
        (0..n)
            .map(|i| {
                let angle = i as f32;
                Point::new(radius * angle.cos(), radius * angle.sin(), 0.0)
            })
            .collect()
    }

    #[test]
    fn a_code_shared_by_many_points_is_emptied_and_the_rest_is_kept() {
        let mut points = circle(32.767, 500);
        points.extend((0..1000).map(|i| Point::new(1.0 + i as f32 * 0.03, 0.0, 0.0)));
        assert_eq!(empty_no_returns(&mut points, 0.0, 100.0, true), 500);
        assert!(points[..500].iter().all(|p| !p.is_return()) && points[500..].iter().all(Point::is_return));
    }

    #[test]
    fn a_few_far_points_are_no_code() {
        let mut points = circle(40.0, 20);
        points.extend((0..1000).map(|i| Point::new(1.0 + i as f32 * 0.03, 0.0, 0.0)));
        assert_eq!(empty_no_returns(&mut points, 0.0, 100.0, true), 0);
    }

    #[test]
    fn returns_outside_the_limits_are_emptied() {
        let mut points =
            vec![Point::new(0.1, 0.0, 0.0), Point::new(2.0, 0.0, 0.0), Point::new(60.0, 0.0, 0.0), Point::EMPTY];
        assert_eq!(empty_no_returns(&mut points, 0.25, 50.0, true), 2);
        assert!(points[1].is_return());
    }
}
