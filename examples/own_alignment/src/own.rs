//! Your alignment: from a scan and its prior to a pose. Here it is mirador's sequential one, with point to plane.

use std::error::Error;

use mirador_core::geometry::{Covariance, Pose};
use mirador_core::registration::{RegistrationConfig, Registry};
use mirador_core::scan::ScanView;
use mirador_core::slam6d::{AlignmentStatus, SequentialAligner, SequentialConfig};

/// What is to be said of a scan.
pub struct Found {
    pub map_from_scanner: Pose,
    /// 6x6, translation before rotation, perturbation on the right, in the scanner's frame.
    pub covariance: Covariance,
    /// The same against the target alone; zero where it was not aligned.
    pub pair_covariance: Covariance,
    pub prior: Option<Pose>,
    /// The scan it was aligned to; none for the first one, which defines the map.
    pub target_id: Option<u64>,
    pub overlap: f64,
    pub residual_m: f64,
    pub iterations: u32,
    /// Why it was not aligned: then its pose is a guess.
    pub rejected: Option<String>,
}

/// The state of your alignment.
pub struct Own {
    aligner: SequentialAligner,
}

impl Own {
    pub fn new(threads: usize) -> Result<Self, Box<dyn Error>> {
        let config = RegistrationConfig { threads, ..RegistrationConfig::default() };
        let method = Registry::default().create("point_to_plane", &config)?;
        let aligner = SequentialAligner::new(method, SequentialConfig::default(), config.preparation.voxel_m)?;
        Ok(Self { aligner })
    }

    /// The scan's points lie in shared memory: take what you need of them, they are gone when this returns.
    pub fn align(&mut self, id: u64, scan: ScanView<'_>, prior: Option<Pose>) -> Found {
        let record = self.aligner.align_next(id, scan, prior);
        let rejected = match &record.status {
            AlignmentStatus::NotAligned(why) => Some(why.to_string()),
            AlignmentStatus::First | AlignmentStatus::Aligned => None,
        };
        Found {
            map_from_scanner: record.map_from_scanner,
            covariance: record.covariance,
            pair_covariance: record.pair_covariance.unwrap_or_else(Covariance::zeros),
            prior: record.prior,
            target_id: record.target_id,
            overlap: record.overlap,
            residual_m: record.residual_m,
            iterations: record.iterations,
            rejected,
        }
    }
}
