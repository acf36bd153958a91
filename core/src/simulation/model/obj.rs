//! Wavefront OBJ with its MTL materials, through `tobj`.

use std::collections::HashMap;
use std::io::BufRead;
use std::path::Path;

use tobj::{LoadError, LoadOptions, Material};

use super::Beside;
use super::error::{Fault, Place};
use super::mesh::Mesh;
use crate::simulation::scene::Colour;

/// Reads all groups as one mesh. A material file that is not there leaves its faces without colour.
pub(super) fn read(bytes: &[u8], beside: Beside<'_>) -> Result<Mesh, Fault> {
    let options = LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..LoadOptions::default() };
    let mut text = Counted { bytes, line: 0 };
    let load = |name: &Path| {
        let text = name.to_str().and_then(beside).ok_or(LoadError::OpenFileFailed)?;
        Ok(materials(&String::from_utf8_lossy(&text)))
    };
    let (models, materials) = tobj::load_obj_buf(&mut text, &options, load)
        .map_err(|error| Fault::new(Place::Line(text.line.max(1)), format!("{error} (here or shortly before)")))?;
    let materials = materials.unwrap_or_default();
    let mut mesh = Mesh::default();
    for model in &models {
        let colour = model.mesh.material_id.and_then(|id| materials.get(id)?.diffuse).map(colour);
        add(&model.mesh, colour, &mut mesh)
            .map_err(|fault| Fault::new(Place::File, format!("group `{}`: {}", model.name, fault.reason)))?;
    }
    Ok(mesh)
}

/// Names and diffuse colours of an MTL file; nothing else of it matters here. (tobj's own reader panics on a colour that
/// does not have three numbers.)
fn materials(text: &str) -> (Vec<Material>, HashMap<String, usize>) {
    let (mut materials, mut names): (Vec<Material>, _) = (Vec::new(), HashMap::new());
    for line in text.lines() {
        let (key, rest) = line.trim().split_once(char::is_whitespace).unwrap_or((line.trim(), ""));
        match (key, materials.last_mut()) {
            ("newmtl", _) => {
                names.insert(rest.trim().to_owned(), materials.len());
                materials.push(Material { name: rest.trim().to_owned(), ..Material::default() });
            }
            ("Kd", Some(material)) => {
                let shares: Vec<f64> = rest.split_whitespace().map_while(|word| word.parse().ok()).collect();
                material.diffuse = shares.try_into().ok();
            }
            _ => {}
        }
    }
    (materials, names)
}

fn colour(shares: [f64; 3]) -> Colour {
    Colour(shares.map(|share| (255.0 * share).clamp(0.0, 255.0).round() as u8))
}

fn add(group: &tobj::Mesh, colour: Option<Colour>, mesh: &mut Mesh) -> Result<(), Fault> {
    let first = mesh.vertices().len() as u32;
    for position in group.positions.chunks_exact(3) {
        mesh.add_vertex([position[0], position[1], position[2]]);
    }
    for corners in group.indices.chunks_exact(3) {
        let index = |k: usize| corners[k].checked_add(first);
        let corners = [index(0), index(1), index(2)].map(|index| index.unwrap_or(u32::MAX));
        mesh.add_polygon(&corners, colour, Place::File)?;
    }
    Ok(())
}

/// Counts the lines that have been read.
struct Counted<'a> {
    bytes: &'a [u8],
    line: usize,
}

impl std::io::Read for Counted<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let count = self.bytes.len().min(out.len());
        out[..count].copy_from_slice(&self.bytes[..count]);
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for Counted<'_> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        Ok(self.bytes)
    }

    fn consume(&mut self, count: usize) {
        let (read, rest) = self.bytes.split_at(count.min(self.bytes.len()));
        self.line += read.iter().filter(|&&b| b == b'\n').count();
        self.bytes = rest;
    }
}
