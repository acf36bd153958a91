//! 3DS, the chunked binary form of 3D Studio: triangle meshes and the diffuse colour of their materials.
//!
//! No kept crate reads it; a chunk is an id, its length and what it holds, often more chunks.

use std::collections::HashMap;
use std::ops::Range;

use super::error::{Fault, Place};
use super::mesh::Mesh;
use crate::simulation::scene::Colour;

const MAIN: u16 = 0x4d4d;
const EDITOR: u16 = 0x3d3d;
const OBJECT: u16 = 0x4000;
const TRIANGLE_MESH: u16 = 0x4100;
const VERTICES: u16 = 0x4110;
const FACES: u16 = 0x4120;
const FACE_MATERIAL: u16 = 0x4130;
const MATERIAL: u16 = 0xafff;
const MATERIAL_NAME: u16 = 0xa000;
const MATERIAL_DIFFUSE: u16 = 0xa020;
const COLOUR_SHARES: [u16; 2] = [0x0010, 0x0013];
const COLOUR_BYTES: [u16; 2] = [0x0011, 0x0012];
/// Id and length.
const CHUNK_HEADER: usize = 6;

/// Reads all triangle meshes as one. Their vertices are in the world's frame as they stand.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Fault> {
    let file = File { bytes };
    let mut mesh = Mesh::default();
    let main = file.chunk(0..bytes.len())?;
    if main.id != MAIN {
        return Err(Fault::new(Place::Byte(0), format!("begins with chunk {:#06x}; a 3DS file with 0x4d4d", main.id)));
    }
    let editors = file.chunks(main.body)?.into_iter().filter(|chunk| chunk.id == EDITOR);
    let parts: Vec<Chunk> = editors.map(|editor| file.chunks(editor.body)).collect::<Result<Vec<_>, _>>()?.concat();
    let mut materials = HashMap::new();
    for part in parts.iter().filter(|part| part.id == MATERIAL) {
        if let Some((name, colour)) = file.material(part.body.clone())? {
            materials.insert(name, colour);
        }
    }
    for part in parts.iter().filter(|part| part.id == OBJECT) {
        let (_, body) = file.text(part.body.clone())?;
        for object in file.chunks(body)?.into_iter().filter(|chunk| chunk.id == TRIANGLE_MESH) {
            file.triangle_mesh(object.body, &materials, &mut mesh)?;
        }
    }
    Ok(mesh)
}

struct File<'a> {
    bytes: &'a [u8],
}

#[derive(Clone)]
struct Chunk {
    id: u16,
    body: Range<usize>,
}

impl<'a> File<'a> {
    /// The bytes of a number at `at`, within `limit`.
    fn take<const N: usize>(&self, at: usize, limit: usize) -> Result<[u8; N], Fault> {
        let end = at.checked_add(N).filter(|&end| end <= limit);
        let found = end.and_then(|end| self.bytes.get(at..end)).and_then(|found| found.try_into().ok());
        found.ok_or_else(|| Fault::new(Place::Byte(at), "a chunk ends before what it should hold; the file is damaged"))
    }

    fn u16(&self, at: usize, limit: usize) -> Result<u16, Fault> {
        Ok(u16::from_le_bytes(self.take(at, limit)?))
    }

    fn f32(&self, at: usize, limit: usize) -> Result<f64, Fault> {
        Ok(f64::from(f32::from_le_bytes(self.take(at, limit)?)))
    }

    /// The chunk that begins at the start of a range and must end within it.
    fn chunk(&self, range: Range<usize>) -> Result<Chunk, Fault> {
        let id = self.u16(range.start, range.end)?;
        let length = u32::from_le_bytes(self.take(range.start + 2, range.end)?) as usize;
        if length < CHUNK_HEADER || length > range.len() {
            let reason = format!(
                "chunk {id:#06x} says it has {length} bytes; between {CHUNK_HEADER} and {} are possible here",
                range.len()
            );
            return Err(Fault::new(Place::Byte(range.start), reason));
        }
        Ok(Chunk { id, body: range.start + CHUNK_HEADER..range.start + length })
    }

    /// The chunks that fill a range.
    fn chunks(&self, mut range: Range<usize>) -> Result<Vec<Chunk>, Fault> {
        let mut chunks = Vec::new();
        while !range.is_empty() {
            let chunk = self.chunk(range.clone())?;
            range.start = chunk.body.end;
            chunks.push(chunk);
        }
        Ok(chunks)
    }

