//! Thinning a frame: the returns in one small cell become their centroid, and of the centroids one a larger cell is
//! aligned with the map.

use super::voxel_key::{NO_KEY, home, key_of, voxel_at};
use crate::scan::ScanView;

/// Returns of different sixteenths of a scan never share a cell: where the scan ends beside its own beginning, and
/// with scanners that look the same way twice, their mean time would belong to neither.
const TIME_BITS: u32 = 4;

/// The centroid of one cell, scanner frame at the time of its beams.
#[derive(Debug, Clone, Copy)]
pub(super) struct Centroid {
    /// [m].
    pub point: [f32; 3],
    /// Mean time, as a fraction of the scan.
    pub time: f32,
    /// Returns in it.
    pub returns: u32,
}

/// Sums of one cell, relative to its first return: coordinates of thousands of returns would lose their millimetres.
#[derive(Debug, Clone, Copy)]
struct Cell {
    first: [f32; 3],
    sum: [f32; 3],
    first_time: u16,
    time: i32,
    returns: u32,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    key: u64,
    at: u32,
}

const EMPTY: Entry = Entry { key: NO_KEY, at: 0 };

/// Thins frames; its buffers are reused.
#[derive(Debug, Default)]
pub(super) struct Reducer {
    table: Vec<Entry>,
    cells: Vec<Cell>,
}

/// The settings of one thinning.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reduction {
    pub min_range_m: f32,
    pub max_range_m: f32,
    pub cell_m: f32,
}

impl Reducer {
    /// Writes the centroids of a scan, in the order of their first returns.
    pub fn centroids(&mut self, scan: ScanView<'_>, settings: &Reduction, out: &mut Vec<Centroid>) {
        self.table.fill(EMPTY);
        self.cells.clear();
        let (least, most) = (settings.min_range_m * settings.min_range_m, settings.max_range_m * settings.max_range_m);
        let per_metre = 1.0 / settings.cell_m;
        let (mut last_key, mut last) = (NO_KEY, 0_usize);
        for point in scan.points {
            let at = [point.x, point.y, point.z];
            // A comparison with NaN is false, so empty cells fall out here.
            let range_sq = at[0] * at[0] + at[1] * at[1] + at[2] * at[2];
            if !(range_sq >= least && range_sq <= most) {
                continue;
            }
            let key = timed_key(voxel_at(at, per_metre), point.time);
            if key != last_key {
                last = self.cell(key, at, point.time);
                last_key = key;
            }
            // `cell` gave a valid index.
            let cell = &mut self.cells[last];
            for axis in 0..3 {
                cell.sum[axis] += at[axis] - cell.first[axis];
            }
            cell.time += i32::from(point.time) - i32::from(cell.first_time);
            cell.returns += 1;
        }
        out.clear();
        out.extend(self.cells.iter().map(Cell::centroid));
    }

    /// The index of the cell with this key, made if need be.
    #[inline]
    fn cell(&mut self, key: u64, at: [f32; 3], time: u16) -> usize {
        if 2 * self.cells.len() >= self.table.len() {
            self.grow();
        }
        let mask = self.table.len() - 1;
        let mut place = home(key, mask);
        loop {
            let entry = &mut self.table[place];
            if entry.key == key {
                return entry.at as usize;
            }
            if entry.key == NO_KEY {
                *entry = Entry { key, at: self.cells.len() as u32 };
                self.cells.push(Cell { first: at, sum: [0.0; 3], first_time: time, time: 0, returns: 0 });
                return self.cells.len() - 1;
            }
            place = (place + 1) & mask;
        }
    }

    /// Doubles the table.
    fn grow(&mut self) {
        let old = std::mem::take(&mut self.table);
        self.table = vec![EMPTY; (2 * old.len()).max(1 << 12)];
        let mask = self.table.len() - 1;
        for entry in old.into_iter().filter(|entry| entry.key != NO_KEY) {
            let mut place = home(entry.key, mask);
            while self.table[place].key != NO_KEY {
                place = (place + 1) & mask;
            }
            self.table[place] = entry;
        }
    }

