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

/// The most alike so far, and how much it differs.
type Nearest = (f32, u32);

/// The nearest target of every source keypoint and the nearest source of every target keypoint, each pair once.
pub(super) fn matches(target: &Features, source: &Features, threads: usize) -> Vec<Match> {
    if target.is_empty() || source.is_empty() {
        return Vec::new();
    }
    let mut blocks: Vec<(Vec<Nearest>, Vec<Nearest>)> = vec![Default::default(); source.len().div_ceil(BLOCK)];
    threads::for_each(blocks.iter_mut().enumerate(), threads, |(block, out)| {
        *out = compare(target, source, block * BLOCK..((block + 1) * BLOCK).min(source.len()));
    });
    let mut of_target = vec![(f32::INFINITY, 0_u32); target.len()];
    let mut all: Vec<Match> = Vec::with_capacity(target.len() + source.len());
    for (of_source, others) in blocks {
        for (_, nearest) in of_source {
            all.push(Match { target: nearest, source: all.len() as u32 });
        }
        for (kept, other) in of_target.iter_mut().zip(others) {
            if other.0 < kept.0 {
                *kept = other;
            }
        }
    }
    all.extend(of_target.iter().enumerate().map(|(target, near)| Match { target: target as u32, source: near.1 }));
    all.sort_unstable();
    all.dedup();
    all
}

/// The nearest target of each of some sources, and for every target the nearest of these.
fn compare(target: &Features, source: &Features, range: std::ops::Range<usize>) -> (Vec<Nearest>, Vec<Nearest>) {
    let mut of_target = vec![(f32::INFINITY, 0_u32); target.len()];
    let of_source = range
        .map(|own| {
            let mut nearest = (f32::INFINITY, 0_u32);
            for (index, (other, kept)) in target.descriptors.iter().zip(&mut of_target).enumerate() {
                let distance = distance_sq(&source.descriptors[own], other);
                if distance < nearest.0 {
                    nearest = (distance, index as u32);
                }
                if distance < kept.0 {
                    *kept = (distance, own as u32);
                }
            }
            nearest
        })
        .collect();
    (of_source, of_target)
}
