//! Images of a world: by a robot's camera, or from above.

use nalgebra::{Point3, Vector3};
use thiserror::Error;

use super::compiled_scene::CompiledScene;
use crate::geometry::Pose;
use crate::threads;

/// Farthest thing an image shows [m].
const HORIZON_M: f64 = 500.0;
/// Rows of an image that a thread takes at a time.
const ROWS_A_BLOCK: usize = 8;
/// Light from everywhere, and from the sun on a surface square to it.
const AMBIENT: f64 = 0.45;
const SUN: f64 = 0.6;
/// Colours of the sky at the horizon and at the zenith.
const SKY: [[f64; 3]; 2] = [[205.0, 218.0, 230.0], [110.0, 150.0, 205.0]];

/// A camera without distortion: looks along its x axis, y to the left, z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Horizontal field of view [rad], below pi.
    pub field_of_view: f64,
}

/// An image, 8 bits red, green and blue, the first row uppermost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Three bytes a pixel, row after row.
    pub rgb: Vec<u8>,
}

/// Why an image cannot be written.
#[derive(Debug, Error)]
pub enum ImageError {
    /// The encoder refused it.
    #[error("an image of {width} x {height} pixels cannot be written as PNG: {source}")]
    Png {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// The encoder's reason.
        source: png::EncodingError,
    },
}

impl Camera {
    /// What the camera sees, surfaces in their colours lit by a sun that stands in the south-west. The bits do not
    /// depend on the number of threads.
    #[must_use]
    pub fn image(&self, scene: &CompiledScene, map_from_camera: &Pose, threads: usize) -> Image {
        let origin = Point3::from(map_from_camera.translation.vector);
        let rotation = map_from_camera.rotation.to_rotation_matrix();
        let step = 2.0 * (self.field_of_view / 2.0).tan() / self.width as f64;
        let ray = |row: usize, col: usize| {
            let left = (self.width as f64 / 2.0 - col as f64 - 0.5) * step;
            let up = (self.height as f64 / 2.0 - row as f64 - 0.5) * step;
            rotation * Vector3::new(1.0, left, up).normalize()
        };
        self.render(threads, |row, colours| {
            let directions: Vec<_> = (0..self.width).map(|col| ray(row, col)).collect();
            let mut hits = vec![None; self.width];
            scene.cast_all(&origin, &directions, HORIZON_M, &mut hits);
            for ((colour, hit), direction) in colours.iter_mut().zip(&hits).zip(&directions) {
                *colour = hit
                    .map_or_else(|| sky(direction), |hit| shade(scene.colour(&hit).0, &scene.normal(&hit), direction));
            }
        })
    }

    fn render(&self, threads: usize, row: impl Fn(usize, &mut [[u8; 3]]) + Sync) -> Image {
        let mut pixels = vec![[0_u8; 3]; self.width * self.height];
        let block = ROWS_A_BLOCK * self.width.max(1);
        threads::for_each(pixels.chunks_mut(block).enumerate(), threads, |(k, rows)| {
            for (offset, colours) in rows.chunks_mut(self.width.max(1)).enumerate() {
                row(k * ROWS_A_BLOCK + offset, colours);
            }
        });
        Image { width: self.width, height: self.height, rgb: pixels.concat() }
    }
}

/// The work area from above, north up, `pixel` [m] a pixel.
#[must_use]
pub fn top_view(scene: &CompiledScene, pixel: f64, threads: usize) -> Image {
    let area = scene.scene().area;
    let pixels = |[low, high]: [f64; 2]| (((high - low) / pixel).round() as usize).clamp(1, 8192);
    let camera = Camera { width: pixels(area.x_m), height: pixels(area.y_m), field_of_view: 1.0 };
    camera.render(threads, |row, colours| {
        for (col, colour) in colours.iter_mut().enumerate() {
            let (x, y) = (area.x_m[0] + (col as f64 + 0.5) * pixel, area.y_m[1] - (row as f64 + 0.5) * pixel);
            let hit = scene.cast(&Point3::new(x, y, 200.0), &-Vector3::z(), HORIZON_M);
            *colour = hit.map_or([0; 3], |hit| shade(scene.colour(&hit).0, &scene.normal(&hit), &-Vector3::z()));
        }
    })
}

