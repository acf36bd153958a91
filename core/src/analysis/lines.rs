//! Scores an ordered scan line by line: a line's own scores, the steps of the mesh, and the means over the neighbours
//! follow each other at a distance of a line or two, eight cells at a time, so that everything asked for again is still
//! in the cache.
//!
//! What a line becomes depends on the two lines before and after it alone: blocks of lines on any number of threads
//! give the same bits.

use super::obstacle::step_score;
use super::point_score::{PointScore, normal_bits, quantise_bits};
use super::scorer::{LOW, NEGATIVE, REACHABLE, Rule, Tally, VALID};
use crate::scan::Point;
use crate::surface::{Surface, SurfacePoint, Topology};

/// Cells worked on together.
const LANES: usize = 8;

/// Cells before the first and after the last one of a line that may be read; the last eight may hang over its end.
const PAD: usize = LANES;

/// Lines at work: the one that comes, the one whose steps are looked for, the one that is finished, and the one before.
const DEPTH: usize = 4;

/// Lines before and after a block that its scores depend on.
const REACH: usize = 2;

/// Line and cell offsets of the cells around, in the order of the bits of [`Surface::links`].
const AROUND: [(usize, usize); 8] = [(1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0), (0, 1), (0, 2)];

/// The bits of the two neighbours in the same line, and in the same column.
const PAIRS: [[usize; 2]; 2] = [[0, 4], [2, 6]];

type Eight<T> = [T; LANES];

/// The last lines of one quantity.
#[derive(Debug, Default)]
struct Ring<T> {
    data: Vec<T>,
    width: usize,
}

impl<T: Copy + Default> Ring<T> {
    fn reset(&mut self, cols: usize) {
        self.width = cols.next_multiple_of(LANES) + 2 * PAD;
        self.data.clear();
        self.data.resize(DEPTH * self.width, T::default());
    }

    #[inline(always)]
    fn line(&self, number: usize) -> &[T] {
        &self.data[number % DEPTH * self.width..][..self.width]
    }

    #[inline(always)]
    fn line_mut(&mut self, number: usize) -> &mut [T] {
        &mut self.data[number % DEPTH * self.width..][..self.width]
    }

    /// Eight cells from the one `back` before `col` on.
    #[inline(always)]
    fn eight(&self, number: usize, col: usize, back: usize) -> Eight<T> {
        let cells = self.line(number).get(PAD + col - back..);
        cells.and_then(<[T]>::first_chunk::<LANES>).copied().unwrap_or_default()
    }

    #[inline(always)]
    fn put(&mut self, number: usize, col: usize, eight: Eight<T>) {
        if let Some(cells) = self.line_mut(number).get_mut(PAD + col..).and_then(<[T]>::first_chunk_mut::<LANES>) {
            *cells = eight;
        }
    }

    /// Gives a line the cells beyond its ends: those of the other end where it is closed.
    fn close(&mut self, number: usize, cols: usize) {
        let line = self.line_mut(number);
        line.copy_within(cols..cols + PAD, 0);
        line.copy_within(PAD..2 * PAD, PAD + cols);
    }
}

/// The lines at work of one block.
#[derive(Debug, Default)]
pub(super) struct ScoreLines {
    /// Positions in the level frame [m].
    level: [Ring<f32>; 3],
    /// F_l, and B_l with what the steps add to it.
    navigable: Ring<f32>,
    obstacle: Ring<f32>,
    /// [`VALID`] and its like.
    state: Ring<u32>,
    /// The finished parts of the records: quality, normal, area.
    shape: [Ring<u32>; 3],
}

impl ScoreLines {
    fn reset(&mut self, cols: usize) {
        self.level.iter_mut().chain([&mut self.navigable, &mut self.obstacle]).for_each(|ring| ring.reset(cols));
        self.shape.iter_mut().chain([&mut self.state]).for_each(|ring| ring.reset(cols));
    }

