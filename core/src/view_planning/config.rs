//! Settings of view planning.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How much each criterion counts in the utility (2.3).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Weights {
    /// w_A: information gain, 0 to 1.
    pub information: f64,
    /// w_Q: quality gain, 0 to 1.
    pub quality: f64,
    /// w_O: zones of interest, 0 to 1. Above 0.25 the robot tends to circle one structure.
    pub zones: f64,
    /// w_C: travel cost [1/m], 0.001 to 10; the inverse of the ideal distance between scans.
    pub cost: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { information: 0.43, quality: 0.35, zones: 0.22, cost: 0.09 }
    }
}

/// What the scanner will see from a place it has not been to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScannerModel {
    /// Farthest return [m], 1 to 500.
    pub range_m: f64,
    /// How far off ground that was never seen can be expected to return light [m], 1 to 500: beams graze it, so mostly far
    /// less than the farthest return. A (4.7) counts unexplored cells up to here, and its footprint ends here.
    pub ground_range_m: f64,
    /// Height of the scanner over the ground [m], 0.05 to 10.
    pub height_m: f64,
    /// Step of the turning head, res_p [deg], 0.01 to 10.
    pub azimuth_step_deg: f64,
    /// Step of the laser's sweep, res_t [deg], 0.01 to 10.
    pub elevation_step_deg: f64,
    /// Lowest elevation of a beam [deg], -90 to 0; nothing is promised under it.
    pub lowest_elevation_deg: f64,
    /// A_max: a point that stands for at most this much surface has the best D_A [m^2], 1e-6 to 1.
    pub max_area_m2: f64,
    /// w_a of the quality (3.27), 0 to 1.
    pub area_weight: f64,
    /// w_n of the quality (3.27), 0 to 1.
    pub incidence_weight: f64,
}

impl Default for ScannerModel {
    fn default() -> Self {
        Self {
            range_m: 50.0,
            ground_range_m: 50.0,
            height_m: 1.0,
            azimuth_step_deg: 0.5,
            elevation_step_deg: 0.5,
            lowest_elevation_deg: -60.0,
            max_area_m2: 0.0025,
            area_weight: 0.93,
            incidence_weight: 0.07,
        }
    }
}

/// A rectangle of the map frame that the robot must not leave and beyond which nothing is worth seeing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkArea {
    /// Smallest x and y [m, map frame].
    pub min: [f64; 2],
    /// Largest x and y [m, map frame].
    pub max: [f64; 2],
}

/// What Q and O are divided by to bring them into [0, 1].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Normalisation {
    /// By a fixed yardstick: Q by what a scan of flat, never seen ground would bring, O by the area of all zones of
    /// the list (at least `zone_saturation_m2`). Values of different plans compare, so the stop rule means something.
    #[default]
    Absolute,
    /// By the best candidate of the plan.
    BestCandidate,
}

/// What must be under the robot's footprint wherever its centre goes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FootprintRule {
    /// No obstacle: known cells under the sight threshold keep their distance, unknown cells may be under it.
    #[default]
    Clear,
    /// Only proven ground: every cell under it has a C_nc over the navigable threshold. Keeps clear of edges beyond
    /// which nothing is known, and of the gaps between the scanner's rings as well.
    Verified,
}

/// `coverage_tour`: which views together are enough, and in what order they are visited.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TourConfig {
    /// A view must bring at least this share of what a view of flat, never seen ground brings, the effort counted, 0.001
    /// to 1. Smaller gives more scans and a better model.
    pub least_gain: f64,
    /// What a cell that was never seen counts for, beside the quality it will have, 0 to 10.
    pub unexplored_value: f64,
    /// Quality over this is not worked for, 0.05 to 1.
    pub enough_quality: f64,
    /// Metres of driving that cost as much as a scan, 0.1 to 100,000: a view so far from the robot and from all others of
    /// the tour, or farther, counts half. Smaller drives less and leaves more out.
    pub scan_metres: f64,
    /// At most so many views in a tour, 1 to 1,000.
    pub max_views: usize,
}

