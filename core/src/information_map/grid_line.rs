//! Straight lines over a grid of cells.

use super::index::CellIndex;

/// The cells of a thin (8-connected) line from `from` to `to`, both included.
pub fn cells_of_line(from: CellIndex, to: CellIndex) -> impl Iterator<Item = CellIndex> {
    let (dx, dy) = (i64::from(to.x) - i64::from(from.x), i64::from(to.y) - i64::from(from.y));
    let steps = dx.abs().max(dy.abs());
    (0..=steps).map(move |step| {
        // Rounded to the nearest cell, halves upwards, in integers: the same on every machine.
        let along = |delta: i64| (2 * delta * step + steps).checked_div_euclid(2 * steps).unwrap_or(0) as i32;
        CellIndex { x: from.x + along(dx), y: from.y + along(dy) }
    })
}

/// Calls `visit` for every cell that the straight segment between two positions (in cell units) touches, from the
/// first to the last; where it passes exactly through a corner both cells beside it are visited too. Stops early when
/// `visit` returns false, and returns whether it went all the way.
pub fn cells_touched_by_segment(from: [f64; 2], to: [f64; 2], mut visit: impl FnMut(CellIndex) -> bool) -> bool {
    let (Some(mut cell), Some(last)) = (CellIndex::containing(from[0], from[1]), CellIndex::containing(to[0], to[1]))
    else {
        return false;
    };
    let delta = [to[0] - from[0], to[1] - from[1]];
    let step = delta.map(|d| if d > 0.0 { 1 } else { -1 });
    // The fraction of the segment at which it crosses the next grid line of each axis.
    let crossing = |axis: usize, at: i32| {
        let line = f64::from(at) + if delta[axis] > 0.0 { 1.0 } else { 0.0 };
        if delta[axis] == 0.0 { f64::INFINITY } else { (line - from[axis]) / delta[axis] }
    };
    let most = (i64::from(last.x) - i64::from(cell.x)).abs() + (i64::from(last.y) - i64::from(cell.y)).abs();
    for _ in 0..=most {
        if !visit(cell) {
            return false;
        }
        if cell == last {
            return true;
        }
        let (tx, ty) = (crossing(0, cell.x), crossing(1, cell.y));
        // Once an axis has arrived, rounding must not carry it past the last cell.
        let take_x = cell.x != last.x && (tx <= ty || cell.y == last.y);
        let take_y = cell.y != last.y && (ty <= tx || cell.x == last.x);
        if take_x && take_y {
            let beside = [CellIndex { x: cell.x + step[0], ..cell }, CellIndex { y: cell.y + step[1], ..cell }];
            if !beside.into_iter().all(&mut visit) {
                return false;
            }
        }
        cell.x += if take_x { step[0] } else { 0 };
        cell.y += if take_y { step[1] } else { 0 };
    }
    cell == last
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_line_goes_from_end_to_end_without_a_gap(ax in -50..50i32, ay in -50..50i32, bx in -50..50i32, by in -50..50i32) {
            let (a, b) = (CellIndex { x: ax, y: ay }, CellIndex { x: bx, y: by });
            let line: Vec<_> = cells_of_line(a, b).collect();
            prop_assert_eq!(line.first(), Some(&a));
            prop_assert_eq!(line.last(), Some(&b));
            for pair in line.windows(2) {
                prop_assert_eq!((pair[1].x - pair[0].x).abs().max((pair[1].y - pair[0].y).abs()), 1);
            }
        }

        #[test]
        fn every_cell_under_a_segment_is_touched(a in (-20.0..20.0f64, -20.0..20.0f64), b in (-20.0..20.0f64, -20.0..20.0f64)) {
            let mut touched = Vec::new();
            let arrived = cells_touched_by_segment([a.0, a.1], [b.0, b.1], |cell| {
                touched.push(cell);
                true
            });
            prop_assert!(arrived);
            for k in 0..=500 {
                let s = f64::from(k) / 500.0;
                let (x, y) = (a.0 + s * (b.0 - a.0), a.1 + s * (b.1 - a.1));
                // Right on a grid line either side may be meant.
                let near_line = |v: f64| (v - v.round()).abs() < 1e-9;
                if near_line(x) || near_line(y) {
                    continue;
                }
                let under = CellIndex::containing(x, y);
                prop_assert!(touched.iter().any(|&cell| Some(cell) == under));
            }
        }
    }

    #[test]
    fn a_segment_through_a_corner_touches_both_sides() {
        let mut touched = Vec::new();
        assert!(cells_touched_by_segment([0.5, 0.5], [1.5, 1.5], |cell| {
            touched.push((cell.x, cell.y));
            true
        }));
        assert_eq!(touched, [(0, 0), (1, 0), (0, 1), (1, 1)]);
    }

    #[test]
    fn a_segment_stops_when_told_so() {
        assert!(!cells_touched_by_segment([0.5, 0.5], [9.5, 0.5], |cell| cell.x < 4));
        assert!(!cells_touched_by_segment([f64::NAN, 0.5], [9.5, 0.5], |_| true));
    }
}
