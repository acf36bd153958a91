//! Where could the next scan be taken? Places drawn at random on ground that can be driven on (section 7).

use super::bits::BitPlane;
use super::config::PlanningConfig;
use super::grid::PlanningGrid;
use super::plan::{Rejected, RejectionReason, Rejections, ViewPlan};
use super::strategy::Situation;
use super::survey::Survey;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// The places drawn, with their travel costs, and those refused.
#[derive(Debug, Default)]
pub(super) struct Draw {
    pub places: Vec<(usize, f64)>,
    pub rejected: Vec<Rejected>,
    pub rejections: Rejections,
}

/// Draws candidate cells with their travel costs: at random, seeded by run and scan, without repetition; farther apart
/// than the spacing, also from the robot; at most one for so many cells that can be driven on. What is refused is
/// recorded. Of what can be drawn in all, a look takes as many as are allowed at a time, and every later `look` those that
/// come next.
pub(super) fn draw(survey: &Survey, situation: &Situation, config: &PlanningConfig, look: usize) -> Draw {
    let mut cells: Vec<u32> = survey.grid.navigable.ones().map(|at| at as u32).collect();
    let all = cells.len() / config.cells_per_candidate;
    let (first, most) = (look.saturating_mul(config.max_candidates), all.min((look + 1) * config.max_candidates));
    let mut taken = 0;
    let mut random = ChaCha8Rng::seed_from_u64(mix(situation.run_seed, situation.scan_number));
    let mut spacing = Spacing::new(survey, config.spacing_m);
    let mut drawn = Draw::default();
    for next in 0..cells.len() {
        if taken >= most {
            break;
        }
        // One step of a Fisher-Yates shuffle: the cell drawn is put out of reach of the next draws.
        let pick = next + below(&mut random, cells.len() - next);
        cells.swap(next, pick);
        let at = cells[next] as usize;
        match survey.check(at).and_then(|cost| spacing.check(at).map(|()| cost)) {
            Ok(cost) => {
                spacing.take(at);
                if taken >= first {
                    drawn.places.push((at, cost));
                }
                taken += 1;
            }
            Err(reason) => drawn.reject(&survey.grid, at, reason),
        }
    }
    drawn
}

impl Draw {
    fn reject(&mut self, grid: &PlanningGrid, at: usize, reason: RejectionReason) {
        *self.rejections.counts.entry(reason).or_insert(0) += 1;
        if self.rejected.len() < ViewPlan::MAX_REJECTED {
            self.rejected.push(Rejected { position: grid.centre(at), reason });
        }
    }
}

/// One seed out of two (the finaliser of splitmix64), so that neighbouring scans draw unrelated places.
pub(super) fn mix(run_seed: u64, scan_number: u64) -> u64 {
    let mut z = run_seed ^ scan_number.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A number in 0..n; its bias is below n / 2^64.
pub(super) fn below(random: &mut ChaCha8Rng, n: usize) -> usize {
    ((u128::from(random.next_u64()) * n as u128) >> 64) as usize
}

/// Which cells are too near to the robot, or to something taken.
struct Spacing {
    near_robot: BitPlane,
    near_candidate: BitPlane,
    width: usize,
    spacing: f64,
}

impl Spacing {
    fn new(survey: &Survey, spacing_m: f64) -> Self {
        let grid = &survey.grid;
        let mut empty = BitPlane::default();
        empty.reset(grid.height, grid.area.stride, 0);
        let mut near_robot = empty.clone();
        let corner = grid.index(0);
        let robot = [
            survey.robot.x / grid.cell_m - 0.5 - f64::from(corner.x),
            survey.robot.y / grid.cell_m - 0.5 - f64::from(corner.y),
        ];
        let spacing = spacing_m / grid.cell_m;
        mark(&mut near_robot, robot, spacing);
        Self { near_robot, near_candidate: empty, width: grid.width, spacing }
    }

    fn check(&self, at: usize) -> Result<(), RejectionReason> {
        let (row, bit) = (at / self.width, at % self.width);
        if self.near_robot.has(row, bit) {
            return Err(RejectionReason::NearRobot);
        }
        if self.near_candidate.has(row, bit) { Err(RejectionReason::NearCandidate) } else { Ok(()) }
    }

    fn take(&mut self, at: usize) {
        mark(&mut self.near_candidate, [(at % self.width) as f64, (at / self.width) as f64], self.spacing);
    }
}

/// Marks every cell whose centre is no farther than the spacing from a place (in cells, centres being integers).
fn mark(plane: &mut BitPlane, place: [f64; 2], spacing: f64) {
    let square = spacing * spacing * (1.0 + 1e-9);
    let width = (plane.stride * super::bits::WORD) as f64;
    for row in ((place[1] - spacing).ceil().max(0.0) as usize)..plane.rows() {
        let dy = row as f64 - place[1];
        if dy > spacing {
            break;
        }
        // Rows at the rim may lie a rounding error outside.
        let half = (square - dy * dy).max(0.0).sqrt();
        let (first, last) = ((place[0] - half).ceil().max(0.0), (place[0] + half).floor().min(width - 1.0));
        if first <= last {
            plane.set_range(row, first as usize, last as usize);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_of_neighbouring_scans_are_unrelated() {
        let seeds: std::collections::BTreeSet<u64> =
            (0..10).flat_map(|run| (0..100).map(move |s| mix(run, s))).collect();
        assert_eq!(seeds.len(), 1000);
        assert!((mix(1, 1) ^ mix(1, 2)).count_ones() > 8);
    }

    #[test]
    fn numbers_below_a_bound_are_spread_over_it() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut counts = [0; 7];
        for _ in 0..7000 {
            counts[below(&mut random, 7)] += 1;
        }
        assert!(counts.iter().all(|&count| (850..1150).contains(&count)), "{counts:?}");
    }
}