impl Default for TourConfig {
    fn default() -> Self {
        Self { least_gain: 0.168, unexplored_value: 0.1, enough_quality: 1.0, scan_metres: 30.0, max_views: 64 }
    }
}

/// Settings shared by the strategies; a strategy reads what it needs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanningConfig {
    /// Name of the strategy in the registry.
    pub strategy: String,
    /// Weights of the utility.
    pub weights: Weights,
    /// The scanner.
    pub scanner: ScannerModel,
    /// Cells with C_nc above this can be driven on, 0.5 to 1.
    pub navigable_threshold: f64,
    /// Known cells with C_nc under this block the view, and are obstacles to keep clear of, 0 to 0.7.
    pub sight_threshold: f64,
    /// Candidates are farther apart than this [m], 0.3 to 100; also from where the robot stands.
    pub spacing_m: f64,
    /// At most one candidate for this many cells that can be driven on, 1 to 100,000.
    pub cells_per_candidate: usize,
    /// At most this many candidates, 1 to 10,000: bounds the time of a plan.
    pub max_candidates: usize,
    /// d_max: the farthest the robot should go for a target of middling use [m], 1 to 10,000.
    pub farthest_m: f64,
    /// The mean quality of the reachable ground must also reach this before the work is done, 0 to 1. 0 leaves the
    /// decision to the utility alone.
    pub min_mean_quality: f64,
    /// `multi_criteria`, `random`, `coverage_tour`: with a work area the work is not done while a candidate away from all earlier scans has an A
    /// (4.7) of this, 0.001 to 1; 1 leaves the decision to utility and quality, as the source does.
    pub least_information: f64,
    /// What Q and O are divided by.
    pub normalisation: Normalisation,
    /// See [`Normalisation::Absolute`] [m^2], 0.01 to 10,000.
    pub zone_saturation_m2: f64,
    /// No obstacle and no ground that is too steep may lie nearer than this to the robot's centre [m], 0 to 10.
    pub footprint_radius_m: f64,
    /// No step down may lie nearer than this to the robot's centre [m], 0 to 10: the wheels of a robot that turns at the edge
    /// of a deck or a bank reach as far as half its diagonal.
    pub step_clearance_m: f64,
    /// No ground of which nothing was ever seen may lie nearer than this to the robot's centre [m], 0 to 10: it may be hidden
    /// because it falls away. 0 lets the robot go up to it.
    pub hidden_clearance_m: f64,
    /// Where ground without a measurement lies nearer than this the robot does not turn on the spot, but first goes back the way it
    /// came [m], 0 to 10: wheels that turn on a slope slide down it, towards whatever that may be. Such ground is as wide as
    /// `hidden_width_m` and beside ground. The same on a slope of more than 8 degrees for an edge that was seen down the slope. 0 lets
    /// it turn anywhere.
    pub turn_clearance_m: f64,
    /// Narrower gaps in what was seen are gaps between the scanner's rings, and do not count [m], 0 to 10.
    pub hidden_width_m: f64,
    /// What must be under the footprint.
    pub footprint: FootprintRule,
    /// Beside obstacles, steps and cells that are known but not proven ground a metre costs more, up to this distance from
    /// their middles [m], 0 to 10: where there is room the robot keeps away from them, and gaps stay open. 0 leaves the cost
    /// as in (4.6).
    pub clearance_m: f64,
    /// How many times its own cost a metre costs more right beside them, 0 to 100; a third of it in the outer half.
    pub clearance_weight: f64,
    /// The highest step that the robot climbs or goes down [m], 0 to 2: with 0.165 m wheels, which slip on a kerb of 0.12 m.
    pub max_step_m: f64,
    /// The steepest slope that the robot climbs [deg], 0 to 60, as the scores' theta. From the middle of a cell to that of a
    /// neighbour the ground may rise or fall by a step and this slope.
    pub max_slope_deg: f64,
    /// Around the robot's present place the ground counts as passable up to this distance even if unknown, since the
    /// scanner cannot see under itself [m], 0 to 10.
    pub start_clearance_m: f64,
    /// Candidates are first sought within this distance of the robot along each axis [m], 10 to 2,000; only when none
    /// there is worth going to, farther off. Bounds the time of a plan, however large the map.
    pub near_m: f64,
    /// Candidates and paths stay within this distance of the robot along each axis [m], 10 to 2,000: bounds memory.
    pub horizon_m: f64,
    /// The work area, if there is one.
    pub work_area: Option<WorkArea>,
    /// `frontier`: smaller groups of frontier cells are passed over, 1 to 10,000.
    pub frontier_min_cells: usize,
    /// `greedy_informative`, `greedy_new_cells`, `exponential_gain`: a view that shows fewer unexplored cells is not worth
    /// a scan, 1 to 1,000,000.
    pub informative_min_cells: usize,
    /// `greedy_replanning`: scan again after so much of the way [m], 0.3 to 1,000.
    pub replanning_step_m: f64,
    /// `exponential_gain`: lambda of A e^(-lambda L) [1/m], 0 to 10.
    pub exponential_lambda: f64,
    /// `coverage_tour`.
    pub tour: TourConfig,
}

