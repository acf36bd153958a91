//! Where a lost scanner is, by what the keyframes of the map look like.

use std::collections::BTreeMap;

use super::RelocalisationConfig;
use crate::registration::coarse::{CoarseAligner, CoarseConfig, CoarseScan, Keyframe, Relocalisation};
use crate::registration::global::{Features, GlobalAligner, GlobalKeyframe};
use crate::registration::{ConfigError, PrepareError, PreparedScan, Registration};
use crate::scan::{Point, ScanView};
use crate::slam6d::global::GlobalAligner as MapAligner;

/// Shells of a profile, a metre each.
const SHELLS: usize = 60;

/// How the points of a scan are spread over the distances from the scanner: the share in each shell. However the scanner
/// is turned, the profile stays the same, and a few metres away it is alike; so it says which keyframes to look at first.
/// On the recorded walk one of the four most alike is of the same place in 9 cases of 10.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RangeProfile([f32; SHELLS + 1]);

impl RangeProfile {
    /// Of points thinned to one a voxel, so that the density of the beams does not count [m, scanner frame].
    pub fn new(points: &[[f32; 3]]) -> Self {
        let mut counts = [0.0; SHELLS + 1];
        for [x, y, z] in points {
            let range = (x * x + y * y + z * z).sqrt();
            counts[(range as usize).min(SHELLS)] += 1.0;
        }
        let share = 1.0 / points.len().max(1) as f32;
        counts.iter_mut().for_each(|count| *count *= share);
        Self(counts)
    }

    /// The share of the points that lie elsewhere, twice: 0 for the same profile, 2 for two that share no shell.
    pub fn distance(&self, other: &Self) -> f32 {
        self.0.iter().zip(&other.0).map(|(a, b)| (a - b).abs()).sum()
    }
}

/// Compares a lost frame with keyframes.
#[derive(Debug)]
pub(super) struct Relocaliser {
    /// Of the keyframes that were looked at, by scan.
    profiles: BTreeMap<u64, RangeProfile>,
    coarse: CoarseAligner,
    search: GlobalAligner,
    spacing_m: f64,
}

/// A scan as the comparison needs it.
pub(super) struct Seen {
    prepared: Box<dyn PreparedScan>,
    coarse: CoarseScan,
    features: Features,
}

impl Seen {
    /// The reduced points [m, scanner frame].
    pub fn points(&self) -> &[[f32; 3]] {
        self.prepared.points()
    }

    fn keyframe(&self) -> GlobalKeyframe<'_> {
        let keyframe = Keyframe { prepared: &*self.prepared, coarse: &self.coarse };
        GlobalKeyframe { keyframe, features: &self.features }
    }
}

impl Relocaliser {
    /// For scans whose reduced points lie about `spacing_m` apart.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn new(config: &RelocalisationConfig, coarse: CoarseConfig, spacing_m: f64) -> Result<Self, ConfigError> {
        let search = GlobalAligner::new(config.search.clone())?;
        Ok(Self { profiles: BTreeMap::new(), coarse: CoarseAligner::new(coarse)?, search, spacing_m })
    }

    /// Keyframes, those first that look most like `points` by their profiles, which are thinned as theirs are.
    pub fn most_alike(&mut self, points: &[[f32; 3]], map: &MapAligner) -> Vec<u64> {
        let own = RangeProfile::new(points);
        let mut ranked: Vec<(f32, u64)> = Vec::new();
        for (id, _) in map.poses() {
            let profile =
                self.profiles.entry(id).or_insert_with(|| RangeProfile::new(&map.points_of(id).unwrap_or_default()));
            ranked.push((own.distance(profile), id));
        }
        // Stable: of two alike the earlier stays first.
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        ranked.into_iter().map(|(_, id)| id).collect()
    }

    /// The memory held [bytes].
    pub fn bytes(&self) -> usize {
        self.profiles.len() * size_of::<(u64, RangeProfile)>()
    }

    /// A scan made ready for comparisons.
    ///
    /// # Errors
    /// [`PrepareError`] when too little is left of it.
    pub fn see(&self, registration: &dyn Registration, scan: ScanView<'_>) -> Result<Seen, PrepareError> {
        let prepared = registration.prepare(scan)?;
        let coarse = self.coarse.prepare(prepared.points(), self.spacing_m);
        let features = self.search.prepare(&coarse);
        Ok(Seen { prepared, coarse, features })
    }

    /// The same for the points of a keyframe [m, scanner frame].
    ///
    /// # Errors
    /// [`PrepareError`] when too little is left of them.
    pub fn see_points(&self, registration: &dyn Registration, points: &[[f32; 3]]) -> Result<Seen, PrepareError> {
        let points: Vec<Point> = points.iter().map(|[x, y, z]| Point::new(*x, *y, *z)).collect();
        self.see(registration, ScanView::unordered(&points))
    }

    /// Where `source` was, seen from `target`; and whether to believe it.
    pub fn locate(&self, registration: &mut dyn Registration, target: &Seen, source: &Seen) -> Relocalisation {
        self.search.locate(&self.coarse, registration, target.keyframe(), source.keyframe())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_does_not_change_when_the_scanner_turns_and_does_when_it_moves_far() {
        let points: Vec<[f32; 3]> = (0..500).map(|k| [0.05 * k as f32, 3.0 + (k % 7) as f32, 0.3]).collect();
        let own = RangeProfile::new(&points);
        let turned: Vec<_> = points.iter().map(|[x, y, z]| [-y, *z, -x]).collect();
        assert!(own.distance(&RangeProfile::new(&turned)) < 1e-5);
        let moved: Vec<_> = points.iter().map(|[x, y, z]| [x + 15.0, *y, *z]).collect();
        assert!(own.distance(&RangeProfile::new(&moved)) > 0.5);
        assert!(RangeProfile::new(&[]).distance(&own) > 0.99);
    }
}
