//! Real registration whose answers are bent by the test.

use super::*;
use crate::registration::{AlignError, Alignment, Limits, PairIds, PrepareError, PreparedScan};

/// What a pair of scans was asked for: the id of the target, the start, the limits.
pub struct Asked<'a> {
    pub target: Option<u64>,
    pub start: &'a Pose,
    pub limits: &'a Limits,
}

/// A method, and what is done to each of its answers.
pub struct Bent<F> {
    method: Box<dyn Registration>,
    bend: F,
    pair: PairIds,
}

impl<F> Bent<F> {
    pub fn new(method: Box<dyn Registration>, bend: F) -> Self {
        Self { method, bend, pair: PairIds::default() }
    }
}

impl<F: FnMut(&mut Alignment, Asked<'_>) + Send> Registration for Bent<F> {
    fn name(&self) -> &str {
        self.method.name()
    }

    fn name_pair(&mut self, pair: PairIds) {
        self.pair = pair;
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
        (self.bend)(&mut alignment, Asked { target: self.pair.target, start, limits });
        Ok(alignment)
    }
}
