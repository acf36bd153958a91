//! One cell of the map, and the levels in it.
//!
//! Evidence is kept by height, in slabs of half a metre, and belongs together when no room for the robot lies between:
//! the ground and the wall that stands on it are one, the road and the bridge over it are two.

use super::evidence::{Evidence, GroundSum};
use super::navigability::CellState;
use super::tile::{Record, Tile};
use nalgebra::Vector3;

/// The most levels told apart in one cell; what lies higher counts to the last.
pub const MAX_LEVELS: usize = 4;

/// A look at one cell.
#[derive(Debug, Clone, Copy)]
pub struct Cell<'a> {
    pub(super) tile: &'a Tile,
    pub(super) within: usize,
}

/// What lies at one level of a cell: ground to drive on with what stands on it, or an obstacle.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Level {
    /// Everything that was seen of it. What hangs over it with room for the robot in between (crowns, lamps, the
    /// underside of a bridge) counts in height, quality and normals; it says nothing of navigability.
    pub evidence: Evidence,
    /// Mean height of its ground [m, map frame]; `None` without any. Where ground was measured, only of slabs in which some
    /// was: a triangle over a few returns on what stands or hangs there lies far from the ground, and looks as level.
    pub ground_height: Option<f64>,
    /// Mean height of the lowest of that ground [m, map frame]; without ground, of its lowest evidence.
    pub lowest: f64,
    /// Mean height of the highest of that ground [m, map frame]; without ground, of its highest evidence.
    pub highest: f64,
    /// Free height over `highest` to what is above [m]; infinite under the open sky.
    pub clearance: f64,
}

impl Level {
    /// Whether a robot that masters steps of `max_step_m` gets from this level to that one of a neighbouring cell.
    /// Ground of a level that is not one surface (a wedge under a ramp too low to drive under) must be within the step
    /// from end to end.
    #[must_use]
    pub fn connects(&self, other: &Self, max_step_m: f64) -> bool {
        (self.highest.max(other.highest) - self.lowest.min(other.lowest)) <= max_step_m
    }

    /// The state of the level.
    #[must_use]
    pub fn state(&self, obstacle_weight: f64) -> CellState {
        self.evidence.navigability(obstacle_weight).map_or(CellState::Unknown, CellState::Known)
    }

    /// The height a robot stands at [m, map frame]: mean height of the ground, of everything where there is none.
    #[must_use]
    pub fn ground(&self) -> f64 {
        self.ground_height.or_else(|| self.evidence.height()).unwrap_or(self.lowest)
    }
}

/// The levels of one cell, upwards.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Levels {
    levels: [Level; MAX_LEVELS],
    count: usize,
}

impl Levels {
    /// The levels, upwards; none in an unknown cell.
    #[must_use]
    pub fn as_slice(&self) -> &[Level] {
        &self.levels[..self.count]
    }
}

/// Evidence without a gap that the robot fits in. Heights are taken from the records when they are asked for: nearly always
/// the slabs alone say what belongs together.
#[derive(Clone, Copy)]
struct Cluster<'a> {
    evidence: Evidence,
    lowest: &'a Record,
    highest: &'a Record,
    ground: Option<Ground<'a>>,
}

/// The records of a cluster with ground: those with measured ground, if there are any.
#[derive(Clone, Copy)]
struct Ground<'a> {
    lowest: &'a Record,
    highest: &'a Record,
    sum: GroundSum,
    is_measured: bool,
}

impl<'a> Ground<'a> {
    fn of(record: &'a Record) -> Option<Self> {
        let evidence = &record.evidence;
        let ground = || Self {
            lowest: record,
            highest: record,
            sum: evidence.ground_sum(),
            is_measured: evidence.has_measured_ground(),
        };
        evidence.has_ground().then(ground)
    }

    /// With that of the next record upwards.
    fn with(self, next: Self) -> Self {
        match (self.is_measured, next.is_measured) {
            (true, false) => self,
            (false, true) => next,
            _ => Self { highest: next.highest, sum: self.sum.plus(next.sum), ..self },
        }
    }
}

impl<'a> Cluster<'a> {
    fn new(record: &'a Record) -> Self {
        Self { evidence: record.evidence, lowest: record, highest: record, ground: Ground::of(record) }
    }

    /// Takes the next record upwards.
    fn take(&mut self, record: &'a Record) {
        self.evidence.merge(&record.evidence);
        self.highest = record;
        if let Some(next) = Ground::of(record) {
            self.ground = Some(self.ground.map_or(next, |ground| ground.with(next)));
        }
    }

