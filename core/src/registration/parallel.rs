//! Work shared among threads in fixed blocks, so that the outcome does not depend on how many there are.

/// Calls `work(block, &mut results[block])` for every block, on up to `threads` threads (the caller's is one of them).
/// Blocks are independent: each writes its own result only, and the caller combines them in their own order.
pub(super) fn for_each_block<R: Send>(results: &mut [R], threads: usize, work: impl Fn(usize, &mut R) + Sync) {
    let share = results.len().div_ceil(threads.max(1)).max(1);
    if share >= results.len() {
        results.iter_mut().enumerate().for_each(|(block, result)| work(block, result));
        return;
    }
    let run = |first: usize, part: &mut [R]| {
        part.iter_mut().enumerate().for_each(|(offset, result)| work(first + offset, result));
    };
    let run = &run;
    std::thread::scope(|scope| {
        let mut parts = results.chunks_mut(share).enumerate();
        let own = parts.next();
        for (k, part) in parts {
            scope.spawn(move || run(k * share, part));
        }
        if let Some((_, part)) = own {
            run(0, part);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_block_is_visited_once_by_any_number_of_threads() {
        for threads in 1..9 {
            let mut results = [0_usize; 7];
            for_each_block(&mut results, threads, |block, result| *result += block + 1);
            assert_eq!(results, [1, 2, 3, 4, 5, 6, 7]);
        }
        for_each_block(&mut [] as &mut [u8], 2, |_, _| unreachable!());
    }
}
