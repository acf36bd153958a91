//! Which cells does a scanner see? Exactly those whose line of sight meets no cell that blocks, found by a sweep.
//!
//! **Definition.** A cell is seen when the straight segment from the middle of the scanner's cell to the middle of the
//! cell touches no blocking cell other than these two; cells are closed squares, so that to touch an edge or a corner is
//! to be blocked. The scanner's own cell never hides anything, and a blocking cell is itself seen: it is what is looked
//! at. Cells whose middle is farther than the range are not seen.
//!
//! **Sweep.** The plane is cut into four wedges about the scanner, each swept in lines of growing depth. In the wedge
//! |lateral| < depth a blocking cell (depth x, lateral y) is touched by exactly the rays of slopes from
//! (2y - 1)/(2x + 1) to (2y + 1)/(2x - 1) (for y > 0), ends included, and it hides what lies on them at greater depths and
//! nothing at its own. So it is enough to keep the open intervals of slopes that nothing hides yet: the cells of a line
//! that lie in them are seen, the line's own blocking cells are then cut out of them. The ends are fractions of small
//! integers and are followed from line to line by whole numbers only, so nothing is rounded. The four diagonals, which
//! pass through corners, are walked. A line of sight is never walked: the work is one step a line and interval, and one a
//! run of blocking cells in view.

use super::bits::{BitPlane, WORD, next_one, next_zero};

/// One end of a lit interval: the slope n/d, and floor and remainder of n depth / d at the present line.
#[derive(Debug, Clone, Copy)]
struct Edge {
    n: i32,
    d: i32,
    floor: i32,
    rest: i32,
}

impl Edge {
    fn at(n: i32, d: i32, depth: i32) -> Self {
        let product = n * depth;
        Self { n, d, floor: product.div_euclid(d), rest: product.rem_euclid(d) }
    }

    /// Moves to the next line; a slope lies in -1 ..= 1, so the floor moves by at most one.
    #[inline]
    fn advance(&mut self) {
        self.rest += self.n;
        if self.rest >= self.d {
            self.rest -= self.d;
            self.floor += 1;
        } else if self.rest < 0 {
            self.rest += self.d;
            self.floor -= 1;
        }
    }

    #[inline]
    fn is_below(&self, other: &Self) -> bool {
        self.n * other.d < other.n * self.d
    }
}

/// The slopes strictly between two ends, hidden by nothing so far.
#[derive(Debug, Clone, Copy)]
struct Gap {
    low: Edge,
    high: Edge,
}

impl Gap {
    /// Whether the middle of any cell within `radius` lines lies in the gap. Behind clutter most gaps are slivers between
    /// all of them, and are not followed.
    fn shows_a_cell(&self, radius: i32) -> bool {
        simplest([self.low.n, self.low.d], [self.high.n, self.high.d])[1] <= radius
    }
}

/// The fraction of the least denominator strictly between two others (numerator, denominator; 1/0 is infinity): the first
/// one in the Stern-Brocot tree.
fn simplest([low, low_d]: [i32; 2], [high, high_d]: [i32; 2]) -> [i32; 2] {
    let whole = low.div_euclid(low_d);
    if (whole + 1) * high_d < high {
        return [whole + 1, 1];
    }
    // Both lie within one whole number of each other; what is left of them is turned over.
    let [n, d] = simplest([high_d, high - whole * high_d], [low_d, low - whole * low_d]);
    [whole * n + d, n]
}

/// What can be seen within a number of cells; the same for every place.
#[derive(Debug, Clone)]
pub(super) struct Reach {
    /// The greatest depth, cells.
    pub radius: i32,
    /// The greatest lateral distance in range at every depth; depth 0 first.
    limits: Vec<i32>,
}

