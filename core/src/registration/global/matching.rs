//! Which keypoints look alike.

use super::features::{Features, distance_sq};
use crate::threads;

/// Keypoints a thread works on at a time.
const BLOCK: usize = 64;

/// A keypoint of the target and one of the source that look alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Match {
    pub target: u32,
    pub source: u32,
}

/// The nearest target of every source keypoint and the nearest source of every target keypoint, each pair once.
pub(super) fn matches(target: &Features, source: &Features, threads: usize) -> Vec<Match> {
    let of_source = nearest(source, target, threads);
    let of_target = nearest(target, source, threads);
    let mut all: Vec<Match> = Vec::with_capacity(of_source.len() + of_target.len());
    all.extend(of_source.iter().enumerate().map(|(source, target)| Match { target: *target, source: source as u32 }));
    all.extend(of_target.iter().enumerate().map(|(target, source)| Match { target: target as u32, source: *source }));
    all.sort_unstable();
    all.dedup();
    all
}

/// For every keypoint of `of` the one of `among` that looks most alike; nothing when there is none.
fn nearest(of: &Features, among: &Features, threads: usize) -> Vec<u32> {
    if among.is_empty() {
        return Vec::new();
    }
    let mut nearest = vec![0_u32; of.len()];
    threads::for_each(nearest.chunks_mut(BLOCK).enumerate(), threads, |(block, nearest)| {
        for (out, own) in nearest.iter_mut().zip(of.descriptors.iter().skip(block * BLOCK)) {
            let mut least = f32::INFINITY;
            for (index, other) in among.descriptors.iter().enumerate() {
                let distance = distance_sq(own, other);
                if distance < least {
                    (least, *out) = (distance, index as u32);
                }
            }
        }
    });
    nearest
}
