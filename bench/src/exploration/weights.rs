//! The weight sets of the source's experiments (section 10).

use mirador_core::view_planning::Weights;

/// A name, and w_A, w_Q, w_O, w_C.
pub type WeightSet = (&'static str, [f64; 4]);

/// All that the source used with its multi-criteria utility: seven in simulation, three with the robot.
pub const WEIGHTS: [WeightSet; 10] = [
    ("simple I", [0.43, 0.35, 0.22, 0.09]),
    ("simple II", [0.65, 0.25, 0.10, 0.09]),
    ("simple III", [0.36, 0.50, 0.14, 0.09]),
    ("structured I", [0.20, 0.55, 0.25, 0.09]),
    ("structured II", [0.65, 0.25, 0.10, 0.08]),
    ("unstructured I", [0.40, 0.35, 0.25, 0.125]),
    ("unstructured II", [0.65, 0.30, 0.05, 0.08]),
    ("office I", [0.84, 0.10, 0.05, 0.05]),
    ("office II", [0.35, 0.40, 0.15, 0.40]),
    ("ruin", [0.55, 0.30, 0.15, 0.16]),
];

/// The weights of a set.
pub(crate) fn weights_of(&(_, [information, quality, zones, cost]): &WeightSet) -> Weights {
    Weights { information, quality, zones, cost }
}
