//! Settings of navigation.

use serde::{Deserialize, Serialize};

use crate::registration::ConfigError;

/// How the robot follows a path, what it stops for, and how an exploration goes on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NavigationConfig {
    /// A scan's plan is driven only after alignment has said what came of older scans (`loop_closing`).
    pub await_corrections: bool,
    /// A control step is not answered until the plan of a finished scan is there, so that planning takes no simulated
    /// time; otherwise the robot stands meanwhile.
    pub is_lockstep: bool,
    /// After so many targets given up in a row the robot stops for good, 1 to 1,000.
    pub max_give_ups: u32,
    /// A command ends after this time [ms], 20 to 10,000.
    pub command_valid_ms: u32,
    /// How a path is followed.
    pub follow: FollowConfig,
    /// The body, and what it stops for.
    pub obstacles: ObstacleConfig,
    /// What is done when it gets no further.
    pub recovery: RecoveryConfig,
    /// What is expected of the sensors.
    pub watch: WatchConfig,
}

impl Default for NavigationConfig {
    fn default() -> Self {
        Self {
            await_corrections: true,
            is_lockstep: true,
            max_give_ups: 5,
            command_valid_ms: 200,
            follow: FollowConfig::default(),
            obstacles: ObstacleConfig::default(),
            recovery: RecoveryConfig::default(),
            watch: WatchConfig::default(),
        }
    }
}

/// Regulated pure pursuit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FollowConfig {
    /// Fastest forward speed [m/s], 0.05 to 3.
    pub max_speed: f64,
    /// Slowest forward speed while driving [m/s], 0.01 to 1.
    pub min_speed: f64,
    /// Fastest turning speed [rad/s], 0.05 to 3.
    pub max_turn: f64,
    /// Acceleration and braking [m/s^2], 0.05 to 5.
    pub acceleration: f64,
    /// The point aimed at is as far ahead as the robot drives in this time [s], 0.1 to 5.
    pub lookahead_s: f64,
    /// Nearest and farthest point aimed at [m], each 0.1 to 5.
    pub lookahead_m: [f64; 2],
    /// Where the path bends by more than this the robot goes to the bend and turns there [deg], 5 to 170.
    pub turn_in_place_deg: f64,
    /// It has turned when it heads within this of the way on [deg], 1 to 45.
    pub turned_deg: f64,
    /// Curves tighter than this are driven more slowly [m], 0.1 to 10.
    pub slow_radius_m: f64,
    /// A robot that leans so far drives at half the speed [deg], 1 to 60.
    pub slow_tilt_deg: f64,
    /// The target is reached within this distance [m], 0.05 to 2.
    pub goal_tolerance_m: f64,
    /// Farther from the path than this the target is given up [m], 0.2 to 5.
    pub off_path_m: f64,
    /// A robot that leans farther than this stops [deg], 5 to 60.
    pub max_tilt_deg: f64,
    /// The target is given up after this time for each metre of the path, and as much again as for five metres [s/m], 1 to
    /// 1,000.
    pub patience_s_per_m: f64,
}

impl Default for FollowConfig {
    fn default() -> Self {
        Self {
            max_speed: 0.6,
            min_speed: 0.08,
            max_turn: 0.8,
            acceleration: 0.8,
            lookahead_s: 1.0,
            lookahead_m: [0.3, 0.5],
            turn_in_place_deg: 25.0,
            turned_deg: 5.0,
            slow_radius_m: 0.9,
            slow_tilt_deg: 20.0,
            goal_tolerance_m: 0.2,
            off_path_m: 0.6,
            max_tilt_deg: 35.0,
            patience_s_per_m: 12.0,
        }
    }
}

