//! The plug: what a registration method promises.

use std::any::Any;

use thiserror::Error;

use super::{Alignment, ConfigError, Limits};
use crate::geometry::Pose;
use crate::scan::ScanView;

/// A registration method. It is object safe, and a user's crate implements it without touching this one.
///
/// `prepare` is called once a scan, `align` any number of times with what it returned, in any order and role (every
/// prepared scan serves as target and as source). Both are deterministic: same input, same bits, whatever the number
/// of threads and whatever was called before.
pub trait Registration: Send {
    /// The name under which the method is registered and reported.
    fn name(&self) -> &str;

    /// Reduces a scan to what `align` needs: filtered and thinned points, an index, normals. Cells without a return
    /// are ignored. The points stay in the scanner's frame [m].
    ///
    /// # Errors
    /// [`PrepareError`] when too little is left of the scan to align it.
    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError>;

    /// Aligns `source` to `target` from the start `initial_target_from_source`, within `limits`.
    ///
    /// Two scans that do not fit are not an error: the result says so by its overlap, residual, `converged` and
    /// `constraint`, and whoever asked decides.
    ///
    /// # Errors
    /// [`AlignError`] when the question itself makes no sense.
    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        initial_target_from_source: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError>;

    /// Says which scans the next alignments are of, for a method that asks or tells somebody else. Results never depend on it.
    fn name_pair(&mut self, _pair: PairIds) {}
}

/// The ids of two scans that are to be aligned; `None` for what is no single scan, or not known by an id.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PairIds {
    /// Of the target.
    pub target: Option<u64>,
    /// Of the source.
    pub source: Option<u64>,
}

/// A scan as one method prepared it; the keyframe that alignment keeps of a scan.
pub trait PreparedScan: Any + Send + Sync {
    /// The reduced points [m, scanner frame], in the method's own order.
    fn points(&self) -> &[[f32; 3]];

    /// The memory it holds [bytes].
    fn bytes(&self) -> usize;

    /// Does now what the first alignment to this scan as the target would do first, so that it need not wait for it.
    /// Results never depend on it.
    fn prepare_as_target(&self) {}

    /// For the method that prepared it, to find its own type again.
    fn as_any(&self) -> &dyn Any;
}

/// Why a scan could not be prepared.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PrepareError {
    /// No cell has a return within the range limits.
    #[error("the scan has no return between {min_range_m} m and {max_range_m} m; {returns} of its points are returns")]
    NoPoints {
        /// Points with a return, at any range.
        returns: usize,
        /// `preparation.min_range_m` [m].
        min_range_m: f64,
        /// `preparation.max_range_m` [m].
        max_range_m: f64,
    },
    /// After thinning, fewer points are left than registration can work with.
    #[error(
        "{points} points are left of the scan after thinning, at least {required} are needed (preparation.minimum_points)"
    )]
    TooFewPoints {
        /// Points left.
        points: usize,
        /// Points needed.
        required: usize,
    },
    /// A method from outside this crate refused the scan.
    #[error("{method} cannot prepare the scan: {reason}")]
    Method {
        /// The method's name.
        method: String,
        /// Its own words.
        reason: String,
    },
}

/// Why two scans could not be compared at all.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum AlignError {
    /// The prepared scan belongs to a method with another representation.
    #[error("{method} was given a {role} that another method prepared")]
    ForeignScan {
        /// The method that was asked.
        method: String,
        /// `target` or `source`.
        role: &'static str,
    },
    /// The start holds a value that is not finite.
    #[error("the initial pose holds a value that is not finite")]
    StartNotFinite,
    /// The limits are out of range.
    #[error(transparent)]
    Limits(#[from] ConfigError),
    /// A method from outside this crate gave up.
    #[error("{method} failed: {reason}")]
    Method {
        /// The method's name.
        method: String,
        /// Its own words.
        reason: String,
    },
}