impl Reach {
    /// Cells whose middle is no farther than `cells` (a number of cell sides, at least 1) are in range.
    pub fn new(cells: f64) -> Self {
        // So many cells fit integers, and a range that is a whole number of cells must not lose its last one.
        let square = (cells * cells * (1.0 + 1e-12)).floor() as i64;
        let root = |value: i64| (0..).take_while(|k: &i64| k * k <= value).last().unwrap_or(0) as i32;
        let radius = root(square).max(1);
        let limits = (0..=radius).map(|depth| root(square - i64::from(depth) * i64::from(depth))).collect();
        Self { radius, limits }
    }

    /// The offsets of all cells in range, the scanner's own left out.
    pub fn offsets(&self) -> impl Iterator<Item = (i32, i32)> + '_ {
        let column = |dx: i32| {
            let limit = self.limits[dx.unsigned_abs() as usize];
            (-limit..=limit).map(move |dy| (dx, dy))
        };
        (-self.radius..=self.radius).flat_map(column).filter(|&cell| cell != (0, 0))
    }
}

/// The two planes a sweep reads: what blocks, as rows of constant y and as rows of constant x.
pub(super) struct Blocking<'a> {
    pub rows: &'a BitPlane,
    pub columns: &'a BitPlane,
}

/// Sweeps from one place after the other; its buffers are reused.
#[derive(Debug, Default)]
pub(super) struct Sweep {
    /// What is seen: rows of constant y. Covers whole blocks of 64 x 64 cells of the blocking plane.
    pub seen: BitPlane,
    /// The cell of the blocking plane at the low corner of `seen`, multiples of 64.
    pub origin: [usize; 2],
    /// The same for the wedges along x, rows of constant x.
    sideways: BitPlane,
    gaps: Vec<Gap>,
    next: Vec<Gap>,
}

/// One wedge: where it starts, and which way its depth goes.
struct Wedge {
    line: usize,
    bit: usize,
    is_forward: bool,
    /// The line and bit of the output's corner.
    origin: [usize; 2],
}

impl Sweep {
    /// Finds what is seen from the cell (x, y) of the blocking planes, which must reach `reach.radius` cells and one more
    /// beyond it on every side. The cell itself is not among the seen.
    pub fn run(&mut self, blocking: &Blocking<'_>, reach: &Reach, x: usize, y: usize) {
        let radius = reach.radius as usize;
        let blocks = (2 * radius + 1).div_ceil(WORD) + 1;
        self.origin = [x, y].map(|at| (at - radius) / WORD * WORD);
        self.seen.reset(blocks * WORD, blocks, 0);
        self.sideways.reset(blocks * WORD, blocks, 0);
        let [x0, y0] = self.origin;
        for is_forward in [true, false] {
            let wedge = Wedge { line: y, bit: x, is_forward, origin: [y0, x0] };
            sweep(blocking.rows, reach, &wedge, &mut self.seen, &mut self.gaps, &mut self.next);
            let wedge = Wedge { line: x, bit: y, is_forward, origin: [x0, y0] };
            sweep(blocking.columns, reach, &wedge, &mut self.sideways, &mut self.gaps, &mut self.next);
        }
        self.sideways.or_transposed_into(&mut self.seen);
        for step in [(1, 1), (1, -1), (-1, 1), (-1, -1)] {
            self.walk_diagonal(blocking.rows, reach, x, y, step);
        }
    }

    /// Whether the cell (x, y) of the blocking plane was seen.
    pub fn sees(&self, x: usize, y: usize) -> bool {
        let (Some(bit), Some(row)) = (x.checked_sub(self.origin[0]), y.checked_sub(self.origin[1])) else {
            return false;
        };
        row < self.seen.rows() && bit < self.seen.stride * WORD && self.seen.has(row, bit)
    }

    fn walk_diagonal(&mut self, blocks: &BitPlane, reach: &Reach, x: usize, y: usize, (dx, dy): (isize, isize)) {
        let mut depth = 1;
        let (mut cx, mut cy) = (x, y);
        while depth <= reach.radius && reach.limits[depth as usize] >= depth {
            let (nx, ny) = (cx.wrapping_add_signed(dx), cy.wrapping_add_signed(dy));
            // The ray passes through the corner that these two share with the next cell.
            if blocks.has(cy, nx) || blocks.has(ny, cx) {
                return;
            }
            self.seen.set(ny - self.origin[1], nx - self.origin[0]);
            if blocks.has(ny, nx) {
                return;
            }
            (cx, cy, depth) = (nx, ny, depth + 1);
        }
    }
}

