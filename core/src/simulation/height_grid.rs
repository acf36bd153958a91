//! Grids of heights from files: 16-bit images and tables of numbers.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::assets::Assets;

/// The most heights a grid may have.
const MOST_HEIGHTS: usize = 4_000_000;

/// A grid of heights in a file, and where it lies. Its first row is the one with the largest y, as in a picture with
/// north up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeightFile {
    /// Beside the world file: a grey PNG of 8 or 16 bits (`.png`), or numbers [m] separated by blanks, commas or
    /// semicolons, one row a line (any other ending).
    pub file: String,
    /// Distance of neighbouring heights [m].
    pub cell_m: f64,
    /// Where the height in the corner with the lowest coordinates lies [m].
    pub x_m: f64,
    /// As `x_m`.
    pub y_m: f64,
    /// Height of black in an image [m].
    #[serde(default)]
    pub low_m: f64,
    /// Height of white in an image [m].
    #[serde(default = "one")]
    pub high_m: f64,
    /// What the file holds.
    #[serde(skip)]
    pub grid: Arc<HeightGrid>,
}

fn one() -> f64 {
    1.0
}

/// Heights on a regular grid [m].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HeightGrid {
    /// Heights along x.
    pub cols: usize,
    /// Heights along y.
    pub rows: usize,
    /// x running fastest, from the lowest y up.
    pub heights: Vec<f64>,
}

impl HeightFile {
    /// Reads the file.
    pub(super) fn load(&mut self, assets: &Assets) -> Result<(), String> {
        let (bytes, file) =
            assets.read(&self.file).map_err(|error| format!("{}: cannot be read: {error}", self.file))?;
        let grid = if self.file.to_ascii_lowercase().ends_with(".png") {
            image(&bytes, self.low_m, self.high_m)
        } else {
            table(&bytes)
        };
        self.grid = Arc::new(grid.map_err(|reason| format!("{file}{reason}"))?);
        Ok(())
    }

    /// The rectangle the grid covers: x and y from their lower to their upper ends [m].
    pub(super) fn extent(&self) -> [[f64; 2]; 2] {
        let span = |low: f64, count: usize| [low, low + self.cell_m * count.saturating_sub(1) as f64];
        [span(self.x_m, self.grid.cols), span(self.y_m, self.grid.rows)]
    }
}

/// A grid from rows in the file's order, the largest y first.
fn grid(cols: usize, mut rows: Vec<Vec<f64>>) -> Result<HeightGrid, String> {
    if cols < 2 || rows.len() < 2 {
        return Err(format!(": {} x {cols} heights; at least 2 x 2 are needed", rows.len()));
    }
    rows.reverse();
    Ok(HeightGrid { cols, rows: rows.len(), heights: rows.concat() })
}

fn image(bytes: &[u8], low: f64, high: f64) -> Result<HeightGrid, String> {
    let fail = |error: png::DecodingError| format!(": not a readable PNG: {error}");
    let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(fail)?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let (colour, depth) = reader.output_color_type();
    if colour != png::ColorType::Grayscale || !matches!(depth, png::BitDepth::Eight | png::BitDepth::Sixteen) {
        return Err(format!(": the image is {colour:?} with {depth:?} bits; heights are grey with 8 or 16 bits"));
    }
    if width.saturating_mul(height) > MOST_HEIGHTS {
        return Err(format!(": {height} x {width} heights are more than {MOST_HEIGHTS}"));
    }
    let size = reader.output_buffer_size().ok_or(": the image is too large")?;
    let mut data = vec![0; size];
    reader.next_frame(&mut data).map_err(fail)?;
    let values: Vec<f64> = match depth {
        png::BitDepth::Sixteen => {
            data.chunks_exact(2).map(|b| f64::from(u16::from_be_bytes([b[0], b[1]])) / 65535.0).collect()
        }
        _ => data.iter().map(|&b| f64::from(b) / 255.0).collect(),
    };
    let rows = values.chunks(width.max(1)).map(|row| row.iter().map(|share| low + (high - low) * share).collect());
    grid(width, rows.collect())
}

