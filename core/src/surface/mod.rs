//! From points to surface: who is next to whom, which way the surface faces, how much of it a point stands for and how
//! well it was seen. Needs no pose: everything is in the scanner's frame, z nominally up.
//!
//! An ordered scan is meshed along its grid (spec section 2): `filter` takes the range noise out, `legs` tells a
//! leg of the grid that follows a surface from one that jumps between two, `mesh` keeps the triangles of honest legs
//! and sums their normals and areas, `discarded` lists the others. A scan without an order gets the same values from
//! its nearest neighbours (`cloud`) and no triangles.

mod builder;
mod cloud;
mod config;
mod discarded;
mod filter;
mod legs;
mod mesh;
mod neighbours;
mod quality;
mod topology;
mod view;

#[cfg(test)]
pub(crate) mod test_scans;
#[cfg(test)]
mod tests;

pub use builder::{SurfaceBuilder, SurfaceError};
pub use config::{SurfaceConfig, SurfaceConfigError};
pub use discarded::DiscardedTriangle;
pub use quality::{area_limit, area_quality, incidence_quality, quality};
pub use topology::Topology;
pub use view::{Surface, SurfacePoint};
