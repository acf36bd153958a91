//! What every message begins with.

use crate::layout::{Record, message};
use iceoryx2::prelude::ZeroCopySend;

message! {
    /// What the message is about, when, and from whom.
    pub struct Header: "mirador/Header/1", size 48 {
        /// Robot, run and scan, see [`ScanId`].
        pub id: u64,
        /// Time of the sensor (simulated time when simulating) [ns], in the clock `clock_id`.
        pub stamp_ns: i64,
        /// When the work on this message began, CLOCK_MONOTONIC [ns].
        pub began_ns: u64,
        /// When it was sent, CLOCK_MONOTONIC [ns]; filled in by the publisher.
        pub sent_ns: u64,
        /// Counts the messages of this publisher from 0; filled in by the publisher.
        pub sequence: u64,
        /// Which clock `stamp_ns` belongs to: 0 recorded or simulated time, 1 CLOCK_REALTIME.
        pub clock_id: u32,
        /// How often the service was started in this run: tells a restart from a loss; filled in by the publisher.
        pub incarnation: u32,
    }
}

message! {
    /// The meta part of messages that need nothing but the header.
    pub struct Envelope: "mirador/Envelope/1", size 48 {
        /// The header.
        pub header: Header,
    }
}

/// Robot, run and scan in one 64-bit id: 8 bits robot, 24 bits run, 32 bits scan (counted from 0 in the run).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ScanId {
    /// Which robot.
    pub robot: u8,
    /// Which run, below 2^24.
    pub run: u32,
    /// Which scan of the run.
    pub scan: u32,
}

impl ScanId {
    /// The id as stored in a [`Header`].
    #[must_use]
    pub fn pack(self) -> u64 {
        (u64::from(self.robot) << 56) | (u64::from(self.run & 0x00ff_ffff) << 32) | u64::from(self.scan)
    }

    /// The id of a [`Header`].
    #[must_use]
    pub fn unpack(id: u64) -> Self {
        Self { robot: (id >> 56) as u8, run: ((id >> 32) & 0x00ff_ffff) as u32, scan: (id & 0xffff_ffff) as u32 }
    }
}

impl Header {
    /// A header about `id`, whose work begins now.
    #[must_use]
    pub fn new(id: u64, stamp_ns: i64) -> Self {
        Self { id, stamp_ns, began_ns: crate::clock::monotonic_ns(), ..Self::default() }
    }

    /// A header about the same subject and time as `other`, whose work began at `began_ns`.
    #[must_use]
    pub fn about(other: &Header, began_ns: u64) -> Self {
        Self { id: other.id, stamp_ns: other.stamp_ns, clock_id: other.clock_id, began_ns, ..Self::default() }
    }

    /// The scan of the run this message is about.
    #[must_use]
    pub fn scan(&self) -> u32 {
        ScanId::unpack(self.id).scan
    }
}

/// The meta part of a message: a record that begins with a [`Header`].
pub trait Meta: Record {
    /// The header.
    fn header(&self) -> &Header;
    /// The header, to be filled in.
    fn header_mut(&mut self) -> &mut Header;
}

macro_rules! metas {
    ($($t:ty),* $(,)?) => {$(
        impl Meta for $t {
            fn header(&self) -> &Header { &self.header }
            fn header_mut(&mut self) -> &mut Header { &mut self.header }
        }
        const _: () = assert!(std::mem::offset_of!($t, header) == 0);
    )*};
}
metas!(
    Envelope,
    super::ClockMeta,
    super::ScanMeta,
    super::LaserSweepMeta,
    super::PlanarScanMeta,
    super::AlignmentMeta,
    super::LoopClosingMeta,
    super::RegistrationRequestMeta,
    super::ScoredScanMeta,
    super::MapMeta,
    super::ViewPlanMeta,
    super::PathMeta,
);

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_scan_id_survives_packing(robot: u8, run in 0..0x0100_0000u32, scan: u32) {
            let id = ScanId { robot, run, scan };
            prop_assert_eq!(ScanId::unpack(id.pack()), id);
        }
    }
}