    /// Scores the lines from `first` on into `out`.
    #[inline(always)]
    pub(super) fn score(
        &mut self,
        rule: &Rule,
        points: &[Point],
        surface: &Surface,
        topology: &Topology,
        first: usize,
        out: &mut [PointScore],
    ) -> Tally {
        let (rows, cols) = (topology.grid.rows, topology.grid.cols);
        let mut tally = Tally::default();
        self.reset(cols);
        let words: &mut [[u32; 4]] = bytemuck::cast_slice_mut(out);
        let count = words.len() / cols.max(1);
        // Line `number` of this block is this line of the scan, if there is one.
        let line_of = |number: usize| {
            let line = first + number;
            let inside = (REACH..rows + REACH).contains(&line);
            (inside || topology.wraps_rows).then(|| (line + rows - REACH) % rows)
        };
        for number in 0..count + 2 * REACH {
            self.take(rule, number, line_of(number), points, surface, topology);
            if number >= 2 && rule.has_steps() {
                self.raise(number - 1, line_of(number - 1), surface, topology);
            }
            if number >= 2 * REACH {
                let out = &mut words[(number - 2 * REACH) * cols..][..cols];
                tally.add(&self.finish(rule, number - REACH, line_of(number - REACH), surface, out));
            }
        }
        tally
    }

    /// Takes the next line: every point's own scores.
    #[inline(always)]
    fn take(
        &mut self,
        rule: &Rule,
        number: usize,
        line: Option<usize>,
        points: &[Point],
        surface: &Surface,
        topology: &Topology,
    ) {
        let cols = topology.grid.cols;
        let range = line.map_or(0..0, |line| line * cols..(line + 1) * cols);
        let (points, shapes) = (&points[range.clone()], &surface.points()[range]);
        for col in (0..cols).step_by(LANES) {
            let end = (col + LANES).min(points.len());
            let given = shapes.get(col..end).unwrap_or_default();
            // Half of a scan is sky.
            if given.iter().all(|shape| shape.area == 0.0) {
                self.skip(number, col);
                continue;
            }
            let rest;
            let whole = points[col..end].first_chunk::<LANES>().zip(given.first_chunk::<LANES>());
            let (point, shape) = match whole {
                Some(eight) => eight,
                None => {
                    rest = (padded(&points[col..end], Point::EMPTY), padded(given, SurfacePoint::default()));
                    (&rest.0, &rest.1)
                }
            };
            self.take_eight(rule, number, col, point, shape);
        }
        if topology.wraps_cols {
            let lines = self.level.iter_mut().chain([&mut self.navigable, &mut self.obstacle]);
            lines.for_each(|ring| ring.close(number, cols));
            self.state.close(number, cols);
        }
    }

    /// Eight cells without a surface.
    #[inline(always)]
    fn skip(&mut self, number: usize, col: usize) {
        self.navigable.put(number, col, [0.0; LANES]);
        self.obstacle.put(number, col, [0.0; LANES]);
        self.state.put(number, col, [0; LANES]);
    }

    #[inline(always)]
    fn take_eight(
        &mut self,
        rule: &Rule,
        number: usize,
        col: usize,
        points: &Eight<Point>,
        shapes: &Eight<SurfacePoint>,
    ) {
        let (mut at, mut normal) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        let (mut incidence, mut quality, mut area) = ([0.0; LANES], [0.0; LANES], [0; LANES]);
        for k in 0..LANES {
            let (point, shape) = (&points[k], &shapes[k]);
            (at[0][k], at[1][k], at[2][k]) = (point.x, point.y, point.z);
            (normal[0][k], normal[1][k], normal[2][k]) = (shape.normal[0], shape.normal[1], shape.normal[2]);
            (incidence[k], quality[k], area[k]) = (shape.incidence, shape.quality, shape.area.to_bits());
        }
        let mut level = [[0.0; LANES]; 3];
        let (mut navigable, mut obstacle, mut state) = ([0.0; LANES], [0.0; LANES], [0; LANES]);
        let (mut quality_word, mut normal_word) = ([0; LANES], [0; LANES]);
        for k in 0..LANES {
            let n = [normal[0][k], normal[1][k], normal[2][k]];
            let own = rule.own([at[0][k], at[1][k], at[2][k]], n, incidence[k]);
            (level[0][k], level[1][k], level[2][k]) = (own.level[0], own.level[1], own.level[2]);
            (navigable[k], obstacle[k], state[k]) = (own.navigable, own.obstacle, own.state);
            quality_word[k] = quantise_bits(quality[k]);
            normal_word[k] = pair(normal_bits(n[0]), normal_bits(n[1]));
        }
        for (ring, values) in self.level.iter_mut().zip(&level) {
            ring.put(number, col, *values);
        }
        self.navigable.put(number, col, navigable);
        self.obstacle.put(number, col, obstacle);
        self.state.put(number, col, state);
        let [qualities, normals, areas] = &mut self.shape;
        qualities.put(number, col, quality_word);
        normals.put(number, col, normal_word);
        areas.put(number, col, area);
    }

