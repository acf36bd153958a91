//! Where the robot is and how it moves.

use crate::layout::message;
use iceoryx2::prelude::ZeroCopySend;

message! {
    /// An estimate of the scanner's pose in a scan: from localisation, or recorded beside the scans.
    pub struct PoseEstimate: "mirador/PoseEstimate/1", size 432 {
        /// map_from_scanner, row-major 4x4.
        pub map_from_scanner: [f64; 16],
        /// Its 6x6 covariance, translation before rotation, perturbation on the right, in the scanner's frame, row-major;
        /// all zero when unknown.
        pub covariance: [f64; 36],
        /// Who says it: 0 recorded, in any fixed frame, [`POSE_FROM_LOCALIZATION`] in the map as alignment has it, 2 constant motion.
        pub source: u32,
        /// 1 while localisation does not know where it is.
        pub lost: u32,
        /// Not used.
        pub reserved: u64,
    }
}

/// The pose is localisation's, which hears where scans were aligned: it is in the map.
pub const POSE_FROM_LOCALIZATION: u32 = 1;

message! {
    /// Where localisation takes the robot to be now.
    pub struct RobotPose: "mirador/RobotPose/1", size 440 {
        /// map_from_robot, row-major 4x4.
        pub map_from_robot: [f64; 16],
        /// Its 6x6 covariance, translation before rotation, perturbation on the right, in the robot's frame, row-major.
        pub covariance: [f64; 36],
        /// Forward speed [m/s].
        pub linear: f64,
        /// Turning speed about z [rad/s].
        pub angular: f64,
        /// 1 while localisation does not know where it is.
        pub lost: u32,
        /// Number of the newest scan whose alignment is in the estimate; u32::MAX for none.
        pub aligned_scan: u32,
    }
}

message! {
    /// A reference for the drives.
    pub struct MotionCommand: "mirador/MotionCommand/1", size 40 {
        /// Time [ns].
        pub stamp_ns: i64,
        /// Forward speed [m/s].
        pub linear: f64,
        /// Turning speed about z [rad/s].
        pub angular: f64,
        /// The command ends after this time [ns]; 0 signs its source off. Of an emergency stop 0 releases it and anything
        /// else presses it.
        pub valid_ns: u64,
        /// Source by priority: 0 emergency stop, 1 board joystick, 2 radio, 3 operator, 4 navigation.
        pub source: u32,
        /// Not used.
        pub reserved: u32,
    }
}

message! {
    /// What navigation does with the path it was given.
    pub struct NavigationStatus: "mirador/NavigationStatus/1", size 136 {
        /// 0 idle, 1 driving, 2 arrived, 3 blocked, 4 recovering, 5 gave up.
        pub state: u32,
        /// Index of the waypoint it drives to.
        pub waypoint: u32,
        /// Distance driven on this path [m].
        pub driven_m: f64,
        /// Distance left [m].
        pub left_m: f64,
        /// Scan whose plan the path belongs to, see `ScanId`.
        pub plan_id: u64,
        /// Why, in words.
        pub reason: [u8; 104],
    }
}

message! {
    /// Where something held the robot that the map shows nothing of: told before the scan that is taken there.
    pub struct Obstruction: "mirador/Obstruction/1", size 32 {
        /// Centre of a disc that the robot cannot get into [m, map frame].
        pub centre: [f64; 2],
        /// Its radius [m].
        pub radius: f64,
        /// Number of the scan after which it happened.
        pub scan: u32,
        /// Not used.
        pub reserved: u32,
    }
}

message! {
    /// The state of the robot as a whole: the last message of a control step, when all that its sensors have said up to
    /// the stamp is sent.
    pub struct RobotState: "mirador/RobotState/2", size 152 {
        /// map_from_robot, row-major 4x4: of a simulated robot the truth, for the record, by which nobody steers; all zero
        /// where nobody knows it.
        pub map_from_robot: [f64; 16],
        /// Forward speed [m/s].
        pub linear: f64,
        /// 1 while the emergency stop is pressed.
        pub emergency_stop: u32,
        /// 1 when tipped over.
        pub tipped: u32,
        /// 1 while the head turns for a scan.
        pub scanning: u32,
        /// Number of scans the head has turned for.
        pub scans: u32,
    }
}
