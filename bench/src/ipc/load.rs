//! Something else to do for every core, as on a machine that also does other work.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use super::pin;

/// Bytes that each of the busy threads goes through again and again: more than a core's own caches.
const BYTES: usize = 8 << 20;

/// A busy thread on every core; they end when this is dropped.
pub(super) struct Load {
    end: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    /// Starts a thread on each of these cores.
    pub fn start(cores: &[usize]) -> Self {
        let end = Arc::new(AtomicBool::new(false));
        let busy = |core: usize| {
            let end = Arc::clone(&end);
            std::thread::spawn(move || {
                pin::pin(core);
                let mut memory = vec![1_u64; BYTES / 8];
                while !end.load(Ordering::Relaxed) {
                    for word in &mut memory {
                        *word = word.rotate_left(7) ^ 0x9e37_79b9;
                    }
                    std::hint::black_box(&memory);
                }
            })
        };
        Self { threads: cores.iter().copied().map(busy).collect(), end }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // It does nothing that could fail.
            let _ = thread.join();
        }
    }
}
