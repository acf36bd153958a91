//! What every method reports of one pass over the pairs, and the distances of that pass.

use super::RegistrationConfig;
use super::information::PlaneSystem;
use super::walk::Walk;

/// Classes of residuals, from which the next pass takes the greatest that counts, and how far pairs that fit err.
const CLASSES: usize = 64;

/// What every method reports of one pass.
#[derive(Debug, Clone, Copy)]
pub(super) struct Evidence {
    /// Pairs within the pair distance of the pass.
    pub pairs: u32,
    /// Pairs within the overlap distance.
    pub overlapping: u32,
    /// Source points whose residual enters `cost_sum`; all others cost `unpaired_cost`.
    pub judged: u32,
    /// Sum of the truncated squared residuals [m^2].
    pub cost_sum: f64,
    /// Sum of the squared residuals of the pairs [m^2].
    pub residual_sq: f64,
    /// The distances to the tangent planes.
    pub plane: PlaneSystem,
    /// Pairs by the square root of their residual, as a share of the pair distance.
    classes: [u32; CLASSES],
}

impl Default for Evidence {
    fn default() -> Self {
        let plane = PlaneSystem::default();
        let (cost_sum, residual_sq) = (0.0, 0.0);
        Self { pairs: 0, overlapping: 0, judged: 0, cost_sum, residual_sq, plane, classes: [0; CLASSES] }
    }
}

impl Evidence {
    /// Counts a pair of a squared residual [m^2] and tells whether it pulls, or is trimmed.
    #[inline(always)]
    pub fn takes(&mut self, gates: &Gates, residual_sq: f32) -> bool {
        self.pairs += 1;
        self.residual_sq += f64::from(residual_sq);
        let share = (residual_sq / gates.pair_sq).sqrt().sqrt();
        self.classes[((share * CLASSES as f32) as usize).min(CLASSES - 1)] += 1;
        residual_sq <= gates.trimmed_sq
    }

    /// The squared residual that the part `kept` of the pairs does not exceed [m^2].
    pub fn quantile_sq(&self, kept: f64, pair_m: f64) -> f32 {
        let wanted = kept * f64::from(self.pairs);
        let mut seen = 0.0;
        for (class, count) in self.classes.iter().enumerate() {
            seen += f64::from(*count);
            if seen >= wanted {
                let share = (class as f64 + 1.0) / CLASSES as f64;
                return (share * share * pair_m).powi(2) as f32;
            }
        }
        f32::INFINITY
    }

    /// Adds the sums of another block.
    pub fn merge(&mut self, other: &Self) {
        self.pairs += other.pairs;
        self.overlapping += other.overlapping;
        self.judged += other.judged;
        self.cost_sum += other.cost_sum;
        self.residual_sq += other.residual_sq;
        self.plane.merge(&other.plane);
        for (own, others) in self.classes.iter_mut().zip(&other.classes) {
            *own += others;
        }
    }
}

/// The distances of a pass.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gates {
    /// The farthest partner [m].
    pub pair_m: f64,
    /// The farthest partner once the alignment has settled [m].
    pub final_m: f64,
    /// Squares [m^2]: of the farthest partner,
    pub pair_sq: f32,
    /// of the distance at which costs are judged, the same for all passes over the same points,
    pub judged_sq: f32,
    /// of the farthest partner that counts as overlap,
    pub overlap_sq: f32,
    /// and of the greatest residual that pulls.
    pub trimmed_sq: f32,
    /// The robust scale at the final pair distance [m].
    pub scale_m: f64,
}

impl Gates {
    pub fn new(walk: &Walk, final_m: f64, config: &RegistrationConfig) -> Self {
        let square = |v: f64| (v * v) as f32;
        Self {
            pair_m: walk.gate,
            final_m,
            pair_sq: square(walk.gate),
            judged_sq: square(walk.final_gate),
            overlap_sq: square(config.overlap_distance_m),
            trimmed_sq: walk.trimmed_sq,
            scale_m: walk.scale_m.unwrap_or(config.robust_scale_m),
        }
    }

    /// How much wider than at the end the pass is. While pairs may be far apart, so may residuals that are right.
    pub fn widening(&self) -> f64 {
        (self.pair_m / self.final_m).max(1.0)
    }
}
