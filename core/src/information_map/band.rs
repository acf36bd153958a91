//! Some rows of the scan, or some points of one without an order: what one thread works on at a time. All of it stays in the
//! second cache.

use super::block::Block;
use super::condense::Frame;
use super::item::Item;
use super::patches::{PatchTally, Patches};
use super::places::{Found, Places};
use crate::analysis::PointScore;
use crate::scan::{Grid, Point};

/// Rows of the grid done together.
pub(super) const BAND_ROWS: usize = 16;
/// Columns of a block.
const BLOCK_COLS: usize = 16;
/// Points of a block without a grid.
const BLOCK_POINTS: usize = BAND_ROWS * BLOCK_COLS;
/// Points of a band without a grid.
pub(super) const BAND_POINTS: usize = 32 * BLOCK_POINTS;

/// Some rows of the scan.
#[derive(Debug, Default)]
pub(super) struct Band {
    /// Of its rows and the one below them.
    places: Places,
    block: Block,
    /// What became of its points.
    pub found: Found,
    /// What they say.
    pub items: Vec<Item>,
    /// What the triangles between them say.
    pub patches: Vec<Item>,
    /// How many those were.
    pub tally: PatchTally,
}

impl Band {
    /// Takes up to [`BAND_ROWS`] rows of an ordered scan from `first` on.
    #[inline(always)]
    pub fn take_rows(&mut self, points: &[Point], scores: &[PointScore], grid: Grid, first: usize, frame: &Frame) {
        let Grid { rows, cols } = grid;
        self.items.clear();
        self.patches.clear();
        self.found = Found::default();
        if cols == 0 {
            return;
        }
        let last = (first + BAND_ROWS).min(rows);
        let own = first * cols..last * cols;
        // The quads of the last row lie across the seam; they keep triangles only where the grid is closed.
        let below = if last < rows { last } else { 0 };
        let below = below * cols..(below + 1) * cols;
        self.places.resize(own.len() + cols);
        let mut chunks = self.places.split_mut(own.len());
        self.found = chunks[0].locate(&points[own.clone()], &scores[own.clone()], frame);
        chunks[1].locate(&points[below.clone()], &scores[below.clone()], frame);
        let places = self.places.all();
        for first_col in (0..cols).step_by(BLOCK_COLS) {
            let last_col = (first_col + BLOCK_COLS).min(cols);
            for row in 0..last - first {
                let (from, to) = (row * cols + first_col, row * cols + last_col);
                self.block.take(&scores[own.start + from..own.start + to], places.slice(from, to), frame);
            }
            self.block.finish(frame, &mut self.items);
        }
        let patches = Patches { places, scores: &scores[own], below: &scores[below], cols, frame };
        self.tally = patches.rasterise(&mut self.patches);
    }

    /// Takes up to [`BAND_POINTS`] points of a scan without an order from `first` on.
    #[inline(always)]
    pub fn take_points(&mut self, points: &[Point], scores: &[PointScore], first: usize, frame: &Frame) {
        self.items.clear();
        self.patches.clear();
        let last = (first + BAND_POINTS).min(points.len());
        let (points, scores) = (&points[first..last], &scores[first..last]);
        self.places.resize(points.len());
        self.found = self.places.split_mut(points.len())[0].locate(points, scores, frame);
        let places = self.places.all();
        for from in (0..points.len()).step_by(BLOCK_POINTS) {
            let to = (from + BLOCK_POINTS).min(points.len());
            self.block.take(&scores[from..to], places.slice(from, to), frame);
            self.block.finish(frame, &mut self.items);
        }
    }
}