fn table(bytes: &[u8]) -> Result<HeightGrid, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| ": not text; heights are numbers in rows")?;
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default();
        let words = line.split(|c: char| c.is_whitespace() || c == ',' || c == ';').filter(|word| !word.is_empty());
        let row: Result<Vec<f64>, _> = words.map(|word| height(word, index + 1)).collect();
        let row = row?;
        if row.is_empty() {
            continue;
        }
        if let Some(first) = rows.first().filter(|first| first.len() != row.len()) {
            return Err(format!(", line {}: {} heights, the rows before have {}", index + 1, row.len(), first.len()));
        }
        rows.push(row);
    }
    let cols = rows.first().map_or(0, Vec::len);
    if cols.saturating_mul(rows.len()) > MOST_HEIGHTS {
        return Err(format!(": {} x {cols} heights are more than {MOST_HEIGHTS}", rows.len()));
    }
    grid(cols, rows)
}

fn height(word: &str, line: usize) -> Result<f64, String> {
    let height = word.parse::<f64>().ok().filter(|height| height.abs() <= 1e4);
    height.ok_or_else(|| format!(", line {line}: `{word}` should be a height between -10000 and 10000 m"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A 16-bit grey PNG, as an encoder of the same library writes it.
    fn png_of(width: u32, values: &[u16]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, values.len() as u32 / width);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let data: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
        encoder.write_header().unwrap().write_image_data(&data).unwrap();
        bytes
    }

    #[test]
    fn the_first_row_of_an_image_is_the_farthest_and_white_is_high() {
        let grid = image(&png_of(3, &[0, 65535, 0, 65535, 0, 32768]), -1.0, 3.0).unwrap();
        assert_eq!((grid.cols, grid.rows), (3, 2));
        assert!((grid.heights[2] - 1.0).abs() < 1e-4, "{:?}", grid.heights);
        assert_eq!(&grid.heights[..2], [3.0, -1.0]);
        assert_eq!(&grid.heights[3..], [-1.0, 3.0, -1.0]);
    }

    #[test]
    fn a_table_may_use_blanks_commas_and_comments() {
        let grid = table(b"# heights\n1, 2; 3\n\n4 5 6 # last\n").unwrap();
        assert_eq!(grid.heights, [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn a_wrong_height_is_named_with_its_line() {
        assert_eq!(table(b"1 2\n3 x\n").unwrap_err(), ", line 2: `x` should be a height between -10000 and 10000 m");
        assert!(table(b"1 2\nnan 3\n").unwrap_err().contains("line 2"));
        assert!(table(b"1 2\n3\n").unwrap_err().contains("line 2: 1 heights, the rows before have 2"));
        assert!(table(b"").unwrap_err().contains("at least 2 x 2"));
        assert!(image(b"no image", 0.0, 1.0).unwrap_err().contains("not a readable PNG"));
    }

    proptest! {
        #[test]
        fn a_damaged_image_is_an_error_or_a_grid(at in 0..200_usize, with in any::<u8>(), cut in 0..200_usize) {
            let mut bytes = png_of(4, &[7; 16]);
            let length = bytes.len();
            bytes[at % length] = with;
            bytes.truncate(length - cut % 40);
            if let Ok(grid) = image(&bytes, 0.0, 1.0) {
                prop_assert_eq!(grid.heights.len(), grid.cols * grid.rows);
            }
        }

        #[test]
        fn any_text_is_an_error_or_a_grid(text in "[0-9 ,;#.x\n-]{0,80}") {
            if let Ok(grid) = table(text.as_bytes()) {
                prop_assert_eq!(grid.heights.len(), grid.cols * grid.rows);
            }
        }
    }
}
