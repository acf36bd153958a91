//! The built-in methods: each says what it sums over the pairs and how a step follows.

mod generalised;
mod method;
mod metric;
mod normal_distributions;
mod point_to_plane;
mod point_to_point;
mod symmetric;
mod voxelised;

pub(super) use generalised::Generalised;
pub(super) use method::Method;
pub(super) use normal_distributions::NormalDistributions;
pub(super) use point_to_plane::PointToPlane;
pub(super) use point_to_point::PointToPoint;
pub(super) use symmetric::Symmetric;
pub(super) use voxelised::Voxelised;
