//! A picture to draw on: lines, discs and a few letters, and out as PNG.

use super::OutputError;

/// Red, green, blue.
pub(super) type Colour = [u8; 3];

/// A picture of 8-bit RGB pixels.
pub(super) struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

/// Places farther away are outside every picture, and so is what is not a number [pixels].
const FAR: f64 = 1e9;
/// Width of a letter and the gap behind it [pixels], at size 1.
const LETTER: i64 = 6;

impl Canvas {
    pub(super) fn new(width: usize, height: usize, background: Colour) -> Self {
        Self { width, height, pixels: background.repeat(width * height) }
    }

    #[cfg(test)]
    pub(super) fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Sets a pixel; outside the picture nothing happens.
    pub(super) fn set(&mut self, x: i64, y: i64, colour: Colour) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if x < self.width && y < self.height {
            let at = (y * self.width + x) * 3;
            self.pixels[at..at + 3].copy_from_slice(&colour);
        }
    }

    #[cfg(test)]
    pub(super) fn get(&self, x: usize, y: usize) -> Colour {
        let at = (y * self.width + x) * 3;
        [self.pixels[at], self.pixels[at + 1], self.pixels[at + 2]]
    }

    pub(super) fn rectangle(&mut self, x: i64, y: i64, width: i64, height: i64, colour: Colour) {
        for row in y..y + height {
            for column in x..x + width {
                self.set(column, row, colour);
            }
        }
    }

    pub(super) fn disc(&mut self, x: f64, y: f64, radius: f64, colour: Colour) {
        if !(x.abs() < FAR && y.abs() < FAR) {
            return;
        }
        let reach = radius.ceil() as i64;
        let (cx, cy) = (x.round() as i64, y.round() as i64);
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                if ((dx * dx + dy * dy) as f64) <= radius * radius {
                    self.set(cx + dx, cy + dy, colour);
                }
            }
        }
    }

    /// A straight line as a chain of discs.
    pub(super) fn line(&mut self, from: (f64, f64), to: (f64, f64), radius: f64, colour: Colour) {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let longest = (self.width + self.height) as f64 * 4.0;
        let steps = dx.abs().max(dy.abs()).min(longest).ceil().max(1.0);
        for k in 0..=steps as u32 {
            let share = f64::from(k) / steps;
            self.disc(from.0 + share * dx, from.1 + share * dy, radius, colour);
        }
    }

    /// Writes digits and the letters of the headings; anything else is a gap.
    pub(super) fn text(&mut self, x: i64, y: i64, size: i64, text: &str, colour: Colour) {
        for (k, letter) in (0..).zip(text.chars()) {
            let glyph = glyph(letter);
            for (row, bits) in (0..).zip(glyph) {
                for column in (0..5).filter(|c| bits >> (4 - c) & 1 == 1) {
                    self.rectangle(x + (k * LETTER + column) * size, y + row * size, size, size, colour);
                }
            }
        }
    }

    /// The picture as a PNG file.
    pub(super) fn png(&self) -> Result<Vec<u8>, OutputError> {
        let draw = |e: png::EncodingError| OutputError::Draw { what: "map.png", reason: e.to_string() };
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(draw)?;
        writer.write_image_data(&self.pixels).map_err(draw)?;
        writer.finish().map_err(draw)?;
        Ok(bytes)
    }
}

/// The rows of a letter, five bits each.
fn glyph(letter: char) -> [u8; 7] {
    match letter {
        // The unit of lengths.
        'm' => [0, 0, 26, 21, 21, 21, 21],
        '0' => [14, 17, 19, 21, 25, 17, 14],
        '1' => [4, 12, 4, 4, 4, 4, 14],
        '2' => [14, 17, 1, 2, 4, 8, 31],
        '3' => [31, 2, 4, 2, 1, 17, 14],
        '4' => [2, 6, 10, 18, 31, 2, 2],
        '5' => [31, 16, 30, 1, 1, 17, 14],
        '6' => [6, 8, 16, 30, 17, 17, 14],
        '7' => [31, 1, 2, 4, 8, 8, 8],
        '8' => [14, 17, 17, 14, 17, 17, 14],
        '9' => [14, 17, 17, 15, 1, 2, 12],
        'A' => [14, 17, 17, 31, 17, 17, 17],
        'B' => [30, 17, 17, 30, 17, 17, 30],
        'E' => [31, 16, 16, 30, 16, 16, 31],
        'G' => [14, 17, 16, 23, 17, 17, 15],
        'I' => [14, 4, 4, 4, 4, 4, 14],
        'K' => [17, 18, 20, 24, 20, 18, 17],
        'L' => [16, 16, 16, 16, 16, 16, 31],
        'M' => [17, 27, 21, 21, 17, 17, 17],
        'N' => [17, 17, 25, 21, 19, 17, 17],
        'O' => [14, 17, 17, 17, 17, 17, 14],
        'P' => [30, 17, 17, 30, 16, 16, 16],
        'Q' => [14, 17, 17, 17, 21, 18, 13],
        'R' => [30, 17, 17, 30, 20, 18, 17],
        'T' => [31, 4, 4, 4, 4, 4, 4],
        'U' => [17, 17, 17, 17, 17, 17, 14],
        'V' => [17, 17, 17, 17, 17, 10, 4],
        'Y' => [17, 17, 17, 10, 4, 4, 4],
        '.' => [0, 0, 0, 0, 0, 12, 12],
        '-' => [0, 0, 0, 31, 0, 0, 0],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawing_outside_the_picture_changes_nothing_and_does_no_harm() {
        let mut canvas = Canvas::new(4, 3, [9, 9, 9]);
        canvas.line((-50.0, -9.0), (-2.0, -9.0), 1.0, [0, 0, 0]);
        canvas.disc(f64::NAN, 1e300, 2.0, [0, 0, 0]);
        canvas.text(90, 90, 2, "Q", [0, 0, 0]);
        assert!((0..12).all(|k| canvas.get(k % 4, k / 4) == [9, 9, 9]));
    }

    #[test]
    fn a_picture_comes_back_from_its_png() {
        let mut canvas = Canvas::new(5, 2, [1, 2, 3]);
        canvas.set(4, 1, [200, 100, 50]);
        let bytes = canvas.png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height), (5, 2));
        assert_eq!(&pixels[27..30], [200, 100, 50]);
        assert_eq!(&pixels[..3], [1, 2, 3]);
    }
}
