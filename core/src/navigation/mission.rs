//! From scan to scan: request, wait for the plan, drive there, request the next.

use super::config::NavigationConfig;
use super::drive::{Drive, DriveState, RobotNow};
use super::driver::Driver;
use super::give_up::GiveUp;
use super::obstacles::{Echo, LaserView, Surroundings};
use super::path::Path;
use super::watch::{SensorFault, Watch, WatchCounters};
use crate::geometry::Pose;
use crate::information_map::Obstruction;

/// A scan that was asked for and does not begin is asked for again after this time [s].
const ASK_AGAIN_S: f64 = 5.0;
/// The robot has stood for so long before a scan is asked for [s]: braking, and rocking on its wheels after it, would distort
/// the scan. It stands below this speed [m/s] and while it turns and tilts by no more than this [rad], or is taken to after this
/// time [s].
const STAND_S: f64 = 1.0;
const STANDING: f64 = 0.02;
const STANDING_TURN: f64 = 2.5e-3;
const LONGEST_STAND_S: f64 = 3.0;

/// What a view plan decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// Go to the chosen view.
    Go,
    /// The exploration is over.
    Stop,
}

/// What the robot says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RobotWord {
    /// Whether the head turns for a scan.
    pub scanning: bool,
    /// Scans the head has turned for.
    pub scans: u32,
    /// Whether the emergency stop is pressed.
    pub emergency_stop: bool,
    /// Whether it lies on its side.
    pub tipped: bool,
}

/// Where the mission is.
#[derive(Debug, Clone, PartialEq)]
pub enum MissionState {
    /// Nothing is known of the robot yet.
    Begin,
    /// The robot comes to rest where it will take this scan.
    Settling {
        /// Which.
        scan: u32,
    },
    /// The head turns, or will, for this scan.
    Scanning {
        /// Which.
        scan: u32,
    },
    /// The scan is taken; its plan is awaited.
    Planning {
        /// Which.
        scan: u32,
    },
    /// On the way to the view chosen after this scan.
    Driving {
        /// Which.
        scan: u32,
    },
    /// Over, for good.
    Ended {
        /// Why.
        reason: String,
        /// Whether that is a fault.
        is_fault: bool,
    },
}

/// What to do at a control step.
#[derive(Debug, Clone, PartialEq)]
pub enum MissionStep {
    /// Not to be answered yet: the plan is awaited, and must take no time.
    Wait,
    /// Forward [m/s] and turning speed [rad/s], and the scan to ask for, if one.
    Answer {
        /// Forward speed [m/s].
        linear: f64,
        /// Turning speed about z [rad/s].
        angular: f64,
        /// Number of the scan to be asked for.
        request: Option<u32>,
    },
}

/// What is known of the plan of a scan.
#[derive(Debug, Clone, Default)]
struct Planned {
    decision: Option<(u32, Decision, String)>,
    path: Option<(u32, Vec<[f64; 3]>)>,
    corrected: Option<u32>,
    /// By what the map has moved where a scan was taken, since its path was planned.
    moved: Option<(u32, Pose)>,
}

/// Keeps the exploration going.
#[derive(Debug, Clone)]
pub struct Mission {
    config: NavigationConfig,
    state: MissionState,
    around: Surroundings,
    watch: Watch,
    word: Option<RobotWord>,
    planned: Planned,
    driver: Option<Driver>,
    fault: Option<SensorFault>,
    asked_ns: i64,
    has_turned: bool,
    /// Since when the robot is to stand, and does.
    settling_ns: i64,
    standing_ns: i64,
    /// How it stood then.
    standing: Pose,
    /// Scans whose plans have been taken.
    planned_scans: u32,
    give_ups: u32,
    last_give_up: Option<GiveUp>,
    battery_low: bool,
}

impl Mission {
    /// A mission at its beginning; the config must be valid.
    #[must_use]
    pub fn new(config: NavigationConfig) -> Self {
        Self {
            config,
            state: MissionState::Begin,
            around: Surroundings::default(),
            watch: Watch::default(),
            word: None,
            planned: Planned::default(),
            driver: None,
            fault: None,
            asked_ns: 0,
            has_turned: false,
            settling_ns: 0,
            standing_ns: 0,
            standing: Pose::identity(),
            planned_scans: 0,
            give_ups: 0,
            last_give_up: None,
            battery_low: false,
        }
    }

