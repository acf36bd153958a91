//! Mirador's own strategy looks further than one view: which views *together* are enough, and in what order are they
//! driven to with the least way? The first of them is taken, and after its scan all is thought over again.
//!
//! What a set of views brings is a sum over cells of the best that any of its views brings there (a cell seen twice is not
//! new twice), a submodular function: taking the view that adds most, again and again, is within 1 - 1/e of the best set
//! (Nemhauser, Wolsey, Fisher 1978), and what a view adds only shrinks as the set grows, so only the top of a heap needs to
//! be looked at again (Minoux 1978). The order is that of the shortest open tour found by exchanges (`tour_order`).

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use super::bits::{BitPlane, WORD};
use super::config::{PlanningConfig, TourConfig};
use super::gain::{GainModel, LEVEL};
use super::plan::{Decision, StopReason, ViewPlan};
use super::strategy::{Situation, Strategy};
use super::sweep::Sweep;
use super::tile_digest::SIDE;
use super::tour_order::order;
use super::utility::unexplored;
use super::visited::Visited;
use super::workspace::{Stage, Workspace, plan_in_stages};
use crate::information_map::InformationMap;

/// Chooses the views that together cover what is unexplored or could be seen better, and drives the shortest tour over
/// them. A candidate's utility is what it adds to those taken before it, as a share of what a view of flat, never seen
/// ground brings; that of candidates not taken is what they would add. Views are taken by that share for the effort: it
/// counts in full where the robot is, and half where the way to it, from the robot or another view of the tour, is as
/// long as a scan is worth, or longer. When no view brings the least share it goes to those away from all scans that show
/// unexplored ground of the work area, and stops when there is none.
#[derive(Debug, Clone, Default)]
pub struct CoverageTour {
    visited: Visited,
}

/// Improvements smaller than this are not counted, cell by cell: far cells become better by next to nothing from anywhere.
const LEAST_IMPROVEMENT: f32 = 0.02;

/// A view counts for this share of what it brings, however far it is: what is left in a far corner is work as well.
const LEAST_SHARE_FAR: f64 = 0.5;

/// What one view shows.
#[derive(Debug, Default)]
struct View {
    /// Unexplored cells in view, and the place of their low corner in the grid.
    unexplored: BitPlane,
    origin: [usize; 2],
    /// Cells and how much better they become.
    better: Vec<(u32, f32)>,
}

impl Strategy for CoverageTour {
    fn name(&self) -> &str {
        "coverage_tour"
    }

    fn remember(&mut self, situation: &Situation) {
        self.visited.remember(situation);
    }

    fn plan(
        &mut self,
        workspace: &mut Workspace,
        map: &InformationMap,
        situation: &Situation,
        config: &PlanningConfig,
    ) -> ViewPlan {
        self.visited.remember(situation);
        let visited = &self.visited;
        plan_in_stages(self.name(), workspace, map, situation, config, |stage, plan| {
            // Before it says that nothing is left it has looked from all over the ground, so many places at a time.
            let looks = if stage.is_last { usize::MAX } else { 1 };
            (0..looks)
                .map(|look| look_and_choose(stage, visited, plan, look))
                .find(|choice| *choice != Choice::TooLittle)
                .is_some_and(|choice| choice == Choice::Made)
        })
    }
}

/// What comes of a look at the ground.
#[derive(Debug, PartialEq, Eq)]
enum Choice {
    /// A tour, in the plan.
    Made,
    /// Nothing that is worth a scan.
    TooLittle,
    /// No place to look from.
    NoPlace,
}

