//! Which cells does a triangle cover, seen from above?

use super::grid_line::cells_of_line;
use super::index::{CellIndex, floor};

/// Calls `visit` for every cell whose centre lies inside the triangle (corners in cell units), at most `limit` times.
/// Edges are half open, so triangles that share an edge never share a cell. Returns whether cells were left out.
#[inline]
pub(super) fn cells_inside(corners: &[[f64; 2]; 3], limit: usize, mut visit: impl FnMut(CellIndex)) -> bool {
    let ys = [corners[0][1], corners[1][1], corners[2][1]];
    let lowest = ceil(ys[0].min(ys[1]).min(ys[2]) - 0.5);
    let highest = floor(ys[0].max(ys[1]).max(ys[2]) - 0.5);
    let mut left = limit;
    for (row, y) in (lowest..=highest).enumerate() {
        if row >= limit {
            return true;
        }
        let Some((low, high)) = crossings(corners, f64::from(y) + 0.5) else { continue };
        for x in ceil(low - 0.5)..ceil(high - 0.5) {
            if left == 0 {
                return true;
            }
            left -= 1;
            visit(CellIndex { x, y });
        }
    }
    false
}

fn ceil(value: f64) -> i32 {
    -floor(-value)
}

/// Where the horizontal line at `y` enters and leaves the triangle.
#[inline]
fn crossings(corners: &[[f64; 2]; 3], y: f64) -> Option<(f64, f64)> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        // The same end first whichever triangle owns the edge, so that both compute the same crossing.
        let (a, b) = if corners[i] <= corners[j] { (corners[i], corners[j]) } else { (corners[j], corners[i]) };
        if (a[1] <= y) != (b[1] <= y) {
            let x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
            low = low.min(x);
            high = high.max(x);
        }
    }
    (low < high).then_some((low, high))
}

/// Calls `visit` for the cells under the triangle's longest side, seen from above, at most `limit` times: a steep
/// triangle is a line from above, and may pass between all cell centres. Returns whether cells were left out.
pub(super) fn cells_under_longest_side(
    corners: &[[f64; 2]; 3],
    cells: &[CellIndex; 3],
    limit: usize,
    visit: impl FnMut(CellIndex),
) -> bool {
    let length = |i: usize, j: usize| {
        let (dx, dy) = (corners[i][0] - corners[j][0], corners[i][1] - corners[j][1]);
        dx * dx + dy * dy
    };
    let sides = [(0, 1), (1, 2), (2, 0)];
    let (i, j) = sides
        .into_iter()
        .fold(sides[0], |best, side| if length(side.0, side.1) > length(best.0, best.1) { side } else { best });
    let mut line = cells_of_line(cells[i], cells[j]);
    line.by_ref().take(limit).for_each(visit);
    line.next().is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn covered(corners: [[f64; 2]; 3]) -> Vec<CellIndex> {
        let mut cells = Vec::new();
        assert!(!cells_inside(&corners, 100_000, |cell| cells.push(cell)));
        cells
    }

    fn is_inside(corners: &[[f64; 2]; 3], p: [f64; 2]) -> Option<bool> {
        let side = |a: [f64; 2], b: [f64; 2]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
        let sides = [side(corners[0], corners[1]), side(corners[1], corners[2]), side(corners[2], corners[0])];
        if sides.iter().any(|s| s.abs() < 1e-6) {
            return None;
        }
        Some(sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0))
    }

    proptest! {
        #[test]
        fn exactly_the_cells_with_their_centre_inside_are_covered(
            a in prop::array::uniform2(-9.0..9.0f64), b in prop::array::uniform2(-9.0..9.0f64), c in prop::array::uniform2(-9.0..9.0f64),
        ) {
            let corners = [a, b, c];
            let cells = covered(corners);
            for x in -10..10 {
                for y in -10..10 {
                    if let Some(inside) = is_inside(&corners, [f64::from(x) + 0.5, f64::from(y) + 0.5]) {
                        prop_assert_eq!(cells.contains(&CellIndex { x, y }), inside);
                    }
                }
            }
        }

        #[test]
        fn two_halves_of_a_quad_cover_each_cell_once(
            a in prop::array::uniform2(-9.0..0.0f64), d in prop::array::uniform2(0.0..9.0f64),
        ) {
            let (b, c) = ([d[0], a[1]], [a[0], d[1]]);
            let mut both = covered([a, b, c]);
            both.extend(covered([b, d, c]));
            let count = both.len();
            both.sort();
            both.dedup();
            prop_assert_eq!(both.len(), count);
            let mut whole = covered([a, b, d]);
            whole.extend(covered([a, d, c]));
            prop_assert_eq!(whole.len(), count);
        }
    }

    #[test]
    fn a_triangle_larger_than_the_limit_is_clipped() {
        let mut count = 0;
        assert!(cells_inside(&[[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]], 50, |_| count += 1));
        assert_eq!(count, 50);
        assert!(cells_inside(&[[0.0, 0.0], [0.0, 1e7], [0.01, 1e7]], 50, |_| ()));
    }

    #[test]
    fn a_steep_triangle_covers_the_line_under_it() {
        let corners = [[0.5, 0.5], [6.5, 0.5], [3.5, 0.5]];
        let cells = corners.map(|c| CellIndex::containing(c[0], c[1]).unwrap());
        let mut line = Vec::new();
        assert!(!cells_under_longest_side(&corners, &cells, 100, |cell| line.push(cell.x)));
        assert_eq!(line, [0, 1, 2, 3, 4, 5, 6]);
        assert!(cells_under_longest_side(&corners, &cells, 3, |_| ()));
    }
}
