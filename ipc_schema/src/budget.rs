//! What a graph takes of `/dev/shm`, worked out before anything is created.
//!
//! A full `/dev/shm` is not an error but a SIGBUS at the first write, so the sum is checked against the free space at
//! start, and the segments are allocated then and there.

use crate::domain::SHM;
use crate::topics::{ALL, Sizes};

/// Bytes iceoryx2 adds to every slot: its own header and alignment.
const SLOT_OVERHEAD: usize = 256;
/// Bytes of management files for every topic and connection, rounded up.
const TOPIC_OVERHEAD: usize = 256 * 1024;

/// The name under which a foreign registration is counted among the services of a graph.
pub const FOREIGN_REGISTRATION: &str = "registration";

/// The memory one publisher of a topic takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicMemory {
    /// The topic.
    pub topic: &'static str,
    /// Slots of one publisher.
    pub slots: usize,
    /// Bytes of one slot.
    pub slot_bytes: usize,
    /// Publishers that are counted.
    pub publishers: usize,
}

impl TopicMemory {
    /// All slots of all publishers, and the management files [bytes].
    #[must_use]
    pub fn bytes(&self) -> u64 {
        (self.publishers * (self.slots * self.slot_bytes + TOPIC_OVERHEAD)) as u64
    }
}

/// `/dev/shm` cannot hold the graph.
#[derive(Debug, thiserror::Error)]
pub enum BudgetError {
    /// There is less free space than the slots need.
    #[error(
        "/dev/shm has {free_mb:.0} MB free of {total_mb:.0} MB, but this graph needs {needed_mb:.0} MB for scans of up to \
         {scan_points} points: enlarge it (Docker: --shm-size={suggested_mb:.0}m; else: mount -o remount,size=... /dev/shm), \
         or lower graph.max_points"
    )]
    TooSmall {
        /// Free space [MB].
        free_mb: f64,
        /// Size of the file system [MB].
        total_mb: f64,
        /// Need [MB].
        needed_mb: f64,
        /// Need with room to spare [MB].
        suggested_mb: f64,
        /// Points of the largest scan.
        scan_points: usize,
    },
    /// `/dev/shm` is not there.
    #[error("/dev/shm cannot be asked for its size ({reason}): shared memory is needed, mount a tmpfs there")]
    Missing {
        /// What the system said.
        reason: String,
    },
}

/// The memory of a graph of these services, topic by topic.
#[must_use]
pub fn of_graph(services: &[&str], sizes: &Sizes) -> Vec<TopicMemory> {
    ALL.iter()
        .filter_map(|topic| {
            let rules = &topic.rules;
            let publishers = match rules.publisher {
                // Alignment opens these only when it asks a foreign process.
                "alignment" if rules.name.starts_with("registration_") => {
                    usize::from(services.contains(&FOREIGN_REGISTRATION))
                }
                // The supervisor reports its own health too.
                "" if rules.name == "service_health" => services.len() + 1,
                "" => usize::from(rules.name == "scan_request"),
                publisher => usize::from(services.contains(&publisher)),
            };
            let slot_bytes = topic.meta_bytes + sizes.items(rules.capacity) * topic.item_bytes + SLOT_OVERHEAD;
            (publishers > 0).then_some(TopicMemory { topic: rules.name, slots: rules.slots(), slot_bytes, publishers })
        })
        .collect()
}

/// The sum over all topics [bytes].
#[must_use]
pub fn total(memory: &[TopicMemory]) -> u64 {
    memory.iter().map(TopicMemory::bytes).sum()
}

/// Free and total bytes of `/dev/shm`.
///
/// # Errors
/// [`BudgetError::Missing`].
pub fn shared_memory_space() -> Result<(u64, u64), BudgetError> {
    let stat = rustix::fs::statvfs(SHM).map_err(|e| BudgetError::Missing { reason: e.to_string() })?;
    Ok((stat.f_bavail * stat.f_frsize, stat.f_blocks * stat.f_frsize))
}

/// Checks that a graph fits.
///
/// # Errors
/// [`BudgetError::TooSmall`] with the numbers.
pub fn check(services: &[&str], sizes: &Sizes) -> Result<u64, BudgetError> {
    let (free, total_space) = shared_memory_space()?;
    check_against(services, sizes, free, total_space)
}

/// [`check`] against a given space.
///
/// # Errors
/// [`BudgetError::TooSmall`] with the numbers.
pub fn check_against(services: &[&str], sizes: &Sizes, free: u64, space: u64) -> Result<u64, BudgetError> {
    let needed = total(&of_graph(services, sizes));
    if needed > free {
        let mb = |bytes: u64| bytes as f64 / 1e6;
        return Err(BudgetError::TooSmall {
            free_mb: mb(free),
            total_mb: mb(space),
            needed_mb: mb(needed),
            suggested_mb: (mb(needed) * 1.3).ceil(),
            scan_points: sizes.scan_points,
        });
    }
    Ok(needed)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAPH: &[&str] = &["acquisition", "alignment", "analysis", "planning", "recorder"];

    #[test]
    fn the_default_of_docker_is_refused_with_the_numbers() {
        let error = check_against(GRAPH, &Sizes { scan_points: 389_520 }, 64 << 20, 64 << 20).unwrap_err().to_string();
        assert!(error.contains("67 MB free") && error.contains("--shm-size="), "{error}");
    }

    #[test]
    fn larger_scans_need_more_memory() {
        let small = total(&of_graph(GRAPH, &Sizes { scan_points: 1_000 }));
        let large = total(&of_graph(GRAPH, &Sizes { scan_points: 389_520 }));
        assert!(large > small + 100_000_000);
    }

    #[test]
    fn keyframes_for_a_foreign_registration_are_counted_where_there_is_one() {
        let sizes = Sizes { scan_points: 100_000 };
        let with = [GRAPH, &[FOREIGN_REGISTRATION]].concat();
        let requests = |services: &[&str]| of_graph(services, &sizes).iter().any(|t| t.topic == "registration_request");
        assert!(requests(&with) && !requests(GRAPH));
    }

    #[test]
    fn services_that_do_not_run_take_nothing() {
        assert!(of_graph(&["recorder"], &Sizes { scan_points: 10 }).iter().all(|t| t.topic != "scan"));
    }
}