impl Default for PlanningConfig {
    fn default() -> Self {
        Self {
            strategy: "multi_criteria".to_owned(),
            weights: Weights::default(),
            scanner: ScannerModel::default(),
            navigable_threshold: 0.7,
            sight_threshold: 0.5,
            spacing_m: 3.0,
            cells_per_candidate: 50,
            max_candidates: 128,
            farthest_m: 30.0,
            min_mean_quality: 0.0,
            least_information: 0.02,
            normalisation: Normalisation::Absolute,
            zone_saturation_m2: 10.0,
            footprint_radius_m: 0.5,
            step_clearance_m: 0.9,
            hidden_clearance_m: 0.9,
            turn_clearance_m: 1.5,
            hidden_width_m: 1.2,
            footprint: FootprintRule::Clear,
            clearance_m: 0.95,
            clearance_weight: 3.0,
            max_step_m: 0.1,
            max_slope_deg: 20.0,
            start_clearance_m: 1.0,
            near_m: 60.0,
            horizon_m: 150.0,
            work_area: None,
            frontier_min_cells: 5,
            informative_min_cells: 500,
            replanning_step_m: 5.0,
            exponential_lambda: 0.2,
            tour: TourConfig::default(),
        }
    }
}

/// Why settings are refused.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlanningConfigError {
    /// A number lies outside its range or is not finite.
    #[error("planning: {field} = {value} is not allowed; give {min} to {max} {unit}")]
    OutOfRange {
        /// The field's name in the config.
        field: &'static str,
        /// What was given.
        value: f64,
        /// Smallest allowed value.
        min: f64,
        /// Largest allowed value.
        max: f64,
        /// Unit of the range.
        unit: &'static str,
    },
    /// All of w_A, w_Q and w_O are zero: no candidate could ever be better than another.
    #[error("planning: weights.information, weights.quality and weights.zones are all 0; give at least one a value")]
    NoCriterion,
    /// The rectangle is empty or not finite.
    #[error("planning: work_area.min must be smaller than work_area.max in x and y, and both finite")]
    EmptyWorkArea,
}

