//! The ground: an inclined plane, gentle hills, and correlated roughness, sampled on a grid of triangles.

use nalgebra::Vector3;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::height_grid::HeightFile;
use super::scene::WorkArea;

/// The ground's form. The height at (x, y) [m] is `height_m` + the slopes + the bumps + the waves + the roughness.
/// The default is flat ground at height 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TerrainConfig {
    /// Side of the grid's cells [m]; a plane without hills or roughness needs no grid and takes one cell.
    pub cell_m: f64,
    /// How far the ground goes on outside the work area [m].
    pub margin_m: f64,
    /// Height at the origin of the inclined plane [m].
    pub height_m: f64,
    /// Heights from a file, added to all the rest. The ground then covers this grid, and `cell_m` and `margin_m` do not
    /// count.
    pub heights: Option<HeightFile>,
    /// Inclination of the plane along x [deg].
    pub slope_x_deg: f64,
    /// Inclination of the plane along y [deg].
    pub slope_y_deg: f64,
    /// Hills and hollows.
    pub bumps: Vec<Bump>,
    /// Undulations.
    pub waves: Vec<Wave>,
    /// Small-scale unevenness.
    pub roughness: Option<Roughness>,
    /// Height of the grass [m]: every ray that would meet the ground ends on a blade, at a random height up to this over
    /// it. Drawn with the scanner's errors; the ground itself and true ranges know nothing of it.
    pub grass_m: f64,
}

impl Default for TerrainConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.5,
            margin_m: 5.0,
            height_m: 0.0,
            heights: None,
            slope_x_deg: 0.0,
            slope_y_deg: 0.0,
            bumps: Vec::new(),
            waves: Vec::new(),
            roughness: None,
            grass_m: 0.0,
        }
    }
}

/// A hill with the profile `height exp(-d^2 / (2 radius^2))`, d the horizontal distance to its top; a hollow when the
/// height is negative.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bump {
    /// The top [m].
    pub x_m: f64,
    /// The top [m].
    pub y_m: f64,
    /// Height over the surrounding [m], may be negative.
    pub height_m: f64,
    /// Standard deviation of the profile [m].
    pub radius_m: f64,
}

/// An undulation `amplitude sin(2 pi (x cos heading + y sin heading) / wavelength + phase)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wave {
    /// Half the height from hollow to crest [m].
    pub amplitude_m: f64,
    /// Distance from crest to crest [m].
    pub wavelength_m: f64,
    /// Direction across the crests, from x towards y [deg].
    #[serde(default)]
    pub heading_deg: f64,
    /// Phase at the origin [deg].
    #[serde(default)]
    pub phase_deg: f64,
}

/// Correlated Gaussian roughness: white noise on a lattice, smoothed by a cubic B-spline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roughness {
    /// Standard deviation of the height over the whole ground [m].
    pub sigma_m: f64,
    /// Spacing of the lattice: heights farther apart than about twice this are independent [m].
    pub correlation_m: f64,
    /// Seed of the noise.
    #[serde(default)]
    pub seed: u64,
}

/// The most grid nodes a terrain may have: 4 million, about 100 MB of triangles and hierarchy a million.
const MAX_NODES: f64 = 4.0e6;

/// Mean of the sum of the squared weights of a cubic B-spline: the variance of the smoothed noise along one axis.
const SPLINE_VARIANCE: f64 = 151.0 / 315.0;

