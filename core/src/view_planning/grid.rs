//! The part of the information map that a plan looks at, laid out densely for speed.

use super::config::PlanningConfig;
use crate::information_map::{CellIndex, CellState, InformationMap, Level, Reach, TILE_SIDE};
use nalgebra::Point3;

/// Neighbouring levels whose ground differs by more than this are not of the same way [m].
const MAX_STEP_M: f64 = 0.5;

/// What gain and cost need of a known cell, 40 bytes.
#[derive(Debug, Clone, Copy)]
pub(super) struct KnownCell {
    /// Mean of n n^T (see `NormalStatistics::mean_moments`).
    pub moments: [f32; 6],
    /// Mean height of everything seen [m, map frame].
    pub height: f32,
    /// Mean height of the ground [m, map frame]; that of everything when there is no ground.
    pub ground: f32,
    /// Q_a (4.5).
    pub quality: f32,
    /// C_nc (4.4).
    pub navigability: f32,
}

/// Dense flags over the known world around the robot, with a margin of the scanner's range on every side so that
/// rays need no bounds check. Beyond the map everything is unknown.
pub(super) struct PlanningGrid {
    low: CellIndex,
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// Side of a cell [m].
    pub cell_m: f64,
    /// Cells of margin.
    pub margin: usize,
    pub flags: Vec<u8>,
    slots: Vec<u32>,
    known: Vec<KnownCell>,
}

impl PlanningGrid {
    /// Nothing was ever seen here, and it lies in the work area.
    pub const UNEXPLORED: u8 = 1;
    /// A known cell in the work area.
    pub const KNOWN: u8 = 2;
    /// C_nc under the sight threshold: blocks the view, is an obstacle.
    pub const BLOCKS: u8 = 4;
    /// C_nc over the navigable threshold, within the horizon (wherever the work area is).
    pub const NAVIGABLE: u8 = 8;
    /// In the work area.
    pub const IN_AREA: u8 = 16;
    /// The footprint would touch an obstacle.
    pub const CRAMPED: u8 = 32;

    /// `None` when the robot is not on the map plane.
    pub fn new(map: &InformationMap, robot: &Point3<f64>, config: &PlanningConfig) -> Option<Self> {
        let here = map.cell_containing(robot.x, robot.y)?;
        let cells = |metres: f64| (metres / map.cell_m()).ceil() as i32;
        let (range, horizon) = (cells(config.scanner.range_m), cells(config.horizon_m));
        let margin = range.max(cells(config.footprint_radius_m)) + 2;
        let reach = horizon + range;
        let (mut low, mut high) = (here, here);
        if let Some((first, last)) = map.tile_bounds() {
            let window = |tile: i32, at: i32| (tile * TILE_SIDE).clamp(at - reach, at + reach);
            low = CellIndex { x: here.x.min(window(first.x, here.x)), y: here.y.min(window(first.y, here.y)) };
            high = CellIndex { x: here.x.max(window(last.x + 1, here.x)), y: here.y.max(window(last.y + 1, here.y)) };
        }
        let low = CellIndex { x: low.x - margin, y: low.y - margin };
        let (width, height) = ((high.x + margin - low.x + 1) as usize, (high.y + margin - low.y + 1) as usize);
        let mut grid = Self {
            low,
            width,
            height,
            cell_m: map.cell_m(),
            margin: margin as usize,
            flags: vec![Self::UNEXPLORED | Self::IN_AREA; width * height],
            slots: vec![u32::MAX; width * height],
            known: Vec::new(),
        };
        grid.mark_area(config);
        grid.add_known(map, robot, here, (horizon, reach), config);
        grid.mark_cramped(config.footprint_radius_m);
        Some(grid)
    }

    fn mark_area(&mut self, config: &PlanningConfig) {
        if config.work_area.is_none() {
            return;
        }
        for at in 0..self.flags.len() {
            if !config.is_in_work_area(self.centre(at)) {
                self.flags[at] = 0;
            }
        }
    }

