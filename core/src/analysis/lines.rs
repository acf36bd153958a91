//! Scores an ordered scan line by line: a line's own scores, the steps of the mesh, and the means over the neighbours
//! follow each other at a distance of a line or two, some cells at a time, so that everything asked for again is still
//! in the cache.
//!
//! What a line becomes depends on the two lines before and after it alone: blocks of lines on any number of threads
//! give the same bits.

use super::config::{HeightForm, ObstacleForm};
use super::obstacle::step_score;
use super::point_score::{PointScore, normal_bits, quantise_bits};
use super::ring::{Given, Ring, WIDE, union};
use super::scorer::{LOW, NEGATIVE, REACHABLE, Rule, Tally, VALID};
use crate::scan::Point;
use crate::surface::{Surface, Topology};

/// Lines before and after a block that its scores depend on.
const REACH: usize = 2;

/// Line and cell offsets of the cells around, in the order of the bits of [`Surface::links`].
const AROUND: [(usize, usize); 8] = [(1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0), (0, 1), (0, 2)];

/// The bits of the neighbours to the right, below, to the left and above.
const RIGHT: u32 = 0;
const BELOW: u32 = 2;
const LEFT: u32 = 4;
const ABOVE: u32 = 6;

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
    /// What the legs of the mesh say: to the next cell of the line, and to the next line.
    step_along: Ring<f32>,
    step_across: Ring<f32>,
    /// The finished parts of the records: quality, normal, area.
    shape: [Ring<u32>; 3],
}

impl ScoreLines {
    fn reset(&mut self, cols: usize) {
        let floats = self.level.iter_mut().chain([&mut self.navigable, &mut self.obstacle]);
        floats.chain([&mut self.step_along, &mut self.step_across]).for_each(|ring| ring.reset(cols));
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
            if number >= 1 && rule.has_steps() {
                self.measure_steps(number - 1, line_of(number - 1), surface, topology);
            }
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
        let (points, shapes) = (&points[range.clone()], &surface.points()[range.clone()]);
        let links = &surface.links()[range];
        for col in (0..cols).step_by(WIDE) {
            let end = (col + WIDE).min(points.len());
            // Half of a scan is sky. What has a surface has a triangle, and so a link.
            if union(links.get(col..end).unwrap_or_default()) == 0 {
                self.navigable.put(number, col, &[0.0; WIDE]);
                self.obstacle.put(number, col, &[0.0; WIDE]);
                self.state.put(number, col, &[0; WIDE]);
                continue;
            }
            let given = Given::of(&points[col..end], &shapes[col..end]);
            self.take_some(rule, number, col, &given);
        }
        if topology.wraps_cols {
            let lines = self.level.iter_mut().chain([&mut self.navigable, &mut self.obstacle]);
            lines.for_each(|ring| ring.close(number, cols));
            self.state.close(number, cols);
        }
    }

    #[inline(always)]
    fn take_some(&mut self, rule: &Rule, number: usize, col: usize, given: &Given) {
        use {HeightForm as H, ObstacleForm as O};
        // The forms are told apart here: a loop in which they are is not worked off many cells at a time.
        let is_literal = rule.obstacle_form() == O::Literal;
        match (rule.height_form(), is_literal) {
            (H::Calibrated, false) => self.own_scores(rule, (H::Calibrated, O::Calibrated), number, col, given),
            (H::Calibrated, true) => self.own_scores(rule, (H::Calibrated, O::Literal), number, col, given),
            (H::Gentle, false) => self.own_scores(rule, (H::Gentle, O::Calibrated), number, col, given),
            (H::Gentle, true) => self.own_scores(rule, (H::Gentle, O::Literal), number, col, given),
            (H::Literal, false) => self.own_scores(rule, (H::Literal, O::Calibrated), number, col, given),
            (H::Literal, true) => self.own_scores(rule, (H::Literal, O::Literal), number, col, given),
        }
        let (mut quality, mut normal, mut area) = ([0; WIDE], [0; WIDE], [0; WIDE]);
        for k in 0..WIDE {
            quality[k] = quantise_bits(given.quality[k]);
            normal[k] = pair(normal_bits(given.normal[0][k]), normal_bits(given.normal[1][k]));
            area[k] = given.area[k].to_bits();
        }
        let [qualities, normals, areas] = &mut self.shape;
        qualities.put(number, col, &quality);
        normals.put(number, col, &normal);
        areas.put(number, col, &area);
    }