impl TerrainConfig {
    /// The first field outside its range as (field, what is allowed), or `None` when all is well for this work area.
    pub(super) fn fault(&self, area: &WorkArea) -> Option<(&'static str, &'static str)> {
        let rough = self.roughness.as_ref();
        let checks = [
            (self.cell_m > 0.0, "cell_m", "must be above 0"),
            (self.margin_m >= 0.0, "margin_m", "must be 0 or more"),
            (self.height_m.is_finite(), "height_m", "must be finite"),
            ((0.0..=2.0).contains(&self.grass_m), "grass_m", "must lie in 0 ..= 2"),
            (self.slope_x_deg.abs() <= 60.0, "slope_x_deg", "must lie in -60 ..= 60"),
            (self.slope_y_deg.abs() <= 60.0, "slope_y_deg", "must lie in -60 ..= 60"),
            (self.bumps.iter().all(|b| b.radius_m > 0.0), "bumps.radius_m", "must be above 0"),
            (self.bumps.iter().all(|b| (b.x_m + b.y_m + b.height_m).is_finite()), "bumps", "must be finite"),
            (self.waves.iter().all(|w| w.wavelength_m > 0.0), "waves.wavelength_m", "must be above 0"),
            (
                self.waves.iter().all(|w| (w.amplitude_m + w.heading_deg + w.phase_deg).is_finite()),
                "waves",
                "must be finite",
            ),
            (rough.is_none_or(|r| r.sigma_m >= 0.0 && r.sigma_m < 10.0), "roughness.sigma_m", "must lie in 0 .. 10"),
            (
                rough.is_none_or(|r| r.correlation_m >= 2.0 * self.heights.as_ref().map_or(self.cell_m, |h| h.cell_m)),
                "roughness.correlation_m",
                "must be at least twice terrain.cell_m",
            ),
        ];
        if let Some(&(_, field, allowed)) = checks.iter().find(|(holds, _, _)| !holds) {
            return Some((field, allowed));
        }
        if let Some(heights) = &self.heights {
            let [x, y] = heights.extent();
            let around = |[low, high]: [f64; 2], area: [f64; 2]| low <= area[0] && high >= area[1];
            return if !(heights.cell_m > 0.0 && heights.cell_m <= 100.0) {
                Some(("heights.cell_m", "must lie in 0 < cell_m <= 100"))
            } else if heights.grid.heights.is_empty() {
                Some(("heights.file", "must have been read"))
            } else if !(around(x, area.x_m) && around(y, area.y_m)) {
                Some(("heights", "must cover the work area; see file, cell_m, x_m and y_m"))
            } else {
                None
            };
        }
        let nodes = (self.span(area.x_m) / self.cell_m + 2.0) * (self.span(area.y_m) / self.cell_m + 2.0);
        (nodes > MAX_NODES || !nodes.is_finite())
            .then_some(("cell_m", "gives more than 4 million cells; make it larger"))
    }

    /// Length of the ground along an axis of the work area [m].
    fn span(&self, interval: [f64; 2]) -> f64 {
        interval[1] - interval[0] + 2.0 * self.margin_m
    }

    /// The rectangle that the ground covers: x and y from their lower to their upper ends [m].
    pub(super) fn extent(&self, area: &WorkArea) -> [[f64; 2]; 2] {
        if let Some(heights) = &self.heights {
            return heights.extent();
        }
        let widen = |[low, high]: [f64; 2]| [low - self.margin_m, high + self.margin_m];
        [widen(area.x_m), widen(area.y_m)]
    }

    /// Whether two triangles can show the whole ground.
    fn is_plane(&self) -> bool {
        self.heights.is_none() && self.bumps.is_empty() && self.waves.is_empty() && self.roughness.is_none()
    }

    /// Height of the smooth part, without roughness [m].
    fn smooth_height(&self, x: f64, y: f64) -> f64 {
        let plane = self.height_m + x * self.slope_x_deg.to_radians().tan() + y * self.slope_y_deg.to_radians().tan();
        let bumps = self.bumps.iter().map(|b| {
            let (dx, dy) = (x - b.x_m, y - b.y_m);
            b.height_m * (-(dx * dx + dy * dy) / (2.0 * b.radius_m * b.radius_m)).exp()
        });
        let waves = self.waves.iter().map(|w| {
            let (sin, cos) = w.heading_deg.to_radians().sin_cos();
            let phase = std::f64::consts::TAU * (x * cos + y * sin) / w.wavelength_m + w.phase_deg.to_radians();
            w.amplitude_m * phase.sin()
        });
        plane + bumps.sum::<f64>() + waves.sum::<f64>()
    }
}

/// The ground as triangles: a regular grid of heights, each cell cut along its diagonal from the lower left to the
/// upper right. This is the true surface: rays and [`Terrain::height`] agree.
#[derive(Debug, Clone)]
pub struct Terrain {
    origin: [f64; 2],
    cell: [f64; 2],
    /// Nodes along x and y, at least two each.
    nodes: [usize; 2],
    /// Heights of the nodes [m], x running fastest.
    heights: Vec<f64>,
}

impl Terrain {
    /// Samples the ground over the work area and its margin.
    #[must_use]
    pub fn new(config: &TerrainConfig, area: &WorkArea) -> Self {
        let [x, y] = config.extent(area);
        let file = config.heights.as_ref();
        let axis = |[low, high]: [f64; 2], nodes: Option<usize>| {
            let span = high - low;
            let cells = match nodes {
                Some(nodes) => (nodes - 1) as f64,
                None if config.is_plane() => 1.0,
                None => (span / config.cell_m).ceil().max(1.0),
            };
            (low, span / cells, cells as usize + 1)
        };
        let (x0, dx, nx) = axis(x, file.map(|file| file.grid.cols.max(2)));
        let (y0, dy, ny) = axis(y, file.map(|file| file.grid.rows.max(2)));
        let lattice = config.roughness.as_ref().map(|r| Lattice::new(r, dx * (nx - 1) as f64, dy * (ny - 1) as f64));
        let mut heights = Vec::with_capacity(nx * ny);
        for j in 0..ny {
            for i in 0..nx {
                let (u, v) = (i as f64 * dx, j as f64 * dy);
                let rough = lattice.as_ref().map_or(0.0, |lattice| lattice.height(u, v));
                let read = file.and_then(|file| file.grid.heights.get(j * nx + i)).copied().unwrap_or(0.0);
                heights.push(config.smooth_height(x0 + u, y0 + v) + rough + read);
            }
        }
        Self { origin: [x0, y0], cell: [dx, dy], nodes: [nx, ny], heights }
    }

