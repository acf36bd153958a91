//! The topics and the one table of their delivery rules.
//!
//! Memory of a publisher is `slot size x (subscribers x (buffer + borrowed) + history + loaned)`, so the numbers are
//! small where the items are clouds. `Lag` says what happens to a reader that does not keep up.

use Capacity::{Fixed, Keyframes, Scan as ScanCells};

use crate::layout::Record;
use crate::messages::{self as m, Meta};

/// A topic: its meta part, its items, its delivery rules.
pub trait Topic: 'static {
    /// The meta part of a message.
    type Meta: Meta;
    /// What a message is a slice of.
    type Item: Record;
    /// How messages are delivered.
    const RULES: Rules;
}

/// What happens when a reader does not keep up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lag {
    /// The oldest message is replaced; the reader counts the gap.
    DropOldest,
    /// The oldest message is replaced, and nobody misses it: every message says all that those before it said.
    Supersede,
    /// The publisher waits up to its back-pressure limit, then reports that it could not deliver.
    Wait,
}

/// The most items a message of the topic may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Capacity {
    /// The same for every graph.
    Fixed(usize),
    /// As many as the largest scan has cells.
    Scan,
    /// As many as two keyframes can have points.
    Keyframes,
}

/// Delivery rules of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rules {
    /// Name of the topic, and of its iceoryx2 service.
    pub name: &'static str,
    /// Who publishes it in the standard graph; empty when every service does.
    pub publisher: &'static str,
    /// Most publishers.
    pub publishers: usize,
    /// Most subscribers.
    pub subscribers: usize,
    /// Messages that wait for a reader.
    pub buffer: usize,
    /// Messages a reader may hold at a time.
    pub borrowed: usize,
    /// Messages a late joiner gets.
    pub history: usize,
    /// Messages a publisher may write at a time.
    pub loaned: usize,
    /// What happens to a reader that lags.
    pub lag: Lag,
    /// Most items of a message.
    pub capacity: Capacity,
}

impl Rules {
    /// Slots a publisher reserves.
    #[must_use]
    pub const fn slots(&self) -> usize {
        self.subscribers * (self.buffer + self.borrowed) + self.history + self.loaned
    }
}

/// The sizes of a graph that decide how large the slots are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sizes {
    /// Cells of the largest scan.
    pub scan_points: usize,
}

impl Sizes {
    /// The most items a message under `capacity` may have.
    #[must_use]
    pub fn items(&self, capacity: Capacity) -> usize {
        match capacity {
            Fixed(n) => n,
            ScanCells => self.scan_points.max(1),
            // A keyframe is a reduced scan, so two of them are never more than two scans.
            Keyframes => (2 * self.scan_points).clamp(1, 200_000),
        }
    }
}

const WAIT: Lag = Lag::Wait;
const DROP: Lag = Lag::DropOldest;
const LAST: Lag = Lag::Supersede;

