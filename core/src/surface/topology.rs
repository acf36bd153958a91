//! Which cells of an ordered scan are next to each other.

use crate::scan::{Grid, Point};

/// A grid of directions that may close on itself: a head that turns a full circle ends where it began.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topology {
    /// Rows and columns.
    pub grid: Grid,
    /// The last row is followed by the first.
    pub wraps_rows: bool,
    /// The last column is followed by the first.
    pub wraps_cols: bool,
}

/// The fewest lines a closed grid has; below, first and last are neighbours anyway.
const LINES_MIN: usize = 8;

/// The seam is closed when at least so many lines across it can be compared.
const WITNESSES_MIN: usize = 4;

/// The largest gap at the seam, in steps.
const SEAM_STEPS_MAX: f32 = 1.5;

impl Topology {
    /// Finds out from the directions of the returns of at least `range_min` [m] whether the grid closes.
    pub(super) fn of(points: &[Point], grid: Grid, range_min: f32) -> Self {
        let Grid { rows, cols } = grid;
        let cell = |r: usize, c: usize| direction(&points[r * cols + c], range_min);
        let wraps_rows = rows >= LINES_MIN
            && closes((0..cols).map(|c| [cell(rows - 1, c), cell(0, c), cell(1, c), cell(rows - 2, c)]));
        let wraps_cols = cols >= LINES_MIN
            && closes((0..rows).map(|r| [cell(r, cols - 1), cell(r, 0), cell(r, 1), cell(r, cols - 2)]));
        Self { grid, wraps_rows, wraps_cols }
    }

    /// The row below, if there is one.
    #[must_use]
    pub fn row_after(&self, row: usize) -> Option<usize> {
        after(row, self.grid.rows, self.wraps_rows)
    }

    /// The row above, if there is one.
    #[must_use]
    pub fn row_before(&self, row: usize) -> Option<usize> {
        before(row, self.grid.rows, self.wraps_rows)
    }

    /// The column to the right, if there is one.
    #[must_use]
    pub fn col_after(&self, col: usize) -> Option<usize> {
        after(col, self.grid.cols, self.wraps_cols)
    }

    /// The column to the left, if there is one.
    #[must_use]
    pub fn col_before(&self, col: usize) -> Option<usize> {
        before(col, self.grid.cols, self.wraps_cols)
    }

    /// The cells a, b (right), c (below), d (below right) of the quad that belongs to a cell, if it has one.
    #[must_use]
    pub fn quad(&self, cell: usize) -> Option<[usize; 4]> {
        let cols = self.grid.cols;
        let (row, col) = (cell.checked_div(cols)?, cell.checked_rem(cols)?);
        let (below, right) = (self.row_after(row)?, self.col_after(col)?);
        Some([cell, row * cols + right, below * cols + col, below * cols + right])
    }
}

/// The unit direction of a return; zero without one.
fn direction(point: &Point, range_min: f32) -> [f32; 3] {
    let range = point.range();
    if range >= range_min && range <= f32::MAX { [point.x / range, point.y / range, point.z / range] } else { [0.0; 3] }
}

fn after(line: usize, lines: usize, wraps: bool) -> Option<usize> {
    if line + 1 < lines { Some(line + 1) } else { wraps.then_some(0) }
}

fn before(line: usize, lines: usize, wraps: bool) -> Option<usize> {
    if line > 0 { Some(line - 1) } else { wraps.then_some(lines - 1) }
}

/// Whether last and first line are about one step apart on most of the lines across. Each witness is the direction on
/// the last, the first, the second and the last but one line.
fn closes(witnesses: impl Iterator<Item = [[f32; 3]; 4]>) -> bool {
    let (mut near, mut all) = (0usize, 0usize);
    for [last, first, second, previous] in witnesses {
        let seam = gap(last, first);
        let step = match (gap(first, second), gap(previous, last)) {
            (Some(a), Some(b)) => Some(a.max(b)),
            (a, b) => a.or(b),
        };
        if let (Some(seam), Some(step)) = (seam, step) {
            all += 1;
            near += usize::from(seam <= SEAM_STEPS_MAX * step);
        }
    }
    all >= WITNESSES_MIN && 2 * near > all
}

/// The chord between two directions, if both are there.
fn gap(a: [f32; 3], b: [f32; 3]) -> Option<f32> {
    let there = |v: [f32; 3]| v != [0.0; 3];
    let square = |i: usize| (a[i] - b[i]) * (a[i] - b[i]);
    (there(a) && there(b)).then(|| (square(0) + square(1) + square(2)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(lines: usize, step_deg: f32) -> Vec<Point> {
        (0..lines * 6)
            .map(|i| {
                let (az, el) = (((i / 6) as f32 * step_deg).to_radians(), ((i % 6) as f32 - 3.0).to_radians());
                Point::new(el.cos() * az.cos(), el.cos() * az.sin(), el.sin())
            })
            .collect()
    }

    #[test]
    fn a_full_circle_closes_and_a_part_of_it_does_not() {
        let full = Topology::of(&ring(90, 4.0), Grid { rows: 90, cols: 6 }, 0.05);
        assert!(full.wraps_rows && !full.wraps_cols);
        let part = Topology::of(&ring(80, 4.0), Grid { rows: 80, cols: 6 }, 0.05);
        assert!(!part.wraps_rows && !part.wraps_cols);
    }

    #[test]
    fn the_quad_at_the_seam_has_its_right_side_at_the_start() {
        let topology = Topology { grid: Grid { rows: 3, cols: 4 }, wraps_rows: false, wraps_cols: true };
        assert_eq!(topology.quad(3), Some([3, 0, 7, 4]));
        assert_eq!(topology.quad(8), None);
        assert_eq!(topology.quad(5), Some([5, 6, 9, 10]));
    }
}
