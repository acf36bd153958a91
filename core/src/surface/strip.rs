//! A strip of a grid on its way to a surface: lines of points go in, and a few lines later the finished ones come out.
//!
//! What becomes of a line depends on a fixed number of lines before and after it alone ([`Strip::lead`],
//! [`Strip::delay`]). So a whole scan, its blocks on several threads, and a scan that comes sweep by sweep all give the
//! same bits; and what is worked on stays in the cache.

use super::config::SurfaceConfig;
use super::discarded::{DiscardedTriangle, Found};
use super::filter::Smoother;
use super::legs::{HONEST, LegTest, Sample, THERE, UNDECIDED};
use super::lines::{LANES, LineShape, Lines, WIDE, lanes, line_of_three, put, some_of_three};
use super::mesh::{self, QuadCorners, QuadLegs, QuadSums, TRIANGLE_CORNERS};
use super::quality::QualityScale;
use super::view::SurfacePoint;
use crate::scan::Point;

/// The formulas with their constants, and how far they reach.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rule {
    least_range: f32,
    /// Along the lines, and from line to line: half of a closed grid is as far as a pair can lie apart.
    along: Smoother,
    across: Smoother,
    legs: LegTest,
    quality: QualityScale,
    /// Lines after it that the filter asks for.
    reach: usize,
}

impl Rule {
    /// For lines of `cols` cells, and `rows` of them where that is known.
    pub(super) fn new(config: &SurfaceConfig, cols: usize, rows: Option<usize>) -> Self {
        let smoother = |cells: usize| Smoother::new(config, config.filter_cells_max.min(cells.saturating_sub(1) / 2));
        Self {
            least_range: config.range_min_m as f32,
            along: smoother(cols),
            across: smoother(rows.unwrap_or(usize::MAX)),
            legs: LegTest::new(config),
            quality: QualityScale::new(config),
            reach: Self::reach(config),
        }
    }

    /// Lines to each side that the filter asks for.
    pub(super) fn reach(config: &SurfaceConfig) -> usize {
        config.filter_cells_max.max(1)
    }
}

/// Where the finished line goes.
pub(super) struct Finished<'a> {
    /// Index of its first cell, and of the first cell of the line after it.
    pub(super) first_cell: usize,
    pub(super) next_cell: usize,
    pub(super) points: &'a mut [SurfacePoint],
    /// Kept triangles in the low four bits, discarded ones in the high four.
    pub(super) triangles: &'a mut [u8],
    pub(super) links: &'a mut [u8],
}

/// The lines at work.
#[derive(Debug, Default)]
pub(super) struct Strip {
    shape: LineShape,
    /// Number of the line that comes next.
    next: usize,
    /// Number of the first line that has all those around it that the filter asks for.
    first_full: usize,
    /// Unit directions and 1/range, zero where there is no return.
    direction: [Lines<f32>; 3],
    inverse: Lines<f32>,
    /// Squares of the chords between the directions of neighbours, zero where one is missing: to the next cell of the
    /// line, and to the next line.
    chord_along: Lines<f32>,
    chord_across: Lines<f32>,
    /// 1/range, filtered along the line; then from line to line, with the point that belongs to it.
    smoothed: Lines<f32>,
    sample: [Lines<f32>; 4],
    legs_along: Lines<u8>,
    legs_across: Lines<u8>,
    /// Kept triangles of the quads.
    kept: Lines<u8>,
    sums: QuadSums,
    /// The discarded triangles of all finished lines.
    pub(super) discarded: Vec<Found>,
}

impl Strip {
    /// Lines before a finished one that must have gone in.
    pub(super) fn lead(config: &SurfaceConfig) -> usize {
        Rule::reach(config) + 2
    }

    /// Lines after a finished one that must have gone in.
    pub(super) fn delay(config: &SurfaceConfig) -> usize {
        Rule::reach(config) + 3
    }

    /// Forgets all lines.
    pub(super) fn reset(&mut self, config: &SurfaceConfig, cols: usize, is_closed: bool) {
        let reach = Rule::reach(config);
        let shape = LineShape::new(cols, reach, is_closed);
        self.shape = shape;
        self.direction.iter_mut().for_each(|lines| lines.reset(shape, reach + 5));
        self.inverse.reset(shape, 2);
        self.chord_along.reset(shape, reach + 5);
        self.chord_across.reset(shape, reach + 5);
        self.smoothed.reset(shape, 2 * reach + 1);
        self.sample.iter_mut().for_each(|lines| lines.reset(shape, 5));
        self.legs_along.reset(shape, 3);
        self.legs_across.reset(shape, 3);
        self.kept.reset(shape, 2);
        self.sums.reset(shape);
        self.discarded.clear();
        // The first lines look back at lines that never were; they are empty.
        self.next = 2 * reach + 8;
        self.first_full = self.next + reach;
    }

