//! Work shared among threads. What a piece of work gives never depends on who does it or on how many there are.
//!
//! Threads are started for each call and end with it: on two cores this costs some 45 microseconds a helper, about one
//! in a hundred of what a stage shares out, and lets the work borrow from its caller without `unsafe`.

mod blocks;

pub(crate) use blocks::{for_blocks, for_blocks2};

use std::sync::{Mutex, PoisonError};

/// Calls `work` with every part, on up to `threads` threads, the caller's among them. Whoever is free takes the next
/// part, so a slow core holds nobody up. One thread works in place, without locks or allocation.
pub(crate) fn for_each<P>(parts: impl Iterator<Item = P> + Send, threads: usize, work: impl Fn(P) + Sync) {
    if threads <= 1 {
        parts.for_each(work);
        return;
    }
    let queue = Mutex::new(parts);
    let work_off = || {
        loop {
            let next = queue.lock().unwrap_or_else(PoisonError::into_inner).next();
            let Some(part) = next else { return };
            work(part);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            // Where the system refuses a thread, the others do its share.
            if std::thread::Builder::new().spawn_scoped(scope, work_off).is_err() {
                break;
            }
        }
        work_off();
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_taken_once_by_any_number_of_threads() {
        for threads in 0..9 {
            let mut results = [0_usize; 7];
            for_each(results.iter_mut().enumerate(), threads, |(k, result)| *result += k + 1);
            assert_eq!(results, [1, 2, 3, 4, 5, 6, 7]);
        }
        for_each(std::iter::empty::<u8>(), 2, |_| unreachable!());
    }
}
