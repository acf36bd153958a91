//! What every service says of itself.

use crate::layout::message;
use iceoryx2::prelude::ZeroCopySend;

/// Ports are being opened.
pub const SERVICE_STARTING: u32 = 0;
/// Working.
pub const SERVICE_RUNNING: u32 = 1;
/// Finishing what it has.
pub const SERVICE_STOPPING: u32 = 2;
/// It cannot go on; `message` says why.
pub const SERVICE_FAILED: u32 = 3;

message! {
    /// Health and progress of one service; also its acknowledgement in lockstep.
    pub struct ServiceHealth: "mirador/ServiceHealth/1", size 336 {
        /// Name of the service.
        pub service: [u8; 32],
        /// Process id.
        pub pid: u32,
        /// One of the `SERVICE_*` constants.
        pub state: u32,
        /// Number of scans finished, counted from the first of the run: every scan below it is done.
        pub finished_scans: u32,
        /// Not used.
        pub reserved: u32,
        /// Resident memory [bytes].
        pub resident_bytes: u64,
        /// CPU time of the process [ns].
        pub cpu_ns: u64,
        /// Payload bytes this service copied out of or into shared memory through its ports.
        pub copied_payload_bytes: u64,
        /// Messages seen to be missing (gaps in sequence numbers).
        pub lost_messages: u64,
        /// Messages that could not be delivered within the back-pressure limit.
        pub undelivered_messages: u64,
        /// Messages sent.
        pub sent_messages: u64,
        /// Messages received.
        pub received_messages: u64,
        /// Time of the last unit of work [ns].
        pub last_work_ns: u64,
        /// Page faults that needed no disk.
        pub minor_faults: u64,
        /// Times the service gave up the processor to wait.
        pub voluntary_switches: u64,
        /// Times the processor was taken from it.
        pub involuntary_switches: u64,
        /// What it is doing, or why it failed.
        pub message: [u8; 200],
    }
}