macro_rules! topics {
    ($($(#[$doc:meta])* $topic:ident = $name:literal from $publisher:literal: $meta:ident [$item:ident; $capacity:expr],
       pub $p:literal sub $s:literal buffer $b:literal borrowed $w:literal history $h:literal loaned $l:literal $lag:ident;)*) => {
        $(
            $(#[$doc])*
            #[derive(Debug, Clone, Copy)]
            pub struct $topic;
            impl Topic for $topic {
                type Meta = m::$meta;
                type Item = m::$item;
                const RULES: Rules = Rules {
                    name: $name, publisher: $publisher, publishers: $p, subscribers: $s, buffer: $b, borrowed: $w,
                    history: $h, loaned: $l, lag: $lag, capacity: $capacity,
                };
            }
        )*

        /// A topic with the sizes of its parts, for tools that go through all of them.
        #[derive(Debug, Clone, Copy)]
        pub struct TopicInfo {
            /// Delivery rules.
            pub rules: Rules,
            /// Bytes of the meta part.
            pub meta_bytes: usize,
            /// Bytes of one item.
            pub item_bytes: usize,
            /// Writes the JSON description of meta and item.
            pub describe: fn() -> String,
        }

        /// Every topic, in the order of the data flow.
        pub const ALL: &[TopicInfo] = &[$(TopicInfo {
            rules: $topic::RULES,
            meta_bytes: size_of::<m::$meta>(),
            item_bytes: size_of::<m::$item>(),
            describe: describe::<$topic>,
        }),*];

        /// Calls `$visitor!(Topic)` for every topic: for code that must open each one with its own type.
        #[macro_export]
        macro_rules! for_each_topic {
            ($visitor:ident) => { $($visitor!($crate::topics::$topic);)* };
        }
    };
}

/// The 64-bit schema hash of a topic: two builds that agree on it agree on every field.
#[must_use]
pub fn schema_hash<T: Topic>() -> u64 {
    crate::layout::hash(&describe::<T>())
}

/// What an answer to a registration request says it was made with, see [`m::RegistrationResult`].
#[must_use]
pub fn registration_schema() -> u32 {
    (schema_hash::<RegistrationRequest>() ^ schema_hash::<RegistrationResult>()) as u32
}

/// The JSON description of a topic's message, and what its schema hash is made from.
#[must_use]
pub fn describe<T: Topic>() -> String {
    format!(
        "{{\"topic\":\"{}\",\"meta\":{},\"item\":{}}}",
        T::RULES.name,
        crate::layout::description::<T::Meta>(),
        crate::layout::description::<T::Item>()
    )
}

topics! {
    /// The step of the run; in lockstep it names the scan that is released.
    Clock = "clock" from "acquisition": ClockMeta [Nothing; Fixed(1)],
        pub 1 sub 12 buffer 16 borrowed 2 history 1 loaned 1 WAIT;
    /// Asks acquisition for a new scan or for an old one again.
    ScanRequests = "scan_request" from "": Envelope [ScanRequest; Fixed(16)],
        pub 8 sub 4 buffer 16 borrowed 2 history 0 loaned 1 WAIT;
    /// Sweeps of the turning laser. Their sender waits for a reader that lags: in lockstep time stands still meanwhile, and
    /// no sweep of a scan is lost.
    LaserSweep = "laser_sweep" from "simulator": LaserSweepMeta [Beam; Fixed(2048)],
        pub 2 sub 4 buffer 64 borrowed 4 history 0 loaned 2 WAIT;
    /// Angle of the turning head. As for the sweeps, its sender waits.
    Encoder = "encoder" from "simulator": Envelope [EncoderReading; Fixed(64)],
        pub 2 sub 4 buffer 128 borrowed 4 history 0 loaned 2 WAIT;
    /// Scans of fixed planar lasers, 2D.
    PlanarScan = "planar_scan" from "simulator": PlanarScanMeta [Beam; Fixed(2048)],
        pub 4 sub 6 buffer 16 borrowed 2 history 0 loaned 2 DROP;
    /// The cloud, written once.
    Scan = "scan" from "acquisition": ScanMeta [Point; ScanCells],
        pub 1 sub 6 buffer 2 borrowed 2 history 1 loaned 1 WAIT;
    /// The pose of a scan.
    Alignment = "alignment" from "alignment": AlignmentMeta [Hypothesis; Fixed(16)],
        pub 1 sub 8 buffer 8 borrowed 2 history 1 loaned 1 WAIT;
    /// Which older scans alignment registered the scan with, and what came of it. Before `pose_corrections`, so that a
    /// recorder that has this has them.
    LoopClosing = "loop_closing" from "alignment": LoopClosingMeta [ScanPair; Fixed(64)],
        pub 1 sub 6 buffer 8 borrowed 2 history 1 loaned 1 WAIT;
    /// Corrected poses of older scans.
    PoseCorrections = "pose_corrections" from "alignment": Envelope [PoseCorrection; Fixed(1024)],
        pub 1 sub 6 buffer 4 borrowed 2 history 4 loaned 1 WAIT;
    /// Work for a foreign registration: both keyframes, written once. Nobody waits for a reader that hangs.
    RegistrationRequest = "registration_request" from "alignment": RegistrationRequestMeta [KeyframePoint; Keyframes],
        pub 1 sub 3 buffer 1 borrowed 2 history 0 loaned 1 DROP;
    /// Its answer.
    RegistrationResult = "registration_result" from "": Envelope [RegistrationResult; Fixed(1)],
        pub 2 sub 3 buffer 4 borrowed 2 history 0 loaned 1 DROP;
    /// How it is doing.
    RegistrationStatus = "registration_status" from "alignment": Envelope [RegistrationStatus; Fixed(1)],
        pub 1 sub 6 buffer 4 borrowed 2 history 1 loaned 1 LAST;
    /// Scores of every point of a scan.
    ScoredScan = "scored_scan" from "analysis": ScoredScanMeta [PointScore; ScanCells],
        pub 1 sub 5 buffer 2 borrowed 2 history 1 loaned 1 WAIT;
    /// Occluded planes worth another look.
    Zones = "zones" from "analysis": Envelope [Zone; Fixed(4096)],
        pub 1 sub 5 buffer 4 borrowed 2 history 1 loaned 1 WAIT;
    /// Tiles of the information map that changed.
    InformationMap = "information_map" from "planning": MapMeta [MapTile; Fixed(192)],
        pub 1 sub 4 buffer 8 borrowed 2 history 1 loaned 1 WAIT;
    /// The decision and its candidates.
    ViewPlan = "view_plan" from "planning": ViewPlanMeta [CandidateView; Fixed(4096)],
        pub 1 sub 8 buffer 4 borrowed 2 history 1 loaned 1 WAIT;
    /// The path to the chosen view.
    Path = "path" from "planning": PathMeta [Waypoint; Fixed(4096)],
        pub 1 sub 6 buffer 4 borrowed 2 history 1 loaned 1 WAIT;
    /// Asks planning to decide again.
    ReplanRequests = "replan_request" from "": Envelope [ReplanRequest; Fixed(1)],
        pub 8 sub 4 buffer 8 borrowed 2 history 0 loaned 1 WAIT;
    /// Wheel odometry.
    Odometry = "odometry" from "simulator": Envelope [Odometry; Fixed(64)],
        pub 2 sub 6 buffer 64 borrowed 2 history 0 loaned 2 DROP;
    /// Inertial unit.
    Imu = "imu" from "simulator": Envelope [Imu; Fixed(64)],
        pub 2 sub 4 buffer 128 borrowed 2 history 0 loaned 2 DROP;
    /// Satellite position.
    Gnss = "gnss" from "simulator": Envelope [Gnss; Fixed(16)],
        pub 2 sub 4 buffer 16 borrowed 2 history 0 loaned 2 DROP;
    /// Magnetic field.
    Magnetometer = "magnetometer" from "simulator": Envelope [Magnetometer; Fixed(64)],
        pub 2 sub 4 buffer 64 borrowed 2 history 0 loaned 2 DROP;
    /// Ultrasonic rangers.
    Rangers = "rangers" from "simulator": Envelope [Ranger; Fixed(32)],
        pub 2 sub 4 buffer 32 borrowed 2 history 0 loaned 2 DROP;
    /// Battery.
    Battery = "battery" from "simulator": Envelope [Battery; Fixed(1)],
        pub 2 sub 4 buffer 4 borrowed 2 history 1 loaned 2 DROP;
    /// Where the robot is now. Simulated time runs at some hundred times the robot's, so a recorder that is busy for a moment
    /// finds many; those it missed would be missing in the track.
    RobotPoses = "robot_pose" from "localization": Envelope [RobotPose; Fixed(1)],
        pub 1 sub 6 buffer 256 borrowed 2 history 1 loaned 1 DROP;
    /// Estimated pose of the scanner in a scan: the prior of its alignment.
    Pose = "pose" from "acquisition": Envelope [PoseEstimate; Fixed(1)],
        pub 2 sub 8 buffer 16 borrowed 2 history 1 loaned 1 DROP;
    /// References for the drives.
    MotionCommand = "motion_command" from "navigation": Envelope [MotionCommand; Fixed(1)],
        pub 5 sub 4 buffer 8 borrowed 2 history 0 loaned 1 DROP;
    /// What navigation does.
    NavigationStatus = "navigation_status" from "navigation": Envelope [NavigationStatus; Fixed(1)],
        pub 1 sub 6 buffer 256 borrowed 2 history 1 loaned 1 DROP;
    /// Where something held the robot.
    Obstructions = "obstructions" from "navigation": Envelope [Obstruction; Fixed(1)],
        pub 1 sub 4 buffer 32 borrowed 2 history 32 loaned 1 WAIT;
    /// State of the robot as a whole.
    RobotState = "robot_state" from "simulator": Envelope [RobotState; Fixed(1)],
        pub 1 sub 6 buffer 256 borrowed 2 history 1 loaned 1 DROP;
    /// Health, progress and lockstep acknowledgements of every service.
    ServiceHealth = "service_health" from "": Envelope [ServiceHealth; Fixed(1)],
        pub 16 sub 8 buffer 16 borrowed 2 history 1 loaned 1 LAST;
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_topic_has_a_name_of_its_own() {
        let names: BTreeSet<_> = ALL.iter().map(|t| t.rules.name).collect();
        assert_eq!(names.len(), ALL.len());
    }

    #[test]
    fn results_are_never_dropped_silently() {
        for name in ["scan", "alignment", "scored_scan", "view_plan"] {
            let topic = ALL.iter().find(|t| t.rules.name == name).unwrap();
            assert_eq!(topic.rules.lag, Lag::Wait, "{name}");
            assert!(topic.rules.history >= 1, "{name} must serve a restarted reader");
        }
    }

    #[test]
    fn no_two_topics_share_a_description() {
        let descriptions: BTreeSet<_> = ALL.iter().map(|t| (t.describe)()).collect();
        assert_eq!(descriptions.len(), ALL.len());
    }
}
