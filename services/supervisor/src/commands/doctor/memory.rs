//! Shared memory: is it there, and does a graph fit.

use std::fs;
use std::path::Path;

use mirador_ipc_schema::{Sizes, budget};

use super::{Finding, megabytes};
use crate::cli::Common;
use crate::graph::{self, GraphError, SERVICES};

/// Cells of the largest scan in common use (541 beams x 720 sweeps): what a graph must have room for.
const LARGEST_SCAN: usize = 389_520;

/// A graph whose memory is checked.
struct Candidate {
    /// What it is called in the findings.
    name: String,
    services: Vec<&'static str>,
    sizes: Sizes,
}

/// Checks `/dev/shm` against the standard graph and the one of `--config`, and the machine's memory against both.
pub(super) fn check(common: &Common) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut candidates = vec![Candidate {
        name: "the standard graph".into(),
        services: SERVICES.to_vec(),
        sizes: Sizes { scan_points: LARGEST_SCAN },
    }];
    if let Some(path) = &common.config {
        let (finding, candidate) = configured(path, &common.set);
        findings.push(finding);
        candidates.extend(candidate);
    }
    match budget::shared_memory_space() {
        Err(error) => findings.push(Finding::problem("shared memory", error.to_string())),
        Ok((free, space)) => {
            findings.extend(candidates.iter().map(|c| space_for(c, free, space)));
            let needed = candidates.iter().map(|c| budget::total(&budget::of_graph(&c.services, &c.sizes))).max();
            let meminfo = fs::read_to_string("/proc/meminfo").unwrap_or_default();
            let limit = fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
            findings.push(memory_behind_it(needed.unwrap_or(0), &meminfo, limit.as_deref()));
        }
    }
    findings
}

/// The graph of `--config`, when it says how large its scans are.
fn configured(path: &Path, settings: &[String]) -> (Finding, Option<Candidate>) {
    let subject = "graph file";
    match graph::load(path, settings, &crate::Registry::default()) {
        Err(GraphError::Value { key, message, .. }) if key == "alignment.registration" => {
            let text = format!("{}: {message}; unless a program of your own adds it, correct the key", path.display());
            (Finding::warning(subject, text), None)
        }
        Err(error) => (Finding::problem(subject, error.to_string()), None),
        Ok(graph) => {
            let points = graph.graph.max_points;
            let services = graph.services.entries().iter().map(|(name, _)| *name).collect();
            let candidate =
                Candidate { name: path.display().to_string(), services, sizes: Sizes { scan_points: points } };
            let size = if points == 0 { "as large as its source's scans".into() } else { format!("{points} points") };
            let text = format!("{}: valid; slots for scans: {size}", path.display());
            (Finding::ok(subject, text), (points > 0).then_some(candidate))
        }
    }
}

/// Whether a graph fits into the free space, with its slots as a table.
fn space_for(graph: &Candidate, free: u64, space: u64) -> Finding {
    let table = budget_table(&budget::of_graph(&graph.services, &graph.sizes));
    let finding = match budget::check_against(&graph.services, &graph.sizes, free, space) {
        Err(error) => Finding::problem("shared memory", format!("{}: {error}", graph.name)),
        Ok(needed) => Finding::ok(
            "shared memory",
            format!(
                "/dev/shm has {} free of {}; {} takes {} for scans of {} points",
                megabytes(free),
                megabytes(space),
                graph.name,
                megabytes(needed),
                graph.sizes.scan_points
            ),
        ),
    };
    finding.with_table(table)
}

/// Topic, publishers, slots of each, bytes of a slot, and all of it with the management files.
fn budget_table(topics: &[budget::TopicMemory]) -> Vec<String> {
    let row = |topic: &str, publishers: &str, slots: &str, slot: &str, total: &str| {
        format!("{topic:<18} {publishers:>10} {slots:>6} {slot:>11} {total:>10}")
    };
    let mut lines = vec![row("topic", "publishers", "slots", "slot bytes", "total")];
    lines.extend(topics.iter().map(|t| {
        let (publishers, slots) = (t.publishers.to_string(), t.slots.to_string());
        row(t.topic, &publishers, &slots, &t.slot_bytes.to_string(), &megabytes(t.bytes()))
    }));
    lines.push(row("sum", "", "", "", &megabytes(budget::total(topics))));
    lines
}

