//! What every service says of itself.

use crate::clock;
use crate::layout::message;
use crate::port::Pause;
use crate::text;
use iceoryx2::prelude::ZeroCopySend;

/// Ports are being opened.
pub const SERVICE_STARTING: u32 = 0;
/// Working.
pub const SERVICE_RUNNING: u32 = 1;
/// Finishing what it has.
pub const SERVICE_STOPPING: u32 = 2;
/// It cannot go on; `message` says why.
pub const SERVICE_FAILED: u32 = 3;

/// The most pieces of work that one report tells of.
pub const MAX_WORK_SPANS: usize = 8;

message! {
    /// A piece of work on a scan: what it waited for and how long it took, all times CLOCK_MONOTONIC [ns].
    pub struct WorkSpan: "mirador/WorkSpan/1", size 64 {
        /// What was done, for example `surface`.
        pub stage: [u8; 16],
        /// The scan.
        pub scan: u32,
        /// The thread: 0 the main one, 1 that which takes scans in.
        pub thread: u32,
        /// When the last of what it needs was sent or made; 0 when it needs nothing.
        pub input_ns: u64,
        /// Since when the thread slept before it.
        pub asleep_ns: u64,
        /// When that sleep ended.
        pub woke_ns: u64,
        /// When the work began.
        pub began_ns: u64,
        /// When it was done, its result sent.
        pub ended_ns: u64,
    }
}

impl WorkSpan {
    /// Work on `scan` that began at `began_ns` and is done now. It needed something that was there at `input_ns`; the
    /// thread's last sleep was `pause`.
    #[must_use]
    pub fn until_now(stage: &str, scan: u32, input_ns: u64, pause: Pause, began_ns: u64) -> Self {
        Self {
            stage: text::pack(stage),
            scan,
            thread: 0,
            input_ns,
            asleep_ns: pause.asleep_ns,
            woke_ns: pause.woke_ns,
            began_ns,
            ended_ns: clock::monotonic_ns(),
        }
    }

    /// The time from the input to the beginning in three parts [ns]; all zero for work that needs nothing.
    #[must_use]
    pub fn delay(&self) -> Delay {
        if self.input_ns == 0 || self.began_ns < self.input_ns {
            return Delay::default();
        }
        // A sleep that ended before the input was there has nothing to do with it: the thread was busy since.
        if self.woke_ns < self.input_ns || self.woke_ns > self.began_ns {
            return Delay { waiting: self.began_ns - self.input_ns, ..Delay::default() };
        }
        let asleep = self.asleep_ns.clamp(self.input_ns, self.woke_ns);
        Delay { waiting: asleep - self.input_ns, wake_up: self.woke_ns - asleep, taking: self.began_ns - self.woke_ns }
    }

    /// The time of the work itself [ns].
    #[must_use]
    pub fn computing(&self) -> u64 {
        self.ended_ns.saturating_sub(self.began_ns)
    }
}

/// What lies between an input and the work on it [ns].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Delay {
    /// The thread was busy with something else.
    pub waiting: u64,
    /// It slept, and had to be woken.
    pub wake_up: u64,
    /// Awake, it took the message and what belongs to it.
    pub taking: u64,
}

message! {
    /// Health and progress of one service; also its acknowledgement in lockstep.
    pub struct ServiceHealth: "mirador/ServiceHealth/2", size 856 {
        /// Name of the service.
        pub service: [u8; 32],
        /// Process id.
        pub pid: u32,
        /// One of the `SERVICE_*` constants.
        pub state: u32,
        /// Number of scans finished, counted from the first of the run: every scan below it is done.
        pub finished_scans: u32,
        /// How many of `spans` are told.
        pub span_count: u32,
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
        /// Page faults that had to wait for a disk.
        pub major_faults: u64,
        /// Times the service gave up the processor to wait.
        pub voluntary_switches: u64,
        /// Times the processor was taken from it.
        pub involuntary_switches: u64,
        /// What it is doing, or why it failed.
        pub message: [u8; 200],
        /// Its work since the last scan it reported as finished; told once, with that of the next.
        pub spans: [WorkSpan; MAX_WORK_SPANS],
    }
}

impl ServiceHealth {
    /// The pieces of work that it tells of.
    #[must_use]
    pub fn work(&self) -> &[WorkSpan] {
        // A foreign program may say any number.
        self.spans.get(..self.span_count as usize).unwrap_or(&self.spans)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn span(input_ns: u64, asleep_ns: u64, woke_ns: u64, began_ns: u64) -> WorkSpan {
        WorkSpan { input_ns, asleep_ns, woke_ns, began_ns, ended_ns: began_ns + 5, ..WorkSpan::default() }
    }

    #[test]
    fn a_thread_that_slept_was_woken_and_one_that_was_busy_kept_its_input_waiting() {
        let slept = Delay { waiting: 0, wake_up: 40, taking: 10 };
        assert_eq!(span(100, 50, 140, 150).delay(), slept);
        let busy = Delay { waiting: 50, ..Delay::default() };
        assert_eq!(span(100, 20, 60, 150).delay(), busy);
        // It went to sleep although the input was there: sent, but not seen yet.
        assert_eq!(span(100, 120, 140, 150).delay(), Delay { waiting: 20, wake_up: 20, taking: 10 });
        assert_eq!(span(0, 20, 60, 150).delay(), Delay::default());
    }

    proptest! {
        #[test]
        fn the_parts_of_a_delay_are_all_of_it(input in 1_u64..1000, asleep in 0_u64..1000, woke in 0_u64..1000, began in 0_u64..1000) {
            let delay = span(input, asleep, woke, began).delay();
            prop_assert_eq!(delay.waiting + delay.wake_up + delay.taking, began.saturating_sub(input));
        }
    }

    #[test]
    fn a_count_beyond_the_list_tells_of_the_whole_list() {
        assert_eq!(ServiceHealth { span_count: 3, ..ServiceHealth::default() }.work().len(), 3);
        assert_eq!(ServiceHealth { span_count: 99, ..ServiceHealth::default() }.work().len(), MAX_WORK_SPANS);
    }
}