impl PlanningConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// Names the first field that lies outside its range, and the range.
    pub fn validate(&self) -> Result<(), PlanningConfigError> {
        let (w, s) = (&self.weights, &self.scanner);
        let ranges = [
            ("weights.information", w.information, 0.0, 1.0, ""),
            ("weights.quality", w.quality, 0.0, 1.0, ""),
            ("weights.zones", w.zones, 0.0, 1.0, ""),
            ("weights.cost", w.cost, 0.001, 10.0, "1/m"),
            ("scanner.range_m", s.range_m, 1.0, 500.0, "m"),
            ("scanner.ground_range_m", s.ground_range_m, 1.0, 500.0, "m"),
            ("scanner.height_m", s.height_m, 0.05, 10.0, "m"),
            ("scanner.azimuth_step_deg", s.azimuth_step_deg, 0.01, 10.0, "deg"),
            ("scanner.elevation_step_deg", s.elevation_step_deg, 0.01, 10.0, "deg"),
            ("scanner.lowest_elevation_deg", s.lowest_elevation_deg, -90.0, 0.0, "deg"),
            ("scanner.max_area_m2", s.max_area_m2, 1e-6, 1.0, "m^2"),
            ("scanner.area_weight", s.area_weight, 0.01, 1.0, ""),
            ("scanner.incidence_weight", s.incidence_weight, 0.0, 1.0, ""),
            ("navigable_threshold", self.navigable_threshold, 0.5, 1.0, ""),
            ("sight_threshold", self.sight_threshold, 0.0, 0.7, ""),
            ("spacing_m", self.spacing_m, 0.3, 100.0, "m"),
            ("cells_per_candidate", self.cells_per_candidate as f64, 1.0, 1e5, ""),
            ("max_candidates", self.max_candidates as f64, 1.0, 1e4, ""),
            ("farthest_m", self.farthest_m, 1.0, 1e4, "m"),
            ("min_mean_quality", self.min_mean_quality, 0.0, 1.0, ""),
            ("least_information", self.least_information, 0.001, 1.0, ""),
            ("zone_saturation_m2", self.zone_saturation_m2, 0.01, 1e4, "m^2"),
            ("footprint_radius_m", self.footprint_radius_m, 0.0, 10.0, "m"),
            ("step_clearance_m", self.step_clearance_m, 0.0, 10.0, "m"),
            ("hidden_clearance_m", self.hidden_clearance_m, 0.0, 10.0, "m"),
            ("turn_clearance_m", self.turn_clearance_m, 0.0, 10.0, "m"),
            ("hidden_width_m", self.hidden_width_m, 0.0, 10.0, "m"),
            ("clearance_m", self.clearance_m, 0.0, 10.0, "m"),
            ("clearance_weight", self.clearance_weight, 0.0, 100.0, ""),
            ("max_step_m", self.max_step_m, 0.0, 2.0, "m"),
            ("max_slope_deg", self.max_slope_deg, 0.0, 60.0, "deg"),
            ("start_clearance_m", self.start_clearance_m, 0.0, 10.0, "m"),
            ("near_m", self.near_m, 10.0, 2000.0, "m"),
            ("horizon_m", self.horizon_m, 10.0, 2000.0, "m"),
            ("frontier_min_cells", self.frontier_min_cells as f64, 1.0, 1e4, ""),
            ("informative_min_cells", self.informative_min_cells as f64, 1.0, 1e6, ""),
            ("replanning_step_m", self.replanning_step_m, 0.3, 1000.0, "m"),
            ("exponential_lambda", self.exponential_lambda, 0.0, 10.0, "1/m"),
            ("tour.least_gain", self.tour.least_gain, 0.001, 1.0, ""),
            ("tour.unexplored_value", self.tour.unexplored_value, 0.0, 10.0, ""),
            ("tour.enough_quality", self.tour.enough_quality, 0.05, 1.0, ""),
            ("tour.scan_metres", self.tour.scan_metres, 0.1, 1e5, "m"),
            ("tour.max_views", self.tour.max_views as f64, 1.0, 1000.0, ""),
        ];
        for (field, value, min, max, unit) in ranges {
            if !(min..=max).contains(&value) {
                return Err(PlanningConfigError::OutOfRange { field, value, min, max, unit });
            }
        }
        if w.information + w.quality + w.zones <= 0.0 {
            return Err(PlanningConfigError::NoCriterion);
        }
        match self.work_area {
            Some(area) if !area.is_usable() => Err(PlanningConfigError::EmptyWorkArea),
            _ => Ok(()),
        }
    }

    /// C_p = 0.5 / (w_C d_max) (4.12): the work is done when no candidate is worth more.
    #[must_use]
    pub fn stop_threshold(&self) -> f64 {
        0.5 / (self.weights.cost * self.farthest_m)
    }

    /// The same settings with those that only weigh what was found set to their defaults: two plans that agree in the rest
    /// find the same candidates with the same terms.
    pub(super) fn without_preferences(&self) -> Self {
        let default = Self::default();
        Self {
            strategy: String::new(),
            weights: default.weights,
            farthest_m: default.farthest_m,
            min_mean_quality: default.min_mean_quality,
            least_information: default.least_information,
            normalisation: default.normalisation,
            zone_saturation_m2: default.zone_saturation_m2,
            frontier_min_cells: default.frontier_min_cells,
            informative_min_cells: default.informative_min_cells,
            replanning_step_m: default.replanning_step_m,
            exponential_lambda: default.exponential_lambda,
            tour: default.tour,
            ..self.clone()
        }
    }

    /// Whether a position of the map frame [m] lies in the work area; everywhere when there is none.
    #[must_use]
    pub fn is_in_work_area(&self, position: [f64; 2]) -> bool {
        self.work_area.is_none_or(|area| (0..2).all(|axis| (area.min[axis]..=area.max[axis]).contains(&position[axis])))
    }
}

