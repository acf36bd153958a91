//! Casts the sweeps of a turning laser many at a time while its robot stands.
//!
//! The hits depend on the place and the direction alone, so that they can be had before their time. As long as the
//! scanner moves, it is one sweep after the other.

use nalgebra::{Point3, Vector3};

use crate::geometry::Pose;
use crate::simulation::compiled_scene::{CompiledScene, Hit, Viewpoint};
use crate::simulation::scanner_config::ScannerConfig;
use crate::threads;

/// Sweeps and beams of a tile of neighbouring rays: as square as possible, so that a packet of rays stays together.
const TILE: usize = 4;
/// Sweeps that are cast at a time from where the last one was cast from, in blocks of a tile.
const BATCH: usize = 16 * TILE;

/// What a beam meets.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Echo {
    /// Range [m]; `None` where it meets nothing.
    pub range: Option<f64>,
    /// Light that comes back, see `ScannerConfig::strength`.
    pub strength: Option<f64>,
}

/// The sweeps that are cast already.
#[derive(Debug, Clone)]
pub(super) struct SweepsAhead {
    threads: usize,
    /// Where they were cast from; `None` when there are none.
    cast_from: Option<Viewpoint>,
    first: u32,
    sweeps: usize,
    /// By sweep, then beam.
    echoes: Vec<Echo>,
    /// Cosine and sine of every beam's angle over the horizon.
    elevations: Vec<(f64, f64)>,
}

impl SweepsAhead {
    pub(super) fn new(config: &ScannerConfig) -> Self {
        let elevation = |beam: usize| {
            let (sin, cos) =
                (config.first_beam_deg.to_radians() + config.beam_step_deg.to_radians() * beam as f64).sin_cos();
            (cos, sin)
        };
        let elevations = (0..config.beams).map(elevation).collect();
        Self { threads: 1, cast_from: None, first: 0, sweeps: 0, echoes: Vec::new(), elevations }
    }

    pub(super) fn set_threads(&mut self, threads: usize) {
        self.threads = threads;
    }

    /// A new scan begins.
    pub(super) fn forget(&mut self) {
        (self.cast_from, self.sweeps) = (None, 0);
    }

    /// The echoes of a sweep's beams. `azimuth` is that of a sweep's beam in the scanner's frame [rad].
    pub(super) fn sweep(
        &mut self,
        sweep: u32,
        config: &ScannerConfig,
        scene: &CompiledScene,
        map_from_scanner: &Pose,
        azimuth: impl Fn(u32, usize) -> f64 + Sync,
    ) -> impl Iterator<Item = Echo> {
        let viewpoint = scene.viewpoint(map_from_scanner);
        let stands = self.cast_from == Some(viewpoint);
        let known = self.first..self.first + self.sweeps as u32;
        if !stands || !known.contains(&sweep) {
            let left = config.sweeps.saturating_sub(sweep as usize);
            (self.first, self.sweeps) = (sweep, if stands { BATCH.min(left) } else { 1 });
            self.cast_from = Some(viewpoint);
            self.cast(config, scene, map_from_scanner, azimuth);
        }
        let from = (sweep - self.first) as usize * config.beams;
        self.echoes[from..from + config.beams].iter().copied()
    }

    fn cast(
        &mut self,
        config: &ScannerConfig,
        scene: &CompiledScene,
        map_from_scanner: &Pose,
        azimuth: impl Fn(u32, usize) -> f64 + Sync,
    ) {
        let (beams, first) = (config.beams, self.first);
        self.echoes.resize(self.sweeps * beams, Echo::default());
        let rotation = map_from_scanner.rotation.to_rotation_matrix();
        let origin = Point3::from(map_from_scanner.translation.vector);
        let elevations = &self.elevations;
        let blocks = self.echoes.chunks_mut(TILE * beams).enumerate();
        let threads = self.threads.min(self.sweeps.div_ceil(TILE));
        threads::for_each(blocks, threads, |(block, echoes): (usize, &mut [Echo])| {
            let rows = echoes.len() / beams;
            let mut directions = vec![Vector3::zeros(); echoes.len()];
            let mut hits: Vec<Option<Hit>> = vec![None; echoes.len()];
            for row in 0..rows {
                for (beam, (cos, sin)) in elevations.iter().enumerate() {
                    let (azimuth_sin, azimuth_cos) = azimuth(first + (block * TILE + row) as u32, beam).sin_cos();
                    let ray = Vector3::new(cos * azimuth_cos, cos * azimuth_sin, *sin);
                    directions[in_tiles(row, beam, rows, beams)] = rotation * ray;
                }
            }
            scene.cast_all(&origin, &directions, config.range_max_m, &mut hits);
            for (cell, echo) in echoes.iter_mut().enumerate() {
                let at = in_tiles(cell / beams, cell % beams, rows, beams);
                let strength = hits[at].and_then(|hit| config.strength(scene, &hit, &directions[at]));
                *echo = Echo { range: hits[at].map(|hit| hit.range), strength };
            }
        });
    }
}

/// Place of a ray when the rays of a block of sweeps are laid out tile by tile.
fn in_tiles(row: usize, beam: usize, rows: usize, beams: usize) -> usize {
    let left = beam / TILE * TILE;
    left * rows + row * TILE.min(beams - left) + (beam - left)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ray_of_a_block_has_a_place_of_its_own_and_tiles_are_together() {
        for (rows, beams) in [(4, 541), (1, 7), (3, 8), (4, 4)] {
            let mut places: Vec<_> =
                (0..rows * beams).map(|cell| in_tiles(cell / beams, cell % beams, rows, beams)).collect();
            assert!(places.iter().take(TILE.min(beams)).all(|place| *place < TILE * rows));
            places.sort_unstable();
            assert_eq!(places, (0..rows * beams).collect::<Vec<_>>());
        }
    }
}
