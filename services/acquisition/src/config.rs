//! Where scans come from.

use std::path::PathBuf;

use mirador_core::scan::Grid;
use mirador_core::simulation::ScannerConfig;
use serde::{Deserialize, Serialize};

/// Where scans come from, and at what pace.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct AcquisitionConfig {
    /// What delivers them.
    pub source: SourceKind,
    /// `replay`: a scan file, a folder of scans of one format, or a run.mcap.
    pub path: PathBuf,
    /// `replay`: a file with one prior pose (map_from_scanner) per scan, or a folder of .pose files; none when missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poses: Option<PathBuf>,
    /// `replay`: order of the points of files that state none, as "ROWSxCOLS".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid: Option<String>,
    /// Returns nearer than this hit the robot itself and are dropped [m].
    pub range_min_m: f32,
    /// Returns farther than this are dropped [m].
    pub range_max_m: f32,
    /// Drop the farthest range when very many points share it exactly: it is the sensor's code for "no return".
    pub drop_no_return_code: bool,
    /// `scene`: name of a built-in scene, or a scene file.
    pub scene: String,
    /// `scene` and `robot`: the scanner.
    pub scanner: ScannerConfig,
    /// `scene`: standard deviation of the odometry that serves as prior [m of every m driven].
    pub odometry_noise: f64,
    /// `scene`: standard deviation of its heading [deg a scan].
    pub odometry_noise_deg: f64,
    /// `scene`: how often the tour of the scene's poses is made.
    pub rounds: u32,
    /// `robot`: a scan with more than this share of its sweeps missing is taken again, twice at most.
    pub missing_max: f64,
    /// What noise is drawn from.
    pub seed: u64,
    /// Release scans by their time at this multiple of real time; 0 releases each when the last one is finished.
    pub speed: f64,
    /// Stop after this many scans; 0 for all.
    pub max_scans: u32,
    /// Services that must be there before the first scan is released and have finished the last one before the run
    /// ends; without a speed also each scan before the next is released (set by the supervisor).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lockstep_with: Vec<String>,
}

/// What delivers scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SourceKind {
    /// Files or a recording.
    Replay,
    /// The ray-cast scanner in a scene.
    Scene,
    /// Sweeps and encoder of a robot's turning laser.
    Robot,
}

impl Default for AcquisitionConfig {
    fn default() -> Self {
        Self {
            source: SourceKind::Scene,
            path: PathBuf::new(),
            poses: None,
            grid: None,
            range_min_m: 0.25,
            range_max_m: 200.0,
            drop_no_return_code: true,
            scene: "simple".into(),
            scanner: ScannerConfig::default(),
            odometry_noise: 0.02,
            odometry_noise_deg: 1.0,
            rounds: 1,
            missing_max: 0.1,
            seed: 1,
            speed: 0.0,
            max_scans: 0,
            lockstep_with: Vec::new(),
        }
    }
}

/// A value of the table `acquisition` is wrong.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// A number is outside its range.
    #[error("acquisition.{field} = {value} is out of range: {allowed}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        allowed: &'static str,
    },
    /// The grid is not of the form ROWSxCOLS.
    #[error("acquisition.grid = '{0}' is not ROWSxCOLS, for example 226x360")]
    BadGrid(String),
    /// The scanner cannot be had.
    #[error("acquisition.{0}")]
    Scanner(String),
}

impl AcquisitionConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first one that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let checks = [
            ("range_min_m", f64::from(self.range_min_m), self.range_min_m >= 0.0, "0 or more"),
            (
                "range_max_m",
                f64::from(self.range_max_m),
                self.range_max_m > self.range_min_m,
                "greater than acquisition.range_min_m",
            ),
            ("odometry_noise", self.odometry_noise, (0.0..=1.0).contains(&self.odometry_noise), "0 to 1"),
            (
                "odometry_noise_deg",
                self.odometry_noise_deg,
                (0.0..=180.0).contains(&self.odometry_noise_deg),
                "0 to 180",
            ),
            ("rounds", f64::from(self.rounds), (1..=10_000).contains(&self.rounds), "1 to 10000"),
            ("missing_max", self.missing_max, (0.0..=1.0).contains(&self.missing_max), "0 to 1"),
            ("speed", self.speed, (0.0..=1e6).contains(&self.speed), "0 (lockstep) to 1000000"),
        ];
        for (field, value, right, allowed) in checks {
            if !right {
                return Err(ConfigError::OutOfRange { field, value, allowed });
            }
        }
        if let Some(grid) = &self.grid {
            parse_grid(grid)?;
        }
        self.scanner.validate().map_err(|e| ConfigError::Scanner(e.to_string()))
    }
}

/// Reads "ROWSxCOLS".
///
/// # Errors
/// [`ConfigError::BadGrid`].
pub fn parse_grid(text: &str) -> Result<Grid, ConfigError> {
    let bad = || ConfigError::BadGrid(text.into());
    let (rows, cols) = text.split_once(['x', 'X']).ok_or_else(bad)?;
    let number = |t: &str| t.trim().parse::<usize>().ok().filter(|n| (1..=1_000_000).contains(n)).ok_or_else(bad);
    Ok(Grid { rows: number(rows)?, cols: number(cols)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid() {
        AcquisitionConfig::default().validate().unwrap();
    }

    #[test]
    fn a_grid_is_rows_by_columns() {
        assert_eq!(parse_grid("226x360").unwrap(), Grid { rows: 226, cols: 360 });
        for bad in ["", "226", "226x", "0x5", "-1x5", "axb", "5x99999999999999999999"] {
            assert!(parse_grid(bad).unwrap_err().to_string().contains("ROWSxCOLS"), "{bad}");
        }
    }

    #[test]
    fn a_range_the_wrong_way_round_is_named() {
        let config = AcquisitionConfig { range_min_m: 5.0, range_max_m: 2.0, ..AcquisitionConfig::default() };
        assert!(config.validate().unwrap_err().to_string().contains("range_max_m"));
    }
}
