//! The machine: cores, limits, kernel, instruction set.

use std::fs;

use rustix::process::{Resource, getrlimit};
use rustix::thread::{CpuSet, sched_getaffinity};

use super::Finding;

/// Files a service of the graph may have open: four a connection, on some thirty topics.
const OPEN_FILES: u64 = 512;
/// The kernel from which pages can be mapped before they are touched (MADV_POPULATE_WRITE).
const POPULATE_KERNEL: (u32, u32) = (5, 14);
/// Number of the capability CAP_SYS_NICE.
const CAP_SYS_NICE: u32 = 23;

/// Checks the machine; `wanted` are the cores of `--cores`.
pub(super) fn check(wanted: &[usize]) -> Vec<Finding> {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
    let online = parse_list(&read("/sys/devices/system/cpu/online"));
    let files = getrlimit(Resource::Nofile);
    let capabilities = read("/proc/self/status");
    vec![
        check_cores(&online, &allowed_cores(), wanted),
        check_governor(&governors(&online)),
        check_instructions(),
        check_open_files(files.current, files.maximum),
        check_real_time(getrlimit(Resource::Rtprio).current, &capabilities),
        check_kernel(&read("/proc/sys/kernel/osrelease")),
    ]
}

/// The cores this process may run on.
fn allowed_cores() -> Vec<usize> {
    let Ok(set) = sched_getaffinity(None) else { return Vec::new() };
    (0..CpuSet::MAX_CPU).filter(|core| set.is_set(*core)).collect()
}

/// A list of the kernel such as `0-3,6`; what is not a number is left out.
fn parse_list(text: &str) -> Vec<usize> {
    let mut numbers = Vec::new();
    for part in text.trim().split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        if let (Ok(first), Ok(last)) = (first.parse::<usize>(), last.parse::<usize>()) {
            numbers.extend(first..=last.min(CpuSet::MAX_CPU));
        }
    }
    numbers
}

fn check_cores(online: &[usize], allowed: &[usize], wanted: &[usize]) -> Finding {
    let subject = "cores";
    let absent: Vec<String> = wanted.iter().filter(|c| !allowed.contains(c)).map(usize::to_string).collect();
    if !allowed.is_empty() && !absent.is_empty() {
        let text = format!(
            "--cores names {}, but this process may use only {}; name others, or widen the affinity (taskset, cpuset)",
            absent.join(","),
            list(allowed)
        );
        return Finding::problem(subject, text);
    }
    if allowed.len() == 1 {
        return Finding::warning(subject, "one core: the services take turns, and latencies add up; allow two or more");
    }
    if allowed.len() < online.len() {
        let text = format!(
            "{} online, but this process may use only {}; widen the affinity (taskset, cpuset) to use all",
            online.len(),
            list(allowed)
        );
        return Finding::warning(subject, text);
    }
    Finding::ok(subject, format!("{}, all of them allowed", online.len().max(allowed.len())))
}

fn list(numbers: &[usize]) -> String {
    numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(",")
}

/// The frequency governors of the cores, each once.
fn governors(online: &[usize]) -> Vec<String> {
    let mut words: Vec<String> = online
        .iter()
        .filter_map(|core| {
            let path = format!("/sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor");
            Some(fs::read_to_string(path).ok()?.trim().to_owned())
        })
        .collect();
    words.sort();
    words.dedup();
    words
}

fn check_governor(governors: &[String]) -> Finding {
    let subject = "CPU governor";
    match governors {
        [] => Finding::ok(subject, "not to be read here (usual in virtual machines)"),
        [word] if word == "performance" => Finding::ok(subject, "performance"),
        words => {
            let text = format!(
                "{}: cores that slow down between scans wake late; for the shortest latency: cpupower frequency-set -g \
                 performance",
                words.join(", ")
            );
            Finding::warning(subject, text)
        }
    }
}

#[cfg(target_arch = "x86_64")]
fn check_instructions() -> Finding {
    let has =
        [("AVX2", std::arch::is_x86_feature_detected!("avx2")), ("FMA", std::arch::is_x86_feature_detected!("fma"))];
    instructions(&has)
}