impl Image {
    /// The bytes of a PNG file.
    ///
    /// # Errors
    /// When a side is 0 or too long for the format.
    pub fn to_png(&self) -> Result<Vec<u8>, ImageError> {
        let fail = |source| ImageError::Png { width: self.width, height: self.height, source };
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(fail)?;
        writer.write_image_data(&self.rgb).map_err(fail)?;
        writer.finish().map_err(fail)?;
        Ok(bytes)
    }
}

/// The colour of a surface seen along `direction`; it is lit on the side that is seen.
fn shade(colour: [u8; 3], normal: &Vector3<f64>, direction: &Vector3<f64>) -> [u8; 3] {
    let normal = if normal.dot(direction) > 0.0 { -normal } else { *normal };
    let sun = Vector3::new(-0.45, -0.35, 0.82).normalize();
    let light = AMBIENT + SUN * normal.dot(&sun).max(0.0);
    colour.map(|channel| (f64::from(channel) * light).clamp(0.0, 255.0) as u8)
}

fn sky(direction: &Vector3<f64>) -> [u8; 3] {
    let up = direction.z.clamp(0.0, 1.0);
    [0, 1, 2].map(|k: usize| (SKY[0][k] + up * (SKY[1][k] - SKY[0][k])) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::{ScanPose, Scene};

    fn world() -> CompiledScene {
        let text = "name = \"t\"\nstart = { x_m = 0, y_m = 0 }\narea = { x_m = [-10, 10], y_m = [-10, 10] }\n\
                    [[box]]\nlabel = \"other\"\nx_m = 6\ny_m = 2\nlength_m = 2\nwidth_m = 2\nheight_m = 2\ncolour = [255, 0, 0]\n";
        CompiledScene::new(Scene::from_toml(text, "t").unwrap()).unwrap()
    }

    const CAMERA: Camera = Camera { width: 64, height: 48, field_of_view: 1.2 };

    #[test]
    fn a_red_box_ahead_to_the_left_is_red_on_the_left_under_the_sky() {
        let world = world();
        let pose = world.level_scanner_pose(&ScanPose { x: 0.0, y: 0.0, yaw: 0.0 }, 1.0).unwrap();
        let image = CAMERA.image(&world, &pose, 2);
        let pixel = |row: usize, col: usize| &image.rgb[3 * (row * 64 + col)..][..3];
        let left = pixel(24, 15);
        assert!(left[0] > 90 && left[1] == 0 && left[2] == 0, "{left:?}");
        assert!(pixel(2, 50)[2] > pixel(2, 50)[0], "blue sky: {:?}", pixel(2, 50));
        assert!(pixel(40, 50)[1] > pixel(40, 50)[2], "green ground: {:?}", pixel(40, 50));
        assert_eq!(image, CAMERA.image(&world, &pose, 1));
    }

    #[test]
    fn from_above_north_is_up_and_a_png_holds_the_image() {
        let image = top_view(&world(), 0.5, 1);
        assert_eq!((image.width, image.height), (40, 40));
        let pixel = |x: f64, y: f64| {
            let (row, col) = (((10.0 - y) / 0.5) as usize, ((x + 10.0) / 0.5) as usize);
            image.rgb[3 * (row * 40 + col)..][..3].to_vec()
        };
        assert!(pixel(6.2, 2.2)[1] == 0 && pixel(6.2, -2.2)[1] > 0);
        let bytes = image.to_png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        assert_eq!(back, image.rgb);
        let none = Image { width: 0, height: 0, rgb: Vec::new() };
        assert!(none.to_png().unwrap_err().to_string().contains("0 x 0"));
    }
}
