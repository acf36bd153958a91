//! The settings of meshing and quality.

use serde::{Deserialize, Serialize};

use super::neighbours::NEIGHBOURS_MAX;

/// How a scan becomes a surface. The defaults are the calibrated ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceConfig {
    /// Returns nearer than this are no part of the surface [m].
    pub range_min_m: f64,
    /// Half width of the noise filter on the surface [m]; 0 switches it off.
    pub filter_radius_m: f64,
    /// Most cells to each side the noise filter takes.
    pub filter_cells_max: usize,
    /// A pair enters the filter only if its mean continues the point's range within this [m].
    pub filter_residual_max_m: f64,
    /// A pair enters the filter only if its two ranges differ by less than this [m] ...
    pub filter_jump_m: f64,
    /// ... or by less than this share of the range, whichever is larger.
    pub filter_jump_share: f64,
    /// A grid leg up to this gamma (3.1; 1 / sine of the incidence) follows a surface.
    pub gamma_max: f64,
    /// Up to this gamma it does if it goes on as its neighbours, or as level ground would.
    pub gamma_grazing_max: f64,
    /// How much steeper in 1/range than an adjacent leg a grazing leg may be.
    pub slope_ratio_max: f64,
    /// A grazing leg down the ground may have up to this over the sine of its depression.
    pub ground_gamma_factor: f64,
    /// Two rays of the grid farther apart than this are not neighbours [deg].
    pub step_max_deg: f64,
    /// A_max, the share of the surface up to which a point has full area quality [m^2] (3.23); see
    /// [`area_limit`](super::area_limit) for (3.24).
    pub area_max_m2: f64,
    /// w_a, weight of the area quality (3.27).
    pub w_a: f64,
    /// w_n, weight of the incidence quality (3.27).
    pub w_n: f64,
    /// Neighbours of a point in a scan without an order.
    pub neighbours: usize,
    /// How far they may be at the scanner [m] ...
    pub neighbour_radius_m: f64,
    /// ... and how much farther for each metre of range [m/m].
    pub neighbour_radius_per_m: f64,
    /// Worker threads; the result does not depend on it.
    pub threads: usize,
}

impl Default for SurfaceConfig {
    fn default() -> Self {
        Self {
            range_min_m: 0.05,
            filter_radius_m: 0.08,
            filter_cells_max: 8,
            filter_residual_max_m: 0.05,
            filter_jump_m: 0.3,
            filter_jump_share: 0.5,
            gamma_max: 8.0,
            gamma_grazing_max: 40.0,
            slope_ratio_max: 1.5,
            ground_gamma_factor: 1.5,
            step_max_deg: 6.0,
            area_max_m2: 0.0025,
            w_a: 0.93,
            w_n: 0.07,
            neighbours: 10,
            neighbour_radius_m: 0.2,
            neighbour_radius_per_m: 0.05,
            threads: 1,
        }
    }
}

/// Why a [`SurfaceConfig`] is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SurfaceConfigError {
    /// A value outside the range in which the formulas hold.
    #[error("surface.{field} = {value}: allowed is {allowed}")]
    OutOfRange {
        /// The field's name.
        field: &'static str,
        /// What it was set to.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
}

impl SurfaceConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// [`SurfaceConfigError::OutOfRange`] names the first field outside its range.
    pub fn validate(&self) -> Result<(), SurfaceConfigError> {
        let check = |field, value: f64, good: bool, allowed| {
            if good && value.is_finite() {
                Ok(())
            } else {
                Err(SurfaceConfigError::OutOfRange { field, value, allowed })
            }
        };
        let count = |n: usize| u32::try_from(n).map_or(f64::INFINITY, f64::from);
        check("range_min_m", self.range_min_m, self.range_min_m > 0.0, "> 0")?;
        check("filter_radius_m", self.filter_radius_m, self.filter_radius_m >= 0.0, ">= 0")?;
        check("filter_cells_max", count(self.filter_cells_max), self.filter_cells_max <= 64, "0 to 64")?;
        check("filter_residual_max_m", self.filter_residual_max_m, self.filter_residual_max_m > 0.0, "> 0")?;
        check("filter_jump_m", self.filter_jump_m, self.filter_jump_m > 0.0, "> 0")?;
        check("filter_jump_share", self.filter_jump_share, self.filter_jump_share >= 0.0, ">= 0")?;
        check("gamma_max", self.gamma_max, self.gamma_max >= 1.0, ">= 1")?;
        let grazing = self.gamma_grazing_max;
        check("gamma_grazing_max", grazing, grazing >= self.gamma_max, ">= gamma_max")?;
        check("slope_ratio_max", self.slope_ratio_max, self.slope_ratio_max >= 1.0, ">= 1")?;
        check("ground_gamma_factor", self.ground_gamma_factor, self.ground_gamma_factor >= 0.0, ">= 0")?;
        let step = self.step_max_deg;
        check("step_max_deg", step, step > 0.0 && step <= 45.0, "above 0, at most 45")?;
        check("area_max_m2", self.area_max_m2, self.area_max_m2 > 0.0, "> 0")?;
        check("w_a", self.w_a, self.w_a >= 0.0, ">= 0")?;
        check("w_n", self.w_n, self.w_n >= 0.0 && self.w_a + self.w_n > 0.0, ">= 0, and not both weights 0")?;
        let k = self.neighbours;
        check("neighbours", count(k), (3..=NEIGHBOURS_MAX).contains(&k), "3 to 12")?;
        check("neighbour_radius_m", self.neighbour_radius_m, self.neighbour_radius_m > 0.0, "> 0")?;
        check("neighbour_radius_per_m", self.neighbour_radius_per_m, self.neighbour_radius_per_m >= 0.0, ">= 0")?;
        check("threads", count(self.threads), (1..=256).contains(&self.threads), "1 to 256")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed_and_survive_a_file() {
        let config = SurfaceConfig::default();
        assert_eq!(config.validate(), Ok(()));
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<SurfaceConfig>(&text).unwrap(), config);
        assert!(toml::from_str::<SurfaceConfig>("gama_max = 8.0").is_err());
    }

    #[test]
    fn a_wrong_value_is_refused_by_name() {
        let config = SurfaceConfig { gamma_max: 0.5, ..SurfaceConfig::default() };
        assert!(config.validate().unwrap_err().to_string().contains("surface.gamma_max = 0.5: allowed is >= 1"));
        let config = SurfaceConfig { w_a: f64::NAN, ..SurfaceConfig::default() };
        assert!(config.validate().is_err());
        let config = SurfaceConfig { neighbours: 13, ..SurfaceConfig::default() };
        assert!(config.validate().is_err());
    }
}
