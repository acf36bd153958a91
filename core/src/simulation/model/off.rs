//! OFF, the text form of Geomview: `OFF`, the three counts, vertices, then faces with an optional colour each.
//!
//! No kept crate reads it, and a reader is as short as the format's description.

use super::error::{Fault, Place};
use super::mesh::Mesh;
use crate::simulation::scene::Colour;

/// Reads vertices (extra numbers of `COFF`, `NOFF` and `STOFF` vertices are skipped) and polygons.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Fault> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes.iter().take(error.valid_up_to()).filter(|&&b| b == b'\n').count();
        Fault::new(Place::Line(line), "not text; only the text form of OFF is read")
    })?;
    let mut lines = Lines { lines: text.lines().enumerate() };
    let (line, header) = lines.next("the word OFF")?;
    let mut words = header.split_whitespace();
    let kind = words.next().unwrap_or_default();
    if !matches!(kind, "OFF" | "COFF" | "NOFF" | "CNOFF" | "STOFF") {
        return Err(Fault::new(Place::Line(line), format!("begins with `{kind}`; an OFF file begins with OFF")));
    }
    // Some programs write the counts behind the word.
    let rest: Vec<_> = words.collect();
    let (line, counts) = if rest.is_empty() { lines.next("the counts")? } else { (line, String::new()) };
    let counts: Vec<_> = if rest.is_empty() { counts.split_whitespace().collect() } else { rest };
    let at = Place::Line(line);
    let count = |index: usize, what: &str| {
        let word = counts.get(index).copied().unwrap_or_default();
        let count = word.parse().map_err(|_| Fault::new(at, format!("the number of {what} is `{word}`")))?;
        Mesh::check_count(count, at, what)
    };
    let (vertices, faces) = (count(0, "vertices")?, count(1, "faces")?);

    let mut mesh = Mesh::default();
    for _ in 0..vertices {
        let (line, text) = lines.next("a vertex")?;
        mesh.add_vertex(vertex(&text, Place::Line(line))?);
    }
    let mut corners = Vec::new();
    for _ in 0..faces {
        let (line, text) = lines.next("a face")?;
        let colour = face(&text, Place::Line(line), &mut corners)?;
        mesh.add_polygon(&corners, colour, Place::Line(line))?;
    }
    Ok(mesh)
}

/// The lines that hold something, comments removed.
struct Lines<'a> {
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
}

impl Lines<'_> {
    fn next(&mut self, expected: &str) -> Result<(usize, String), Fault> {
        let mut last = 0;
        for (index, line) in self.lines.by_ref() {
            last = index + 1;
            let line = line.split('#').next().unwrap_or_default().trim();
            if !line.is_empty() {
                return Ok((index + 1, line.to_owned()));
            }
        }
        Err(Fault::new(Place::Line(last.max(1)), format!("the file ends where {expected} should follow")))
    }
}

fn vertex(text: &str, at: Place) -> Result<[f64; 3], Fault> {
    let mut words = text.split_whitespace();
    let mut vertex = [0.0; 3];
    for value in &mut vertex {
        let word = words.next().unwrap_or_default();
        *value = word
            .parse()
            .map_err(|_| Fault::new(at, format!("`{word}` should be a coordinate; a vertex has three numbers")))?;
    }
    Ok(vertex)
}

/// The corners of a face, and its colour: three or four numbers behind them, all integers 0 to 255 or shares 0 to 1.
fn face(text: &str, at: Place, corners: &mut Vec<u32>) -> Result<Option<Colour>, Fault> {
    let words: Vec<_> = text.split_whitespace().collect();
    let wrong = |word: &str, what: &str| Fault::new(at, format!("`{word}` should be {what}"));
    let (first, rest) = words.split_first().ok_or_else(|| Fault::new(at, "an empty face"))?;
    let count: usize = first.parse().map_err(|_| wrong(first, "the number of a face's corners"))?;
    corners.clear();
    for word in rest.iter().take(count) {
        corners.push(word.parse().map_err(|_| wrong(word, "the index of a vertex"))?);
    }
    if corners.len() < count {
        return Err(Fault::new(at, format!("a face of {count} corners lists {}", corners.len())));
    }
    let colour = rest.get(count..).unwrap_or_default();
    if colour.len() < 3 {
        return Ok(None);
    }
    let mut channels = [0_u8; 3];
    let whole = colour.iter().take(3).all(|word| !word.contains('.'));
    for (channel, word) in channels.iter_mut().zip(colour) {
        let value: f64 = word.parse().map_err(|_| wrong(word, "a colour"))?;
        *channel = (if whole { value } else { 255.0 * value }).round() as u8;
    }
    Ok(Some(Colour(channels)))
}