/// Looks from some places, other ones every time, and makes a tour of those that are worth it.
fn look_and_choose(stage: &mut Stage<'_>, visited: &Visited, plan: &mut ViewPlan, look: usize) -> Choice {
    let config = stage.config;
    let places = stage.rate_candidates_of(look, plan);
    if places.is_empty() {
        return Choice::NoPlace;
    }
    let views = stage.for_each_candidate(|model, sweep, at, ground, view| {
        *view = View::look(model, sweep, at, ground, &config.tour);
    });
    let whole = stage.flat_quality();
    let (mut chosen, best) = choose(stage, plan, &views, whole);
    let is_good = plan.mean_quality.unwrap_or(0.0) >= config.min_mean_quality;
    let is_little = best <= 0.0 || (best < config.tour.least_gain && is_good);
    if is_little {
        chosen = unexplored(&plan.candidates, visited, config);
        chosen.truncate(config.tour.max_views);
    }
    if is_little && chosen.is_empty() {
        let reason = if is_good { StopReason::Done } else { StopReason::NothingToGain };
        plan.decision = Decision::Stop { reason };
        return Choice::TooLittle;
    }
    let cells: Vec<usize> = chosen.iter().map(|&index| places[index]).collect();
    plan.tour = order(stage.survey(), &cells).into_iter().map(|k| chosen[k]).collect();
    let candidate = plan.tour[0];
    plan.decision = Decision::Go { candidate };
    plan.path = stage.survey().path_to(places[candidate]);
    Choice::Made
}

impl View {
    fn look(model: &GainModel<'_>, sweep: &mut Sweep, at: usize, ground: f64, config: &TourConfig) -> Self {
        let grid = model.grid;
        let (x, y) = (at % grid.width, at / grid.width);
        let eye = (ground + model.view.height_m()) as f32;
        sweep.run(&grid.blocking(), &model.view.reach, x, y);
        let mut view = Self { origin: sweep.origin, ..Self::default() };
        view.list_better(model, sweep, [x, y], eye, config.enough_quality as f32);
        view.list_unexplored(model, sweep, [x, y], config.enough_quality as f32);
        view
    }

    /// Known cells that would become better.
    fn list_better(&mut self, model: &GainModel<'_>, sweep: &Sweep, place: [usize; 2], eye: f32, enough: f32) {
        let (cell_m, width) = (model.grid.cell_m as f32, model.grid.width);
        model.for_each_tile(sweep, place, eye, |digest, mask, offset, [column, row]| {
            for (k, &bits) in mask.iter().enumerate() {
                for half in [0, SIDE / 2] {
                    if bits >> half & 0xff == 0 {
                        continue;
                    }
                    let (first, y) = (k * SIDE + half, offset.y + k as f32 * cell_m);
                    let from = [offset.x + half as f32 * cell_m, y, offset.eye];
                    let gains = model.view.quality.gains(&digest.cells, first, from, cell_m);
                    for (lane, gain) in gains.into_iter().enumerate() {
                        let gain = gain.min(enough - digest.cells.quality[first + lane]);
                        if bits >> (half + lane) & 1 == 1 && gain > LEAST_IMPROVEMENT {
                            self.better.push((((row + k) * width + column + half + lane) as u32, gain));
                        }
                    }
                }
            }
        });
    }

    /// Unexplored cells, and the quality that near ones would have were they level ground.
    fn list_unexplored(&mut self, model: &GainModel<'_>, sweep: &Sweep, [x, y]: [usize; 2], enough: f32) {
        let grid = model.grid;
        self.unexplored.reset(sweep.seen.rows(), sweep.seen.stride, 0);
        model.for_each_unexplored_word(sweep, [x, y], |row, word, bits| self.unexplored.row_mut(row)[word] = bits);
        let (cell_m, height) = (grid.cell_m as f32, model.view.height_m() as f32);
        let stride = self.unexplored.stride * WORD;
        for place in self.unexplored.ones() {
            let (column, row) = (self.origin[0] + place % stride, self.origin[1] + place / stride);
            let (dx, dy) = (column as f32 - x as f32, row as f32 - y as f32);
            let value = model.view.quality.expected([dx * cell_m, dy * cell_m, -height], &LEVEL).min(enough);
            if value > LEAST_IMPROVEMENT {
                self.better.push(((row * grid.width + column) as u32, value));
            }
        }
    }
}

/// What the views taken so far bring.
struct Taken {
    explored: BitPlane,
    better: Vec<f32>,
    unexplored_value: f64,
}

impl Taken {
    /// What a view adds.
    fn adds(&self, view: &View) -> f64 {
        let first = view.origin[0] / WORD;
        let rows = view.unexplored.rows().min(self.explored.rows() - view.origin[1]);
        let mut cells = 0;
        for row in 0..rows {
            let taken = &self.explored.row(view.origin[1] + row)[first..];
            cells +=
                view.unexplored.row(row).iter().zip(taken).map(|(new, old)| (new & !old).count_ones()).sum::<u32>();
        }
        let better: f64 =
            view.better.iter().map(|&(at, value)| f64::from((value - self.better[at as usize]).max(0.0))).sum();
        self.unexplored_value * f64::from(cells) + better
    }

