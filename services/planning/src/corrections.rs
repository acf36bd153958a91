//! Corrected poses, until their turn comes.
//!
//! What alignment says about older scans after scan N holds from after plan N on, however early it comes; so a plan does
//! not depend on who was faster.

use std::collections::BTreeMap;

use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_ipc_schema::messages::ScanId;
use mirador_ipc_schema::{Participant, Subscriber, Wakeable, topics};
use mirador_service_common::ServiceError;

/// The receiving end of what alignment says about older scans.
pub(crate) struct Corrections {
    loops: Subscriber<topics::LoopClosing>,
    poses: Subscriber<topics::PoseCorrections>,
    queue: CorrectionQueue,
}

/// Corrections by the scan after which they hold.
#[derive(Debug, Default)]
pub(crate) struct CorrectionQueue {
    waiting: BTreeMap<u32, Vec<(u32, Pose)>>,
    /// Number of scans after which alignment has said all it had to say about older ones.
    told_scans: u32,
}

impl Corrections {
    pub fn open(participant: &Participant) -> Result<Self, ServiceError> {
        Ok(Self {
            loops: participant.subscriber()?,
            poses: participant.subscriber()?,
            queue: CorrectionQueue::default(),
        })
    }

    pub fn awaited(&self) -> [&dyn Wakeable; 2] {
        [&self.loops, &self.poses]
    }

    /// Takes what is there.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn receive(&mut self) -> Result<(), ServiceError> {
        // The word that all is said comes last, so it is read first: what it stands behind is there by now.
        while let Some(message) = self.loops.receive()? {
            self.queue.told(message.header().scan());
        }
        while let Some(message) = self.poses.receive()? {
            let after = message.header().scan();
            for correction in message.items() {
                let scan = ScanId::unpack(correction.id).scan;
                match pose_from_rows(&correction.map_from_scanner) {
                    Some(pose) => self.queue.put(after, scan, pose),
                    None => tracing::warn!(scan, "its corrected pose is not a rigid pose; it stays where it is"),
                }
            }
        }
        Ok(())
    }

    pub fn queue(&mut self) -> &mut CorrectionQueue {
        &mut self.queue
    }
}

impl CorrectionQueue {
    fn told(&mut self, scan: u32) {
        self.told_scans = self.told_scans.max(scan.saturating_add(1));
    }

    fn put(&mut self, after: u32, scan: u32, pose: Pose) {
        self.waiting.entry(after).or_default().push((scan, pose));
    }

    /// Number of scans after which alignment has said all it had to say about older ones.
    pub fn told_scans(&self) -> u32 {
        self.told_scans
    }

    /// The corrections that hold once `planned` scans are planned on, in the order in which they were made.
    pub fn due(&mut self, planned: u32) -> impl Iterator<Item = (u32, Pose)> {
        let later = self.waiting.split_off(&planned);
        std::mem::replace(&mut self.waiting, later).into_values().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_correction_waits_for_the_plan_of_the_scan_after_which_it_was_made() {
        let mut queue = CorrectionQueue::default();
        let at = |x: f64| Pose::translation(x, 0.0, 0.0);
        queue.put(6, 2, at(3.0));
        queue.put(5, 2, at(1.0));
        queue.put(5, 4, at(2.0));
        queue.told(5);
        assert_eq!(queue.told_scans(), 6);
        assert_eq!(queue.due(5).count(), 0);
        assert_eq!(queue.due(6).collect::<Vec<_>>(), [(2, at(1.0)), (4, at(2.0))]);
        assert_eq!(queue.due(9).collect::<Vec<_>>(), [(2, at(3.0))]);
        assert_eq!(queue.due(9).count(), 0);
    }
}
