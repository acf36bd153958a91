//! A picture of a run's map: one pixel a cell.

use mirador_core::information_map::{CellState, InformationMap};
use serde::{Deserialize, Serialize};

use super::ExperimentError;

/// Where a picture lies in the map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Lowest x and y [m, map frame].
    pub min: [f64; 2],
    /// Side of a cell, which is a pixel [m].
    pub cell_m: f64,
    /// Pixels along x.
    pub width: u32,
    /// Pixels along y.
    pub height: u32,
}

type Colour = [u8; 3];

const UNKNOWN: Colour = [226, 226, 226];
const OBSTACLE: Colour = [70, 66, 74];
/// Under this C_nc a cell is drawn as an obstacle.
const BLOCKED: f64 = 0.5;

/// The known map as a PNG, y upwards: quality by colour on open ground, obstacles dark.
pub(super) fn draw(map: &InformationMap) -> Result<Option<(Frame, Vec<u8>)>, ExperimentError> {
    let known: Vec<_> = map.known_cells().map(|(index, cell)| (index, cell.quality().unwrap_or(0.0))).collect();
    let bound = |of: fn(&mirador_core::information_map::CellIndex) -> i32| {
        let low = known.iter().map(|(index, _)| of(index)).min()?;
        let high = known.iter().map(|(index, _)| of(index)).max()?;
        Some((low, high))
    };
    let (Some((x0, x1)), Some((y0, y1))) = (bound(|i| i.x), bound(|i| i.y)) else { return Ok(None) };
    let (width, height) = (x1.abs_diff(x0) + 1, y1.abs_diff(y0) + 1);
    let mut pixels = UNKNOWN.repeat(width as usize * height as usize);
    for (index, quality) in &known {
        let colour = match map.state(*index) {
            CellState::Unknown => continue,
            CellState::Known(navigability) if navigability < BLOCKED => OBSTACLE,
            CellState::Known(_) => blue_to_yellow(*quality),
        };
        let at = (y1.abs_diff(index.y) * width + index.x.abs_diff(x0)) as usize * 3;
        pixels[at..at + 3].copy_from_slice(&colour);
    }
    let cell_m = map.cell_m();
    let min = [f64::from(x0) * cell_m, f64::from(y0) * cell_m];
    Ok(Some((Frame { min, cell_m, width, height }, encode(width, height, &pixels)?)))
}

fn encode(width: u32, height: u32, pixels: &[u8]) -> Result<Vec<u8>, ExperimentError> {
    let failure = |e: png::EncodingError| ExperimentError::Draw { what: "a map".into(), reason: e.to_string() };
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(failure)?;
    writer.write_image_data(pixels).map_err(failure)?;
    writer.finish().map_err(failure)?;
    Ok(bytes)
}

/// Dark blue at 0, teal, green, yellow at 1; rises in brightness throughout.
pub(super) fn blue_to_yellow(value: f64) -> Colour {
    const STOPS: [Colour; 4] = [[50, 20, 100], [40, 120, 140], [90, 190, 100], [250, 230, 60]];
    let place = value.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let k = (place as usize).min(STOPS.len() - 2);
    let share = place - k as f64;
    std::array::from_fn(|c| (f64::from(STOPS[k][c]) * (1.0 - share) + f64::from(STOPS[k + 1][c]) * share).round() as u8)
}