    /// Takes the next line of points, none for a line that does not exist, and finishes the one [`Strip::delay`] lines
    /// before it into `out`, if that is wanted.
    #[inline(always)]
    pub(super) fn advance(&mut self, rule: &Rule, points: &[Point], out: Option<Finished<'_>>) {
        let new = self.next;
        self.next += 1;
        self.split_rays(rule, new, points);
        self.measure_chords(new);
        self.smooth_along(rule, new);
        let full = new - rule.reach;
        // Lines that not all those around them went in for come before the first one that is finished, and before all
        // that it asks for.
        if full >= self.first_full {
            self.smooth_across(rule, full);
            self.judge_legs(rule, full - 2);
            self.mesh(rule, full - 3, out);
        }
    }

    /// Splits every return into its direction and 1/range.
    #[inline(always)]
    fn split_rays(&mut self, rule: &Rule, new: usize, points: &[Point]) {
        let (cols, least) = (self.shape.cols, rule.least_range);
        let [x, y, z] = &mut self.direction;
        let (x, y, z, q) = (x.cells_mut(new), y.cells_mut(new), z.cells_mut(new), self.inverse.cells_mut(new));
        let given = points.len().min(cols);
        let points = &points[..given];
        let (x, y, z, q) = (&mut x[..cols], &mut y[..cols], &mut z[..cols], &mut q[..cols]);
        for (k, point) in points.iter().enumerate() {
            let range = (point.x * point.x + point.y * point.y + point.z * point.z).sqrt();
            // Comparisons with NaN are false: an empty cell fails the first, an infinite one the second.
            let is_there = (range >= least) & (range <= f32::MAX);
            let inverse = if is_there { 1.0 / range } else { 0.0 };
            q[k] = inverse;
            x[k] = if is_there { point.x * inverse } else { 0.0 };
            y[k] = if is_there { point.y * inverse } else { 0.0 };
            z[k] = if is_there { point.z * inverse } else { 0.0 };
        }
        x[given..].fill(0.0);
        y[given..].fill(0.0);
        z[given..].fill(0.0);
        q[given..].fill(0.0);
        for axis in 0..3 {
            self.direction[axis].close(new);
        }
        self.inverse.close(new);
    }

    /// Measures the steps within the new line, and from the line before to it.
    #[inline(always)]
    fn measure_chords(&mut self, new: usize) {
        let (here, above) = (line_of_three(&self.direction, new), line_of_three(&self.direction, new - 1));
        let pad = self.shape.pad;
        let (along, across) = (self.chord_along.line_mut(new), self.chord_across.line_mut(new - 1));
        let (inverse, inverse_above) = (self.inverse.at(new), self.inverse.at(new - 1));
        for col in (0..self.shape.cols).step_by(WIDE) {
            let (rays, own) = (some_of_three(&here, col), inverse.some(col));
            let right = chords2(&rays, &some_of_three(&here, col + 1), &own, &inverse.some(col + 1));
            put(along, pad + col, right);
            put(across, pad + col, chords2(&some_of_three(&above, col), &rays, &inverse_above.some(col), &own));
        }
        self.chord_along.close(new);
        self.chord_across.close(new - 1);
    }

    /// Filters 1/range along the new line.
    #[inline(always)]
    fn smooth_along(&mut self, rule: &Rule, new: usize) {
        let pad = self.shape.pad;
        for col in (0..self.shape.cols).step_by(LANES) {
            let inverse = self.inverse.line(new);
            let chord2 = or_else(self.chord_along.eight(new, col), self.chord_along.eight_before(new, col));
            let smoothed = rule.along.smooth(
                lanes(inverse, pad + col),
                chord2,
                #[inline(always)]
                |k| (lanes(inverse, pad + col + k), lanes(inverse, pad + col - k)),
            );
            self.smoothed.put(new, col, smoothed);
        }
        self.smoothed.close(new);
    }