    /// Of the centroids in each cell of `cell_m` the one with the most returns, which the noise of the ranges moves
    /// least; the first of equals. Writes their indices in ascending order of cells' first centroids.
    pub fn select(&mut self, centroids: &[Centroid], cell_m: f32, out: &mut Vec<u32>) {
        self.table.fill(EMPTY);
        self.cells.clear();
        out.clear();
        let per_metre = 1.0 / cell_m;
        for (index, centroid) in centroids.iter().enumerate() {
            let key = key_of(voxel_at(centroid.point, per_metre));
            let cell = self.cell(key, centroid.point, 0);
            match out.get_mut(cell) {
                None => out.push(index as u32),
                Some(chosen) => {
                    if centroids[*chosen as usize].returns < centroid.returns {
                        *chosen = index as u32;
                    }
                }
            }
        }
    }

    /// The memory of the buffers [bytes].
    pub fn bytes(&self) -> usize {
        self.table.capacity() * size_of::<Entry>() + self.cells.capacity() * size_of::<Cell>()
    }
}

impl Cell {
    fn centroid(&self) -> Centroid {
        let share = 1.0 / self.returns as f32;
        let time = f32::from(self.first_time) + self.time as f32 * share;
        Centroid {
            point: [
                self.first[0] + self.sum[0] * share,
                self.first[1] + self.sum[1] * share,
                self.first[2] + self.sum[2] * share,
            ],
            time: time / 65535.0,
            returns: self.returns,
        }
    }
}

/// The key of a cell and the part of the scan in which it was seen. 20 bits an axis are left.
#[inline(always)]
fn timed_key(voxel: [i32; 3], time: u16) -> u64 {
    // The part goes above z's bits: the low bits of the axes stay where the table's blocks want them.
    key_of([voxel[0], voxel[1], voxel[2] & 0xFFFF | i32::from(time >> (16 - TIME_BITS)) << 16])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Point;
    use proptest::prelude::*;

    const SETTINGS: Reduction = Reduction { min_range_m: 0.5, max_range_m: 100.0, cell_m: 0.25 };

    fn thinned(points: &[Point]) -> Vec<Centroid> {
        let mut out = Vec::new();
        Reducer::default().centroids(ScanView::unordered(points), &SETTINGS, &mut out);
        out
    }

    #[test]
    fn returns_in_one_cell_become_their_centroid() {
        let points = [
            Point::new(1.01, 1.01, 0.01),
            Point::EMPTY,
            Point::new(-3.0, 2.1, 0.1),
            Point::new(1.03, 1.05, 0.03),
            Point::new(0.01, 0.0, 0.0),
            Point::new(f32::INFINITY, 0.0, 0.0),
            Point::new(500.0, 0.0, 0.0),
        ];
        let cells = thinned(&points);
        assert_eq!(cells.len(), 2);
        assert!((cells[0].point[0] - 1.02).abs() < 1e-6 && (cells[0].point[1] - 1.03).abs() < 1e-6);
        assert_eq!((cells[0].returns, cells[1].point), (2, [-3.0, 2.1, 0.1]));
    }

    #[test]
    fn the_seam_of_a_turning_scan_is_not_averaged() {
        let late = Point { time: 65_000, ..Point::new(5.0, 0.1, 0.0) };
        let cells = thinned(&[Point::new(5.0, 0.1, 0.0), late]);
        assert_eq!(cells.len(), 2);
        assert!(cells[0].time < 0.01 && cells[1].time > 0.99);
    }

    proptest! {
        #[test]
        fn every_return_is_counted_in_a_cell_of_its_own_place(
            points in prop::collection::vec(prop::array::uniform3(-40.0..40.0f32), 0..3000),
        ) {
            let points: Vec<_> = points.iter().map(|p| Point::new(p[0], p[1], p[2])).collect();
            let cells = thinned(&points);
            let within = points.iter().filter(|p| p.range() >= 0.5).count();
            prop_assert_eq!(cells.iter().map(|c| c.returns as usize).sum::<usize>(), within);
            let mut places: Vec<_> = cells.iter().map(|c| c.point.map(|v| (v / 0.25).floor() as i32)).collect();
            places.sort_unstable();
            places.dedup();
            // A centroid may be rounded over the border of its cell, hardly ever.
            prop_assert!(places.len() + 2 >= cells.len());
        }
    }
}
