//! Alignment without any prior.

use nalgebra::Vector3;

use super::consistency::Agreements;
use super::features::Features;
use super::{GlobalConfig, matching, rigid};
use crate::geometry::Pose;
use crate::registration::coarse::{CoarseAligner, CoarseAlignment, Keyframe, Relocalisation};
use crate::registration::{ConfigError, Registration};

/// A scan for alignment without a prior.
#[derive(Clone, Copy)]
pub struct GlobalKeyframe<'a> {
    /// For refinement and verification.
    pub keyframe: Keyframe<'a>,
    /// Its keypoints.
    pub features: &'a Features,
}

/// Finds the pose of one scan in another by what their keypoints look like, whichever way the scanners stood.
#[derive(Debug, Clone)]
pub struct GlobalAligner {
    config: GlobalConfig,
}

impl GlobalAligner {
    /// An aligner with these settings.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn new(config: GlobalConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self { config })
    }

    /// Describes a scan.
    #[must_use]
    pub fn prepare(&self, scan: &crate::registration::coarse::CoarseScan) -> Features {
        Features::new(scan, &self.config)
    }

    /// Poses `target_from_source` under which many keypoints coincide, those with most first.
    #[must_use]
    pub fn candidates(&self, target: &Features, source: &Features) -> Vec<Pose> {
        let matches = matching::matches(target, source, self.config.threads);
        let agreements = Agreements::new(target, source, &matches, &self.config);
        let vector = |points: &[[f32; 3]], index: u32| {
            points.get(index as usize).map_or_else(Vector3::zeros, |p| Vector3::from(p.map(f64::from)))
        };
        let mut poses = Vec::new();
        for clique in agreements.cliques(self.config.seeds) {
            let members = clique.iter().filter_map(|k| matches.get(*k as usize));
            let pairs: Vec<_> =
                members.map(|m| (vector(&target.points, m.target), vector(&source.points, m.source))).collect();
            poses.extend(rigid::fit(&pairs));
            if poses.len() >= self.config.hypotheses {
                break;
            }
        }
        poses
    }

    /// The candidates moved to where surfaces meet, judged and ranked by `coarse`.
    #[must_use]
    pub fn align(
        &self,
        coarse: &CoarseAligner,
        target: GlobalKeyframe<'_>,
        source: GlobalKeyframe<'_>,
    ) -> CoarseAlignment {
        let candidates = self.candidates(target.features, source.features);
        coarse.rank(target.keyframe.coarse, source.keyframe.coarse, &candidates)
    }

    /// Searches without a prior, refines the best hypotheses with `registration` and returns the first that
    /// verification trusts; else the best one with the reason to doubt it.
    #[must_use]
    pub fn locate(
        &self,
        coarse: &CoarseAligner,
        registration: &mut dyn Registration,
        target: GlobalKeyframe<'_>,
        source: GlobalKeyframe<'_>,
    ) -> Relocalisation {
        let found = self.align(coarse, target, source);
        coarse.confirm(registration, target.keyframe, source.keyframe, &found)
    }
}
