//! The settings of loop closing and of the correction of older scans.

use serde::{Deserialize, Serialize};

use crate::registration::ConfigError;
use crate::registration::coarse::CoarseConfig;
use crate::slam6d::pose_graph::PoseGraphConfig;

/// How the poses of older scans are corrected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CorrectionMethod {
    /// A graph of all registered pairs with their covariances, solved for the most likely poses; loop closures that
    /// contradict the rest are switched off.
    #[default]
    PoseGraph,
    /// The source's way (equations 3.5 to 3.7): a loop that closes spreads its error over the scans between in
    /// proportion to the distance travelled. Pairs that close no loop are not looked at.
    Proportional,
    /// Older scans are never corrected, and no keyframe is kept.
    Off,
}

/// The settings of loop closing and of the correction of older scans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GlobalConfig {
    /// How the poses of older scans are corrected.
    pub method: CorrectionMethod,
    /// A pair of scans with at least so many scans from one to the other closes a loop; nearer ones overlap because
    /// they follow one another, unless their prediction lies outside the basin.
    pub loop_scans: usize,
    /// Most pairs with scans shortly before that are registered for a scan.
    pub overlaps_per_scan: usize,
    /// A scan that does not fit the last accepted one is tried against up to so many older ones, the nearest to its prior.
    pub retry_scans: usize,
    /// Most loop closures that are tried for a scan.
    pub loops_per_scan: usize,
    /// Of these, most whose prediction lies outside the basin, so that they may need coarse alignment.
    pub coarse_per_scan: usize,
    /// Least share of a scan that, by the predicted poses, the other has seen too, to register the pair.
    pub min_predicted_overlap: f64,
    /// Scans within this share of the mean of their ranges from each other may overlap. A keyframe's range is that of
    /// four fifths of its points.
    pub reach: f64,
    /// The farthest that scans may be from each other to be registered [m].
    pub max_reach_m: f64,
    /// How many standard deviations a prediction may be off.
    pub gate_sigmas: f64,
    /// How many standard deviations of prediction and measurement the pose found may be from the predicted one.
    /// Covariances of registration are good to a factor of two or so, which is why it is wide.
    pub accept_sigmas: f64,
    /// Loops are not looked for where the prediction's gate is wider than this [m].
    pub max_uncertainty_m: f64,
    /// The basin: a prediction that is off by no more than this is where registration may begin [m].
    pub basin_m: f64,
    /// The same for angles [rad].
    pub basin_rotation: f64,
    /// The least share of a scan's points that must have a partner to close a loop; see [`Self::verify_near_loops`].
    pub min_loop_overlap: f64,
    /// Poses are corrected when one of them is off by more than this [m] ...
    pub correction_threshold_m: f64,
    /// ... or by more than this [deg]. Then all go along that are off by a tenth of it.
    pub correction_threshold_deg: f64,
    /// When no loop was closed, only the newest so many scans are corrected.
    pub window_scans: usize,
    /// Keyframes that are held ready for registration beside the packed ones. More save time, fewer memory.
    pub prepared_keyframes: usize,
    /// Whether a loop is judged by the evidence of the points, too: overlap in both directions, and points in space
    /// that the other scan saw to be free.
    pub verify_loops: bool,
    /// Whether that also holds for loops whose prediction lies within the basin. Switched off, these count like pairs of scans that
    /// follow one another, which need less overlap: where priors say how sure they are, hardly another pose can be found from
    /// there, and it is scans of little overlap that tie what hangs on a weak pair alone. The graph may still switch them off.
    pub verify_near_loops: bool,
    /// Coarse alignment, where a prediction is too uncertain to begin registration at, and the judgement of loops. Its
    /// `threads` are those of the service.
    pub coarse: CoarseConfig,
    /// The graph.
    pub pose_graph: PoseGraphConfig,
}

impl Default for GlobalConfig {
    fn default() -> Self {
        Self {
            method: CorrectionMethod::PoseGraph,
            loop_scans: 12,
            overlaps_per_scan: 3,
            retry_scans: 3,
            loops_per_scan: 2,
            coarse_per_scan: 1,
            min_predicted_overlap: 0.4,
            reach: 1.0,
            max_reach_m: 40.0,
            gate_sigmas: 3.0,
            accept_sigmas: 6.0,
            max_uncertainty_m: 20.0,
            basin_m: 1.0,
            basin_rotation: 0.15,
            min_loop_overlap: 0.4,
            correction_threshold_m: 0.005,
            correction_threshold_deg: 0.05,
            window_scans: 40,
            prepared_keyframes: 24,
            verify_loops: true,
            verify_near_loops: true,
            coarse: CoarseConfig::default(),
            pose_graph: PoseGraphConfig::default(),
        }
    }
}

impl GlobalConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("global.loop_scans", self.loop_scans as f64, 2.0, 1e6)?;
        ConfigError::check("global.overlaps_per_scan", self.overlaps_per_scan as f64, 0.0, 1e3)?;
        ConfigError::check("global.retry_scans", self.retry_scans as f64, 0.0, 1e3)?;
        ConfigError::check("global.loops_per_scan", self.loops_per_scan as f64, 0.0, 1e3)?;
        ConfigError::check("global.coarse_per_scan", self.coarse_per_scan as f64, 0.0, 1e3)?;
        ConfigError::check("global.min_predicted_overlap", self.min_predicted_overlap, 0.0, 1.0)?;
        ConfigError::check("global.reach", self.reach, 0.0, 10.0)?;
        ConfigError::check("global.max_reach_m", self.max_reach_m, 0.0, 1e4)?;
        ConfigError::check("global.gate_sigmas", self.gate_sigmas, 0.0, 100.0)?;
        ConfigError::check("global.accept_sigmas", self.accept_sigmas, 0.0, 1e6)?;
        ConfigError::check("global.max_uncertainty_m", self.max_uncertainty_m, 0.0, 1e4)?;
        ConfigError::check("global.basin_m", self.basin_m, 0.0, 100.0)?;
        ConfigError::check("global.basin_rotation", self.basin_rotation, 0.0, std::f64::consts::PI)?;
        ConfigError::check("global.min_loop_overlap", self.min_loop_overlap, 0.0, 1.0)?;
        ConfigError::check("global.correction_threshold_m", self.correction_threshold_m, 0.0, 100.0)?;
        ConfigError::check("global.correction_threshold_deg", self.correction_threshold_deg, 0.0, 180.0)?;
        ConfigError::check("global.window_scans", self.window_scans as f64, 2.0, 1e6)?;
        ConfigError::check("global.prepared_keyframes", self.prepared_keyframes as f64, 2.0, 1e4)?;
        self.coarse.validate()?;
        self.pose_graph.validate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_survive_toml() {
        let config = GlobalConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert!(text.contains("method = \"pose_graph\""), "{text}");
        assert_eq!(toml::from_str::<GlobalConfig>(&text).unwrap(), config);
    }

    #[test]
    fn a_value_out_of_range_is_refused_by_name() {
        let config = GlobalConfig { min_loop_overlap: f64::NAN, ..GlobalConfig::default() };
        assert_eq!(config.validate().unwrap_err().field, "global.min_loop_overlap");
    }
}
