//! Where could the next scan be taken? Places drawn at random on ground that can be driven on (section 7).

use super::config::PlanningConfig;
use super::grid::PlanningGrid;
use super::plan::{RejectionReason, ViewPlan};
use super::strategy::Situation;
use super::survey::Survey;
use crate::information_map::CellIndex;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Draws candidate cells with their travel costs: at random, seeded by run and scan, without repetition; farther apart
/// than the spacing, also from the robot; at most one for so many cells that can be driven on. What is refused goes
/// into the record.
pub(super) fn draw(
    survey: &Survey,
    situation: &Situation,
    config: &PlanningConfig,
    plan: &mut ViewPlan,
) -> Vec<(usize, f64)> {
    let mut cells: Vec<u32> = survey.grid.with(PlanningGrid::NAVIGABLE).map(|at| at as u32).collect();
    let most = (cells.len() / config.cells_per_candidate).min(config.max_candidates);
    let mut random = ChaCha8Rng::seed_from_u64(mix(situation.run_seed, situation.scan_number));
    let mut spacing = Spacing::new(survey, config.spacing_m);
    let mut drawn: Vec<(usize, f64)> = Vec::with_capacity(most);
    for next in 0..cells.len() {
        if drawn.len() >= most {
            break;
        }
        // One step of a Fisher-Yates shuffle: the cell drawn is put out of reach of the next draws.
        let pick = next + below(&mut random, cells.len() - next);
        cells.swap(next, pick);
        let at = cells[next] as usize;
        match survey.check(at).and_then(|cost| spacing.check(at).map(|()| cost)) {
            Ok(cost) => {
                spacing.take(survey, at);
                drawn.push((at, cost));
            }
            Err(reason) => plan.reject(survey.grid.centre(at), reason),
        }
    }
    drawn
}

/// One seed out of two (the finaliser of splitmix64), so that neighbouring scans draw unrelated places.
fn mix(run_seed: u64, scan_number: u64) -> u64 {
    let mut z = run_seed ^ scan_number.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A number in 0..n; its bias is below n / 2^64.
fn below(random: &mut ChaCha8Rng, n: usize) -> usize {
    ((u128::from(random.next_u64()) * n as u128) >> 64) as usize
}

/// Which cells are too near to something taken.
struct Spacing {
    taken: Vec<Option<RejectionReason>>,
    spacing: f64,
}

impl Spacing {
    fn new(survey: &Survey, spacing_m: f64) -> Self {
        let mut spacing = Self { taken: vec![None; survey.grid.flags.len()], spacing: spacing_m / survey.grid.cell_m };
        let robot = [survey.robot.x / survey.grid.cell_m - 0.5, survey.robot.y / survey.grid.cell_m - 0.5];
        spacing.mark(survey, robot, RejectionReason::NearRobot);
        spacing
    }

    fn check(&self, at: usize) -> Result<(), RejectionReason> {
        self.taken[at].map_or(Ok(()), Err)
    }

    fn take(&mut self, survey: &Survey, at: usize) {
        let index = survey.grid.index(at);
        self.mark(survey, [f64::from(index.x), f64::from(index.y)], RejectionReason::NearCandidate);
    }

    /// Marks every cell whose centre is no farther than the spacing from a place (in cells, centres being integers).
    fn mark(&mut self, survey: &Survey, place: [f64; 2], reason: RejectionReason) {
        let ends =
            |axis: usize| ((place[axis] - self.spacing).ceil() as i32)..=((place[axis] + self.spacing).floor() as i32);
        for (x, y) in ends(1).flat_map(|y| ends(0).map(move |x| (x, y))) {
            let (dx, dy) = (f64::from(x) - place[0], f64::from(y) - place[1]);
            let is_near = dx * dx + dy * dy <= self.spacing * self.spacing * (1.0 + 1e-9);
            if is_near && let Some(at) = survey.grid.at(CellIndex { x, y }) {
                self.taken[at].get_or_insert(reason);
            }
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