    fn take(&mut self, view: &View) {
        let first = view.origin[0] / WORD;
        let rows = view.unexplored.rows().min(self.explored.rows() - view.origin[1]);
        for row in 0..rows {
            let taken = &mut self.explored.row_mut(view.origin[1] + row)[first..];
            taken.iter_mut().zip(view.unexplored.row(row)).for_each(|(taken, new)| *taken |= new);
        }
        for &(at, value) in &view.better {
            let taken = &mut self.better[at as usize];
            *taken = taken.max(value);
        }
    }
}

/// A view in the heap: what it was worth when last looked at, and how many views were taken then.
#[derive(Debug, PartialEq)]
struct Waiting {
    worth: f64,
    index: Reverse<usize>,
    taken: usize,
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        self.worth.total_cmp(&other.worth).then(self.index.cmp(&other.index))
    }
}

/// The views of a tour as they are chosen.
struct Selection<'a> {
    places: Vec<[f64; 2]>,
    from_robot: Vec<f64>,
    views: &'a [View],
    taken: Taken,
    chosen: Vec<usize>,
    scan_metres: f64,
    whole: f64,
}

impl Selection<'_> {
    /// What a view adds, as a share of the whole, and the same for the effort: a scan at the next corner is worth more than
    /// one at the other end of the world.
    fn worth(&self, index: usize) -> (f64, f64) {
        let adds = self.taken.adds(&self.views[index]) / self.whole;
        let [x, y] = self.places[index];
        let to = |&other: &usize| (self.places[other][0] - x).hypot(self.places[other][1] - y);
        let way = self.chosen.iter().map(to).fold(self.from_robot[index], f64::min);
        (adds, adds * (self.scan_metres / (self.scan_metres + way)).max(LEAST_SHARE_FAR))
    }

    fn wait(&self, index: usize) -> Waiting {
        Waiting { worth: self.worth(index).1, index: Reverse(index), taken: self.chosen.len() }
    }

    fn take(&mut self, index: usize) {
        self.taken.take(&self.views[index]);
        self.chosen.push(index);
    }
}

/// Takes the view that is worth most until none is worth enough, at least one, and writes what each adds into the plan's
/// candidates as a share of `whole`. Returns the views taken, and what the first was worth.
fn choose(stage: &Stage<'_>, plan: &mut ViewPlan, views: &[View], whole: f64) -> (Vec<usize>, f64) {
    let (grid, config) = (&stage.survey().grid, &stage.config.tour);
    let mut explored = BitPlane::default();
    explored.reset(grid.height, grid.unexplored.stride, 0);
    let mut choice = Selection {
        places: plan.candidates.iter().map(|c| [c.position[0], c.position[1]]).collect(),
        from_robot: plan.candidates.iter().map(|c| c.cost).collect(),
        views,
        taken: Taken { explored, better: vec![0.0; grid.len()], unexplored_value: config.unexplored_value },
        chosen: Vec::new(),
        scan_metres: config.scan_metres,
        whole: whole.max(f64::MIN_POSITIVE),
    };
    for (index, candidate) in plan.candidates.iter_mut().enumerate() {
        candidate.utility = choice.worth(index).0;
    }
    let mut heap: BinaryHeap<Waiting> = (0..views.len()).map(|index| choice.wait(index)).collect();
    let mut best = 0.0;
    while let Some(top) = heap.pop() {
        let index = top.index.0;
        if top.taken < choice.chosen.len() {
            heap.push(choice.wait(index));
            continue;
        }
        let is_first = choice.chosen.is_empty();
        if choice.chosen.len() >= config.max_views || !(top.worth >= config.least_gain || is_first) {
            break;
        }
        if is_first {
            best = top.worth;
        }
        plan.candidates[index].utility = choice.worth(index).0;
        choice.take(index);
    }
    (choice.chosen, best)
}

#[cfg(test)]
#[path = "tour_tests.rs"]
mod tests;
