//! The last lines of a scan at work, one array a quantity, and some cells of them at a time.

use crate::scan::Point;
use crate::surface::SurfacePoint;

/// Cells worked on together. So many that their loops stay loops for the compiler: unrolled ones it leaves scalar.
pub(super) const WIDE: usize = 32;

/// Cells before the first and after the last one of a line that may be read.
const PAD: usize = 8;

/// Lines kept: the one that comes, the one whose steps are looked for, the one that is finished, and the one before.
const DEPTH: usize = 4;

/// The last lines of one quantity.
#[derive(Debug, Default)]
pub(super) struct Ring<T> {
    data: Vec<T>,
    width: usize,
}

impl<T: Copy + Default> Ring<T> {
    pub(super) fn reset(&mut self, cols: usize) {
        // The last cells worked on together may hang over the end of the line.
        self.width = cols.next_multiple_of(WIDE) + 2 * PAD;
        self.data.clear();
        self.data.resize(DEPTH * self.width, T::default());
    }

    /// Some cells from `col` on.
    #[inline(always)]
    pub(super) fn some(&self, number: usize, col: usize) -> &[T; WIDE] {
        self.some_before(number, col + 1)
    }

    /// Some cells from the one before `col` on.
    #[inline(always)]
    pub(super) fn some_before(&self, number: usize, col: usize) -> &[T; WIDE] {
        whole(&self.data[number % DEPTH * self.width + PAD + col - 1..])
    }

    /// Writes some cells from `col` on.
    #[inline(always)]
    pub(super) fn put(&mut self, number: usize, col: usize, cells: &[T; WIDE]) {
        // Not `copy_from_slice`, which is a call.
        if let Some(to) = self.data[number % DEPTH * self.width + PAD + col..].first_chunk_mut() {
            *to = *cells;
        }
    }

    /// Gives a line the cells beyond its ends: those of the other end where it is closed.
    pub(super) fn close(&mut self, number: usize, cols: usize) {
        let line = &mut self.data[number % DEPTH * self.width..][..self.width];
        line.copy_within(cols..cols + PAD, 0);
        line.copy_within(PAD..2 * PAD, PAD + cols);
    }
}

/// The first cells, of which there are enough.
#[inline(always)]
fn whole<T>(cells: &[T]) -> &[T; WIDE] {
    match cells.first_chunk() {
        Some(cells) => cells,
        None => unreachable!("a line is a whole number of cells worked on together"),
    }
}

/// Some points with their shapes, by quantity.
pub(super) struct Given {
    pub(super) at: [[f32; WIDE]; 3],
    pub(super) normal: [[f32; WIDE]; 3],
    pub(super) incidence: [f32; WIDE],
    pub(super) quality: [f32; WIDE],
    pub(super) area: [f32; WIDE],
}

impl Given {
    /// Up to [`WIDE`] points; the rest has no surface.
    #[inline(always)]
    pub(super) fn of(points: &[Point], shapes: &[SurfacePoint]) -> Self {
        let mut given = Self {
            at: [[0.0; WIDE]; 3],
            normal: [[0.0; WIDE]; 3],
            incidence: [0.0; WIDE],
            quality: [0.0; WIDE],
            area: [0.0; WIDE],
        };
        match (points.first_chunk::<WIDE>(), shapes.first_chunk::<WIDE>()) {
            // So many are known to be there: no end has to be looked for.
            (Some(points), Some(shapes)) => given.fill(points, shapes),
            _ => given.fill(points, shapes),
        }
        given
    }

    #[inline(always)]
    fn fill(&mut self, points: &[Point], shapes: &[SurfacePoint]) {
        let count = points.len().min(shapes.len()).min(WIDE);
        for (k, point) in points[..count].iter().enumerate() {
            (self.at[0][k], self.at[1][k], self.at[2][k]) = (point.x, point.y, point.z);
        }
        for (k, shape) in shapes[..count].iter().enumerate() {
            let [x, y, z] = shape.normal;
            (self.normal[0][k], self.normal[1][k], self.normal[2][k]) = (x, y, z);
            (self.incidence[k], self.quality[k], self.area[k]) = (shape.incidence, shape.quality, shape.area);
        }
    }
}

/// All bits that any of the bytes has.
#[inline(always)]
pub(super) fn union(bytes: &[u8]) -> u8 {
    let mut all = 0;
    for byte in bytes {
        all |= byte;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_line_goes_on_at_its_other_end() {
        let mut ring = Ring::<u32>::default();
        ring.reset(40);
        let cells: Vec<u32> = (1..=64).collect();
        for (col, cells) in [(0, &cells[..32]), (32, &cells[32..])] {
            ring.put(5, col, cells.first_chunk().unwrap());
        }
        ring.close(5, 40);
        assert_eq!(ring.some_before(5, 0)[..3], [40, 1, 2]);
        assert_eq!(ring.some(5, 32)[..10], [33, 34, 35, 36, 37, 38, 39, 40, 1, 2]);
        assert_eq!(ring.some(4, 0), &[0; WIDE]);
    }

    #[test]
    fn points_are_given_by_quantity_whether_they_are_many_or_few() {
        for count in [0, 7, WIDE] {
            let points: Vec<Point> = (0..count).map(|k| Point::new(k as f32, 2.0, 3.0)).collect();
            let shape =
                |k: usize| SurfacePoint { quality: k as f32 + 0.5, normal: [1.0, 2.0, 3.0], ..Default::default() };
            let shapes: Vec<SurfacePoint> = (0..count).map(shape).collect();
            let given = Given::of(&points, &shapes);
            for k in 0..WIDE {
                let (x, quality, normal) = if k < count { (k as f32, k as f32 + 0.5, 3.0) } else { (0.0, 0.0, 0.0) };
                assert_eq!((given.at[0][k], given.quality[k], given.normal[2][k]), (x, quality, normal));
            }
        }
    }
}
