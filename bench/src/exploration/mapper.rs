//! From points to scores to the map.

use mirador_core::analysis::{GroundHeight, PointScore, ScoreConfig, Scorer, ZoneConfig, ZoneFinder};
use mirador_core::geometry::Pose;
use mirador_core::information_map::{self, InformationMap, MapConfig};
use mirador_core::scan::ScanView;
use mirador_core::simulation::ScannerConfig;
use mirador_core::surface::{SurfaceBuilder, SurfaceConfig};
use mirador_core::view_planning::PlanningConfig;

use super::ExplorationError;

/// What alignment, analysis and planning do with a scan whose pose is known.
pub(crate) struct Mapper {
    surface: SurfaceBuilder,
    surface_config: SurfaceConfig,
    scores: ScoreConfig,
    scorer: Scorer,
    finder: ZoneFinder,
    records: Vec<PointScore>,
    pub map: InformationMap,
    scans: u64,
}

impl Mapper {
    /// A mapper for scans of this scanner.
    pub fn new(scanner: &ScannerConfig, threads: usize) -> Result<Self, ExplorationError> {
        Ok(Self {
            surface: SurfaceBuilder::new(),
            surface_config: SurfaceConfig { threads, area_max_m2: max_area_m2(scanner), ..SurfaceConfig::default() },
            scores: ScoreConfig { threads, scanner_height_m: Some(scanner.height_m), ..ScoreConfig::default() },
            scorer: Scorer::new(),
            finder: ZoneFinder::new(),
            records: Vec::new(),
            map: InformationMap::new(MapConfig::default())?,
            scans: 0,
        })
    }

    /// Takes in a scan.
    pub fn take_in(&mut self, scan: ScanView<'_>, map_from_scanner: &Pose) -> Result<(), ExplorationError> {
        let surface = self.surface.build(scan, &self.surface_config)?;
        let level = &map_from_scanner.rotation;
        let ground = GroundHeight::resolve(&self.scores, scan, surface, level);
        self.records.resize(scan.points.len(), PointScore::NONE);
        self.scorer.score(scan, surface, level, ground, &self.scores, &mut self.records)?;
        let mut found = Vec::new();
        self.finder.find(surface, scan, &ZoneConfig::default(), &mut found)?;
        self.map.insert(scan, &self.records, map_from_scanner)?;
        let in_map: Vec<_> = found
            .iter()
            .map(|zone| information_map::Zone {
                centre: map_from_scanner * zone.centre.cast::<f64>(),
                normal: map_from_scanner.rotation * zone.normal.cast::<f64>(),
            })
            .collect();
        self.map.update_zones(self.scans, &in_map, map_from_scanner, &information_map::ZoneConfig::default());
        self.scans += 1;
        Ok(())
    }
}

/// A_max grows with the scanner's steps, so that a coarse scanner finds the same quality at the same distance.
fn max_area_m2(scanner: &ScannerConfig) -> f64 {
    0.0025 * (scanner.beam_step_deg / 0.5) * (scanner.turn_deg / scanner.sweeps as f64 / 0.5)
}

/// A scanner with both angular steps `times` as large, at least 1.
#[must_use]
pub fn coarser(fine: &ScannerConfig, times: usize) -> ScannerConfig {
    let times = times.max(1);
    ScannerConfig {
        beam_step_deg: fine.beam_step_deg * times as f64,
        beams: (fine.beams - 1) / times + 1,
        sweeps: fine.sweeps / times,
        ..fine.clone()
    }
}

/// The planner's settings for this scanner.
#[must_use]
pub fn planning_config(scanner: &ScannerConfig) -> PlanningConfig {
    for_scanner(PlanningConfig::default(), scanner)
}

/// These settings of the planner, for this scanner.
#[must_use]
pub fn for_scanner(mut config: PlanningConfig, scanner: &ScannerConfig) -> PlanningConfig {
    config.scanner.range_m = scanner.range_max_m;
    config.scanner.ground_range_m = scanner.ground_range_m();
    config.scanner.height_m = scanner.height_m;
    config.scanner.azimuth_step_deg = scanner.turn_deg / scanner.sweeps as f64;
    config.scanner.elevation_step_deg = scanner.beam_step_deg;
    // The fan begins so far under the horizon.
    config.scanner.lowest_elevation_deg = scanner.first_beam_deg.max(-90.0);
    config.scanner.max_area_m2 = max_area_m2(scanner);
    config
}
