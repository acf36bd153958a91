//! Matches that one rigid motion can explain together.
//!
//! Two matches agree when the distance between their points, and the angles of their normals with each other and with
//! the line between them, are the same in both scans: no motion changes these. Right matches all agree with one another
//! and form a clique; wrong ones agree by chance (Bustos et al. 2019; Yang et al. 2021, TEASER; Lim et al. 2025,
//! KISS-Matcher).

use nalgebra::Vector3;

use super::GlobalConfig;
use super::features::Features;
use super::matching::Match;
use crate::threads;

/// Nearer points say little about a rotation, in tolerances.
const LEAST_LEVER: f32 = 4.0;

/// Who agrees with whom, as bits.
pub(super) struct Agreements {
    words: usize,
    bits: Vec<u64>,
    degrees: Vec<u32>,
}

impl Agreements {
    /// Compares every match with every other.
    pub fn new(target: &Features, source: &Features, matches: &[Match], config: &GlobalConfig) -> Self {
        let words = matches.len().div_ceil(64);
        let mut bits = vec![0_u64; words * matches.len()];
        let rule = Rule {
            target: Sides::new(matches.iter().map(|m| m.target as usize), target),
            source: Sides::new(matches.iter().map(|m| m.source as usize), source),
            tolerance: config.consistency_m as f32,
            cosine: config.consistency_cosine as f32,
        };
        threads::for_each(bits.chunks_mut(words.max(1)).enumerate(), config.threads, |(i, row)| {
            for j in i + 1..matches.len() {
                row[j / 64] |= u64::from(rule.agree(i, j)) << (j % 64);
            }
        });
        mirror(&mut bits, words, matches.len());
        let degrees = bits.chunks(words.max(1)).map(|row| row.iter().map(|w| w.count_ones()).sum()).collect();
        Self { words, bits, degrees }
    }

    /// Large cliques, the largest first, no two with the same first two members: each grown from one of the matches
    /// with most agreements by adding, again and again, whoever agrees with most of those that are left.
    pub fn cliques(&self, seeds: usize) -> Vec<Vec<u32>> {
        let mut order: Vec<u32> = (0..self.degrees.len() as u32).collect();
        order.sort_unstable_by_key(|k| (u32::MAX - self.degrees[*k as usize], *k));
        let mut cliques: Vec<Vec<u32>> = Vec::new();
        for seed in order.into_iter() {
            if cliques.len() >= seeds {
                break;
            }
            if cliques.iter().any(|clique| clique.contains(&seed)) {
                continue;
            }
            cliques.push(self.grow(seed));
        }
        cliques.sort_by_key(|clique| usize::MAX - clique.len());
        cliques
    }

    fn grow(&self, seed: u32) -> Vec<u32> {
        let mut clique = vec![seed];
        let mut left: Vec<u64> = self.row(seed).to_vec();
        loop {
            let mut best: Option<(u32, u32)> = None;
            for index in ones(&left) {
                let common = self.row(index).iter().zip(&left).map(|(a, b)| (a & b).count_ones()).sum();
                if best.is_none_or(|(most, _)| common > most) {
                    best = Some((common, index));
                }
            }
            let Some((_, index)) = best else { return clique };
            clique.push(index);
            for (word, row) in left.iter_mut().zip(self.row(index)) {
                *word &= row;
            }
        }
    }

    fn row(&self, index: u32) -> &[u64] {
        let start = index as usize * self.words;
        &self.bits[start..start + self.words]
    }
}

/// Copies the upper half of the bits into the lower.
fn mirror(bits: &mut [u64], words: usize, count: usize) {
    for i in 0..count {
        for word in i / 64..words {
            let mut rest = bits[i * words + word];
            while rest != 0 {
                let j = word * 64 + rest.trailing_zeros() as usize;
                rest &= rest - 1;
                if j > i {
                    bits[j * words + i / 64] |= 1 << (i % 64);
                }
            }
        }
    }
}

/// The positions of the bits that are set.
fn ones(words: &[u64]) -> impl Iterator<Item = u32> + '_ {
    words.iter().enumerate().flat_map(|(k, word)| {
        let mut rest = *word;
        std::iter::from_fn(move || {
            let bit = rest.trailing_zeros();
            (rest != 0).then(|| {
                rest &= rest - 1;
                k as u32 * 64 + bit
            })
        })
    })
}

/// The matched keypoints of one scan, in the order of the matches.
struct Sides {
    points: Vec<Vector3<f32>>,
    normals: Vec<Vector3<f32>>,
}

impl Sides {
    fn new(indices: impl Iterator<Item = usize> + Clone, features: &Features) -> Self {
        Self {
            points: indices.clone().map(|k| Vector3::from(features.points[k])).collect(),
            normals: indices.map(|k| Vector3::from(features.normals[k])).collect(),
        }
    }

    /// The distance of two points, the cosine of their normals, and of each normal with the line between them.
    #[inline]
    fn relation(&self, i: usize, j: usize) -> (f32, [f32; 3]) {
        let line = self.points[j] - self.points[i];
        let distance = line.norm();
        let (a, b) = (self.normals[i], self.normals[j]);
        let inverse = 1.0 / distance.max(1e-6);
        (distance, [a.dot(&b), a.dot(&line) * inverse, b.dot(&line) * inverse])
    }
}

/// When two matches agree.
struct Rule {
    target: Sides,
    source: Sides,
    tolerance: f32,
    cosine: f32,
}

impl Rule {
    #[inline]
    fn agree(&self, i: usize, j: usize) -> bool {
        let (a, b) = (
            (self.target.points[j] - self.target.points[i]).norm_squared(),
            (self.source.points[j] - self.source.points[i]).norm_squared(),
        );
        let least = LEAST_LEVER * self.tolerance;
        if a.min(b) < least * least || (a.sqrt() - b.sqrt()).abs() > self.tolerance {
            return false;
        }
        let (_, of_target) = self.target.relation(i, j);
        let (_, of_source) = self.source.relation(i, j);
        of_target.iter().zip(&of_source).all(|(a, b)| (a - b).abs() < self.cosine)
    }
}
