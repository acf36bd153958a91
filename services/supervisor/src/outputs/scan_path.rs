//! One scan's way through the processes: what fed what, and which work the plan had to wait for.

use super::run_data::RunData;
use super::work::ServiceWork;

/// What feeds what: a piece of work and those that need its result.
pub(super) const FEEDS: [(&str, &str); 9] = [
    ("scan", "prepare"),
    ("scan", "surface"),
    ("prepare", "align"),
    ("surface", "scores"),
    ("align", "scores"),
    ("scores", "map"),
    ("map", "plan"),
    ("plan", "show"),
    ("plan", "correct"),
];

/// The work on one scan.
pub(super) struct ScanPath<'a> {
    /// Number of the scan.
    pub scan: u32,
    /// All of it, by its beginning.
    pub works: Vec<&'a ServiceWork>,
    /// Whether the plan had to wait for each of them: the critical path from the last beam to the plan.
    pub is_critical: Vec<bool>,
}

impl<'a> ScanPath<'a> {
    /// The work on a scan; `None` when nothing was told of it.
    pub fn of(data: &'a RunData, scan: u32) -> Option<Self> {
        let mut works: Vec<&ServiceWork> = data.work.spans.iter().filter(|work| work.span.scan == scan).collect();
        works.sort_by_key(|work| work.span.began_ns);
        let mut is_critical = vec![false; works.len()];
        let mut next = last_of(&works, "plan");
        while let Some(place) = next {
            // A loop cannot come up: what feeds something begins before it.
            is_critical[place] = true;
            next = awaited(&works, place);
        }
        (!works.is_empty()).then_some(Self { scan, works, is_critical })
    }

    /// The first work of this name.
    pub fn work(&self, stage: &str) -> Option<&'a ServiceWork> {
        self.works.iter().copied().find(|work| work.stage() == stage)
    }

    /// The scan is there [ns]: what its readers took, as its sender may be kept from going on after it has sent it.
    pub fn scan_sent_ns(&self) -> Option<u64> {
        self.work("surface").or_else(|| self.work("prepare")).map(|work| work.span.input_ns)
    }

    /// Its plan is there [ns].
    pub fn plan_sent_ns(&self) -> Option<u64> {
        self.work("plan").map(|work| work.span.ended_ns)
    }

    /// From the last beam to the plan [ns].
    pub fn end_to_end(&self) -> Option<u64> {
        self.plan_sent_ns()?.checked_sub(self.scan_sent_ns()?)
    }

    /// The critical path, from the first to the last.
    pub fn critical(&self) -> impl Iterator<Item = &'a ServiceWork> {
        self.works.iter().zip(&self.is_critical).filter(|(_, is)| **is).map(|(work, _)| *work)
    }
}

fn last_of(works: &[&ServiceWork], stage: &str) -> Option<usize> {
    works.iter().rposition(|work| work.stage() == stage)
}

/// What the work at `place` needed and that came last, among what had begun before it.
fn awaited(works: &[&ServiceWork], place: usize) -> Option<usize> {
    let stage = works.get(place)?.stage();
    let before = works.get(..place)?;
    let feeding = FEEDS.iter().filter(|(_, to)| *to == stage).filter_map(|(from, _)| last_of(before, from));
    feeding.max_by_key(|place| before[*place].span.ended_ns)
}

/// The scan whose plan took the middle time: what is usual, not the first one, for which memory is fetched.
pub(super) fn typical(data: &RunData) -> Option<ScanPath<'_>> {
    let numbers = data.scans.iter().map(super::run_data::ScanRecord::number);
    let mut paths: Vec<(u64, ScanPath<'_>)> = numbers
        .filter_map(|scan| ScanPath::of(data, scan))
        .filter_map(|path| Some((path.end_to_end()?, path)))
        .collect();
    paths.sort_by_key(|(time, _)| *time);
    let middle = paths.len().checked_sub(1)? / 2;
    paths.into_iter().nth(middle).map(|(_, path)| path)
}

#[cfg(test)]
pub(super) mod tests {
    use mirador_ipc_schema::messages::WorkSpan;
    use mirador_ipc_schema::text;

    use super::super::run_data::ScanRecord;
    use super::*;

    const MS: u64 = 1_000_000;

    fn work(service: &str, stage: &str, scan: u32, thread: u32, [input, began, ended]: [u64; 3]) -> ServiceWork {
        let (asleep_ns, woke_ns) = (input.saturating_sub(1), (began * MS).saturating_sub(10_000));
        let span = WorkSpan {
            stage: text::pack(stage),
            scan,
            thread,
            input_ns: input * MS,
            asleep_ns: asleep_ns * MS,
            woke_ns,
            began_ns: began * MS,
            ended_ns: ended * MS,
        };
        ServiceWork { service: service.into(), pid: service.bytes().map(u32::from).sum(), span }
    }

    /// Two scans, 1 s apart; alignment is what the scores wait for in the first and the surface in the second.
    pub(in super::super) fn data() -> RunData {
        let mut data = RunData::default();
        for (scan, align_end, surface_end) in [(0, 140, 130), (1, 120, 150)] {
            let at = 1000 * u64::from(scan);
            let both: u64 = 150;
            let spans = [
                ("acquisition", "scan", 0, [0, 10, 100]),
                ("alignment", "prepare", 1, [100, 101, 110]),
                ("analysis", "surface", 0, [100, 101, surface_end]),
                ("alignment", "align", 0, [110, 111, align_end]),
                ("analysis", "scores", 0, [align_end, both + 1, 160]),
                ("planning", "map", 0, [160, 161, 170]),
                ("planning", "plan", 0, [0, 170, 190]),
                ("planning", "show", 0, [0, 190, 230]),
                ("alignment", "correct", 0, [190, 191, 200]),
            ];
            for (service, stage, thread, times) in spans {
                let times = times.map(|ms| if ms == 0 { 0 } else { at + ms });
                data.work.spans.push(work(service, stage, scan, thread, times));
            }
            let mut record = ScanRecord::default();
            record.scan.header.id = u64::from(scan);
            data.scans.push(record);
        }
        data
    }

    #[test]
    fn the_critical_path_goes_through_the_branch_that_was_waited_for() {
        let data = data();
        let stages = |scan| {
            let path = ScanPath::of(&data, scan).unwrap();
            path.critical().map(|work| work.stage().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(stages(0), ["scan", "prepare", "align", "scores", "map", "plan"]);
        assert_eq!(stages(1), ["scan", "surface", "scores", "map", "plan"]);
        assert!(ScanPath::of(&data, 2).is_none());
    }

    #[test]
    fn the_typical_scan_has_a_plan() {
        let mut data = data();
        assert_eq!(typical(&data).unwrap().end_to_end(), Some(90 * MS));
        data.work.spans.retain(|work| work.stage() != "plan");
        assert!(typical(&data).is_none());
    }
}