/// Shared memory is memory: whether the machine, or the container's limit, has that much. `limit` is the text of the
/// control group's `memory.max`.
fn memory_behind_it(needed: u64, meminfo: &str, limit: Option<&str>) -> Finding {
    let available = meminfo
        .lines()
        .find_map(|line| line.strip_prefix("MemAvailable:"))
        .and_then(|rest| rest.split_ascii_whitespace().next()?.parse::<u64>().ok())
        .map(|kib| kib * 1024);
    let limit = limit.and_then(|text| text.trim().parse::<u64>().ok());
    let Some(room) = [available, limit].into_iter().flatten().min() else {
        return Finding::ok("memory", "the system does not say how much is available");
    };
    let limited = if limit == Some(room) { " (limit of the control group)" } else { "" };
    if room < needed {
        let text = format!(
            "{} available{limited}, but shared memory alone takes {}: end other programs, raise the limit, or lower \
             graph.max_points",
            megabytes(room),
            megabytes(needed)
        );
        return Finding::problem("memory", text);
    }
    if room < 2 * needed {
        let text = format!(
            "{} available{limited}, {} of it for shared memory: long runs of large scans may not fit; end other programs",
            megabytes(room),
            megabytes(needed)
        );
        return Finding::warning("memory", text);
    }
    Finding::ok("memory", format!("{} available{limited}", megabytes(room)))
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::*;

    fn standard() -> Candidate {
        let sizes = Sizes { scan_points: LARGEST_SCAN };
        Candidate { name: "the standard graph".into(), services: SERVICES.to_vec(), sizes }
    }

    #[test]
    fn the_default_of_docker_is_a_problem_that_says_what_to_do() {
        let finding = space_for(&standard(), 64 << 20, 64 << 20);
        assert_eq!(finding.level, Level::Problem);
        assert!(finding.text.contains("--shm-size="), "{}", finding.text);
    }

    #[test]
    fn a_roomy_machine_is_ok_and_the_budget_adds_up() {
        let finding = space_for(&standard(), 8 << 30, 8 << 30);
        assert_eq!(finding.level, Level::Ok);
        let topics = budget::of_graph(&SERVICES, &Sizes { scan_points: LARGEST_SCAN });
        assert_eq!(finding.table.len(), topics.len() + 2, "a head, a line a topic, the sum");
        assert!(finding.table.last().unwrap().ends_with(&megabytes(budget::total(&topics))));
        let scan = finding.table.iter().find(|line| line.starts_with("scan ")).unwrap();
        let slot_bytes: usize = scan.split_whitespace().nth(3).unwrap().parse().unwrap();
        assert!(slot_bytes >= LARGEST_SCAN * 16, "{scan}");
    }

    #[test]
    fn the_smaller_of_memory_and_limit_decides() {
        let meminfo = "MemTotal: 8000000 kB\nMemAvailable:    4000000 kB\n";
        assert_eq!(memory_behind_it(500_000_000, meminfo, Some("max\n")).level, Level::Ok);
        assert_eq!(memory_behind_it(500_000_000, meminfo, None).level, Level::Ok);
        let tight = memory_behind_it(500_000_000, meminfo, Some("800000000\n"));
        assert_eq!(tight.level, Level::Warning);
        assert!(tight.text.contains("control group"), "{}", tight.text);
        assert_eq!(memory_behind_it(500_000_000, meminfo, Some("400000000\n")).level, Level::Problem);
        assert_eq!(memory_behind_it(500_000_000, "", None).level, Level::Ok);
    }

    #[test]
    fn a_graph_file_that_is_not_there_is_a_problem() {
        let (finding, candidate) = configured(Path::new("/nonexistent/graph.toml"), &[]);
        assert_eq!(finding.level, Level::Problem);
        assert!(candidate.is_none() && finding.text.contains("/nonexistent/graph.toml"));
    }
}