    /// Raises B_l of a line where the mesh steps up or down to a neighbour in the line or the column.
    #[inline(always)]
    fn raise(&mut self, number: usize, line: Option<usize>, surface: &Surface, topology: &Topology) {
        let Some(line) = line else { return };
        let cols = topology.grid.cols;
        for col in (0..cols).step_by(LANES) {
            let links = eight_links(surface, line * cols, col, cols);
            if links == [0; LANES] {
                continue;
            }
            let [x, y, z] = self.level_of(number, col, 0);
            let mut step = [0.0f32; LANES];
            for [one, other] in PAIRS {
                for bit in [one, other] {
                    let (down, across) = AROUND[bit];
                    let [to_x, to_y, to_z] = self.level_of(number + down - 1, col + across, 1);
                    for k in 0..LANES {
                        let score = step_score([to_x[k] - x[k], to_y[k] - y[k], to_z[k] - z[k]]);
                        let is_linked = links[k] >> bit & 1 != 0;
                        step[k] = step[k].max(if is_linked { score } else { 0.0 });
                    }
                }
            }
            let (mut obstacle, state) = (self.obstacle.eight(number, col, 0), self.state.eight(number, col, 0));
            for k in 0..LANES {
                obstacle[k] = if state[k] & LOW != 0 { obstacle[k].max(step[k]) } else { obstacle[k] };
            }
            self.obstacle.put(number, col, obstacle);
        }
        if topology.wraps_cols {
            self.obstacle.close(number, cols);
        }
    }

    /// Eight positions.
    #[inline(always)]
    fn level_of(&self, number: usize, col: usize, back: usize) -> [Eight<f32>; 3] {
        let [x, y, z] = &self.level;
        [x.eight(number, col, back), y.eight(number, col, back), z.eight(number, col, back)]
    }

    /// The records of a line: its own scores and the means of its neighbours' (3.17 to 3.21), its quality and shape.
    #[inline(always)]
    fn finish(
        &self,
        rule: &Rule,
        number: usize,
        line: Option<usize>,
        surface: &Surface,
        out: &mut [[u32; 4]],
    ) -> Tally {
        let (mut tally, cols) = (Tally::default(), out.len());
        let start = line.unwrap_or(0) * cols;
        let mut sums = [[0u32; LANES]; 3];
        for col in (0..cols).step_by(LANES) {
            let records = &mut out[col..(col + LANES).min(cols)];
            let state = self.state.eight(number, col, 0);
            let links = eight_links(surface, start, col, cols);
            let mut kept = [0; LANES];
            for (k, kept) in kept.iter_mut().enumerate().take(records.len()) {
                *kept = u32::from(PointScore::KEPT_WITHOUT * surface.kept_bits(start + col + k));
            }
            if state == [0; LANES] {
                for (record, kept) in records.iter_mut().zip(kept) {
                    *record = [0, pair(0, kept), 0, 0];
                }
                continue;
            }
            let [f_mean, b_mean] = self.neighbour_means(rule, number, col, &links);
            let (f, b) = (self.navigable.eight(number, col, 0), self.obstacle.eight(number, col, 0));
            let [qualities, normals, areas] = &self.shape;
            let (quality, normal) = (qualities.eight(number, col, 0), normals.eight(number, col, 0));
            let area = areas.eight(number, col, 0);
            let mut words = [[0; LANES]; 4];
            for k in 0..LANES {
                let [f, b] = rule.combine([f[k], b[k]], [f_mean[k], b_mean[k]]);
                let (valid, reach) = (mask(state[k] & VALID), mask((state[k] & REACHABLE) >> 1));
                let flags = kept[k] | state[k] & (VALID | REACHABLE | NEGATIVE);
                words[0][k] = pair(quantise_bits(f), quantise_bits(b)) & reach;
                words[1][k] = pair(quality[k] & valid, flags);
                words[2][k] = normal[k] & valid;
                words[3][k] = area[k] & valid;
                sums[0][k] = sums[0][k].wrapping_add(state[k] & VALID);
                sums[1][k] = sums[1][k].wrapping_add((state[k] & REACHABLE) >> 1);
                sums[2][k] = sums[2][k].wrapping_add(quality[k] & valid);
            }
            for (k, record) in records.iter_mut().enumerate() {
                *record = [words[0][k], words[1][k], words[2][k], words[3][k]];
            }
        }
        let [valid, reachable, quality] = sums.map(|sum| sum.iter().map(|count| u64::from(*count)).sum::<u64>());
        tally.add(&Tally { valid, reachable, quality });
        tally
    }

