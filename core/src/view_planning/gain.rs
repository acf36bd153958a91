//! What a scan from a candidate would bring: A (4.7), Q (4.8 to 4.10), O (4.11), as raw sums.

use super::bits::{BitPlane, WORD};
use super::config::ScannerModel;
use super::grid::PlanningGrid;
use super::plan::RawGain;
use super::quality::{Offset, QualityModel};
use super::sweep::{Reach, Sweep};
use super::tile_digest::{SIDE, TileDigest};
use crate::information_map::{CellIndex, Zone};
use crate::simd::widest;
use crate::threads;
use nalgebra::Vector3;
use std::sync::{Mutex, PoisonError};

/// Everything about a scanner that does not depend on the map.
#[derive(Debug, Clone)]
pub(super) struct ScannerView {
    scanner: ScannerModel,
    cell_m: f64,
    pub reach: Reach,
    /// Half the width of the disc in which unexplored ground counts, in its rows from the middle on [cells].
    ground: Vec<usize>,
    pub quality: QualityModel,
    /// What Q's raw sum would be over flat, never seen ground.
    pub flat_quality: f64,
    /// A_ce: cells in the scanner's whole footprint.
    pub footprint_cells: f64,
}

/// The mean products of the normals of level ground.
pub(super) const LEVEL: [f32; 6] = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];

impl ScannerView {
    pub fn new(scanner: &ScannerModel, cell_m: f64) -> Self {
        let reach = Reach::new((scanner.range_m / cell_m).max(1.0));
        let quality = QualityModel::new(scanner);
        let ground = disc((scanner.ground_range_m.min(scanner.range_m) / cell_m).max(1.0));
        let (mut flat_quality, mut footprint_cells) = (0.0, 0.0);
        for (dx, dy) in reach.offsets() {
            let ray = [dx as f32 * cell_m as f32, dy as f32 * cell_m as f32, -scanner.height_m as f32];
            flat_quality += f64::from(quality.expected(ray, &LEVEL));
            if ground.get(dy.unsigned_abs() as usize).is_some_and(|half| dx.unsigned_abs() as usize <= *half) {
                footprint_cells += 1.0;
            }
        }
        Self { scanner: *scanner, cell_m, reach, ground, quality, flat_quality, footprint_cells }
    }

    pub fn is_of(&self, scanner: &ScannerModel, cell_m: f64) -> bool {
        self.scanner == *scanner && self.cell_m == cell_m
    }

    /// Height of the scanner's eye over the ground [m].
    pub fn height_m(&self) -> f64 {
        self.scanner.height_m
    }
}

/// Evaluates candidates on one grid.
pub(super) struct GainModel<'a> {
    pub grid: &'a PlanningGrid,
    /// Zones in the window, each with its cell.
    pub zones: Vec<(usize, Zone)>,
    pub view: &'a ScannerView,
}

/// The zones that lie in the window, each with its cell: however many the map has, these are soon looked through.
pub(super) fn zones_of(grid: &PlanningGrid, zones: &[Zone]) -> Vec<(usize, Zone)> {
    let place = |zone: &Zone| {
        let cell = CellIndex::containing(zone.centre.x / grid.cell_m, zone.centre.y / grid.cell_m)?;
        grid.at(cell)
    };
    zones.iter().filter_map(|zone| place(zone).map(|at| (at, *zone))).collect()
}

