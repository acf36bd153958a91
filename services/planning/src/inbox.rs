//! Everything that belongs to one scan, put together.

use mirador_core::information_map::{Obstruction, Zone};
use mirador_ipc_schema::messages::{AlignmentMeta, ScanId};
use mirador_ipc_schema::{Participant, Received, Subscriber, Wakeable, topics};
use mirador_service_common::{InOrder, ServiceError};
use nalgebra::{Point3, Vector3};

/// Everything that belongs to one scan.
pub(crate) struct Step {
    pub scan: Received<topics::Scan>,
    pub scores: Received<topics::ScoredScan>,
    pub alignment: AlignmentMeta,
    pub zones: Vec<Zone>,
    /// When the last of these messages was sent, CLOCK_MONOTONIC [ns].
    pub ready_ns: u64,
}

/// What is received about scans.
pub(crate) struct Inbox {
    scans: InOrder<topics::Scan>,
    alignments: InOrder<topics::Alignment>,
    scores: InOrder<topics::ScoredScan>,
    zones: InOrder<topics::Zones>,
    obstructions: Subscriber<topics::Obstructions>,
    /// A step that was looked for while older scans were being moved.
    held: Option<Step>,
}

impl Inbox {
    pub fn open(participant: &Participant) -> Result<Self, ServiceError> {
        Ok(Self {
            scans: InOrder::new(participant.subscriber()?),
            alignments: InOrder::new(participant.subscriber()?),
            scores: InOrder::new(participant.subscriber()?),
            zones: InOrder::new(participant.subscriber()?),
            obstructions: participant.subscriber()?,
            held: None,
        })
    }

    /// What is waited for: the scores, which are sent when everything else about a scan is, and the zones, which come right before
    /// them. To wake for each of the others would take a core from those who still work on the scan.
    pub fn awaited(&self) -> impl Iterator<Item = &dyn Wakeable> {
        self.scores.awaited(0).into_iter().chain(self.zones.awaited(0))
    }

    /// Takes in what came with the zones, and looks for the scores that follow them.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn look_for_scores(&mut self, participant: &Participant) -> Result<(), ServiceError> {
        let came_with = self.zones.awaited(0).is_some_and(Wakeable::is_ready);
        if came_with && !self.is_next_there()? {
            participant.look(&self.scores.awaited(0).into_iter().collect::<Vec<_>>());
        }
        Ok(())
    }

    /// Whether the next scan with everything that belongs to it is there.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn is_next_there(&mut self) -> Result<bool, ServiceError> {
        if self.held.is_none() {
            self.held = self.look()?;
        }
        Ok(self.held.is_some())
    }

    /// The next scored scan with everything that belongs to it, if all of it is there.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn next(&mut self) -> Result<Option<Step>, ServiceError> {
        if self.is_next_there()? { Ok(self.held.take()) } else { Ok(None) }
    }

    /// Where something held the robot, of which nothing was said here yet. What belongs to a scan was sent before it.
    ///
    /// # Errors
    /// See [`ServiceError`].
    pub fn obstructions(&mut self) -> Result<Vec<Obstruction>, ServiceError> {
        let mut found = Vec::new();
        while let Some(message) = self.obstructions.receive()? {
            found.extend(message.items().iter().map(|o| Obstruction { centre: o.centre, radius_m: o.radius }));
        }
        Ok(found)
    }

    fn look(&mut self) -> Result<Option<Step>, ServiceError> {
        loop {
            self.scores.fill(0)?;
            let id = self.scores.front();
            // Mostly the other parts are held already.
            if id.is_some() && self.parts().iter().all(|part| *part == id) {
                return Ok(self.put_together());
            }
            self.scans.discard_before(id.unwrap_or(0));
            self.alignments.discard_before(id.unwrap_or(0));
            self.zones.discard_before(id.unwrap_or(0));
            self.scans.fill(0)?;
            self.alignments.fill(0)?;
            self.zones.fill(0)?;
            let Some(id) = id else { return Ok(None) };
            let parts = self.parts();
            if parts.iter().any(|part| part.is_some_and(|of| of > id)) {
                tracing::warn!(scan = ScanId::unpack(id).scan, "a part of it was lost; it is not planned on");
                self.scores.pop();
            } else if parts.iter().all(|part| *part == Some(id)) {
                return Ok(self.put_together());
            } else if parts.iter().all(|part| part.is_none_or(|of| of == id)) {
                return Ok(None);
            }
            // Else parts of older scans came in just now; they are let go, and what follows them is looked at.
        }
    }

    /// Ids of the oldest messages beside the scores.
    fn parts(&self) -> [Option<u64>; 3] {
        [self.scans.front(), self.alignments.front(), self.zones.front()]
    }

    /// The step of the oldest messages.
    fn put_together(&mut self) -> Option<Step> {
        let (scan, scores) = (self.scans.pop()?, self.scores.pop()?);
        let (alignment, zones) = (self.alignments.pop()?, self.zones.pop()?);
        let sent = [scan.header(), scores.header(), alignment.header(), zones.header()].map(|header| header.sent_ns);
        let ready_ns = sent.into_iter().max().unwrap_or(0);
        Some(Step { scan, scores, alignment: *alignment.meta(), zones: read_zones(&zones), ready_ns })
    }
}

fn read_zones(message: &Received<topics::Zones>) -> Vec<Zone> {
    let point = |v: [f32; 3]| Vector3::from(v).cast::<f64>();
    message.items().iter().map(|z| Zone { centre: Point3::from(point(z.centre)), normal: point(z.normal) }).collect()
}
