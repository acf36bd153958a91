//! The built-in methods behind the plug: a minimiser, its settings and its room.

use crate::geometry::Pose;
use crate::registration::iteration::{Minimiser, Problem, Rooms};
use crate::registration::keyframe::PreparedCloud;
use crate::registration::{
    AlignError, Alignment, Limits, PrepareError, PreparedScan, Registration, RegistrationConfig,
};
use crate::scan::ScanView;

/// A built-in method.
pub(in crate::registration) struct Method<M: Minimiser> {
    config: RegistrationConfig,
    rooms: Rooms<M>,
}

impl<M: Minimiser> Method<M> {
    /// The method with these settings.
    pub fn new(config: RegistrationConfig) -> Self {
        Self { config, rooms: Rooms::default() }
    }
}

impl<M: Minimiser> Registration for Method<M>
where
    M::Sum: Send,
    <M::Approach as Minimiser>::Sum: Send,
{
    fn name(&self) -> &str {
        M::NAME
    }

    fn prepare(&self, scan: ScanView<'_>) -> Result<Box<dyn PreparedScan>, PrepareError> {
        Ok(Box::new(PreparedCloud::new(scan, &self.config)?))
    }

    fn align(
        &mut self,
        target: &dyn PreparedScan,
        source: &dyn PreparedScan,
        initial_target_from_source: &Pose,
        limits: &Limits,
    ) -> Result<Alignment, AlignError> {
        let problem = Problem::new(M::NAME, target, source, initial_target_from_source, limits, &self.config)?;
        Ok(problem.solve(&mut self.rooms))
    }
}
