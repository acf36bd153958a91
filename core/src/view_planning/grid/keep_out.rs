//! What the robot keeps out of, or may always go back to, beside what the cells themselves say: hidden ground, places that
//! held it, ways it has driven.

use super::{Extent, PlanningGrid};
use crate::information_map::{CellIndex, Obstruction, cells_touched_by_segment};
use crate::view_planning::bits::{BitPlane, WORD};
use crate::view_planning::config::PlanningConfig;

impl PlanningGrid {
    /// Marks what lies near ground that may be hidden because it falls away, with nothing that stands between: to drive, ground
    /// that nothing was ever seen of; to turn, ground without a measurement. Under the scanner, where it cannot look, the robot
    /// stands.
    pub(super) fn mark_hidden(&mut self, extent: &Extent, config: &PlanningConfig) {
        let (mut hidden, mut precarious) = (std::mem::take(&mut self.hidden), std::mem::take(&mut self.precarious));
        let mut seen = std::mem::take(&mut self.scratch);
        seen.clone_from(&self.known);
        self.mark_hidden_from(&mut seen, extent, config, config.hidden_clearance_m, &mut hidden);
        seen.clone_from(&self.grounded);
        seen.words.iter_mut().zip(&self.blocks.words).for_each(|(seen, blocks)| *seen |= blocks);
        self.mark_hidden_from(&mut seen, extent, config, config.turn_clearance_m, &mut precarious);
        (self.hidden, self.precarious, self.scratch) = (hidden, precarious, seen);
    }

    /// The cells nearer than the clearance to ground that may be hidden; none for a clearance of 0. `seen` is used up.
    fn mark_hidden_from(
        &mut self,
        seen: &mut BitPlane,
        extent: &Extent,
        config: &PlanningConfig,
        clearance_m: f64,
        out: &mut BitPlane,
    ) {
        if clearance_m <= 0.0 {
            out.reset(self.height, self.width / WORD, 0);
            return;
        }
        let middle = |metres: f64| ((metres / self.cell_m).floor() + 0.5) * self.cell_m;
        let start = [middle(extent.robot.x), middle(extent.robot.y)];
        self.for_each_cell_within(start, config.start_clearance_m, |_, row, bit| seen.set(row, bit));
        self.spread_hidden(seen, config, clearance_m, out);
    }

    /// The cells nearer than the clearance to ground that may be hidden; `seen` is used up.
    fn spread_hidden(&self, seen: &mut BitPlane, config: &PlanningConfig, clearance_m: f64, out: &mut BitPlane) {
        let gap = 0.5 * config.hidden_width_m / self.cell_m;
        let mut wide = BitPlane::default();
        // What a disc of the gap's width fits into.
        seen.dilate_into(gap, out);
        out.words.iter_mut().for_each(|word| *word = !*word);
        out.dilate_into(gap, &mut wide);
        // Of that, what lies beside ground, and not behind a wall.
        seen.words.iter_mut().zip(&self.blocks.words).for_each(|(seen, blocks)| *seen &= !blocks);
        seen.dilate_into(std::f64::consts::SQRT_2, out);
        wide.words.iter_mut().zip(&out.words).for_each(|(wide, beside)| *wide &= beside);
        wide.dilate_into(clearance_m / self.cell_m, out);
    }

    /// Cells at ground of the work area of which nothing was ever seen: beside it, and those that the robot cannot go nearer
    /// than to ground that may be hidden.
    pub fn brink(&self, config: &PlanningConfig) -> BitPlane {
        let mut brink = BitPlane::default();
        self.unexplored.dilate_into(std::f64::consts::SQRT_2, &mut brink);
        if config.hidden_clearance_m > 0.0 {
            let (mut seen, mut hidden) = (self.unexplored.clone(), BitPlane::default());
            seen.words.iter_mut().for_each(|word| *word = !*word);
            self.spread_hidden(&mut seen, config, config.hidden_clearance_m, &mut hidden);
            hidden.dilate_into(std::f64::consts::SQRT_2, &mut seen);
            brink.words.iter_mut().zip(&seen.words).for_each(|(brink, near)| *brink |= near);
        }
        brink
    }

    /// What held the robot cannot be driven on, whatever was seen there.
    pub(super) fn mark_held(&mut self, obstructions: &[Obstruction]) {
        self.held.reset(self.height, self.width / WORD, 0);
        for obstruction in obstructions {
            let Obstruction { centre, radius_m } = *obstruction;
            self.for_each_cell_within(centre, radius_m, |grid, row, bit| grid.held.set(row, bit));
        }
        for (navigable, held) in self.navigable.words.iter_mut().zip(&self.held.words) {
            *navigable &= !held;
        }
    }

    /// Where the robot has been it can be, though a scan says that it should not: ways back stay open, as far as can be
    /// driven to. Its wheels have been on the cells beside those that its middle crossed, too: they count where nothing speaks
    /// against them, so that one cell that a scan takes for an obstacle does not shut the way.
    pub(super) fn mark_driven(&mut self, driven: &[[[f64; 2]; 2]], extent: &Extent) {
        let (mut middle, mut beside) = (std::mem::take(&mut self.driven), std::mem::take(&mut self.scratch));
        for plane in [&mut middle, &mut beside] {
            plane.reset(self.height, self.width / WORD, 0);
        }
        let mark = |plane: &mut BitPlane, cell: CellIndex| {
            if let Some(at) = self.at(cell).filter(|_| extent.is_near(cell)) {
                plane.set(at / self.width, at % self.width);
            }
        };
        for piece in driven {
            let [from, to] = piece.map(|end| end.map(|metres| metres / self.cell_m));
            cells_touched_by_segment(from, to, |cell| {
                mark(&mut middle, cell);
                for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                    mark(&mut beside, CellIndex { x: cell.x + dx, y: cell.y + dy });
                }
                true
            });
        }
        let shut = self.held.words.iter().zip(&self.blocks.words);
        let edges = self.steps.words.iter().zip(&self.steep.words);
        for (((middle, beside), (held, blocks)), (steps, steep)) in
            middle.words.iter_mut().zip(&beside.words).zip(shut).zip(edges)
        {
            *middle = (*middle | beside & !(steps | steep)) & !(held | blocks);
        }
        (self.driven, self.scratch) = (middle, beside);
    }
}