/// The body, and what it stops for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObstacleConfig {
    /// From the robot's middle to its front and back [m], 0.05 to 5.
    pub half_length_m: f64,
    /// From the robot's middle to its sides [m], 0.05 to 5.
    pub half_width_m: f64,
    /// Kept free on both sides of the body [m], 0 to 1.
    pub side_margin_m: f64,
    /// The robot stops with this between its front and the obstacle [m], 0.05 to 2.
    pub stop_gap_m: f64,
    /// From this distance to an obstacle on it drives more slowly [m], 0.1 to 10.
    pub slow_gap_m: f64,
    /// From the robot's middle to where its front wheels touch the ground [m], 0 to 5.
    pub axle_m: f64,
    /// The steepest slope, against that the robot stands on, that may begin before its wheels [deg], 5 to 60: what rises
    /// less is ground.
    pub steepest_deg: f64,
    /// A ranger's ground reading this much longer than on level ground may be an edge, 1.1 to 10 times.
    pub drop_ratio: f64,
    /// After so far with such readings it is taken for one [m], 0.05 to 0.5.
    pub drop_m: f64,
    /// What was seen is kept for so long [s], 0.1 to 10.
    pub keep_s: f64,
}

impl Default for ObstacleConfig {
    fn default() -> Self {
        Self {
            half_length_m: 0.52,
            half_width_m: 0.425,
            side_margin_m: 0.06,
            stop_gap_m: 0.25,
            slow_gap_m: 1.2,
            axle_m: 0.345,
            steepest_deg: 32.0,
            drop_ratio: 1.6,
            drop_m: 0.3,
            keep_s: 1.0,
        }
    }
}

/// What is done when the robot gets no further.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecoveryConfig {
    /// Wheels that turn for so long without the robot getting on are stuck [s], 0.5 to 60.
    pub stuck_s: f64,
    /// It gets on when it moves or turns by at least this share of what is asked of it, 0.01 to 0.9.
    pub stuck_share: f64,
    /// It waits so long for an obstacle to go away [s], 0 to 600.
    pub blocked_s: f64,
    /// Then it goes back so far the way it came [m], 0 to 10.
    pub back_up_m: f64,
    /// At this speed [m/s], 0.02 to 1.
    pub back_up_speed: f64,
    /// After so many attempts the target is given up, 0 to 100.
    pub attempts: u32,
    /// Then the map is told to keep away from a disc of this radius where something held the robot [m], 0.05 to 2.
    pub obstruction_radius_m: f64,
}

impl Default for RecoveryConfig {
    fn default() -> Self {
        Self {
            stuck_s: 3.0,
            stuck_share: 0.2,
            blocked_s: 4.0,
            back_up_m: 0.6,
            back_up_speed: 0.2,
            attempts: 1,
            obstruction_radius_m: 0.3,
        }
    }
}

/// What is expected of the sensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WatchConfig {
    /// Whether the robot drives only with a front laser.
    pub needs_laser: bool,
    /// Whether the robot drives only with rangers.
    pub needs_rangers: bool,
    /// A sensor that says nothing for so long is silent [s], 0.1 to 1.
    pub silence_s: f64,
    /// More messages than this in a second are babble, 10 to 100,000.
    pub max_messages_per_s: u32,
    /// So long everything must be well before the robot goes on [s], 0 to 60.
    pub settle_s: f64,
    /// A target is given up when a sensor stays away for so long [s], 1 to 10,000.
    pub patience_s: f64,
}

impl Default for WatchConfig {
    fn default() -> Self {
        Self {
            needs_laser: true,
            needs_rangers: true,
            silence_s: 0.5,
            max_messages_per_s: 200,
            settle_s: 0.5,
            patience_s: 30.0,
        }
    }
}

