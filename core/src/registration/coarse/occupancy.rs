//! The target's cubes, and for every window of cubes the most that any of them is worth.

/// What an occupied cube is worth.
pub(super) const OCCUPIED: u8 = 4;
/// What a cube next to an occupied one is worth: a lattice of poses never hits the true one.
const BESIDE: u8 = 2;
/// Levels of windows: 1, 2, 4 and 8 cubes wide.
pub(super) const LEVELS: usize = 4;
/// Cubes kept below the lowest occupied one, so that every window that holds one, or its neighbour, begins inside.
const MARGIN: i32 = (1 << (LEVELS - 1)) + 1;

/// A dense grid of cubes and its pyramid of windows.
///
/// Level h at cube c is the largest value among the cubes c to c + 2^h - 1 along each axis (Olson 2015; Hess et al.
/// 2016, eq. 13, in 3D). A point in cube c that is still to be moved by up to 2^h - 1 cubes is worth no more than that.
#[derive(Debug, Clone, Default)]
pub(super) struct Occupancy {
    /// The lower corner of cube (0, 0, 0) [m].
    origin: [f64; 3],
    per_metre: f64,
    size: [i32; 3],
    levels: [Vec<u8>; LEVELS],
}

impl Occupancy {
    /// The cubes of edge `cell_m` that hold one of the points.
    pub fn new(points: &[[f32; 3]], cell_m: f64) -> Self {
        let mut low = [f32::INFINITY; 3];
        let mut high = [f32::NEG_INFINITY; 3];
        for p in points {
            for axis in 0..3 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        if points.is_empty() {
            return Self::default();
        }
        let per_metre = 1.0 / cell_m;
        let cube = |v: f32| (f64::from(v) * per_metre).floor();
        let origin = low.map(|v| (cube(v) - f64::from(MARGIN)) * cell_m);
        let size: [i32; 3] = std::array::from_fn(|axis| (cube(high[axis]) - cube(low[axis])) as i32 + MARGIN + 2);
        let mut grid = Self { origin, per_metre, size, levels: Default::default() };
        let mut base = vec![0_u8; size.iter().map(|s| *s as usize).product()];
        for p in points {
            grid.mark(&mut base, grid.cube(p.map(f64::from)));
        }
        grid.levels[0] = base;
        for level in 1..LEVELS {
            grid.levels[level] = grid.widened(&grid.levels[level - 1], 1 << (level - 1));
        }
        grid
    }

    /// The cube that holds a point [m].
    #[inline]
    pub fn cube(&self, point: [f64; 3]) -> [i32; 3] {
        std::array::from_fn(|axis| ((point[axis] - self.origin[axis]) * self.per_metre).floor() as i32)
    }

    /// The largest value of the window of this level that begins at a cube.
    #[inline]
    pub fn value(&self, level: usize, cube: [i32; 3]) -> u8 {
        let inside = (0..3).all(|axis| (0..self.size[axis]).contains(&cube[axis]));
        if inside { self.levels[level].get(self.index(cube)).copied().unwrap_or(0) } else { 0 }
    }

    /// The sum of the values under `cubes` moved by `offset`.
    #[inline]
    pub fn overlap(&self, level: usize, cubes: &[[i32; 3]], offset: [i32; 3]) -> u32 {
        let [nx, ny, nz] = self.size.map(|s| s as u32);
        let values = &self.levels[level][..];
        let mut sum = 0_u32;
        for cube in cubes {
            let x = cube[0].wrapping_add(offset[0]) as u32;
            let y = cube[1].wrapping_add(offset[1]) as u32;
            let z = cube[2].wrapping_add(offset[2]) as u32;
            if x < nx && y < ny && z < nz {
                let index = (x as usize * ny as usize + y as usize) * nz as usize + z as usize;
                sum += u32::from(values.get(index).copied().unwrap_or(0));
            }
        }
        sum
    }

    fn index(&self, cube: [i32; 3]) -> usize {
        (cube[0] as usize * self.size[1] as usize + cube[1] as usize) * self.size[2] as usize + cube[2] as usize
    }

    /// Occupies a cube and raises its six neighbours.
    fn mark(&self, base: &mut [u8], cube: [i32; 3]) {
        base[self.index(cube)] = OCCUPIED;
        for axis in 0..3 {
            for step in [-1, 1] {
                let mut beside = cube;
                beside[axis] += step;
                if (0..self.size[axis]).contains(&beside[axis]) {
                    let value = &mut base[self.index(beside)];
                    *value = (*value).max(BESIDE);
                }
            }
        }
    }

    /// Each cube's maximum with the ones `step` further along every axis. A window that runs over the end of a row
    /// looks into the margin of the next one, which is empty.
    fn widened(&self, values: &[u8], step: usize) -> Vec<u8> {
        let strides = [(self.size[1] * self.size[2]) as usize, self.size[2] as usize, 1];
        let mut from = values.to_vec();
        let mut into = values.to_vec();
        for stride in strides {
            for (value, ahead) in into.iter_mut().zip(from.iter().skip(step * stride)) {
                *value = (*value).max(*ahead);
            }
            from.copy_from_slice(&into);
        }
        into
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_points() -> impl Strategy<Value = Vec<[f32; 3]>> {
        prop::collection::vec(prop::array::uniform3(-6.0f32..6.0), 1..60)
    }

    proptest! {
        #[test]
        fn a_window_is_worth_what_its_best_cube_is_worth(
            points in any_points(),
            start in prop::array::uniform3(-9i32..24),
            level in 0..LEVELS,
        ) {
            let grid = Occupancy::new(&points, 0.5);
            let width = 1 << level;
            let mut best = 0;
            for k in 0..width * width * width {
                let cube = [start[0] + k / (width * width), start[1] + k / width % width, start[2] + k % width];
                best = best.max(grid.value(0, cube));
            }
            prop_assert_eq!(grid.value(level, start), best);
        }

        #[test]
        fn the_bound_of_a_set_of_moves_is_never_below_the_overlap_of_any_of_them(
            points in any_points(),
            cubes in prop::collection::vec(prop::array::uniform3(0i32..40), 1..40),
            offset in prop::array::uniform3(-30i32..30),
            within in prop::array::uniform3(0i32..8),
        ) {
            let grid = Occupancy::new(&points, 0.5);
            for level in 1..LEVELS {
                let width = 1 << level;
                let moved: [i32; 3] = std::array::from_fn(|axis| offset[axis] + within[axis] % width);
                prop_assert!(grid.overlap(level, &cubes, offset) >= grid.overlap(0, &cubes, moved));
            }
        }

        #[test]
        fn a_scan_overlaps_itself_more_than_any_moved_copy_of_it(
            points in any_points(),
            offset in prop::array::uniform3(-6i32..6),
        ) {
            let grid = Occupancy::new(&points, 0.5);
            let cubes: Vec<[i32; 3]> = points.iter().map(|p| grid.cube(p.map(f64::from))).collect();
            let own = grid.overlap(0, &cubes, [0; 3]);
            prop_assert_eq!(own, u32::from(OCCUPIED) * points.len() as u32);
            prop_assert!(grid.overlap(0, &cubes, offset) <= own);
        }
    }

    #[test]
    fn nothing_overlaps_an_empty_scan() {
        assert_eq!(Occupancy::new(&[], 0.5).overlap(0, &[[0; 3]], [0; 3]), 0);
    }
}