    /// A text that ends with a zero, and what follows it.
    fn text(&self, range: Range<usize>) -> Result<(&'a [u8], Range<usize>), Fault> {
        let bytes = self.bytes.get(range.clone()).unwrap_or_default();
        let length = bytes.iter().position(|&b| b == 0);
        let length = length.ok_or_else(|| Fault::new(Place::Byte(range.start), "a name without an end"))?;
        Ok((&bytes[..length], range.start + length + 1..range.end))
    }

    /// Name and diffuse colour of a material, if it has both.
    fn material(&self, body: Range<usize>) -> Result<Option<(&'a [u8], Colour)>, Fault> {
        let (mut name, mut colour) = (None, None);
        for chunk in self.chunks(body)? {
            match chunk.id {
                MATERIAL_NAME => name = Some(self.text(chunk.body)?.0),
                MATERIAL_DIFFUSE => {
                    for chunk in self.chunks(chunk.body)? {
                        colour = self.colour(&chunk)?.or(colour);
                    }
                }
                _ => {}
            }
        }
        Ok(name.zip(colour))
    }

    fn colour(&self, chunk: &Chunk) -> Result<Option<Colour>, Fault> {
        let (start, end) = (chunk.body.start, chunk.body.end);
        if COLOUR_BYTES.contains(&chunk.id) {
            return Ok(Some(Colour(self.take(start, end)?)));
        }
        if !COLOUR_SHARES.contains(&chunk.id) {
            return Ok(None);
        }
        let mut channels = [0_u8; 3];
        for (k, channel) in channels.iter_mut().enumerate() {
            *channel = (255.0 * self.f32(start + 4 * k, end)?).clamp(0.0, 255.0).round() as u8;
        }
        Ok(Some(Colour(channels)))
    }

    fn triangle_mesh(
        &self,
        body: Range<usize>,
        materials: &HashMap<&[u8], Colour>,
        mesh: &mut Mesh,
    ) -> Result<(), Fault> {
        let chunks = self.chunks(body)?;
        let first = mesh.vertices().len() as u32;
        for chunk in chunks.iter().filter(|chunk| chunk.id == VERTICES) {
            let (start, end) = (chunk.body.start, chunk.body.end);
            for k in 0..usize::from(self.u16(start, end)?) {
                let at = |axis: usize| self.f32(start + 2 + 12 * k + 4 * axis, end);
                mesh.add_vertex([at(0)?, at(1)?, at(2)?]);
            }
        }
        for chunk in chunks.iter().filter(|chunk| chunk.id == FACES) {
            let (start, end) = (chunk.body.start, chunk.body.end);
            let count = usize::from(self.u16(start, end)?);
            let colours = self.face_colours(start + 2 + 8 * count..end, count, materials)?;
            for (k, colour) in colours.into_iter().enumerate() {
                let at = start + 2 + 8 * k;
                let corner = |c: usize| Ok::<_, Fault>(first + u32::from(self.u16(at + 2 * c, end)?));
                mesh.add_polygon(&[corner(0)?, corner(1)?, corner(2)?], colour, Place::Byte(at))?;
            }
        }
        Ok(())
    }

    /// The colours of a mesh's faces, from the chunks behind them that name a material and its faces.
    fn face_colours(
        &self,
        range: Range<usize>,
        faces: usize,
        materials: &HashMap<&[u8], Colour>,
    ) -> Result<Vec<Option<Colour>>, Fault> {
        let mut colours = vec![None; faces];
        for chunk in self.chunks(range)?.iter().filter(|chunk| chunk.id == FACE_MATERIAL) {
            let (name, list) = self.text(chunk.body.clone())?;
            let Some(&colour) = materials.get(name) else { continue };
            for k in 0..usize::from(self.u16(list.start, list.end)?) {
                let face = usize::from(self.u16(list.start + 2 + 2 * k, list.end)?);
                let slot = colours.get_mut(face);
                let slot = slot.ok_or_else(|| Fault::new(Place::Byte(list.start), format!("no face {face} here")))?;
                *slot = Some(colour);
            }
        }
        Ok(colours)
    }
}
