//! When localisation does not know where the robot is, why, and when that ends.

use std::fmt;

use super::config::LostConfig;

/// What the estimate is made from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// Inertial unit.
    Imu,
    /// Wheels.
    Wheels,
    /// Satellite receiver.
    Gnss,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Imu => "the inertial unit",
            Self::Wheels => "the wheels",
            Self::Gnss => "the satellite receiver",
        })
    }
}

/// Why localisation does not know where the robot is.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Lost {
    /// It leans farther than a robot on its wheels can. Ends when it is upright.
    #[error("the robot leans by {tilt_deg:.0} deg: it has tipped over")]
    Tipped {
        /// Between the robot's z axis and up [deg].
        tilt_deg: f64,
    },
    /// A sensor that the estimate cannot do without says nothing, or nothing that can be used. Ends when it speaks again.
    #[error("{source} has said nothing for {seconds:.2} s", source = .sensor)]
    Silent {
        /// Which.
        sensor: Source,
        /// For how long [s].
        seconds: f64,
    },
    /// A sensor contradicts the estimate all the time. Ends when it agrees again, or when a scan is aligned.
    #[error("{source} has contradicted the estimate for {seconds:.0} s", source = .sensor)]
    Contradicted {
        /// Which.
        sensor: Source,
        /// For how long [s].
        seconds: f64,
    },
    /// The position could be anywhere. Ends when it is known better, at the latest with the next aligned scan.
    #[error("the position is known to {sigma_m:.1} m only")]
    Position {
        /// Standard deviation of the worse horizontal direction [m].
        sigma_m: f64,
    },
    /// The heading could be anything. Ends as that of the position.
    #[error("the heading is known to {sigma_deg:.0} deg only")]
    Heading {
        /// Standard deviation [deg].
        sigma_deg: f64,
    },
}

/// Since when a sensor contradicts.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Quarrel {
    since_ns: Option<i64>,
}

impl Quarrel {
    pub fn note(&mut self, stamp_ns: i64, agrees: bool) {
        self.since_ns = if agrees { None } else { self.since_ns.or(Some(stamp_ns)) };
    }

    pub fn seconds(&self, now_ns: i64) -> f64 {
        self.since_ns.map_or(0.0, |since| now_ns.saturating_sub(since) as f64 * 1e-9)
    }
}

/// What is looked at to tell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Signs {
    pub tilt: f64,
    pub position_sigma: f64,
    pub yaw_sigma: f64,
    /// Seconds since each has said something.
    pub silent: [(Source, f64); 2],
    /// Seconds for which each has contradicted.
    pub contradicted: [(Source, f64); 2],
}

/// The gravest reason there is.
pub(super) fn judge(signs: &Signs, config: &LostConfig) -> Option<Lost> {
    if signs.tilt.to_degrees() > config.tipped_deg {
        return Some(Lost::Tipped { tilt_deg: signs.tilt.to_degrees() });
    }
    if let Some(&(sensor, seconds)) = signs.silent.iter().find(|(_, seconds)| *seconds > config.silence_s) {
        return Some(Lost::Silent { sensor, seconds });
    }
    if let Some(&(sensor, seconds)) = signs.contradicted.iter().find(|(_, seconds)| *seconds > config.contradiction_s) {
        return Some(Lost::Contradicted { sensor, seconds });
    }
    if signs.position_sigma > config.position_sigma_m {
        return Some(Lost::Position { sigma_m: signs.position_sigma });
    }
    let sigma_deg = signs.yaw_sigma.to_degrees();
    (sigma_deg > config.yaw_sigma_deg).then_some(Lost::Heading { sigma_deg })
}
