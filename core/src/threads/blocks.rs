//! Row-blocked work: the rows of an output are cut into blocks. What a row becomes never depends on the block it lies
//! in, so any number of threads gives the same bits.

use super::for_each;

/// So many blocks a thread: enough that all end at about the same time, few enough that blocks cost nothing.
const BLOCKS_A_THREAD: usize = 4;

/// The number of rows of one block.
fn rows_per_block(items: usize, row_len: usize, threads: usize) -> usize {
    (items / row_len.max(1)).div_ceil(threads.saturating_mul(BLOCKS_A_THREAD).max(1)).max(1)
}

/// Calls `work(first_row, rows)` on blocks of whole rows of `out`; one thread runs in place, without allocation.
pub(crate) fn for_blocks<T: Send>(
    out: &mut [T],
    row_len: usize,
    threads: usize,
    work: impl Fn(usize, &mut [T]) + Sync,
) {
    let rows = rows_per_block(out.len(), row_len, threads);
    if out.is_empty() {
        return;
    }
    if threads <= 1 || rows * row_len >= out.len() {
        work(0, out);
        return;
    }
    let blocks = out.chunks_mut(rows * row_len).enumerate();
    for_each(blocks, threads, |(block, rows_out)| work(block * rows, rows_out));
}

/// As [`for_blocks`], for two outputs of equal length.
pub(crate) fn for_blocks2<T: Send, U: Send>(
    first: &mut [T],
    second: &mut [U],
    row_len: usize,
    threads: usize,
    work: impl Fn(usize, &mut [T], &mut [U]) + Sync,
) {
    let rows = rows_per_block(first.len(), row_len, threads);
    if first.is_empty() {
        return;
    }
    if threads <= 1 || rows * row_len >= first.len() {
        work(0, first, second);
        return;
    }
    let chunk = rows * row_len;
    let blocks = first.chunks_mut(chunk).zip(second.chunks_mut(chunk)).enumerate();
    for_each(blocks, threads, |(block, (a, b))| work(block * rows, a, b));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_visited_once_whatever_the_number_of_threads() {
        for threads in 1..5 {
            let mut out = vec![0usize; 7 * 3];
            for_blocks(&mut out, 3, threads, |first_row, rows| {
                for (offset, value) in rows.iter_mut().enumerate() {
                    *value += first_row * 3 + offset + 1;
                }
            });
            assert_eq!(out, (1..=21).collect::<Vec<_>>());
        }
    }

    #[test]
    fn an_empty_output_asks_for_no_work() {
        for_blocks(&mut [] as &mut [u8], 0, 2, |_, _| panic!("no rows to work on"));
    }
}
