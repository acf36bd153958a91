//! The layouts of everything that is said, in the order of the data flow.
//!
//! A message is one `Meta` (the iceoryx2 user header; it begins with the [`Header`]) and a slice of fixed-size items.
//! Messages of one fixed size are a slice of one. Scores in [0, 1] are stored as `value * 65535` where the type is u16.

mod alignment;
mod analysis;
mod header;
mod health;
mod motion;
mod planning;
mod scan;
mod sensors;

use crate::layout::message;
use iceoryx2::prelude::ZeroCopySend;

pub use alignment::{
    ALIGNMENT_ACCEPTED, ALIGNMENT_FIRST, ALIGNMENT_REJECTED, AlignmentMeta, Hypothesis, KeyframePoint, LoopClosingMeta,
    PAIR_ACCEPTED, PAIR_LOOP, PAIR_OVERLAP, PAIR_REJECTED, PAIR_SWITCHED_OFF, PAIR_SWITCHED_ON, PoseCorrection,
    REGISTRATION_ABSENT, REGISTRATION_COVARIANCE, REGISTRATION_DIED, REGISTRATION_FLOOD, REGISTRATION_LATE,
    REGISTRATION_NOT_FINITE, REGISTRATION_NOT_RIGID, REGISTRATION_NOT_SENT, REGISTRATION_OUTDATED,
    REGISTRATION_OUTSIDE, REGISTRATION_PAUSED, REGISTRATION_SCHEMA, REGISTRATION_WRONG, RegistrationRequestMeta,
    RegistrationResult, RegistrationStatus, ScanPair,
};
pub use analysis::{
    MAP_CAUSE_CORRECTION, MAP_CAUSE_RESTART, MAP_CAUSE_SCAN, MAP_TILE_CELLS, MAP_TILE_SIDE, MapCell, MapMeta, MapTile,
    PointScore, ScoredScanMeta, ZONE_MERGED, Zone,
};
pub use header::{Envelope, Header, Meta, ScanId};
pub use health::{
    Delay, MAX_WORK_SPANS, SERVICE_FAILED, SERVICE_RUNNING, SERVICE_STARTING, SERVICE_STOPPING, ServiceHealth, WorkSpan,
};
pub use motion::{
    MotionCommand, NavigationStatus, Obstruction, POSE_FROM_LOCALIZATION, PoseEstimate, RobotPose, RobotState,
};
pub use planning::{
    CANDIDATE_OPEN, CandidateView, DECISION_GO, DECISION_STOP, PathMeta, ReplanRequest, ViewPlanMeta, Waypoint,
};
pub use scan::{Point, SCAN_HAS_PRIOR, ScanMeta, ScanRequest, ScanRequestKind};
pub use sensors::{
    Battery, Beam, EncoderReading, Gnss, Imu, LaserSweepMeta, Magnetometer, Odometry, PlanarScanMeta, Ranger,
};

pub mod clock_step {
    //! The clock of a graph in lockstep.

    use super::Header;
    use crate::layout::message;
    use iceoryx2::prelude::ZeroCopySend;

    message! {
        /// One step of the clock: what is released, and how far the run has come.
        pub struct ClockMeta: "mirador/ClockMeta/1", size 80 {
            /// Names the scan that this step releases.
            pub header: Header,
            /// Offset of the stamps' clock to UTC [ns]; 0 while simulating.
            pub utc_offset_ns: i64,
            /// Number of scans the source will deliver, 0 when it cannot know.
            pub scans_expected: u32,
            /// One of [`CLOCK_RUNNING`], [`CLOCK_ENDED`], [`CLOCK_FAULT`].
            pub state: u32,
            /// 1 when the next step waits for every service (lockstep), 0 when time releases it.
            pub lockstep: u32,
            /// Number of scans skipped because their file could not be read.
            pub scans_failed: u32,
            /// Not used.
            pub reserved: u64,
        }
    }

    /// Scans are being released.
    pub const CLOCK_RUNNING: u32 = 0;
    /// The last scan was released and finished by every service.
    pub const CLOCK_ENDED: u32 = 1;
    /// The source cannot go on; the reason is in its service health.
    pub const CLOCK_FAULT: u32 = 2;
}
pub use clock_step::{CLOCK_ENDED, CLOCK_FAULT, CLOCK_RUNNING, ClockMeta};

message! {
    /// The item of topics whose meta part says everything.
    pub struct Nothing: "mirador/Nothing/1", size 8 {
        /// Not used.
        pub reserved: u64,
    }
}