impl WorkArea {
    fn is_usable(&self) -> bool {
        (0..2).all(|axis| self.min[axis].is_finite() && self.max[axis].is_finite() && self.min[axis] < self.max[axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed_and_survive_a_config_file() {
        let config =
            PlanningConfig { work_area: Some(WorkArea { min: [-1.0, -2.0], max: [3.0, 4.0] }), ..Default::default() };
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<PlanningConfig>(&text).unwrap(), config);
        assert!(toml::from_str::<PlanningConfig>("weight = 1").is_err());
    }

    #[test]
    fn a_field_outside_its_range_is_named_with_the_range() {
        let mut config = PlanningConfig::default();
        config.scanner.range_m = f64::NAN;
        let message = config.validate().unwrap_err().to_string();
        assert!(message.contains("scanner.range_m") && message.contains("1 to 500 m"), "{message}");
    }

    #[test]
    fn negative_weights_and_steps_are_named() {
        let refused = |change: fn(&mut PlanningConfig)| {
            let mut config = PlanningConfig::default();
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        assert!(refused(|c| c.weights.information = -0.2).contains("weights.information = -0.2"));
        assert!(refused(|c| c.weights.cost = 0.0).contains("weights.cost = 0 is not allowed; give 0.001 to 10 1/m"));
        assert!(refused(|c| c.max_step_m = -0.1).contains("max_step_m = -0.1 is not allowed; give 0 to 2 m"));
        assert!(refused(|c| c.max_slope_deg = 90.0).contains("max_slope_deg = 90 is not allowed; give 0 to 60 deg"));
    }

    #[test]
    fn weights_that_rank_nothing_and_an_empty_area_are_refused() {
        let weights = Weights { information: 0.0, quality: 0.0, zones: 0.0, cost: 0.1 };
        let config = PlanningConfig { weights, ..Default::default() };
        assert_eq!(config.validate(), Err(PlanningConfigError::NoCriterion));
        let area = WorkArea { min: [0.0, 0.0], max: [1.0, 0.0] };
        let config = PlanningConfig { work_area: Some(area), ..Default::default() };
        assert_eq!(config.validate(), Err(PlanningConfigError::EmptyWorkArea));
    }

    #[test]
    fn the_stop_threshold_is_that_of_the_source() {
        let config = PlanningConfig { farthest_m: 50.0, ..Default::default() };
        assert!((config.stop_threshold() - 0.5 / (0.09 * 50.0)).abs() < 1e-12);
    }
}
