//! The settings of the scores.

use serde::{Deserialize, Serialize};

/// H(P_z, d), with x = P_z / (d tan theta).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeightForm {
    /// exp(-x^2): straight slopes up to about 0.62 theta stay navigable at u_F = 0.65.
    #[default]
    Calibrated,
    /// exp(-x^2 / 2): up to about 0.76 theta.
    Gentle,
    /// exp(-|x|), the literal reading: a 15 deg slope fails at theta = 30 deg.
    Literal,
}

/// B_l of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObstacleForm {
    /// As `Calibrated`, and the steps of the mesh count, too: a leg between neighbours that rises steeply is part of a
    /// face even where neither point's own normal says so, and a face of one line of rays keeps its score beside the
    /// ground over and under it. Kerbs, wheels and the lowest steps of stairs are found.
    #[default]
    Stepped,
    /// |N_xy| min(1, |v.n| / 0.1) within reach: walls are obstacles at every incidence.
    Calibrated,
    /// |N_xy| H |v.n| within reach, the literal reading: misses walls seen beyond about 30 deg.
    Literal,
}

/// How points are scored (spec section 5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScoreConfig {
    /// theta, the steepest slope the robot climbs [deg].
    pub theta_deg: f64,
    /// Points higher than this over the ground cannot touch the robot [m].
    pub robot_height_m: f64,
    /// w_l, weight of a point's own F (3.18).
    pub w_l: f64,
    /// w_g, weight of its neighbours' mean F (3.18).
    pub w_g: f64,
    /// w_bl, weight of a point's own B (3.21).
    pub w_bl: f64,
    /// w_bg, weight of its neighbours' mean B (3.21).
    pub w_bg: f64,
    /// How H falls with height.
    pub height_form: HeightForm,
    /// What makes an obstacle.
    pub obstacle_form: ObstacleForm,
    /// Height of the scanner over the ground under the robot [m], where the mount is known; else it is estimated.
    pub scanner_height_m: Option<f64>,
    /// The height taken where it is neither known nor can be estimated [m].
    pub assumed_scanner_height_m: f64,
    /// Worker threads; the result does not depend on it.
    pub threads: usize,
}

impl Default for ScoreConfig {
    fn default() -> Self {
        Self {
            theta_deg: 20.0,
            robot_height_m: 1.2,
            w_l: 0.66,
            w_g: 0.33,
            w_bl: 0.55,
            w_bg: 0.45,
            height_form: HeightForm::default(),
            obstacle_form: ObstacleForm::default(),
            scanner_height_m: None,
            assumed_scanner_height_m: 1.0,
            threads: 1,
        }
    }
}

/// Why a [`ScoreConfig`] or a [`ZoneConfig`](super::ZoneConfig) is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScoreConfigError {
    /// A value outside the range in which the formulas hold.
    #[error("{field} = {value}: allowed is {allowed}")]
    OutOfRange {
        /// The field's name.
        field: &'static str,
        /// What it was set to.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
}

/// Passes a finite value that is good, and names the field of one that is not.
pub(super) fn check(
    field: &'static str,
    value: f64,
    good: bool,
    allowed: &'static str,
) -> Result<(), ScoreConfigError> {
    if good && value.is_finite() { Ok(()) } else { Err(ScoreConfigError::OutOfRange { field, value, allowed }) }
}

impl ScoreConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ScoreConfigError::OutOfRange`] names the first field outside its range.
    pub fn validate(&self) -> Result<(), ScoreConfigError> {
        let theta = self.theta_deg;
        check("theta_deg", theta, (1.0..=60.0).contains(&theta), "1 to 60")?;
        check("robot_height_m", self.robot_height_m, self.robot_height_m > 0.0, "> 0")?;
        for (field, weight) in [("w_l", self.w_l), ("w_g", self.w_g), ("w_bl", self.w_bl), ("w_bg", self.w_bg)] {
            check(field, weight, (0.0..=1.0).contains(&weight), "0 to 1")?;
        }
        check("w_g", self.w_g, self.w_l + self.w_g <= 1.0 + 1e-9, "at most 1 - w_l")?;
        check("w_bg", self.w_bg, self.w_bl + self.w_bg <= 1.0 + 1e-9, "at most 1 - w_bl")?;
        if let Some(height) = self.scanner_height_m {
            check("scanner_height_m", height, height > 0.0, "> 0, or left out")?;
        }
        let assumed = self.assumed_scanner_height_m;
        check("assumed_scanner_height_m", assumed, assumed > 0.0, "> 0")?;
        let threads = u32::try_from(self.threads).map_or(f64::INFINITY, f64::from);
        check("threads", threads, (1..=256).contains(&self.threads), "1 to 256")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed_and_survive_a_file() {
        let config = ScoreConfig::default();
        assert_eq!(config.validate(), Ok(()));
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<ScoreConfig>(&text).unwrap(), config);
        let config: ScoreConfig = toml::from_str("obstacle_form = \"literal\"\nheight_form = \"gentle\"").unwrap();
        assert_eq!((config.obstacle_form, config.height_form), (ObstacleForm::Literal, HeightForm::Gentle));
        assert!(toml::from_str::<ScoreConfig>("theta = 20.0").is_err());
    }

    #[test]
    fn a_wrong_value_is_refused_by_name() {
        let config = ScoreConfig { theta_deg: 0.0, ..ScoreConfig::default() };
        assert!(config.validate().unwrap_err().to_string().contains("theta_deg = 0: allowed is 1 to 60"));
        for theta_deg in [90.0, -5.0, f64::NAN, f64::INFINITY] {
            let error = ScoreConfig { theta_deg, ..ScoreConfig::default() }.validate().unwrap_err();
            assert!(error.to_string().starts_with("theta_deg = "), "{error}");
        }
        let config = ScoreConfig { w_l: 0.9, w_g: 0.2, ..ScoreConfig::default() };
        assert!(config.validate().is_err());
        let config = ScoreConfig { scanner_height_m: Some(f64::NAN), ..ScoreConfig::default() };
        assert!(config.validate().is_err());
    }
}