    #[inline(always)]
    fn own_scores(&mut self, rule: &Rule, forms: (HeightForm, ObstacleForm), number: usize, col: usize, given: &Given) {
        let Given { at, normal, incidence, .. } = given;
        let mut level = [[0.0; WIDE]; 3];
        let (mut navigable, mut obstacle, mut state) = ([0.0; WIDE], [0.0; WIDE], [0; WIDE]);
        for k in 0..WIDE {
            let (at, normal) = ([at[0][k], at[1][k], at[2][k]], [normal[0][k], normal[1][k], normal[2][k]]);
            let own = rule.own_by_forms(forms, at, normal, incidence[k]);
            (level[0][k], level[1][k], level[2][k]) = (own.level[0], own.level[1], own.level[2]);
            (navigable[k], obstacle[k], state[k]) = (own.navigable, own.obstacle, own.state);
        }
        for (ring, values) in self.level.iter_mut().zip(&level) {
            ring.put(number, col, values);
        }
        self.navigable.put(number, col, &navigable);
        self.obstacle.put(number, col, &obstacle);
        self.state.put(number, col, &state);
    }

    /// What the legs from the cells of a line to the next cell, and to the next line, say of obstacles; nothing where the
    /// mesh has none.
    #[inline(always)]
    fn measure_steps(&mut self, number: usize, line: Option<usize>, surface: &Surface, topology: &Topology) {
        let cols = topology.grid.cols;
        for col in (0..cols).step_by(WIDE) {
            let links = line.map_or([0; WIDE], |line| some_links(surface, line * cols, col, cols));
            let (mut along, mut across) = ([0.0; WIDE], [0.0; WIDE]);
            if union(&links) & (1 << RIGHT | 1 << BELOW) != 0 {
                let here = self.level_of(number, col);
                leg_scores(here, self.level_of(number, col + 1), &links, RIGHT, &mut along);
                leg_scores(here, self.level_of(number + 1, col), &links, BELOW, &mut across);
            }
            self.step_along.put(number, col, &along);
            self.step_across.put(number, col, &across);
        }
        if topology.wraps_cols {
            self.step_along.close(number, cols);
        }
    }

    /// Some positions.
    #[inline(always)]
    fn level_of(&self, number: usize, col: usize) -> [&[f32; WIDE]; 3] {
        let [x, y, z] = &self.level;
        [x.some(number, col), y.some(number, col), z.some(number, col)]
    }

    /// Raises B_l of a line where the mesh steps up or down to a neighbour in the line or the column.
    #[inline(always)]
    fn raise(&mut self, number: usize, line: Option<usize>, surface: &Surface, topology: &Topology) {
        let Some(line) = line else { return };
        let cols = topology.grid.cols;
        for col in (0..cols).step_by(WIDE) {
            if union(&some_links(surface, line * cols, col, cols)) == 0 {
                continue;
            }
            let (right, left) = (self.step_along.some(number, col), self.step_along.some_before(number, col));
            let (below, above) = (self.step_across.some(number, col), self.step_across.some(number - 1, col));
            let (own, state) = (self.obstacle.some(number, col), self.state.some(number, col));
            let mut obstacle = [0.0; WIDE];
            for k in 0..WIDE {
                let step = greater(greater(right[k], left[k]), greater(below[k], above[k]));
                let is_low = mask((state[k] & LOW) / LOW);
                obstacle[k] = greater(own[k], f32::from_bits(step.to_bits() & is_low));
            }
            self.obstacle.put(number, col, &obstacle);
        }
        if topology.wraps_cols {
            self.obstacle.close(number, cols);
        }
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
        let mut sums = [[0u32; WIDE]; 3];
        for col in (0..cols).step_by(WIDE) {
            let records = &mut out[col..(col + WIDE).min(cols)];
            let kept = &surface.triangles()[start + col..][..records.len()];
            let links = some_links(surface, start, col, cols);
            if union(&links) == 0 {
                for (record, kept) in records.iter_mut().zip(kept) {
                    *record = [0, pair(0, kept_flags(*kept)), 0, 0];
                }
                continue;
            }
            let state = self.state.some(number, col);
            let [f_mean, b_mean] = self.neighbour_means(rule, number, col, &links);
            let (f, b) = (self.navigable.some(number, col), self.obstacle.some(number, col));
            let [qualities, normals, areas] = &self.shape;
            let (quality, normal) = (qualities.some(number, col), normals.some(number, col));
            let area = areas.some(number, col);
            let mut words = [[0; 4]; WIDE];
            for k in 0..WIDE {
                let [f, b] = rule.combine([f[k], b[k]], [f_mean[k], b_mean[k]]);
                let (is_valid, is_reachable) = (state[k] & VALID, (state[k] & REACHABLE) >> 1);
                let (valid, reach) = (mask(is_valid), mask(is_reachable));
                words[k] = [
                    pair(quantise_bits(f), quantise_bits(b)) & reach,
                    pair(quality[k] & valid, state[k] & (VALID | REACHABLE | NEGATIVE)),
                    normal[k] & valid,
                    area[k] & valid,
                ];
                sums[0][k] = sums[0][k].wrapping_add(is_valid);
                sums[1][k] = sums[1][k].wrapping_add(is_reachable);
                sums[2][k] = sums[2][k].wrapping_add(quality[k] & valid);
            }
            for ((record, words), kept) in records.iter_mut().zip(&words).zip(kept) {
                *record = [words[0], words[1] | pair(0, kept_flags(*kept)), words[2], words[3]];
            }
        }
        let [valid, reachable, quality] = sums.map(|sum| sum.iter().map(|count| u64::from(*count)).sum::<u64>());
        tally.add(&Tally { valid, reachable, quality });
        tally
    }