    /// How many scans it has taken the plans of: every scan below is done for navigation.
    #[must_use]
    pub fn planned_scans(&self) -> u32 {
        self.planned_scans
    }

    /// Where the mission is.
    #[must_use]
    pub fn state(&self) -> &MissionState {
        &self.state
    }

    /// Who drives, while someone drives or has just done so.
    #[must_use]
    pub fn driver(&self) -> Option<&Driver> {
        self.driver.as_ref()
    }

    /// Why the last target was given up, if it was.
    #[must_use]
    pub fn last_give_up(&self) -> Option<GiveUp> {
        self.last_give_up
    }

    /// Where something held the robot since this was asked last.
    pub fn take_obstruction(&mut self) -> Option<Obstruction> {
        self.driver.as_mut().and_then(Driver::take_obstruction)
    }

    /// What is wrong with a sensor now.
    #[must_use]
    pub fn fault(&self) -> Option<SensorFault> {
        self.fault
    }

    /// What was taken and refused of the sensors.
    #[must_use]
    pub fn counters(&self) -> WatchCounters {
        self.watch.counters
    }

    /// A sweep of the front laser.
    pub fn laser(&mut self, view: &LaserView<'_>) {
        if self.watch.laser(view) {
            self.around.laser(view);
        }
    }

    /// An echo of a ranger.
    pub fn echo(&mut self, echo: Echo) {
        if self.watch.echo(&echo) {
            self.around.echo(echo);
        }
    }

    /// What the robot says of itself.
    pub fn robot(&mut self, word: RobotWord) {
        self.word = Some(word);
    }

    /// Whether the battery is so low that the robot must stop.
    pub fn battery(&mut self, is_low: bool) {
        self.battery_low = is_low;
    }

    /// The decision after a scan, with its reason.
    pub fn plan(&mut self, scan: u32, decision: Decision, reason: &str) {
        self.planned.decision = Some((scan, decision, reason.to_owned()));
    }

    /// The path to the view chosen after a scan [m, map frame].
    pub fn path(&mut self, scan: u32, waypoints: Vec<[f64; 3]>) {
        self.planned.path = Some((scan, waypoints));
    }

    /// The pose of a scan was corrected after the path from it was planned: `new_from_old` moves the map there. The path moves
    /// along, as the estimate of the robot's pose does.
    pub fn moved(&mut self, scan: u32, new_from_old: &Pose) {
        match (&self.state, &mut self.driver) {
            (MissionState::Driving { scan: of }, Some(driver)) if *of == scan => driver.move_path(new_from_old),
            _ => {
                // It may be corrected more than once before the path is taken.
                let before = self.planned.moved.filter(|(of, _)| *of == scan).map_or_else(Pose::identity, |(_, by)| by);
                self.planned.moved = Some((scan, new_from_old * before));
            }
        }
    }

    /// Alignment has said what came of older scans after a scan.
    pub fn corrected(&mut self, scan: u32) {
        self.planned.corrected = Some(scan);
    }

    /// One control step.
    pub fn step(&mut self, now: &RobotNow) -> MissionStep {
        self.fault = self.watch.check(now.stamp_ns, &self.config.watch);
        let Some(word) = self.word else { return stand(None) };
        match self.state.clone() {
            MissionState::Begin => self.begin(now, &word),
            MissionState::Settling { scan } => self.settle(now, scan),
            MissionState::Scanning { scan } => self.scan(now, &word, scan),
            MissionState::Planning { scan } => self.await_plan(now, scan),
            MissionState::Driving { scan } => self.drive(now, &word, scan),
            MissionState::Ended { .. } => stand(None),
        }
    }

    /// The first scan; after a restart what the robot has done already is not asked for again.
    fn begin(&mut self, now: &RobotNow, word: &RobotWord) -> MissionStep {
        if word.scanning {
            self.has_turned = true;
            self.state = MissionState::Scanning { scan: word.scans.saturating_sub(1) };
            return stand(None);
        }
        if word.scans > 0 {
            self.state = MissionState::Planning { scan: word.scans - 1 };
            return self.await_plan(now, word.scans - 1);
        }
        self.come_to_rest(now, 0)
    }

    fn come_to_rest(&mut self, now: &RobotNow, scan: u32) -> MissionStep {
        (self.settling_ns, self.standing_ns, self.standing) = (now.stamp_ns, now.stamp_ns, now.map_from_robot);
        self.state = MissionState::Settling { scan };
        stand(None)
    }

