//! A second look at alignments that overlap little, by evidence that registration did not use.

use crate::geometry::Pose;
use crate::registration::coarse::{CoarseAligner, CoarseConfig, CoarseScan, Evidence};
use crate::registration::{ConfigError, PreparedScan};

/// Weighs poses by what each scan has seen of the other, free space included.
///
/// It keeps the target reduced for coarse alignment once that was needed; what it says does not depend on it.
pub(super) struct Verifier {
    aligner: CoarseAligner,
    spacing_m: f64,
    target: Option<CoarseScan>,
    source: Option<CoarseScan>,
}

impl Verifier {
    /// For scans whose reduced points lie about `spacing_m` apart.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn new(config: CoarseConfig, spacing_m: f64) -> Result<Self, ConfigError> {
        ConfigError::check("spacing_m", spacing_m, 1e-3, 100.0)?;
        Ok(Self { aligner: CoarseAligner::new(config)?, spacing_m, target: None, source: None })
    }

    /// What speaks for and against the pose.
    pub fn weigh(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        target_from_source: &Pose,
    ) -> Evidence {
        let Self { aligner, spacing_m, .. } = self;
        let target = self.target.get_or_insert_with(|| aligner.prepare(target.points(), *spacing_m));
        let source = self.source.get_or_insert_with(|| aligner.prepare(source.points(), *spacing_m));
        aligner.verify(target, source, target_from_source).evidence
    }

    /// The same against a scan other than the target, which is not kept.
    pub fn weigh_other(
        &mut self,
        other: &dyn PreparedScan,
        source: &dyn PreparedScan,
        other_from_source: &Pose,
    ) -> Evidence {
        let Self { aligner, spacing_m, .. } = self;
        let other = aligner.prepare(other.points(), *spacing_m);
        let source = self.source.get_or_insert_with(|| aligner.prepare(source.points(), *spacing_m));
        aligner.verify(&other, source, other_from_source).evidence
    }

    /// The scan just weighed, if it was, is the next target when it was accepted.
    pub fn next(&mut self, accepted: bool) {
        let source = self.source.take();
        if accepted {
            self.target = source;
        }
    }

    /// The memory held [bytes].
    pub fn bytes(&self) -> usize {
        self.target.as_ref().map_or(0, CoarseScan::bytes)
    }
}
