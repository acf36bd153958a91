//! The two topics between alignment and a foreign registration: requests go out, answers come back in time or not.

use std::time::{Duration, Instant};

use mirador_core::geometry::{Pose, rows_from_pose};
use mirador_core::registration::{Limits, PreparedCloud, PreparedScan};
use mirador_ipc_schema::messages::{Header, KeyframePoint, RegistrationRequestMeta, RegistrationResult};
use mirador_ipc_schema::{Participant, PortError, Publisher, Subscriber, Waiter, topics};
use mirador_service_common::log_keyframes;

use super::fault::Fault;

/// Between two looks whether the process is still there.
const LOOK: Duration = Duration::from_millis(20);
/// More results than this that nobody asked for are a flood.
const MOST_UNASKED: u64 = 16;
/// Most results that are taken from the buffer before a request.
const MOST_DRAINED: u32 = 64;
/// After as many failures in a row as give a pause of this length, the pauses grow no more.
const LONGEST_PAUSE: u32 = 31;

/// Two keyframes, a start, and the limits of the way from there.
pub(crate) struct Question<'a> {
    pub target: &'a dyn PreparedScan,
    pub source: &'a dyn PreparedScan,
    pub start: &'a Pose,
    pub limits: &'a Limits,
    /// Names the source scan.
    pub header: Header,
    /// Id of the target scan.
    pub target_id: Option<u64>,
}

/// The ports.
pub(crate) struct Link {
    requests: Publisher<topics::RegistrationRequest>,
    results: Subscriber<topics::RegistrationResult>,
    waiter: Waiter,
    deadline_ms: u32,
    /// Number of the last request.
    request: u64,
    /// The publisher's incarnation and the number of the result that comes next; `None` before the first one that is
    /// seen, when results to an earlier alignment may have gone before.
    next_result: Option<(u32, u64)>,
    /// Results that nobody asked for, since the last request.
    unasked: u64,
    failures: u32,
    pause: u32,
}

impl Link {
    pub fn open(participant: &Participant, deadline_ms: u32) -> Result<Self, PortError> {
        Ok(Self {
            results: participant.subscriber()?,
            requests: participant.publisher()?,
            waiter: participant.waiter(),
            deadline_ms,
            // A restarted alignment gives other numbers, so that it does not take answers to the one before.
            request: u64::from(participant.incarnation()) << 32,
            next_result: (participant.incarnation() == 0).then_some((0, 0)),
            unasked: 0,
            failures: 0,
            pause: 0,
        })
    }

    /// Whether somebody is there to answer.
    pub fn is_answered(&self) -> bool {
        self.results.publishers() > 0
    }

    /// Waits until somebody is there to answer, serves whoever comes late, and calls `meanwhile` between. Whether somebody is
    /// there; nobody when the time is over or the process should end.
    pub fn wait_for_somebody(&self, patience: Duration, mut meanwhile: impl FnMut()) -> bool {
        let begin = Instant::now();
        while !self.is_answered() {
            if self.waiter.stop().is_set() || begin.elapsed() >= patience {
                return false;
            }
            self.requests.serve_late_joiners();
            self.waiter.wait(&[&self.results], LOOK);
            meanwhile();
        }
        true
    }

    /// Asks, unless there is nobody to ask or it has failed too often; `meanwhile` is done while the answer is awaited.
    pub fn ask(
        &mut self,
        question: &Question<'_>,
        meanwhile: impl FnOnce(),
    ) -> Result<(RegistrationResult, Duration), Fault> {
        if !self.is_answered() {
            return Err(Fault::Absent);
        }
        if self.pause > 0 {
            self.pause -= 1;
            return Err(Fault::Paused { failures: self.failures, left: self.pause });
        }
        self.drain()?;
        self.send(question)?;
        let begin = Instant::now();
        meanwhile();
        Ok((self.wait(begin)?, begin.elapsed()))
    }

    /// Remembers how it went: who fails again and again is asked less and less.
    pub fn remember(&mut self, fault: Option<&Fault>) {
        match fault {
            None => self.failures = 0,
            Some(fault) if fault.is_its_own() => {
                self.failures += 1;
                self.pause = (1_u32 << (self.failures - 1).min(5)).saturating_sub(1).min(LONGEST_PAUSE);
            }
            Some(_) => {}
        }
    }

    /// Asks about the next pair all the same.
    pub fn forgive(&mut self) {
        (self.failures, self.pause) = (0, 0);
    }