    /// Whether a gap of `clearance_m` or more lies between this and the next record upwards.
    fn ends_below(&self, record: &Record, clearance_m: f64) -> bool {
        // Means lie in their slabs of half a metre, so the gap is less than this, and more than a metre less.
        let most_m = 0.5 * f64::from(record.slab - self.highest.slab + 1);
        if most_m <= clearance_m {
            return false;
        }
        most_m - 1.0 >= clearance_m || span(record)[0] - span(self.highest)[1] >= clearance_m
    }

    /// Mean height of its lowest slab, or of the ground in that [m, map frame].
    fn bottom(&self) -> f64 {
        span(self.lowest)[0]
    }

    fn level(&self) -> Level {
        let height = |record: &Record| record.evidence.ground_height().unwrap_or_default();
        let [lowest, highest] = match self.ground {
            Some(ground) => [ground.lowest, ground.highest].map(height),
            None => [self.bottom(), span(self.highest)[1]],
        };
        let ground_height = self.ground.and_then(|ground| ground.sum.mean());
        Level { evidence: self.evidence, ground_height, lowest, highest, clearance: f64::INFINITY }
    }
}

impl Cell<'_> {
    /// Whether nothing was ever seen here. This is not the same as a navigability of 0.5.
    #[must_use]
    #[inline]
    pub fn is_unknown(&self) -> bool {
        self.tile.records_of(self.within).next().is_none()
    }

    /// All evidence of the cell, whatever its height.
    #[must_use]
    pub fn total(&self) -> Evidence {
        let mut total = Evidence::default();
        self.tile.records_of(self.within).for_each(|record| total.merge(&record.evidence));
        total
    }

    /// Q_a (4.5): the mean D of the cell's points, whatever their height; where there are none, of the interpolated
    /// evidence. `None` when the cell is unknown.
    #[must_use]
    pub fn quality(&self) -> Option<f64> {
        self.total().quality()
    }

    /// The levels of the cell: evidence with a gap of `clearance_m` or more between belongs to different ones.
    ///
    /// Only what the robot can drive on or bump into makes a level. What says neither, as a crown over a path, limits
    /// the clearance of the level below it, which is otherwise as it would be without.
    #[must_use]
    pub fn levels(&self, clearance_m: f64) -> Levels {
        let mut levels = Levels::default();
        let mut records = self.tile.records_of(self.within);
        let Some(first) = records.next() else { return levels };
        let mut cluster = Cluster::new(first);
        for record in records {
            if cluster.ends_below(record, clearance_m) {
                levels.push(&cluster);
                cluster = Cluster::new(record);
            } else {
                cluster.take(record);
            }
        }
        levels.push(&cluster);
        levels
    }

    /// The only one of [`Self::levels`] where all evidence of the cell belongs together, as nearly always, at a fraction of
    /// the time; `None` where there is a gap of `clearance_m` or more, and in an unknown cell.
    #[must_use]
    pub fn undivided(&self, clearance_m: f64) -> Option<Level> {
        let mut records = self.tile.records_of(self.within);
        let mut cluster = Cluster::new(records.next()?);
        for record in records {
            if cluster.ends_below(record, clearance_m) {
                return None;
            }
            cluster.take(record);
        }
        Some(cluster.level())
    }

    /// The lowest level.
    #[must_use]
    pub fn lowest_level(&self, clearance_m: f64) -> Option<Level> {
        self.levels(clearance_m).as_slice().first().copied()
    }

    /// The expected incidence |v . n| of everything in the cell for the unit direction `v` of the map frame (4.9).
    #[must_use]
    pub fn expected_incidence(&self, v: &Vector3<f32>) -> f32 {
        self.total().expected_incidence(v)
    }
}

/// From where to where the evidence of a slab reaches, by its means [m, map frame].
fn span(record: &Record) -> [f64; 2] {
    let height = record.evidence.height().unwrap_or_default();
    let ground = record.evidence.ground_height().unwrap_or(height);
    [height.min(ground), height.max(ground)]
}

impl Levels {
    /// Puts a cluster over the others.
    fn push(&mut self, cluster: &Cluster<'_>) {
        let below = self.count.checked_sub(1).and_then(|k| self.levels.get_mut(k));
        if let Some(below) = below {
            let room = cluster.bottom() - below.highest;
            below.clearance = below.clearance.min(room);
            let is_level = cluster.evidence.concerns_the_robot();
            if !below.evidence.concerns_the_robot() && is_level {
                // Nothing to drive on or bump into below, as under a floor seen through: it counts to this level.
                let mut level = cluster.level();
                level.evidence.merge(&below.evidence);
                *below = level;
                return;
            }
            if !is_level || self.count == MAX_LEVELS {
                below.evidence.merge(&cluster.evidence);
                return;
            }
        }
        if let Some(place) = self.levels.get_mut(self.count) {
            *place = cluster.level();
            self.count += 1;
        }
    }
}

#[cfg(test)]
#[path = "cell_tests.rs"]
mod tests;
