//! The settings of coarse alignment and how far it looks.

use serde::{Deserialize, Serialize};

use crate::registration::ConfigError;

/// How the overlap of occupied cubes is searched for its maximum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Branch and bound over translations for every rotation of a lattice (Olson 2015; Hess et al. 2016, in 3D): the
    /// maximum over the whole lattice, and the next best ones that differ from it.
    #[default]
    BranchAndBound,
    /// As the source has it (section 3, step 2): at each depth of the octree every combination of one step back, none
    /// and one ahead over six degrees of freedom around the best of the depth before. A maximum of its neighbourhood,
    /// and only one.
    DepthByDepth,
}

/// The settings of [`super::CoarseAligner`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CoarseConfig {
    /// Worker threads; results do not depend on it.
    pub threads: usize,
    /// How the overlap is maximised.
    pub method: Method,
    /// Edge of the smallest cubes, in which scans are compared and to which they are thinned [m].
    pub cell_m: f64,
    /// Points farther than this are not used [m].
    pub max_range_m: f64,
    /// How many points of the source are laid over the target's cubes, drawn evenly over the directions that surfaces
    /// face, so that the ground counts no more than any wall.
    pub search_points: usize,
    /// Step of the lattice in yaw [rad].
    pub yaw_step: f64,
    /// Step of the lattice in roll and pitch [rad].
    pub tilt_step: f64,
    /// How many different maxima are followed up.
    pub hypotheses: usize,
    /// The search ends after so many cube sets were laid over the target; what it found until then is reported.
    pub max_evaluations: usize,
    /// What a pose must show to be trusted.
    pub trust: TrustConfig,
}

impl Default for CoarseConfig {
    fn default() -> Self {
        Self {
            threads: 2,
            method: Method::default(),
            cell_m: 0.5,
            max_range_m: 35.0,
            search_points: 384,
            yaw_step: 5.0_f64.to_radians(),
            tilt_step: 5.0_f64.to_radians(),
            hypotheses: 8,
            max_evaluations: 60_000,
            trust: TrustConfig::default(),
        }
    }
}

impl CoarseConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("coarse.threads", self.threads as f64, 1.0, 256.0)?;
        ConfigError::check("coarse.cell_m", self.cell_m, 0.05, 10.0)?;
        // The cubes of a scan lie in one dense array.
        ConfigError::check("coarse.max_range_m", self.max_range_m, 4.0 * self.cell_m, 150.0 * self.cell_m)?;
        ConfigError::check("coarse.search_points", self.search_points as f64, 50.0, 20_000.0)?;
        ConfigError::check("coarse.yaw_step", self.yaw_step, 0.01, 0.6)?;
        ConfigError::check("coarse.tilt_step", self.tilt_step, 0.01, 0.6)?;
        ConfigError::check("coarse.hypotheses", self.hypotheses as f64, 1.0, 64.0)?;
        ConfigError::check("coarse.max_evaluations", self.max_evaluations as f64, 1.0, 1e9)?;
        self.trust.validate()
    }
}

/// What a pose must show to be trusted; see [`super::Evidence`] for the terms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrustConfig {
    /// Points of each scan that must lie on a surface of the other.
    pub least_matched_points: u32,
    /// The largest share of contradicted points among those that are matched or contradicted, in the worse direction.
    pub most_contradicted: f64,
    /// The share of one scan's points that must lie on a surface of the other, in the better direction.
    pub least_overlap: f64,
    /// The least [`super::Evidence::score`]: surfaces matched both ways, every direction that they face counting alike,
    /// less what is contradicted.
    pub least_score: f64,
    /// The largest root mean square distance of matched points from the planes they lie on [m].
    pub most_residual_m: f64,
    /// The least eigenvalue of the normalised Hessian of the matched points (see
    /// [`crate::registration::Constraint`]).
    pub least_eigenvalue: f64,
    /// By how much of its own score a pose must beat the next best different one, where there was a search.
    pub least_margin: f64,
}

impl Default for TrustConfig {
    fn default() -> Self {
        Self {
            least_matched_points: 200,
            most_contradicted: 0.05,
            least_overlap: 0.4,
            least_score: 0.45,
            most_residual_m: 0.12,
            least_eigenvalue: 0.004,
            least_margin: 0.2,
        }
    }
}

impl TrustConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("trust.least_matched_points", f64::from(self.least_matched_points), 6.0, 1e9)?;
        ConfigError::check("trust.most_contradicted", self.most_contradicted, 0.0, 1.0)?;
        ConfigError::check("trust.least_overlap", self.least_overlap, 0.0, 1.0)?;
        ConfigError::check("trust.least_score", self.least_score, 0.0, 1.0)?;
        ConfigError::check("trust.most_residual_m", self.most_residual_m, 1e-3, 10.0)?;
        ConfigError::check("trust.least_eigenvalue", self.least_eigenvalue, 0.0, 0.3)?;
        ConfigError::check("trust.least_margin", self.least_margin, 0.0, 1.0)
    }
}

/// How wrong the initial pose may be: the true pose is `initial_target_from_source * error`, so the error is a motion
/// in the source's frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SearchRange {
    /// Across the vertical, along each axis [m].
    pub translation_m: f64,
    /// Along the vertical [m]; what the tilt adds over `translation_m` is seen to.
    pub height_m: f64,
    /// About the vertical [rad].
    pub yaw: f64,
    /// About each axis across the vertical [rad].
    pub tilt: f64,
    /// The direction up in the source's frame, of any length.
    pub vertical: [f64; 3],
}

impl Default for SearchRange {
    fn default() -> Self {
        Self {
            translation_m: 5.0,
            height_m: 0.5,
            yaw: 45.0_f64.to_radians(),
            tilt: 5.0_f64.to_radians(),
            vertical: [0.0, 0.0, 1.0],
        }
    }
}

impl SearchRange {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of range, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        ConfigError::check("search.translation_m", self.translation_m, 0.0, 200.0)?;
        ConfigError::check("search.height_m", self.height_m, 0.0, 200.0)?;
        ConfigError::check("search.yaw", self.yaw, 0.0, std::f64::consts::PI)?;
        ConfigError::check("search.tilt", self.tilt, 0.0, 1.0)?;
        let length = self.vertical.iter().map(|v| v * v).sum::<f64>().sqrt();
        ConfigError::check("search.vertical", length, 1e-6, 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_survive_toml() {
        let config = CoarseConfig::default();
        config.validate().unwrap();
        assert_eq!(toml::from_str::<CoarseConfig>(&toml::to_string(&config).unwrap()).unwrap(), config);
        SearchRange::default().validate().unwrap();
    }

    #[test]
    fn values_out_of_range_are_refused_by_name() {
        let config = CoarseConfig { cell_m: 0.0, ..CoarseConfig::default() };
        assert_eq!(config.validate().unwrap_err().field, "coarse.cell_m");
        let range = SearchRange { vertical: [0.0; 3], ..SearchRange::default() };
        assert_eq!(range.validate().unwrap_err().field, "search.vertical");
        assert!(SearchRange { yaw: f64::NAN, ..SearchRange::default() }.validate().is_err());
    }
}
