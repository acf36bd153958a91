//! Real registration whose answers are bent by the test.

use super::*;
use crate::registration::{AlignError, Alignment, Limits, PrepareError, PreparedScan};

/// What a pair of scans was asked for: the number of the target's points, the start, the limits.
pub struct Asked<'a> {
    pub target_points: usize,
    pub start: &'a Pose,
    pub limits: &'a Limits,
}

/// A method, and what is done to each of its answers.
pub struct Bent<F> {
    pub method: Box<dyn Registration>,
    pub bend: F,
}

impl<F: FnMut(&mut Alignment, Asked<'_>) + Send> Registration for Bent<F> {
    fn name(&self) -> &str {
        self.method.name()
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        self.method.prepare(scan)
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        start: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let mut alignment = self.method.align(target, source, start, limits)?;
        (self.bend)(&mut alignment, Asked { target_points: target.points().len(), start, limits });
        Ok(alignment)
    }
}