    /// Filters 1/range from line to line, and puts the points where it says.
    #[inline(always)]
    fn smooth_across(&mut self, rule: &Rule, full: usize) {
        let rays = line_of_three(&self.direction, full);
        for col in (0..self.shape.cols).step_by(LANES) {
            let chord2 = or_else(self.chord_across.eight(full, col), self.chord_across.eight(full - 1, col));
            let smoothed = &self.smoothed;
            let inverse = rule.across.smooth(
                smoothed.eight(full, col),
                chord2,
                #[inline(always)]
                |k| (smoothed.eight(full + k, col), smoothed.eight(full - k, col)),
            );
            let mut range = [0.0; LANES];
            for k in 0..LANES {
                range[k] = if inverse[k] > 0.0 { 1.0 / inverse[k] } else { 0.0 };
            }
            let mut place = some_of_three::<LANES>(&rays, col);
            for (axis, values) in place.iter_mut().enumerate() {
                for k in 0..LANES {
                    values[k] *= range[k];
                }
                self.sample[axis].put(full, col, *values);
            }
            self.sample[3].put(full, col, inverse);
        }
        for part in 0..4 {
            self.sample[part].close(full);
        }
    }

    /// A filtered point.
    #[inline(always)]
    fn sample(&self, number: usize, col: usize, back: usize) -> Sample {
        let at = |axis: usize| self.sample[axis].from(number, col, back)[0];
        [at(0), at(1), at(2), at(3)]
    }

    /// Judges the legs from every cell to the next one of its line and to the next line.
    #[inline(always)]
    fn judge_legs(&mut self, rule: &Rule, line: usize) {
        let cols = self.shape.cols;
        for col in (0..cols).step_by(WIDE) {
            let inverse = self.sample[3].at(line);
            let (here, right): ([f32; WIDE], [f32; WIDE]) = (inverse.some(col), inverse.some(col + 1));
            let below: [f32; WIDE] = self.sample[3].at(line + 1).some(col);
            let chord_along: [f32; WIDE] = self.chord_along.at(line).some(col);
            let chord_across: [f32; WIDE] = self.chord_across.at(line).some(col);
            let (mut along, mut across) = ([0; WIDE], [0; WIDE]);
            for k in 0..WIDE {
                along[k] = rule.legs.presort(here[k], right[k], chord_along[k]);
            }
            for k in 0..WIDE {
                across[k] = rule.legs.presort(here[k], below[k], chord_across[k]);
            }
            if union(&along, &across) & UNDECIDED != 0 {
                self.decide(rule, line, col, &mut along, &mut across);
            }
            self.legs_along.put(line, col, along);
            self.legs_across.put(line, col, across);
        }
        self.legs_along.close(line);
        self.legs_across.close(line);
    }

    /// Decides on the legs of some cells that their neighbours decide on.
    fn decide(&self, rule: &Rule, line: usize, col: usize, along: &mut [u8; WIDE], across: &mut [u8; WIDE]) {
        for k in 0..WIDE.min(self.shape.cols - col) {
            if (along[k] | across[k]) & UNDECIDED == 0 {
                continue;
            }
            let here = self.sample(line, col + k, 0);
            if along[k] & UNDECIDED != 0 {
                let beyond = || [self.sample(line, col + k, 1), self.sample(line, col + k + 2, 0)];
                along[k] = rule.legs.judge(&here, &self.sample(line, col + k + 1, 0), beyond).bits();
            }
            if across[k] & UNDECIDED != 0 {
                let beyond = || [self.sample(line - 1, col + k, 0), self.sample(line + 2, col + k, 0)];
                across[k] = rule.legs.judge(&here, &self.sample(line + 1, col + k, 0), beyond).bits();
            }
        }
    }

