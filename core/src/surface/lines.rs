//! The last few lines of a grid, one array a quantity, so that many cells are worked on at a time.

/// Cells that the filter works on together, each with its own reach.
pub(super) const LANES: usize = 8;
/// Cells that the other steps work on together. So many that their loops stay loops for the compiler: unrolled ones it
/// leaves scalar.
pub(super) const WIDE: usize = 32;

/// What all quantities of a strip have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct LineShape {
    /// Cells a line.
    pub(super) cols: usize,
    /// Cells before the first and after the last one that may be read: those beyond the seam where the lines are closed,
    /// empty ones otherwise.
    pub(super) pad: usize,
    /// The last cell of a line is followed by its first.
    pub(super) is_closed: bool,
}

impl LineShape {
    /// Lines of `cols` cells of which up to `reach` to each side are asked for.
    pub(super) fn new(cols: usize, reach: usize, is_closed: bool) -> Self {
        // The last cells worked on together may hang over the end of the line.
        Self { cols, pad: reach.max(2) + WIDE, is_closed }
    }
}

/// The last lines of one quantity, found by their number modulo a power of two.
#[derive(Debug, Default)]
pub(super) struct Lines<T> {
    data: Vec<T>,
    shape: LineShape,
    /// Cells of a line with those before and after it.
    width: usize,
    mask: usize,
}

impl<T: Copy + Default> Lines<T> {
    /// Empties the lines and makes room for at least `depth` of them.
    pub(super) fn reset(&mut self, shape: LineShape, depth: usize) {
        let depth = depth.next_power_of_two();
        self.data.clear();
        self.data.resize(depth * (shape.cols + 2 * shape.pad), T::default());
        (self.shape, self.mask, self.width) = (shape, depth - 1, shape.cols + 2 * shape.pad);
    }

    /// Line `number` with its cells before and after: cell c has index `pad + c`.
    #[inline(always)]
    pub(super) fn line(&self, number: usize) -> &[T] {
        let start = (number & self.mask) * self.width;
        &self.data[start..start + self.width]
    }

    /// Line `number` from cell `col - back` on.
    #[inline(always)]
    pub(super) fn from(&self, number: usize, col: usize, back: usize) -> &[T] {
        &self.line(number)[self.shape.pad + col - back..]
    }

    #[inline(always)]
    pub(super) fn line_mut(&mut self, number: usize) -> &mut [T] {
        let start = (number & self.mask) * self.width;
        &mut self.data[start..start + self.width]
    }

    /// Writes some cells of line `number` from `col` on; the last ones may hang over its end.
    #[inline(always)]
    pub(super) fn put<const N: usize>(&mut self, number: usize, col: usize, cells: [T; N]) {
        let at = self.shape.pad + col;
        put(self.line_mut(number), at, cells);
    }

    /// Line `number`, found once for all its cells.
    #[inline(always)]
    pub(super) fn at(&self, number: usize) -> Line<'_, T> {
        Line { cells: self.line(number), pad: self.shape.pad }
    }

    /// Eight cells of line `number` from `col` on.
    #[inline(always)]
    pub(super) fn eight(&self, number: usize, col: usize) -> [T; LANES] {
        lanes(self.line(number), self.shape.pad + col)
    }

    /// As [`Lines::eight`], from the cell before `col` on.
    #[inline(always)]
    pub(super) fn eight_before(&self, number: usize, col: usize) -> [T; LANES] {
        lanes(self.line(number), self.shape.pad + col - 1)
    }

    /// The cells of line `number`, to be written.
    #[inline(always)]
    pub(super) fn cells_mut(&mut self, number: usize) -> &mut [T] {
        let LineShape { cols, pad, .. } = self.shape;
        &mut self.line_mut(number)[pad..pad + cols]
    }

    /// Gives line `number`, once written, the cells before its first and after its last one.
    #[inline(always)]
    pub(super) fn close(&mut self, number: usize) {
        let LineShape { cols, pad, is_closed } = self.shape;
        let line = self.line_mut(number);
        if !is_closed || cols == 0 {
            // What is before the first cell is never written.
            line[pad + cols..].fill(T::default());
        } else if cols >= pad {
            line.copy_within(pad..2 * pad, pad + cols);
            line.copy_within(cols..cols + pad, 0);
        } else {
            for k in 0..pad {
                line[pad + cols + k] = line[pad + k % cols];
                line[pad - 1 - k] = line[pad + cols - 1 - k % cols];
            }
        }
    }
}

/// One line of a quantity.
#[derive(Clone, Copy)]
pub(super) struct Line<'a, T> {
    cells: &'a [T],
    pad: usize,
}

impl<T: Copy + Default> Line<'_, T> {
    /// Some cells from `col` on.
    #[inline(always)]
    pub(super) fn some<const N: usize>(&self, col: usize) -> [T; N] {
        lanes(self.cells, self.pad + col)
    }

    /// As [`Line::some`], from the cell before `col` on.
    #[inline(always)]
    pub(super) fn some_before<const N: usize>(&self, col: usize) -> [T; N] {
        lanes(self.cells, self.pad + col - 1)
    }
}

/// One line of each of the first three quantities.
#[inline(always)]
pub(super) fn line_of_three(lines: &[Lines<f32>], number: usize) -> [Line<'_, f32>; 3] {
    let nothing = Line { cells: &[][..], pad: 0 };
    let [x, y, z, ..] = lines else { return [nothing; 3] };
    [x.at(number), y.at(number), z.at(number)]
}

/// Some cells of each of three quantities.
#[inline(always)]
pub(super) fn some_of_three<const N: usize>(lines: &[Line<'_, f32>; 3], col: usize) -> [[f32; N]; 3] {
    [lines[0].some(col), lines[1].some(col), lines[2].some(col)]
}

/// Some values from `at` on.
#[inline(always)]
pub(super) fn lanes<T: Copy + Default, const N: usize>(values: &[T], at: usize) -> [T; N] {
    // Not `unwrap_or_default`, which is a call.
    values.get(at..).and_then(<[T]>::first_chunk).copied().unwrap_or([T::default(); N])
}

/// Writes some values from `at` on.
#[inline(always)]
pub(super) fn put<T: Copy, const N: usize>(values: &mut [T], at: usize, cells: [T; N]) {
    if let Some(to) = values.get_mut(at..).and_then(<[T]>::first_chunk_mut) {
        *to = cells;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_line_goes_on_at_its_other_end_and_an_open_one_with_nothing() {
        for is_closed in [true, false] {
            let mut lines = Lines::<f32>::default();
            let shape = LineShape::new(3, 4, is_closed);
            lines.reset(shape, 2);
            lines.cells_mut(5).copy_from_slice(&[1.0, 2.0, 3.0]);
            lines.close(5);
            let around = &lines.from(5, 0, 4)[..11];
            let expected = if is_closed {
                [3.0, 1.0, 2.0, 3.0, 1.0, 2.0, 3.0, 1.0, 2.0, 3.0, 1.0]
            } else {
                [0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0]
            };
            assert_eq!(around, expected);
        }
    }
}
