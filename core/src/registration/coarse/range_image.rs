//! What a scanner saw in every direction, to tell the space its rays have crossed.

/// Cells about the vertical.
const COLUMNS: usize = 180;
/// Cells from straight down to straight up.
const ROWS: usize = 90;
/// Angle of a cell [rad].
const STEP: f32 = std::f32::consts::PI / ROWS as f32;
/// Cells of the three by three about a direction that must hold a range before anything is said about it.
const LEAST_KNOWN: u32 = 5;

/// The least range seen about every direction, in cells of 2 by 2 degrees.
///
/// The points are centroids of voxels, so each stands for the angle its voxel covers, and the least range is taken over
/// three by three cells: a ray is only said to have passed where all of its neighbours passed too.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RangeImage {
    /// Row by row; infinite where too little is known [m].
    least: Vec<f32>,
}

impl RangeImage {
    /// Draws the points [m, scanner frame], each as wide as `spacing_m`.
    pub fn new(points: &[[f32; 3]], spacing_m: f32) -> Self {
        let mut seen = vec![f32::INFINITY; ROWS * COLUMNS];
        for point in points {
            draw(&mut seen, *point, 0.5 * spacing_m);
        }
        Self { least: pooled(&seen) }
    }

    /// The range up to which nothing stood in the direction of `point`, or `None` where that is not known [m].
    #[inline]
    pub fn free_range(&self, point: [f32; 3]) -> Option<f32> {
        let range = length(point);
        let (row, column) = cell(point, range)?;
        self.least.get(row * COLUMNS + column).copied().filter(|least| least.is_finite())
    }

    /// The memory it holds [bytes].
    pub fn bytes(&self) -> usize {
        self.least.capacity() * size_of::<f32>()
    }
}

/// The length of a vector.
#[inline]
pub(super) fn length(v: [f32; 3]) -> f32 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

/// The cell of a direction.
#[inline]
fn cell(point: [f32; 3], range: f32) -> Option<(usize, usize)> {
    if !(range > 1e-3 && range.is_finite()) {
        return None;
    }
    let elevation = (point[2] / range).clamp(-1.0, 1.0).asin() + std::f32::consts::FRAC_PI_2;
    let azimuth = point[1].atan2(point[0]) + std::f32::consts::PI;
    Some((((elevation / STEP) as usize).min(ROWS - 1), ((azimuth / STEP) as usize).min(COLUMNS - 1)))
}

/// Lowers the cells that a point of this half width covers to its range.
fn draw(seen: &mut [f32], point: [f32; 3], half_width: f32) {
    let range = length(point);
    let Some((row, column)) = cell(point, range) else { return };
    let half_angle = (half_width / range).min(0.2);
    let reach = (half_angle / STEP + 0.5) as usize;
    let across = (point[0] * point[0] + point[1] * point[1]).sqrt() / range;
    let reach_columns = ((half_angle / (STEP * across.max(0.05)) + 0.5) as usize).min(COLUMNS / 2 - 1);
    for r in row.saturating_sub(reach)..=(row + reach).min(ROWS - 1) {
        for c in 0..=2 * reach_columns {
            let c = (column + COLUMNS + c - reach_columns) % COLUMNS;
            let least = &mut seen[r * COLUMNS + c];
            *least = least.min(range);
        }
    }
}

/// The least of three by three cells, the columns running round; infinite where the cell itself is unknown.
fn pooled(seen: &[f32]) -> Vec<f32> {
    let mut least = vec![f32::INFINITY; seen.len()];
    for row in 0..ROWS {
        for column in 0..COLUMNS {
            if seen[row * COLUMNS + column].is_infinite() {
                continue;
            }
            let (mut nearest, mut known) = (f32::INFINITY, 0);
            for r in row.saturating_sub(1)..=(row + 1).min(ROWS - 1) {
                for c in [column + COLUMNS - 1, column, column + 1] {
                    let range = seen[r * COLUMNS + c % COLUMNS];
                    known += u32::from(range.is_finite());
                    nearest = nearest.min(range);
                }
            }
            if known >= LEAST_KNOWN {
                least[row * COLUMNS + column] = nearest;
            }
        }
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_cross_the_space_in_front_of_a_wall_and_nothing_is_known_beside_it() {
        let wall: Vec<[f32; 3]> =
            (0..1600).map(|i| [10.0, (i % 40) as f32 * 0.25 - 5.0, (i / 40) as f32 * 0.25 - 5.0]).collect();
        let image = RangeImage::new(&wall, 0.25);
        let free = image.free_range([5.0, 0.1, 0.1]).unwrap();
        assert!((free - 10.0).abs() < 0.1, "{free}");
        assert_eq!(image.free_range([-5.0, 0.0, 0.0]), None);
        assert_eq!(image.free_range([0.0; 3]), None);
    }

    #[test]
    fn a_post_hides_what_lies_beside_it_so_that_nothing_is_claimed_too_much() {
        let mut points: Vec<[f32; 3]> =
            (0..1600).map(|i| [10.0, (i % 40) as f32 * 0.25 - 5.0, (i / 40) as f32 * 0.25 - 5.0]).collect();
        points.extend((0..20).map(|i| [4.0, 0.0, i as f32 * 0.1 - 1.0]));
        let image = RangeImage::new(&points, 0.25);
        assert!(image.free_range([9.0, 0.0, 0.0]).unwrap() < 4.2);
        assert!(image.free_range([9.0, 2.5, 0.0]).unwrap() > 9.5);
    }
}