    /// Every known cell at the level the robot would be on there.
    fn add_known(
        &mut self,
        map: &InformationMap,
        robot: &Point3<f64>,
        here: CellIndex,
        (horizon, reach): (i32, i32),
        config: &PlanningConfig,
    ) {
        let (weight, clearance) = (map.config().obstacle_weight, map.config().clearance_m);
        let mut several = Vec::new();
        for (index, cell) in map.known_cells() {
            let away = (index.x - here.x).abs().max((index.y - here.y).abs());
            if away < reach {
                let levels = cell.levels(clearance);
                if let Some(lowest) = levels.as_slice().first() {
                    self.add(index, lowest, weight, away <= horizon, config);
                }
                if levels.as_slice().len() > 1 {
                    several.push((index, cell, away <= horizon));
                }
            }
        }
        if several.is_empty() {
            return;
        }
        let choice = map.choose_levels(&Reach {
            robot: *robot,
            window_m: f64::from(reach) * map.cell_m(),
            start_m: config.start_clearance_m,
            max_step_m: MAX_STEP_M,
            navigable_threshold: config.navigable_threshold,
        });
        for (index, cell, in_horizon) in several {
            let levels = cell.levels(clearance);
            if let Some(level) = choice.pick(index, &levels) {
                self.add(index, level, weight, in_horizon, config);
            }
        }
    }

    fn add(&mut self, index: CellIndex, level: &Level, weight: f64, in_horizon: bool, config: &PlanningConfig) {
        let (Some(at), CellState::Known(navigability)) = (self.at(index), level.state(weight)) else { return };
        let evidence = &level.evidence;
        let mut flags = self.flags[at] & Self::IN_AREA;
        if flags != 0 {
            flags |= Self::KNOWN;
        }
        if navigability < config.sight_threshold {
            flags |= Self::BLOCKS;
        }
        if navigability > config.navigable_threshold && in_horizon {
            flags |= Self::NAVIGABLE;
        }
        self.flags[at] = flags;
        self.slots[at] = self.known.len() as u32;
        let height = evidence.height().unwrap_or(0.0);
        self.known.push(KnownCell {
            moments: evidence.mean_moments(),
            height: height as f32,
            ground: evidence.ground_height().unwrap_or(height) as f32,
            quality: evidence.quality().unwrap_or(0.0) as f32,
            navigability: navigability as f32,
        });
    }

    /// Marks every cell that has an obstacle's centre within the footprint's radius of its own.
    fn mark_cramped(&mut self, radius_m: f64) {
        let disc = self.disc(radius_m);
        for at in 0..self.flags.len() {
            if self.flags[at] & Self::BLOCKS != 0 {
                for offset in &disc {
                    // Obstacles lie inside the margin, which is wider than the disc.
                    self.flags[at.wrapping_add_signed(*offset)] |= Self::CRAMPED;
                }
            }
        }
    }

    /// Offsets to all cells whose centres lie within `radius_m`, this cell included.
    pub fn disc(&self, radius_m: f64) -> Vec<isize> {
        let radius = radius_m / self.cell_m;
        let reach = radius.floor() as isize;
        let within = |x: isize, y: isize| ((x * x + y * y) as f64) <= radius * radius;
        (-reach..=reach)
            .flat_map(|y| (-reach..=reach).filter(move |&x| within(x, y)).map(move |x| (x, y)))
            .map(|(x, y)| y * self.width as isize + x)
            .collect()
    }

    /// The place of a cell in the arrays, or `None` outside.
    pub fn at(&self, index: CellIndex) -> Option<usize> {
        let (x, y) = (i64::from(index.x) - i64::from(self.low.x), i64::from(index.y) - i64::from(self.low.y));
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        inside.then(|| y as usize * self.width + x as usize)
    }

    /// The cell at a place of the arrays.
    pub fn index(&self, at: usize) -> CellIndex {
        CellIndex { x: self.low.x + (at % self.width) as i32, y: self.low.y + (at / self.width) as i32 }
    }

    /// The centre of a cell [m, map frame].
    pub fn centre(&self, at: usize) -> [f64; 2] {
        let index = self.index(at);
        [index.x, index.y].map(|i| (f64::from(i) + 0.5) * self.cell_m)
    }

    pub fn known(&self, at: usize) -> Option<&KnownCell> {
        self.known.get(self.slots[at] as usize)
    }

    pub fn has(&self, at: usize, flag: u8) -> bool {
        self.flags[at] & flag != 0
    }

    /// The places that carry a flag, in a fixed order.
    pub fn with(&self, flag: u8) -> impl Iterator<Item = usize> + '_ {
        (0..self.flags.len()).filter(move |&at| self.flags[at] & flag != 0)
    }
}