    /// F_g and B_g of some cells: the mean of F_l and B_l over their neighbours; with steps B_g is no less than the
    /// smaller of the two neighbours' in the same line, or in the same column: a face of one line of rays keeps its score
    /// beside the ground over and under it.
    #[inline(always)]
    fn neighbour_means(&self, rule: &Rule, number: usize, col: usize, links: &[u8; WIDE]) -> [[f32; WIDE]; 2] {
        let (mut f, mut b, mut count) = ([0.0f32; WIDE], [0.0f32; WIDE], [0u32; WIDE]);
        for (bit, (down, across)) in AROUND.iter().enumerate() {
            let (there, col) = (number + down - 1, col + across);
            let (navigable, obstacle) = (self.navigable.some_before(there, col), self.obstacle.some_before(there, col));
            let state = self.state.some_before(there, col);
            for k in 0..WIDE {
                let is_linked = u32::from(links[k]) >> bit & state[k] & VALID;
                f[k] += f32::from_bits(navigable[k].to_bits() & mask(is_linked));
                b[k] += f32::from_bits(obstacle[k].to_bits() & mask(is_linked));
                count[k] = count[k].wrapping_add(is_linked);
            }
        }
        for k in 0..WIDE {
            let share = 1.0 / (count[k].max(1) as i32 as f32);
            (f[k], b[k]) = (f[k] * share, b[k] * share);
        }
        if !rule.has_steps() {
            return [f, b];
        }
        for (one, other) in [(RIGHT, LEFT), (BELOW, ABOVE)] {
            let ((down, across), (up, back)) = (AROUND[one as usize], AROUND[other as usize]);
            let first = self.obstacle.some_before(number + down - 1, col + across);
            let second = self.obstacle.some_before(number + up - 1, col + back);
            for k in 0..WIDE {
                let both = mask(u32::from(links[k]) >> one & u32::from(links[k]) >> other & 1);
                let smaller = if first[k] < second[k] { first[k] } else { second[k] };
                b[k] = greater(b[k], f32::from_bits(smaller.to_bits() & both));
            }
        }
        [f, b]
    }
}

/// What legs from some points to others say of obstacles, where the mesh has them.
#[inline(always)]
fn leg_scores(
    [x, y, z]: [&[f32; WIDE]; 3],
    [to_x, to_y, to_z]: [&[f32; WIDE]; 3],
    links: &[u8; WIDE],
    bit: u32,
    out: &mut [f32; WIDE],
) {
    for k in 0..WIDE {
        let score = step_score([to_x[k] - x[k], to_y[k] - y[k], to_z[k] - z[k]]);
        out[k] = f32::from_bits(score.to_bits() & mask(u32::from(links[k]) >> bit & 1));
    }
}

/// The links of some cells of the line that begins at `start`; none beyond its end.
#[inline(always)]
fn some_links(surface: &Surface, start: usize, col: usize, cols: usize) -> [u8; WIDE] {
    let links = &surface.links()[start + col..start + cols];
    if let Some(links) = links.first_chunk() {
        return *links;
    }
    let mut some = [0; WIDE];
    for (some, link) in some.iter_mut().zip(links) {
        *some = *link;
    }
    some
}

/// The flags of the kept triangles of a cell.
#[inline(always)]
fn kept_flags(triangles: u8) -> u32 {
    const _: () = assert!(PointScore::KEPT_WITHOUT == 1 << 4);
    u32::from(triangles & 0x0f) << 4
}

/// The greater of two scores; one instruction, unlike `f32::max`.
#[inline(always)]
fn greater(first: f32, second: f32) -> f32 {
    if first > second { first } else { second }
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
