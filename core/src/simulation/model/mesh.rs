//! Triangles with shared corners.

use nalgebra::Vector3;

use super::error::{Fault, ModelError, Place};
use crate::simulation::scene::Colour;

/// The most vertices or triangles a mesh may have.
const MOST: usize = 20_000_000;

/// A mesh of triangles in the frame of its file [m].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    vertices: Vec<[f64; 3]>,
    /// Corners of each triangle, anticlockwise from outside.
    triangles: Vec<[u32; 3]>,
    /// One a triangle, or none at all.
    colours: Vec<Option<Colour>>,
}

impl Mesh {
    /// The corners [m].
    #[must_use]
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.vertices
    }

    /// The corners of each triangle, as indices of vertices, anticlockwise from outside.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The colour that the file gives a triangle.
    #[must_use]
    pub fn colour(&self, triangle: usize) -> Option<Colour> {
        self.colours.get(triangle).copied().flatten()
    }

    /// The corners of the smallest upright box around the mesh [m].
    #[must_use]
    pub fn bounds(&self) -> [[f64; 3]; 2] {
        let mut bounds = [[f64::MAX; 3], [f64::MIN; 3]];
        for vertex in &self.vertices {
            for (axis, &value) in vertex.iter().enumerate() {
                bounds[0][axis] = bounds[0][axis].min(value);
                bounds[1][axis] = bounds[1][axis].max(value);
            }
        }
        bounds
    }

    /// Appends a vertex and returns its index.
    pub(super) fn add_vertex(&mut self, vertex: [f64; 3]) -> u32 {
        self.vertices.push(vertex);
        (self.vertices.len() - 1) as u32
    }

    /// Refuses more vertices or triangles than a mesh may have, before memory is asked for.
    pub(super) fn check_count(count: usize, at: Place, what: &str) -> Result<usize, Fault> {
        if count <= MOST {
            return Ok(count);
        }
        Err(Fault::new(at, format!("{count} {what}; at most {MOST} are possible")))
    }

    /// Appends a polygon as a fan of triangles; its corners must be vertices that exist already.
    pub(super) fn add_polygon(&mut self, corners: &[u32], colour: Option<Colour>, at: Place) -> Result<(), Fault> {
        if let Some(corner) = corners.iter().find(|&&corner| corner as usize >= self.vertices.len()) {
            let reason = format!("a face asks for vertex {corner}, but there are only {}", self.vertices.len());
            return Err(Fault::new(at, reason));
        }
        let [first, rest @ ..] = corners else {
            return Err(Fault::new(at, "a face has no corner; it needs at least three"));
        };
        if rest.len() < 2 {
            return Err(Fault::new(at, format!("a face has {} corners; it needs at least three", corners.len())));
        }
        for pair in rest.windows(2) {
            self.triangles.push([*first, pair[0], pair[1]]);
            self.colours.push(colour);
        }
        Ok(())
    }

    /// The mesh, if all its coordinates are finite and all its triangles have an area.
    pub(crate) fn checked(self, file: &str) -> Result<Self, ModelError> {
        let file = || file.to_owned();
        if self.triangles.is_empty() {
            return Err(ModelError::Empty { file: file() });
        }
        if let Some(vertex) = self.vertices.iter().position(|v| v.iter().any(|c| !c.is_finite())) {
            return Err(ModelError::NotFinite { file: file(), vertex });
        }
        let mut flat = (0..self.triangles.len()).filter(|&triangle| self.is_degenerate(triangle));
        if let Some(first) = flat.next() {
            return Err(ModelError::Degenerate { file: file(), count: flat.count() + 1, first });
        }
        Ok(self)
    }

    /// The mesh without the triangles that have no area.
    pub(crate) fn without_degenerate(mut self) -> Self {
        let keep: Vec<_> = (0..self.triangles.len()).map(|triangle| !self.is_degenerate(triangle)).collect();
        let mut kept = keep.iter();
        self.triangles.retain(|_| *kept.next().unwrap_or(&true));
        let mut kept = keep.iter();
        self.colours.retain(|_| *kept.next().unwrap_or(&true));
        self
    }

    /// Whether a triangle's height is nothing beside its longest side. NaN counts as sound here.
    fn is_degenerate(&self, triangle: usize) -> bool {
        let Some(&[a, b, c]) = self.triangles.get(triangle) else { return false };
        let at = |index: u32| self.vertices.get(index as usize).map_or_else(Vector3::zeros, |&v| Vector3::from(v));
        let (ab, ac, bc) = (at(b) - at(a), at(c) - at(a), at(c) - at(b));
        let longest = ab.norm_squared().max(ac.norm_squared()).max(bc.norm_squared());
        ab.cross(&ac).norm() <= 1e-10 * longest
    }
}