    /// Lets go what came since the last request: answers that were late, or that nobody asked for.
    fn drain(&mut self) -> Result<(), Fault> {
        for _ in 0..MOST_DRAINED {
            if self.next()?.is_none() {
                break;
            }
            self.unasked = self.unasked.saturating_add(1);
        }
        let results = std::mem::take(&mut self.unasked);
        if results > MOST_UNASKED { Err(Fault::Flood { results }) } else { Ok(()) }
    }

    /// The next result. Those that were replaced before they could be read count as unasked.
    fn next(&mut self) -> Result<Option<RegistrationResult>, Fault> {
        let received = self.results.receive().map_err(|e| Fault::NotSent { reason: e.to_string() })?;
        let Some(message) = received else { return Ok(None) };
        let (incarnation, sequence) = (message.header().incarnation, message.header().sequence);
        if let Some((of, next)) = self.next_result {
            // A restarted process counts from 0 again.
            let next = if of == incarnation { next } else { 0 };
            self.unasked = self.unasked.saturating_add(sequence.saturating_sub(next));
        }
        self.next_result = Some((incarnation, sequence.saturating_add(1)));
        Ok(message.items().first().copied())
    }

    /// Writes both keyframes where they will be read, and nowhere else.
    fn send(&mut self, question: &Question<'_>) -> Result<(), Fault> {
        let not_sent = |e: &dyn std::fmt::Display| Fault::NotSent { reason: e.to_string() };
        let (target, source) = (question.target.points().len(), question.source.points().len());
        let mut loan = self.requests.loan(target + source).map_err(|e| not_sent(&e))?;
        let (targets, sources) = loan.items_mut().split_at_mut(target);
        write(question.target, targets);
        write(question.source, sources);
        self.request += 1;
        let limits = question.limits;
        *loan.meta_mut() = RegistrationRequestMeta {
            header: Header::about(&question.header, question.header.began_ns),
            target_id: question.target_id.unwrap_or(u64::MAX),
            initial_target_from_source: rows_from_pose(question.start),
            pair_distance_m: limits.pair_distance_m,
            max_translation_m: limits.max_translation_m,
            max_rotation: limits.max_rotation,
            target_points: target as u32,
            source_points: source as u32,
            max_iterations: limits.max_iterations,
            timeout_ms: self.deadline_ms,
            request: self.request,
        };
        log_keyframes(question.header.scan(), || loan.location());
        loan.send().map_err(|e| not_sent(&e))
    }

    fn wait(&mut self, begin: Instant) -> Result<RegistrationResult, Fault> {
        let deadline = Duration::from_millis(self.deadline_ms.into());
        let (deadline_ms, asked) = (self.deadline_ms, self.request);
        let mut outdated = None;
        loop {
            while let Some(result) = self.next()? {
                let here = topics::registration_schema();
                if result.schema != here {
                    return Err(Fault::Schema { here, there: result.schema });
                }
                if result.request == asked {
                    return Ok(result);
                }
                outdated = Some(result.request);
                self.unasked = self.unasked.saturating_add(1);
                if self.unasked > MOST_UNASKED {
                    return Err(Fault::Flood { results: std::mem::take(&mut self.unasked) });
                }
            }
            if !self.is_answered() {
                return Err(Fault::Died);
            }
            let left = deadline.saturating_sub(begin.elapsed());
            if left.is_zero() {
                return Err(match outdated {
                    Some(answered) => Fault::Outdated { answered, asked, deadline_ms },
                    None => Fault::Late { deadline_ms },
                });
            }
            if self.waiter.stop().is_set() {
                return Err(Fault::NotSent { reason: "the run is being ended".into() });
            }
            self.waiter.wait(&[&self.results], left.min(LOOK));
        }
    }
}

/// Writes a keyframe: points, and normals where the method has any.
fn write(scan: &dyn PreparedScan, items: &mut [KeyframePoint]) {
    let cloud = scan.as_any().downcast_ref::<PreparedCloud>();
    for (index, (item, [x, y, z])) in items.iter_mut().zip(scan.points()).enumerate() {
        let [nx, ny, nz] = cloud.and_then(|c| c.plane(index)).map_or([0.0; 3], |(normal, _)| normal);
        *item = KeyframePoint { position: [*x, *y, *z, 1.0], normal: [nx, ny, nz, 0.0] };
    }
}