    fn settle(&mut self, now: &RobotNow, scan: u32) -> MissionStep {
        let turned = self.standing.rotation.angle_to(&now.map_from_robot.rotation);
        if now.linear.abs() > STANDING || turned > STANDING_TURN {
            (self.standing_ns, self.standing) = (now.stamp_ns, now.map_from_robot);
        }
        let since = |then: i64| now.stamp_ns.saturating_sub(then) as f64 * 1e-9;
        if since(self.standing_ns) >= STAND_S || since(self.settling_ns) >= LONGEST_STAND_S {
            return self.ask(now, scan);
        }
        stand(None)
    }

    fn ask(&mut self, now: &RobotNow, scan: u32) -> MissionStep {
        (self.asked_ns, self.has_turned) = (now.stamp_ns, false);
        self.state = MissionState::Scanning { scan };
        stand(Some(scan))
    }

    fn scan(&mut self, now: &RobotNow, word: &RobotWord, scan: u32) -> MissionStep {
        self.has_turned |= word.scanning;
        if !word.scanning && word.scans > scan {
            self.state = MissionState::Planning { scan };
            return self.await_plan(now, scan);
        }
        let waited = now.stamp_ns.saturating_sub(self.asked_ns) as f64 * 1e-9;
        if !self.has_turned && waited > ASK_AGAIN_S {
            return self.ask(now, scan);
        }
        stand(None)
    }

    fn await_plan(&mut self, now: &RobotNow, scan: u32) -> MissionStep {
        let not_yet = if self.config.is_lockstep { MissionStep::Wait } else { stand(None) };
        let of_scan = self.planned.decision.as_ref().filter(|(of, ..)| *of == scan);
        let Some((_, decision, reason)) = of_scan.cloned() else { return not_yet };
        if self.config.await_corrections && self.planned.corrected != Some(scan) {
            return not_yet;
        }
        if decision == Decision::Stop {
            self.planned_scans = scan.saturating_add(1);
            self.end(reason, false);
            return stand(None);
        }
        let Some((_, waypoints)) = self.planned.path.take_if(|(of, _)| *of == scan) else { return not_yet };
        (self.last_give_up, self.planned_scans) = (None, scan.saturating_add(1));
        match Path::new(&waypoints) {
            Ok(path) => {
                let mut driver = Driver::after(self.driver.as_ref(), path);
                if let Some((_, new_from_old)) = self.planned.moved.take_if(|(of, _)| *of == scan) {
                    driver.move_path(&new_from_old);
                }
                self.driver = Some(driver);
                self.state = MissionState::Driving { scan };
                // The pose at hand is older than the alignment of the scan, by which it may be a good way off the path that
                // begins at the aligned one; the next step's is not.
                stand(None)
            }
            Err(error) => self.gave_up(now, scan, GiveUp::NoPath(error)),
        }
    }

    fn drive(&mut self, now: &RobotNow, word: &RobotWord, scan: u32) -> MissionStep {
        let held = self.battery_low || word.emergency_stop || word.tipped;
        let Some(driver) = self.driver.as_mut().filter(|_| !held) else { return stand(None) };
        let Drive { linear, angular, state, .. } = driver.step(now, &self.around, self.fault, &self.config);
        match state {
            DriveState::Arrived => {
                self.give_ups = 0;
                self.come_to_rest(now, scan.saturating_add(1))
            }
            DriveState::GaveUp(reason) => self.gave_up(now, scan, reason),
            _ => MissionStep::Answer { linear, angular, request: None },
        }
    }

    /// Takes a scan where it stands, so that the map learns why; not for ever.
    fn gave_up(&mut self, now: &RobotNow, scan: u32, reason: GiveUp) -> MissionStep {
        self.give_ups += 1;
        self.last_give_up = Some(reason);
        if self.give_ups >= self.config.max_give_ups {
            self.end(format!("{} targets given up in a row; the last: {reason}", self.give_ups), true);
            return stand(None);
        }
        self.come_to_rest(now, scan.saturating_add(1))
    }

    fn end(&mut self, reason: String, is_fault: bool) {
        self.state = MissionState::Ended { reason, is_fault };
    }
}

fn stand(request: Option<u32>) -> MissionStep {
    MissionStep::Answer { linear: 0.0, angular: 0.0, request }
}

#[cfg(test)]
#[path = "mission_tests.rs"]
mod tests;