#[cfg(target_arch = "aarch64")]
fn check_instructions() -> Finding {
    instructions(&[("NEON", std::arch::is_aarch64_feature_detected!("neon"))])
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn check_instructions() -> Finding {
    instructions(&[])
}

/// Vector instructions by name, and whether the processor has them.
fn instructions(has: &[(&str, bool)]) -> Finding {
    let names = |wanted: bool| has.iter().filter(|(_, h)| *h == wanted).map(|(n, _)| *n).collect::<Vec<_>>().join(", ");
    let (present, missing) = (names(true), names(false));
    if !missing.is_empty() {
        let text = format!("without {missing}: all results are right but slower; use a machine that has them");
        return Finding::warning("instructions", text);
    }
    let text = if present.is_empty() { "nothing known of this processor".into() } else { present };
    Finding::ok("instructions", text)
}

/// `None` is no limit.
fn check_open_files(current: Option<u64>, maximum: Option<u64>) -> Finding {
    let subject = "open files";
    let Some(limit) = current else { return Finding::ok(subject, "no limit") };
    if limit >= OPEN_FILES {
        return Finding::ok(subject, format!("{limit} a process"));
    }
    let remedy = match maximum {
        Some(maximum) if maximum < OPEN_FILES => format!("have the hard limit of {maximum} raised (limits.conf)"),
        _ => "run: ulimit -n 4096".to_owned(),
    };
    Finding::problem(subject, format!("{limit} a process, but a service may need {OPEN_FILES}; {remedy}"))
}

/// Only worth knowing: mirador runs at normal priority. `None` is no limit.
fn check_real_time(limit: Option<u64>, status: &str) -> Finding {
    let permitted = limit.is_none_or(|priority| priority > 0) || has_capability(status, CAP_SYS_NICE);
    let text = if permitted { "permitted" } else { "not permitted; not needed at normal priority" };
    Finding::ok("real-time", text)
}

/// Whether the effective capabilities of `/proc/self/status` include one.
fn has_capability(status: &str, number: u32) -> bool {
    status
        .lines()
        .find_map(|line| line.strip_prefix("CapEff:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask & (1 << number) != 0)
}

fn check_kernel(release: &str) -> Finding {
    let release = release.trim();
    let mut numbers = release.split(|c: char| !c.is_ascii_digit()).map(str::parse::<u32>);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(major)), Some(Ok(minor))) if (major, minor) < POPULATE_KERNEL => {
            let text = format!(
                "{release}: before 5.14 pages cannot be mapped ahead, so the first scans take longer; a newer kernel helps"
            );
            Finding::warning("kernel", text)
        }
        (Some(Ok(_)), Some(Ok(_))) => Finding::ok("kernel", format!("{release}, maps pages ahead")),
        _ => Finding::ok("kernel", "its version cannot be read"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::*;

    #[test]
    fn a_list_of_cores_is_read() {
        assert_eq!(parse_list("0-2,5\n"), [0, 1, 2, 5]);
        assert_eq!(parse_list("0\n"), [0]);
        assert!(parse_list("").is_empty() && parse_list("x-y").is_empty());
    }

    #[test]
    fn cores_that_may_not_be_used_are_named() {
        assert_eq!(check_cores(&[0, 1], &[0, 1], &[0]).level, Level::Ok);
        let narrow = check_cores(&[0, 1, 2, 3], &[1, 2], &[]);
        assert_eq!(narrow.level, Level::Warning);
        assert!(narrow.text.contains("1,2"), "{}", narrow.text);
        assert_eq!(check_cores(&[0, 1], &[1], &[]).level, Level::Warning);
        let absent = check_cores(&[0, 1], &[0, 1], &[1, 7]);
        assert_eq!(absent.level, Level::Problem);
        assert!(absent.text.contains("names 7,"), "{}", absent.text);
    }

    #[test]
    fn few_open_files_are_a_problem_with_the_right_remedy() {
        assert_eq!(check_open_files(None, None).level, Level::Ok);
        assert_eq!(check_open_files(Some(1024), Some(4096)).level, Level::Ok);
        let soft = check_open_files(Some(256), Some(4096));
        assert!(soft.level == Level::Problem && soft.text.contains("ulimit"), "{}", soft.text);
        let hard = check_open_files(Some(256), Some(256));
        assert!(hard.level == Level::Problem && hard.text.contains("limits.conf"), "{}", hard.text);
    }

    #[test]
    fn real_time_is_permitted_by_limit_or_capability() {
        let none = "Name:\tx\nCapEff:\t0000000000000000\n";
        let nice = "Name:\tx\nCapEff:\t0000000000800000\n";
        assert!(check_real_time(Some(0), none).text.starts_with("not permitted"));
        assert_eq!(check_real_time(Some(0), nice).text, "permitted");
        assert_eq!(check_real_time(Some(50), none).text, "permitted");
        assert_eq!(check_real_time(None, "").text, "permitted");
    }

    #[test]
    fn an_old_kernel_is_a_warning() {
        assert_eq!(check_kernel("5.10.0-28-amd64\n").level, Level::Warning);
        assert_eq!(check_kernel("5.14.0").level, Level::Ok);
        assert_eq!(check_kernel("6.1").level, Level::Ok);
        assert_eq!(check_kernel("").level, Level::Ok);
    }

    #[test]
    fn a_governor_that_saves_power_is_a_warning() {
        assert_eq!(check_governor(&["performance".into()]).level, Level::Ok);
        assert_eq!(check_governor(&["performance".into(), "powersave".into()]).level, Level::Warning);
        assert_eq!(check_governor(&[]).level, Level::Ok);
    }

    #[test]
    fn missing_instructions_are_named() {
        let found = instructions(&[("AVX2", true), ("FMA", false)]);
        assert!(found.level == Level::Warning && found.text.contains("without FMA"), "{}", found.text);
        assert_eq!(instructions(&[("NEON", true)]).text, "NEON");
    }
}
