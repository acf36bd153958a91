//! What was recorded already: repeated messages are told from new ones, and finished scans are counted.
//!
//! A message comes twice when a reader that restarts gets the history of a topic, or when a publisher that restarts
//! refills what died with it.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use mirador_ipc_schema::{Header, ScanId};

/// More messages than a topic's publishers keep as history together.
const REMEMBERED: usize = 64;

/// Topics with one message a scan: whatever comes later about the same scan is a repetition.
const ONCE: [&str; 4] = ["scan", "alignment", "loop_closing", "scored_scan"];
/// Topics with a message a decision: the publisher may decide again, but one that restarts repeats itself.
const PER_DECISION: [&str; 2] = ["view_plan", "path"];

/// The messages of one topic.
#[derive(Default)]
struct Pages {
    /// Send time, sequence and incarnation of the last messages.
    recent: VecDeque<(u64, u64, u32)>,
    /// Incarnation of the publisher that spoke first about an id; only for topics about scans.
    scans: BTreeMap<u64, u32>,
}

/// Which messages are recorded, and which scans are complete.
pub(crate) struct Ledger {
    pages: BTreeMap<&'static str, Pages>,
    /// A scan is complete when it is on each of these topics.
    required: Vec<&'static str>,
    /// How many of `required` a scan has; scans below `finished` are forgotten.
    open: BTreeMap<u32, usize>,
    finished: u32,
}

impl Ledger {
    pub(crate) fn new(required: Vec<&'static str>) -> Self {
        Self { pages: BTreeMap::new(), required, open: BTreeMap::new(), finished: 0 }
    }

    /// Whether the message is new; it then counts as recorded.
    pub(crate) fn admit(&mut self, topic: &'static str, header: &Header) -> bool {
        let pages = self.pages.entry(topic).or_default();
        let key = (header.sent_ns, header.sequence, header.incarnation);
        if pages.recent.contains(&key) {
            return false;
        }
        if ONCE.contains(&topic) && pages.scans.contains_key(&header.id) {
            return false;
        }
        if PER_DECISION.contains(&topic)
            && pages.scans.get(&header.id).is_some_and(|first| *first != header.incarnation)
        {
            return false;
        }
        if pages.recent.len() == REMEMBERED {
            pages.recent.pop_front();
        }
        pages.recent.push_back(key);
        let about_scan = ONCE.contains(&topic) || PER_DECISION.contains(&topic);
        let first = about_scan && pages.scans.insert(header.id, header.incarnation).is_none();
        if first && self.required.contains(&topic) {
            *self.open.entry(header.scan()).or_default() += 1;
        }
        true
    }

    /// Number of scans complete: every scan below it is recorded on all required topics.
    pub(crate) fn finished(&mut self) -> u32 {
        while self.open.get(&self.finished) == Some(&self.required.len()) {
            self.open.remove(&self.finished);
            self.finished += 1;
        }
        self.finished
    }
}

impl Ledger {
    /// Whether a later scan is complete while the one that is due is not.
    pub(crate) fn is_overtaken(&self) -> bool {
        self.open.range(self.finished + 1..).any(|(_, topics)| *topics == self.required.len())
    }

    /// The scans from the one that is due to the last one seen whose points were not recorded.
    pub(crate) fn missing_scans(&self) -> Vec<u32> {
        let Some(pages) = self.pages.get("scan") else { return Vec::new() };
        let numbers: BTreeSet<u32> = pages.scans.keys().map(|id| ScanId::unpack(*id).scan).collect();
        let last = numbers.last().copied().unwrap_or(0);
        (self.finished..last).filter(|scan| !numbers.contains(scan)).collect()
    }

    /// Counts the scan that is due as finished although it is not complete.
    pub(crate) fn give_up(&mut self) {
        self.open.remove(&self.finished);
        self.finished += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::header;

    const ALL: [&str; 4] = ["scan", "alignment", "scored_scan", "view_plan"];

    #[test]
    fn a_scan_is_finished_when_it_is_on_every_required_topic() {
        let mut ledger = Ledger::new(ALL.to_vec());
        for topic in &ALL[..3] {
            assert!(ledger.admit(topic, &header(0, 5)));
            assert_eq!(ledger.finished(), 0);
        }
        assert!(ledger.admit("view_plan", &header(0, 5)));
        assert_eq!(ledger.finished(), 1);
    }

    #[test]
    fn a_gap_holds_the_count() {
        let mut ledger = Ledger::new(vec!["scan"]);
        for scan in [0, 2, 3] {
            assert!(ledger.admit("scan", &header(scan, 1 + u64::from(scan))));
        }
        assert_eq!(ledger.finished(), 1);
        assert!(ledger.admit("scan", &header(1, 9)));
        assert_eq!(ledger.finished(), 4);
    }

    #[test]
    fn a_scan_sent_again_is_a_repetition() {
        let mut ledger = Ledger::new(ALL.to_vec());
        assert!(ledger.admit("scan", &header(0, 5)));
        let again = Header { sequence: 17, incarnation: 1, ..header(0, 99) };
        assert!(!ledger.admit("scan", &again));
    }

    #[test]
    fn a_scan_that_never_comes_can_be_given_up() {
        let mut ledger = Ledger::new(vec!["scan"]);
        assert!(!ledger.is_overtaken());
        assert!(ledger.admit("scan", &header(1, 5)));
        assert!(ledger.is_overtaken());
        assert_eq!(ledger.missing_scans(), [0]);
        ledger.give_up();
        assert_eq!((ledger.finished(), ledger.is_overtaken()), (2, false));
    }

    #[test]
    fn a_second_decision_is_kept_and_a_repeated_one_is_not() {
        let mut ledger = Ledger::new(ALL.to_vec());
        assert!(ledger.admit("view_plan", &header(0, 5)));
        assert!(ledger.admit("view_plan", &Header { sequence: 1, ..header(0, 6) }));
        assert!(!ledger.admit("view_plan", &Header { sequence: 1, ..header(0, 6) }));
        assert!(!ledger.admit("view_plan", &Header { incarnation: 1, ..header(0, 7) }));
    }

    #[test]
    fn messages_without_a_scan_of_their_own_are_told_apart_by_when_they_were_sent() {
        let mut ledger = Ledger::new(ALL.to_vec());
        for sent in 0..200 {
            assert!(ledger.admit("odometry", &header(0, sent)));
        }
        assert!(!ledger.admit("odometry", &header(0, 199)));
    }
}