impl GainModel<'_> {
    /// What a scan from the cell `at`, with the ground at `ground` [m, map frame], would bring. `sweep` then holds what
    /// is seen.
    pub fn evaluate(&self, sweep: &mut Sweep, at: usize, ground: f64) -> RawGain {
        let (x, y) = (at % self.grid.width, at / self.grid.width);
        let eye = ground + self.view.height_m();
        sweep.run(&self.grid.blocking(), &self.view.reach, x, y);
        let seen = &*sweep;
        let (unexplored, known, quality_sum) = widest(
            #[inline(always)]
            || {
                let mut unexplored = 0;
                self.for_each_unexplored_word(seen, [x, y], |_, _, bits| unexplored += bits.count_ones());
                let known = count_both(seen, &self.grid.known);
                (unexplored, known, self.improvement(seen, [x, y], eye as f32))
            },
        );
        let zone_sum = self.zones_in(sweep, at, eye);
        RawGain { unexplored_cells: unexplored, known_cells: known, quality_sum, zone_sum }
    }

    /// Calls `visit` with the unexplored cells that are seen within the ground's range of a place, in words of the sweep's
    /// plane: row, number of the word, cells.
    #[inline(always)]
    pub fn for_each_unexplored_word(
        &self,
        sweep: &Sweep,
        [x, y]: [usize; 2],
        mut visit: impl FnMut(usize, usize, u64),
    ) {
        let [x0, y0] = sweep.origin;
        let plane = &self.grid.unexplored;
        let stride = sweep.seen.stride.min(plane.stride - x0 / WORD);
        let rows = sweep.seen.rows().min(plane.rows() - y0);
        for row in 0..rows {
            let Some(&half) = self.view.ground.get((y0 + row).abs_diff(y)) else { continue };
            let (low, high) = ((x.saturating_sub(half)).saturating_sub(x0), (x + half).saturating_sub(x0));
            let of_plane = &plane.row(y0 + row)[x0 / WORD..x0 / WORD + stride];
            for word in low / WORD..=(high / WORD).min(stride - 1) {
                let after = if word == low / WORD { u64::MAX << (low % WORD) } else { u64::MAX };
                let until = if word == high / WORD { u64::MAX >> (WORD - 1 - high % WORD) } else { u64::MAX };
                visit(row, word, sweep.seen.row(row)[word] & of_plane[word] & after & until);
            }
        }
    }

    /// Sum over the known cells in view of the quality expected less the quality so far, improvements only (4.10). Tiles
    /// so good that nothing seen from here could be better are passed over, which changes nothing.
    #[inline(always)]
    fn improvement(&self, seen: &Sweep, place: [usize; 2], eye: f32) -> f64 {
        let mut sum = 0.0f64;
        self.for_each_tile(seen, place, eye, |digest, mask, offset, _| {
            let cell_m = self.grid.cell_m as f32;
            sum += f64::from(self.view.quality.improvement(&digest.cells, mask, offset, cell_m));
        });
        sum
    }

    /// Calls `visit` with every tile in view that could become better: its digest, which of its known cells are seen, where
    /// it lies, and its first row and column in the grid.
    #[inline(always)]
    pub fn for_each_tile(
        &self,
        seen: &Sweep,
        [x, y]: [usize; 2],
        eye: f32,
        mut visit: impl FnMut(&TileDigest, &[u16; SIDE], Offset, [usize; 2]),
    ) {
        let cell_m = self.grid.cell_m as f32;
        let [x0, y0] = seen.origin;
        for tile_row in 0..seen.seen.rows() / SIDE {
            let row = y0 + tile_row * SIDE;
            let dy = row as f32 - y as f32;
            for group in 0..seen.seen.stride * (WORD / SIDE) {
                let column = x0 + group * SIDE;
                let Some(digest) = self.grid.tile(column / SIDE, row / SIDE) else { continue };
                let dx = column as f32 - x as f32;
                let apart = |d: f32| d.max(-(d + (SIDE - 1) as f32)).max(0.0);
                let least_m = cell_m * (apart(dx) * apart(dx) + apart(dy) * apart(dy)).sqrt();
                if self.view.quality.bound(&digest.bounds, least_m * 0.9999, eye) <= digest.bounds.least_quality {
                    continue;
                }
                let (mut mask, mut any) = ([0u16; SIDE], 0);
                for (k, mask) in mask.iter_mut().enumerate() {
                    *mask =
                        seen.seen.sixteen(tile_row * SIDE + k, group) & self.grid.known.sixteen(row + k, column / SIDE);
                    any |= *mask;
                }
                if any != 0 {
                    visit(digest, &mask, Offset { x: dx * cell_m, y: dy * cell_m, eye }, [column, row]);
                }
            }
        }
    }

    /// Sum over the zones in range and in view of |v . n_zone| (4.11). A zone is in view when its cell is.
    fn zones_in(&self, sweep: &Sweep, at: usize, eye: f64) -> f64 {
        let [x, y] = self.grid.centre(at);
        let width = self.grid.width;
        let is_seen = |there: usize| there == at || sweep.sees(there % width, there / width);
        let face = |zone: &Zone| {
            let ray = zone.centre.coords - Vector3::new(x, y, eye);
            let range = ray.norm();
            if range > 0.0 { zone.normal.dot(&ray).abs() / range } else { 0.0 }
        };
        // Not `sum`, which makes -0 of nothing.
        let seen = self.zones.iter().filter(|(there, _)| is_seen(*there));
        seen.map(|(_, zone)| face(zone)).fold(0.0, |sum, area| sum + area)
    }
}

/// Half the width of a disc in its rows from the middle on, as [`Reach`] has it [cells].
fn disc(radius: f64) -> Vec<usize> {
    let half = |dy: usize| (radius * radius - (dy * dy) as f64).sqrt().floor() as usize;
    (0..=radius.floor() as usize).map(half).collect()
}

/// The number of cells that are seen and of the plane.
#[inline(always)]
fn count_both(seen: &Sweep, plane: &BitPlane) -> u32 {
    let first = seen.origin[0] / WORD;
    let stride = seen.seen.stride.min(plane.stride - first);
    let rows = seen.seen.rows().min(plane.rows() - seen.origin[1]);
    let mut count = 0;
    for row in 0..rows {
        let of_plane = &plane.row(seen.origin[1] + row)[first..first + stride];
        count += seen.seen.row(row).iter().zip(of_plane).map(|(a, b)| (a & b).count_ones()).sum::<u32>();
    }
    count
}

/// Sweeps that wait to be used again, one a thread at work.
#[derive(Debug, Default)]
pub(super) struct SweepPool {
    idle: Mutex<Vec<Sweep>>,
}

impl SweepPool {
    pub fn with<R>(&self, work: impl FnOnce(&mut Sweep) -> R) -> R {
        let mut sweep = self.lock().pop().unwrap_or_default();
        let result = work(&mut sweep);
        self.lock().push(sweep);
        result
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Sweep>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Calls `work` for every place on up to `threads` threads. Each place is computed by one thread from the same input, so
/// the result does not depend on how many there are.
pub(super) fn for_each_place<R: Send>(
    places: &[(usize, f64)],
    results: &mut [R],
    threads: usize,
    pool: &SweepPool,
    work: impl Fn(&mut Sweep, usize, f64, &mut R) + Sync,
) {
    let pairs = places.iter().zip(results);
    threads::for_each(pairs, threads.min(places.len()), |(&(at, ground), result)| {
        pool.with(|sweep| work(sweep, at, ground, result));
    });
}

#[cfg(test)]
#[path = "gain_tests.rs"]
mod tests;