fn sweep(
    blocks: &BitPlane,
    reach: &Reach,
    wedge: &Wedge,
    out: &mut BitPlane,
    gaps: &mut Vec<Gap>,
    next: &mut Vec<Gap>,
) {
    gaps.clear();
    gaps.push(Gap { low: Edge::at(-1, 1, 1), high: Edge::at(1, 1, 1) });
    for depth in 1..=reach.radius {
        let limit = reach.limits[depth as usize];
        let step = if wedge.is_forward { depth as isize } else { -(depth as isize) };
        let line = wedge.line.wrapping_add_signed(step);
        let blocks = blocks.row(line);
        next.clear();
        for gap in gaps.iter() {
            let first = (gap.low.floor + 1).max(-limit);
            let last = (gap.high.floor - i32::from(gap.high.rest == 0)).min(limit);
            // All of it is beyond the range, and farther lines are no nearer.
            if gap.low.floor >= limit || gap.high.floor < -limit {
                continue;
            }
            if first <= last {
                let bit = |lateral: i32| wedge.bit.wrapping_add_signed(lateral as isize) - wedge.origin[1];
                out.set_range(line - wedge.origin[0], bit(first), bit(last));
            }
            cut(*gap, [depth, reach.radius], blocks, wedge.bit, next);
        }
        std::mem::swap(gaps, next);
        if gaps.is_empty() {
            return;
        }
    }
}

/// Takes from a gap what the blocking cells of the line at `depth` hide, and passes what is left on to the next line.
#[inline]
fn cut(gap: Gap, [depth, radius]: [i32; 2], blocks: &[u64], middle: usize, next: &mut Vec<Gap>) {
    let (mut rest, mut is_cut) = (gap, false);
    // Only cells that the gap's cone touches between half a cell before and behind the line matter.
    let bit = |lateral: i32| middle.wrapping_add_signed(lateral as isize);
    let (mut from, to) = (bit((gap.low.floor - 1).max(-depth)), bit((gap.high.floor + 1).min(depth)));
    while let Some(first) = next_one(blocks, from, to) {
        let end = next_zero(blocks, first, to).unwrap_or(to + 1);
        from = end + 1;
        let lateral = |bit: usize| bit as i32 - middle as i32;
        let (low, high) = shadow(lateral(first), lateral(end - 1), depth);
        let is_touched = rest.low.is_below(&high) && low.is_below(&rest.high);
        if is_touched {
            let lower = Gap { low: rest.low, high: low };
            if rest.low.is_below(&low) && lower.shows_a_cell(radius) {
                push(lower, next);
            }
            if !high.is_below(&rest.high) {
                return;
            }
            (rest.low, is_cut) = (high, true);
        }
    }
    if !is_cut || rest.shows_a_cell(radius) {
        push(rest, next);
    }
}

#[inline]
fn push(mut gap: Gap, next: &mut Vec<Gap>) {
    gap.low.advance();
    gap.high.advance();
    next.push(gap);
}

/// The slopes hidden by a run of blocking cells: from the lower corner of its first to the upper corner of its last.
#[inline]
fn shadow(first: i32, last: i32, depth: i32) -> (Edge, Edge) {
    let (below, above) = (2 * first - 1, 2 * last + 1);
    let (near, far) = (2 * depth - 1, 2 * depth + 1);
    let low = Edge::at(below, if below > 0 { far } else { near }, depth);
    let high = Edge::at(above, if above > 0 { near } else { far }, depth);
    (low, high)
}

#[cfg(test)]
#[path = "sweep_tests.rs"]
mod tests;
