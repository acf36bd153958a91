//! PLY with faces, through `ply-rs-bw`: text and both binary forms.

use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{PropertyAccess, PropertyAccessResult};

use super::error::{Fault, Place};
use super::mesh::Mesh;
use crate::simulation::scene::Colour;

/// A vertex or a face; the header tells which.
#[derive(Default)]
struct Element {
    position: [f64; 3],
    /// Which of red, green and blue were given.
    coloured: [bool; 3],
    colour: [u8; 3],
    corners: Vec<i64>,
}

impl Element {
    fn set_number(&mut self, name: &str, value: f64, colour_scale: f64) -> PropertyAccessResult {
        let channel = |value: f64| (value * colour_scale).clamp(0.0, 255.0).round() as u8;
        match name {
            "x" => self.position[0] = value,
            "y" => self.position[1] = value,
            "z" => self.position[2] = value,
            "red" | "r" => (self.colour[0], self.coloured[0]) = (channel(value), true),
            "green" | "g" => (self.colour[1], self.coloured[1]) = (channel(value), true),
            "blue" | "b" => (self.colour[2], self.coloured[2]) = (channel(value), true),
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }

    fn set_corners(&mut self, name: &str, corners: impl Iterator<Item = i64>) -> PropertyAccessResult {
        if !matches!(name, "vertex_indices" | "vertex_index") {
            return PropertyAccessResult::Ignored;
        }
        self.corners = corners.collect();
        PropertyAccessResult::Set
    }

    fn colour(&self) -> Option<Colour> {
        (self.coloured == [true; 3]).then_some(Colour(self.colour))
    }
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self::default()
    }

    fn set_char(&mut self, name: &str, value: i8) -> PropertyAccessResult {
        self.set_number(name, f64::from(value), 1.0)
    }

    fn set_uchar(&mut self, name: &str, value: u8) -> PropertyAccessResult {
        self.set_number(name, f64::from(value), 1.0)
    }

    fn set_short(&mut self, name: &str, value: i16) -> PropertyAccessResult {
        self.set_number(name, f64::from(value), 1.0)
    }

    fn set_ushort(&mut self, name: &str, value: u16) -> PropertyAccessResult {
        self.set_number(name, f64::from(value), 1.0 / 257.0)
    }

    fn set_int(&mut self, name: &str, value: i32) -> PropertyAccessResult {
        self.set_number(name, f64::from(value), 1.0)
    }

    fn set_uint(&mut self, name: &str, value: u32) -> PropertyAccessResult {
        self.set_number(name, f64::from(value), 1.0)
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        self.set_number(name, f64::from(value), 255.0)
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        self.set_number(name, value, 255.0)
    }

    fn set_list_char(&mut self, name: &str, value: Vec<i8>) -> PropertyAccessResult {
        self.set_corners(name, value.into_iter().map(i64::from))
    }

    fn set_list_uchar(&mut self, name: &str, value: Vec<u8>) -> PropertyAccessResult {
        self.set_corners(name, value.into_iter().map(i64::from))
    }

    fn set_list_short(&mut self, name: &str, value: Vec<i16>) -> PropertyAccessResult {
        self.set_corners(name, value.into_iter().map(i64::from))
    }

    fn set_list_ushort(&mut self, name: &str, value: Vec<u16>) -> PropertyAccessResult {
        self.set_corners(name, value.into_iter().map(i64::from))
    }

    fn set_list_int(&mut self, name: &str, value: Vec<i32>) -> PropertyAccessResult {
        self.set_corners(name, value.into_iter().map(i64::from))
    }

    fn set_list_uint(&mut self, name: &str, value: Vec<u32>) -> PropertyAccessResult {
        self.set_corners(name, value.into_iter().map(i64::from))
    }
}

/// Reads the elements `vertex` and `face`.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Fault> {
    let parser = Parser::<Element>::new();
    let mut reader = Reader::new(bytes);
    let line = |error: &ply_rs_bw::parser::ParseError| error.line().map_or(Place::File, Place::Line);
    let header = parser.read_header(&mut reader).map_err(|error| Fault::new(line(&error), error.to_string()))?;
    let mut mesh = Mesh::default();
    let mut colours = Vec::new();
    for (name, definition) in &header.elements {
        // Every element takes a byte at least, so a count beyond the file's length is damage.
        if definition.count > bytes.len() {
            let reason = format!("announces {} elements `{name}`, more than the file has bytes", definition.count);
            return Err(Fault::new(Place::File, reason));
        }
        Mesh::check_count(definition.count, Place::File, name)?;
        let elements = parser
            .read_payload_for_element(&mut reader, definition, &header)
            .map_err(|error| Fault::new(line(&error), error.to_string()))?;
        match name.as_str() {
            "vertex" => {
                for element in &elements {
                    mesh.add_vertex(element.position);
                    colours.push(element.colour());
                }
            }
            "face" => add_faces(&elements, &colours, &mut mesh)?,
            _ => {}
        }
    }
    Ok(mesh)
}

fn add_faces(faces: &[Element], colours: &[Option<Colour>], mesh: &mut Mesh) -> Result<(), Fault> {
    for (index, face) in faces.iter().enumerate() {
        let at = Place::File;
        let corners: Result<Vec<u32>, _> = face.corners.iter().map(|&corner| u32::try_from(corner)).collect();
        let corners = corners.map_err(|_| Fault::new(at, format!("face {index} (from 0) has a negative index")))?;
        let colour = face.colour().or_else(|| mean_colour(&corners, colours));
        mesh.add_polygon(&corners, colour, at)
            .map_err(|fault| Fault::new(at, format!("face {index} (from 0): {}", fault.reason)))?;
    }
    Ok(())
}

/// The mean colour of the corners, if all have one.
fn mean_colour(corners: &[u32], colours: &[Option<Colour>]) -> Option<Colour> {
    let mut sum = [0_u32; 3];
    for &corner in corners {
        let Colour(colour) = colours.get(corner as usize).copied().flatten()?;
        for (sum, channel) in sum.iter_mut().zip(colour) {
            *sum += u32::from(channel);
        }
    }
    let count = u32::try_from(corners.len()).ok().filter(|&count| count > 0)?;
    Some(Colour(sum.map(|sum| (sum / count) as u8)))
}