    /// Height of the ground at (x, y) [m], or `None` beyond its edge.
    #[must_use]
    pub fn height(&self, x: f64, y: f64) -> Option<f64> {
        let (corners, fx, fy) = self.cell_at(x, y)?;
        let [h00, h10, h01, h11] = corners;
        Some(if fx >= fy {
            h00 + fx * (h10 - h00) + fy * (h11 - h10)
        } else {
            h00 + fy * (h01 - h00) + fx * (h11 - h01)
        })
    }

    /// The ground's unit normal at (x, y), upward, or `None` beyond its edge.
    #[must_use]
    pub fn normal(&self, x: f64, y: f64) -> Option<Vector3<f64>> {
        let ([h00, h10, h01, h11], fx, fy) = self.cell_at(x, y)?;
        let (rise_x, rise_y) = if fx >= fy { (h10 - h00, h11 - h10) } else { (h11 - h01, h01 - h00) };
        Some(Vector3::new(-rise_x / self.cell[0], -rise_y / self.cell[1], 1.0).normalize())
    }

    /// The cell's corner heights (00, 10, 01, 11) and the position within it, each coordinate in [0, 1].
    fn cell_at(&self, x: f64, y: f64) -> Option<([f64; 4], f64, f64)> {
        let u = (x - self.origin[0]) / self.cell[0];
        let v = (y - self.origin[1]) / self.cell[1];
        let (cells_x, cells_y) = ((self.nodes[0] - 1) as f64, (self.nodes[1] - 1) as f64);
        if !(0.0..=cells_x).contains(&u) || !(0.0..=cells_y).contains(&v) {
            return None;
        }
        // The far edge belongs to the last cell.
        let (i, j) = (u.floor().min(cells_x - 1.0), v.floor().min(cells_y - 1.0));
        let first = j as usize * self.nodes[0] + i as usize;
        let height = |index: usize| self.heights.get(index).copied();
        let corners =
            [height(first)?, height(first + 1)?, height(first + self.nodes[0])?, height(first + self.nodes[0] + 1)?];
        Some((corners, u - i, v - j))
    }

    /// Appends the ground's triangles, seen from above counter-clockwise.
    pub(super) fn triangulate(&self, triangles: &mut Vec<[Vector3<f64>; 3]>) {
        let node = |i: usize, j: usize| {
            let (x, y) = (self.origin[0] + i as f64 * self.cell[0], self.origin[1] + j as f64 * self.cell[1]);
            Vector3::new(x, y, self.heights[j * self.nodes[0] + i])
        };
        for j in 0..self.nodes[1] - 1 {
            for i in 0..self.nodes[0] - 1 {
                let (low, high) = (node(i, j), node(i + 1, j + 1));
                triangles.push([low, node(i + 1, j), high]);
                triangles.push([low, high, node(i, j + 1)]);
            }
        }
    }
}

/// White noise on a square lattice with one node beyond every edge, as the cubic B-spline needs.
struct Lattice {
    spacing: f64,
    cols: usize,
    values: Vec<f64>,
}

impl Lattice {
    fn new(roughness: &Roughness, span_x: f64, span_y: f64) -> Self {
        let spacing = roughness.correlation_m;
        let cols = (span_x / spacing) as usize + 5;
        let rows = (span_y / spacing) as usize + 5;
        let mut rng = ChaCha8Rng::seed_from_u64(roughness.seed);
        // The variance of the smoothed noise is SPLINE_VARIANCE along each of the two axes.
        let scale = roughness.sigma_m / SPLINE_VARIANCE;
        let values = (0..rows * cols)
            .map(|_| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                scale * normal
            })
            .collect();
        Self { spacing, cols, values }
    }

    /// The smoothed noise at (u, v) [m] from the lattice's first inner node.
    fn height(&self, u: f64, v: f64) -> f64 {
        let (i, wu) = spline_weights(u / self.spacing);
        let (j, wv) = spline_weights(v / self.spacing);
        let mut sum = 0.0;
        for (dj, wy) in wv.iter().enumerate() {
            let row = (j + dj) * self.cols + i;
            for (di, wx) in wu.iter().enumerate() {
                sum += wx * wy * self.values[row + di];
            }
        }
        sum
    }
}

