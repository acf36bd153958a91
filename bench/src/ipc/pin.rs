//! Cores: publisher and subscriber each stay on one of their own.

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// The cores of publisher and subscriber: the first and the last this thread may use; none when it has only one.
pub(super) fn two_cores() -> Option<(usize, usize)> {
    let allowed = sched_getaffinity(None).ok()?;
    let mut cores = (0..CpuSet::MAX_CPU).filter(|core| allowed.is_set(*core));
    let first = cores.next()?;
    Some((first, cores.next_back()?))
}

/// Keeps the calling thread on `core` from now on.
pub(super) fn pin(core: usize) {
    let mut set = CpuSet::new();
    set.set(core);
    if let Err(error) = sched_setaffinity(None, &set) {
        tracing::warn!(core, %error, "cannot be pinned to a core: the figures are noisier");
    }
}

/// Gives the calling thread its cores back when dropped.
pub(super) struct Restore(Option<CpuSet>);

impl Restore {
    /// Remembers the cores of the calling thread.
    pub fn now() -> Self {
        Self(sched_getaffinity(None).ok())
    }
}

impl Drop for Restore {
    fn drop(&mut self) {
        if let Some(Err(error)) = self.0.map(|cores| sched_setaffinity(None, &cores)) {
            tracing::warn!(%error, "the thread stays pinned");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pinned_thread_gets_its_cores_back() {
        let before = sched_getaffinity(None).unwrap();
        let Some((first, last)) = two_cores() else {
            // On standard error itself: the test runner keeps what a passing test prints.
            let why = "SKIPPED: a_pinned_thread_gets_its_cores_back: only one core";
            let _ = std::io::Write::write_all(&mut std::io::stderr(), format!("{why}\n").as_bytes());
            return;
        };
        assert_ne!(first, last);
        {
            let _restore = Restore::now();
            pin(last);
            let pinned = sched_getaffinity(None).unwrap();
            assert!(pinned.count() == 1 && pinned.is_set(last));
        }
        assert_eq!(sched_getaffinity(None).unwrap(), before);
    }
}