    /// Meshes the quads between `line` and the next one, and finishes the points of `line`.
    #[inline(always)]
    fn mesh(&mut self, rule: &Rule, line: usize, out: Option<Finished<'_>>) {
        let cols = self.shape.cols;
        let mut out = out;
        let (upper, lower) = (line_of_three(&self.sample, line), line_of_three(&self.sample, line + 1));
        let (above, below) = (self.legs_along.at(line), self.legs_along.at(line + 1));
        let across = self.legs_across.at(line);
        let mut has_discarded = false;
        for col in (0..cols).step_by(WIDE) {
            let (ab, cd) = (above.some(col), below.some(col));
            let triangles = if union(&ab, &cd) == 0 {
                self.sums.skip(col);
                [0; WIDE]
            } else {
                let (ac, bd) = (across.some(col), across.some(col + 1));
                let corners = QuadCorners {
                    a: some_of_three(&upper, col),
                    b: some_of_three(&upper, col + 1),
                    c: some_of_three(&lower, col),
                    d: some_of_three(&lower, col + 1),
                };
                self.sums.cut(col, &corners, &QuadLegs { ab, ac, bd, cd })
            };
            let mut kept = triangles;
            for bits in &mut kept {
                *bits &= KEPT;
            }
            self.kept.put(line, col, kept);
            if let Some(out) = &mut out {
                let width = WIDE.min(cols - col);
                out.triangles[col..col + width].copy_from_slice(&triangles[..width]);
                has_discarded |= union(&triangles, &triangles) & !KEPT != 0;
            }
        }
        if let Some(out) = out.as_ref().filter(|_| has_discarded) {
            self.list_discarded(line, out);
        }
        self.kept.close(line);
        let (shape, rays) = (self.shape, line_of_three(&self.direction, line));
        let mut points = out.as_mut().map(|out| &mut *out.points);
        self.sums.gather(
            cols,
            shape.is_closed,
            #[inline(always)]
            |col, sums| {
                let Some(points) = points.as_mut().and_then(|points| points.get_mut(col..(col + WIDE).min(cols)))
                else {
                    return;
                };
                match sums {
                    None => points.fill(SurfacePoint::default()),
                    Some(sums) => {
                        mesh::finish_points(sums, &some_of_three(&rays, col), &rule.quality, points);
                    }
                }
            },
        );
        if let Some(out) = out {
            let (own, left) = (self.kept.from(line, 0, 0), self.kept.from(line, 0, 1));
            let (above, above_left) = (self.kept.from(line - 1, 0, 0), self.kept.from(line - 1, 0, 1));
            mesh::links_of(own, left, above, above_left, out.links);
        }
    }

    /// Lists the discarded triangles of a line.
    fn list_discarded(&mut self, line: usize, out: &Finished<'_>) {
        let cols = self.shape.cols;
        let found = out.triangles.iter().map(|bits| bits >> 4).enumerate().filter(|(_, bits)| *bits != 0);
        for (here, discarded) in found {
            let right = if here + 1 < cols { here + 1 } else { 0 };
            let cells = [out.first_cell + here, out.first_cell + right, out.next_cell + here, out.next_cell + right];
            let sample = |down: usize, across: usize| self.sample(line + down, here + across, 0);
            let samples = [sample(0, 0), sample(0, 1), sample(1, 0), sample(1, 1)];
            for (without, corners) in TRIANGLE_CORNERS.iter().enumerate().filter(|(k, _)| discarded & (1 << k) != 0) {
                let [x, y, z, area] = mesh::facing_area(corners.map(|k| &samples[k]));
                self.discarded.push(Found {
                    cell: cells[0] as u32,
                    without: without as u32,
                    triangle: DiscardedTriangle {
                        corners: corners.map(|k| cells[k] as u32),
                        neighbours: [DiscardedTriangle::NONE; 3],
                        area_vector: [x, y, z],
                        area,
                    },
                });
            }
        }
    }
}

/// The bits of the kept triangles.
const KEPT: u8 = 0x0f;
const _: () = assert!(THERE == 1 && HONEST == 2, "the mesh counts on the places of these bits");

/// All bits that any of the bytes has.
#[inline(always)]
fn union(first: &[u8; WIDE], second: &[u8; WIDE]) -> u8 {
    let mut all = 0;
    for k in 0..WIDE {
        all |= first[k] | second[k];
    }
    all
}

/// The squares of the chords between some directions each; zero where one is missing, as its inverse range says.
#[inline(always)]
fn chords2(
    a: &[[f32; WIDE]; 3],
    b: &[[f32; WIDE]; 3],
    inverse_a: &[f32; WIDE],
    inverse_b: &[f32; WIDE],
) -> [f32; WIDE] {
    let mut chords = [0.0; WIDE];
    for k in 0..WIDE {
        let (x, y, z) = (b[0][k] - a[0][k], b[1][k] - a[1][k], b[2][k] - a[2][k]);
        let are_there = (inverse_a[k] > 0.0) & (inverse_b[k] > 0.0);
        chords[k] = if are_there { x * x + y * y + z * z } else { 0.0 };
    }
    chords
}

/// The first values where there are any, else the second ones.
#[inline(always)]
fn or_else(first: [f32; LANES], second: [f32; LANES]) -> [f32; LANES] {
    let mut chosen = first;
    for k in 0..LANES {
        chosen[k] = if first[k] > 0.0 { first[k] } else { second[k] };
    }
    chosen
}
