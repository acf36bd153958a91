//! From points to surface: who is next to whom, which way the surface faces, how much of it a point stands for and how
//! well it was seen. Needs no pose: everything is in the scanner's frame, z nominally up.
//!
//! An ordered scan is meshed along its grid (spec section 2): `filter` takes the range noise out, `legs` tells a
//! leg of the grid that follows a surface from one that jumps between two, `mesh` keeps the triangles of honest legs
//! and sums their normals and areas, `discarded` lists the others. `strip` does all of it line by line, so that a scan
//! can be given sweep by sweep as it comes.
//!
//! A scan without an order gets its triangles from a grid over the directions of its points (`spherical_index`), and its
//! normals from each point's nearest neighbours (`cloud`).

mod builder;
mod cloud;
mod config;
mod discarded;
mod filter;
mod legs;
mod lines;
mod mesh;
mod neighbours;
mod quality;
mod spherical_index;
mod strip;
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
