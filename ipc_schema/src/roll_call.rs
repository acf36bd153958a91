//! Whether everyone is there and hears everyone else, before anything is said that nobody may miss.
//!
//! A publisher knows of a reader as soon as that has opened its port, but the reader is connected only when it looks for
//! publishers. Until then its buffer fills, and what does not fit any more is dropped without waiting for it (measured:
//! two scans of fifteen on a busy machine). So each health report begins with such a look at every port
//! ([`Participant::connect`](crate::Participant::connect)), and its header says when that was.

use std::collections::BTreeSet;

use crate::clock;
use crate::messages::{Header, SERVICE_RUNNING, ServiceHealth};
use crate::text;

/// Two rounds of health reports of the same services: after the first every port of theirs is open, after the second
/// every reader among them is connected to every publisher.
#[derive(Debug)]
pub struct RollCall {
    names: BTreeSet<String>,
    missing: BTreeSet<String>,
    /// Reports that began earlier say nothing of this round, CLOCK_MONOTONIC [ns].
    since_ns: u64,
    rounds_left: u32,
}

impl RollCall {
    /// Begins when the caller's own ports are open.
    #[must_use]
    pub fn of(names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        let names: BTreeSet<String> = names.into_iter().map(Into::into).collect();
        let mut call = Self { missing: names.clone(), names, since_ns: clock::monotonic_ns(), rounds_left: 2 };
        call.begin_next_round();
        call
    }

    /// Takes note of a report.
    pub fn hear(&mut self, header: &Header, health: &ServiceHealth) {
        if health.state == SERVICE_RUNNING && header.began_ns >= self.since_ns {
            self.missing.remove(text::unpack(&health.service));
            self.begin_next_round();
        }
    }

    /// Whether nobody is missing.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.rounds_left == 0
    }

    fn begin_next_round(&mut self) {
        while self.missing.is_empty() && self.rounds_left > 0 {
            self.rounds_left -= 1;
            if self.rounds_left > 0 {
                self.since_ns = clock::monotonic_ns();
                self.missing.clone_from(&self.names);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::SERVICE_STARTING;

    fn report(name: &str, state: u32) -> ServiceHealth {
        ServiceHealth { service: text::pack(name), state, ..ServiceHealth::default() }
    }

    #[test]
    fn a_roll_call_ends_when_everyone_has_reported_after_everyone_was_there() {
        let mut call = RollCall::of(["analysis", "planning"]);
        let early = Header { began_ns: call.since_ns - 1, ..Header::new(0, 0) };
        call.hear(&early, &report("analysis", SERVICE_RUNNING));
        call.hear(&Header::new(0, 0), &report("planning", SERVICE_STARTING));
        assert_eq!(call.missing.len(), 2, "one spoke too early, one is not ready");
        let first = Header::new(0, 0);
        for name in ["analysis", "planning", "somebody else"] {
            call.hear(&first, &report(name, SERVICE_RUNNING));
        }
        call.hear(&first, &report("analysis", SERVICE_RUNNING));
        assert_eq!(
            (call.missing.len(), call.is_complete()),
            (2, false),
            "a report of the first round is no second one"
        );
        call.hear(&Header::new(0, 0), &report("planning", SERVICE_RUNNING));
        assert!(!call.is_complete());
        call.hear(&Header::new(0, 0), &report("analysis", SERVICE_RUNNING));
        assert!(call.is_complete());
        assert!(RollCall::of([""; 0]).is_complete(), "nobody to wait for");
    }
}