/// The lattice cell of `t >= 0` and the four weights of the uniform cubic B-spline there.
fn spline_weights(t: f64) -> (usize, [f64; 4]) {
    let cell = t.floor();
    let f = t - cell;
    let g = 1.0 - f;
    let weights = [
        g * g * g / 6.0,
        (3.0 * f * f * f - 6.0 * f * f + 4.0) / 6.0,
        (3.0 * g * g * g - 6.0 * g * g + 4.0) / 6.0,
        f * f * f / 6.0,
    ];
    (cell as usize, weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const AREA: WorkArea = WorkArea { x_m: [-10.0, 10.0], y_m: [-5.0, 15.0] };

    #[test]
    fn an_inclined_plane_needs_two_triangles_and_is_exact() {
        let config = TerrainConfig { slope_x_deg: 10.0, height_m: 2.0, ..TerrainConfig::default() };
        let terrain = Terrain::new(&config, &AREA);
        let mut triangles = Vec::new();
        terrain.triangulate(&mut triangles);
        assert_eq!(triangles.len(), 2);
        let expected = 2.0 + 3.0 * 10.0f64.to_radians().tan();
        assert!((terrain.height(3.0, 4.0).unwrap() - expected).abs() < 1e-12);
        assert!((terrain.normal(3.0, 4.0).unwrap().z - 10.0f64.to_radians().cos()).abs() < 1e-12);
        assert_eq!(terrain.height(100.0, 0.0), None);
    }

    #[test]
    fn the_far_edge_of_the_ground_still_has_a_height() {
        let config = TerrainConfig {
            bumps: vec![Bump { x_m: 0.0, y_m: 0.0, height_m: 1.0, radius_m: 3.0 }],
            ..TerrainConfig::default()
        };
        let terrain = Terrain::new(&config, &AREA);
        assert!(terrain.height(15.0, 20.0).is_some());
        assert!(terrain.height(-15.0, -10.0).is_some());
        assert!((terrain.height(0.0, 0.0).unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn roughness_has_the_asked_standard_deviation_and_depends_on_its_seed_only() {
        let rough = |seed| TerrainConfig {
            cell_m: 0.1,
            roughness: Some(Roughness { sigma_m: 0.05, correlation_m: 0.25, seed }),
            ..TerrainConfig::default()
        };
        let terrain = Terrain::new(&rough(7), &AREA);
        let n = terrain.heights.len() as f64;
        let mean = terrain.heights.iter().sum::<f64>() / n;
        let sigma = (terrain.heights.iter().map(|h| (h - mean).powi(2)).sum::<f64>() / n).sqrt();
        assert!((sigma - 0.05).abs() < 0.004, "{sigma}");
        assert_eq!(terrain.heights, Terrain::new(&rough(7), &AREA).heights);
        assert_ne!(terrain.heights, Terrain::new(&rough(8), &AREA).heights);
    }

    #[test]
    fn a_field_out_of_range_is_named() {
        let config = TerrainConfig { cell_m: 0.0, ..TerrainConfig::default() };
        assert_eq!(config.fault(&AREA), Some(("cell_m", "must be above 0")));
        let config = TerrainConfig { cell_m: 1e-5, ..TerrainConfig::default() };
        assert_eq!(config.fault(&AREA).unwrap().0, "cell_m");
        assert_eq!(TerrainConfig::default().fault(&AREA), None);
    }

    proptest! {
        #[test]
        fn spline_weights_sum_to_one(t in 0.0..100.0f64) {
            let (cell, weights) = spline_weights(t);
            prop_assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            prop_assert!(cell as f64 <= t);
        }

        #[test]
        fn the_height_follows_the_normal(x in -9.0..9.0f64, y in -4.0..14.0f64) {
            let config = TerrainConfig {
                waves: vec![Wave { amplitude_m: 0.3, wavelength_m: 9.0, heading_deg: 30.0, phase_deg: 10.0 }],
                ..TerrainConfig::default()
            };
            let terrain = Terrain::new(&config, &AREA);
            let smooth = config.smooth_height(x, y);
            prop_assert!((terrain.height(x, y).unwrap() - smooth).abs() < 0.01);
            let slope = |h: f64, d: f64| (h - smooth) / d;
            let n = terrain.normal(x, y).unwrap();
            let gradient = [slope(config.smooth_height(x + 1e-4, y), 1e-4), slope(config.smooth_height(x, y + 1e-4), 1e-4)];
            prop_assert!((-n.x / n.z - gradient[0]).abs() < 0.08);
            prop_assert!((-n.y / n.z - gradient[1]).abs() < 0.08);
        }
    }
}