    /// F_g and B_g of eight cells: the mean of F_l and B_l over their neighbours; with steps B_g is no less than the
    /// smaller of the two neighbours' in the same line, or in the same column: a face of one line of rays keeps its score
    /// beside the ground over and under it.
    #[inline(always)]
    fn neighbour_means(&self, rule: &Rule, number: usize, col: usize, links: &Eight<u32>) -> [Eight<f32>; 2] {
        let (mut f, mut b, mut count) = ([0.0f32; LANES], [0.0f32; LANES], [0u32; LANES]);
        for (bit, (down, across)) in AROUND.iter().enumerate() {
            let (there, col) = (number + down - 1, col + across);
            let (navigable, obstacle) = (self.navigable.eight(there, col, 1), self.obstacle.eight(there, col, 1));
            let state = self.state.eight(there, col, 1);
            for k in 0..LANES {
                let is_linked = links[k] >> bit & state[k] & VALID;
                f[k] += f32::from_bits(navigable[k].to_bits() & mask(is_linked));
                b[k] += f32::from_bits(obstacle[k].to_bits() & mask(is_linked));
                count[k] = count[k].wrapping_add(is_linked);
            }
        }
        for k in 0..LANES {
            let share = 1.0 / (count[k].max(1) as i32 as f32);
            (f[k], b[k]) = (f[k] * share, b[k] * share);
        }
        if !rule.has_steps() {
            return [f, b];
        }
        for [one, other] in PAIRS {
            let ((down, across), (up, back)) = (AROUND[one], AROUND[other]);
            let first = self.obstacle.eight(number + down - 1, col + across, 1);
            let second = self.obstacle.eight(number + up - 1, col + back, 1);
            for k in 0..LANES {
                let both = mask(links[k] >> one & links[k] >> other & 1);
                b[k] = b[k].max(f32::from_bits(first[k].min(second[k]).to_bits() & both));
            }
        }
        [f, b]
    }
}

/// The links of eight cells of the line that begins at `start`; none beyond its end.
#[inline(always)]
fn eight_links(surface: &Surface, start: usize, col: usize, cols: usize) -> Eight<u32> {
    let links = &surface.links()[start + col..start + cols];
    let mut eight = [0; LANES];
    if let Some(links) = links.first_chunk::<LANES>() {
        for k in 0..LANES {
            eight[k] = u32::from(links[k]);
        }
    } else {
        for (eight, link) in eight.iter_mut().zip(links) {
            *eight = u32::from(*link);
        }
    }
    eight
}

/// The last cells of a line, made up to eight.
fn padded<T: Copy>(given: &[T], empty: T) -> Eight<T> {
    let mut eight = [empty; LANES];
    eight[..given.len()].copy_from_slice(given);
    eight
}

/// All ones for 1, none for 0.
#[inline(always)]
fn mask(bit: u32) -> u32 {
    0u32.wrapping_sub(bit)
}

/// Two halves that follow each other in memory, as one word.
#[inline(always)]
fn pair(first: u32, second: u32) -> u32 {
    if cfg!(target_endian = "little") { first | second << 16 } else { first << 16 | second }
}