impl NavigationConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first field that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), ConfigError> {
        for (field, value, least, most) in self.bounds() {
            ConfigError::check(field, value, least, most)?;
        }
        let [near, far] = self.follow.lookahead_m;
        ConfigError::check("follow.lookahead_m", near, 0.1, 5.0)?;
        ConfigError::check("follow.lookahead_m", far, near, 5.0)?;
        ConfigError::check("follow.min_speed", self.follow.min_speed, 0.01, self.follow.max_speed)?;
        ConfigError::check("obstacles.slow_gap_m", self.obstacles.slow_gap_m, self.obstacles.stop_gap_m, 10.0)
    }

    /// Every number: field, value, least, greatest.
    fn bounds(&self) -> impl Iterator<Item = (&'static str, f64, f64, f64)> {
        let (follow, obstacles) = (&self.follow, &self.obstacles);
        let (recovery, watch) = (&self.recovery, &self.watch);
        [
            ("max_give_ups", f64::from(self.max_give_ups), 1.0, 1e3),
            ("command_valid_ms", f64::from(self.command_valid_ms), 20.0, 1e4),
            ("follow.max_speed", follow.max_speed, 0.05, 3.0),
            ("follow.min_speed", follow.min_speed, 0.01, 1.0),
            ("follow.max_turn", follow.max_turn, 0.05, 3.0),
            ("follow.acceleration", follow.acceleration, 0.05, 5.0),
            ("follow.lookahead_s", follow.lookahead_s, 0.1, 5.0),
            ("follow.turn_in_place_deg", follow.turn_in_place_deg, 5.0, 170.0),
            ("follow.turned_deg", follow.turned_deg, 1.0, 45.0),
            ("follow.slow_radius_m", follow.slow_radius_m, 0.1, 10.0),
            ("follow.slow_tilt_deg", follow.slow_tilt_deg, 1.0, 60.0),
            ("follow.goal_tolerance_m", follow.goal_tolerance_m, 0.05, 2.0),
            ("follow.off_path_m", follow.off_path_m, 0.2, 5.0),
            ("follow.max_tilt_deg", follow.max_tilt_deg, 5.0, 60.0),
            ("follow.patience_s_per_m", follow.patience_s_per_m, 1.0, 1e3),
            ("obstacles.half_length_m", obstacles.half_length_m, 0.05, 5.0),
            ("obstacles.half_width_m", obstacles.half_width_m, 0.05, 5.0),
            ("obstacles.side_margin_m", obstacles.side_margin_m, 0.0, 1.0),
            ("obstacles.stop_gap_m", obstacles.stop_gap_m, 0.05, 2.0),
            ("obstacles.slow_gap_m", obstacles.slow_gap_m, 0.1, 10.0),
            ("obstacles.axle_m", obstacles.axle_m, 0.0, 5.0),
            ("obstacles.steepest_deg", obstacles.steepest_deg, 5.0, 60.0),
            ("obstacles.drop_ratio", obstacles.drop_ratio, 1.1, 10.0),
            ("obstacles.drop_m", obstacles.drop_m, 0.05, 0.5),
            ("obstacles.keep_s", obstacles.keep_s, 0.1, 10.0),
            ("recovery.stuck_s", recovery.stuck_s, 0.5, 60.0),
            ("recovery.stuck_share", recovery.stuck_share, 0.01, 0.9),
            ("recovery.blocked_s", recovery.blocked_s, 0.0, 600.0),
            ("recovery.back_up_m", recovery.back_up_m, 0.0, 10.0),
            ("recovery.back_up_speed", recovery.back_up_speed, 0.02, 1.0),
            ("recovery.obstruction_radius_m", recovery.obstruction_radius_m, 0.05, 2.0),
            ("recovery.attempts", f64::from(recovery.attempts), 0.0, 100.0),
            ("watch.silence_s", watch.silence_s, 0.1, 1.0),
            ("watch.max_messages_per_s", f64::from(watch.max_messages_per_s), 10.0, 1e5),
            ("watch.settle_s", watch.settle_s, 0.0, 60.0),
            ("watch.patience_s", watch.patience_s, 1.0, 1e4),
        ]
        .into_iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid() {
        NavigationConfig::default().validate().unwrap();
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        let mut config = NavigationConfig::default();
        config.follow.lookahead_m = [0.5, 0.4];
        assert!(config.validate().unwrap_err().to_string().starts_with("follow.lookahead_m = 0.4 is out of range"));
    }

    #[test]
    fn a_misspelt_key_is_refused() {
        let error = toml::from_str::<NavigationConfig>("max_give_up = 3").unwrap_err().to_string();
        assert!(error.contains("max_give_up"), "{error}");
    }
}
