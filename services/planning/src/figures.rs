//! The map in two figures; the mean is kept tile by tile, so that it costs what has changed and not what is known.

use std::collections::HashMap;

use mirador_core::information_map::{InformationMap, Tile, TileIndex};

/// The figures of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Figures {
    /// Known cells.
    pub cells_known: u32,
    /// Their mean quality; 0 without any.
    pub mean_quality: f64,
}

/// What every tile of one map brings to its mean quality.
#[derive(Debug, Default)]
pub(crate) struct FigureBook {
    /// Sums over the known cells, with the tile's revision they hold for.
    qualities: HashMap<TileIndex, (u64, f64)>,
}

impl FigureBook {
    /// The figures of the map; sums in the order of its tiles, so that they do not depend on what was kept.
    pub fn figures(&mut self, map: &InformationMap) -> Figures {
        let sum: f64 = map.tiles().map(|tile| self.quality(tile)).sum();
        let cells = map.known_count();
        Figures { cells_known: cells as u32, mean_quality: if cells == 0 { 0.0 } else { sum / cells as f64 } }
    }

    fn quality(&mut self, tile: &Tile) -> f64 {
        match self.qualities.get(&tile.index()) {
            Some((revision, sum)) if *revision == tile.revision() => *sum,
            _ => {
                let sum = tile.known_cells().filter_map(|(_, cell)| cell.quality()).sum();
                self.qualities.insert(tile.index(), (tile.revision(), sum));
                sum
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use mirador_core::analysis::PointScore;
    use mirador_core::geometry::Pose;
    use mirador_core::information_map::MapConfig;
    use mirador_core::scan::{Point, ScanView};

    use super::*;

    #[test]
    fn kept_figures_are_those_counted_anew() {
        let mut map = InformationMap::new(MapConfig::default()).unwrap();
        let mut book = FigureBook::default();
        assert_eq!(book.figures(&map), Figures { cells_known: 0, mean_quality: 0.0 });
        for scan in 0..4_u16 {
            let points: Vec<_> = (0..300).map(|k| Point::new(0.07 * k as f32, f32::from(scan), -1.0)).collect();
            let score = PointScore { flags: 3, navigable: 60_000, quality: 10_000 * scan, ..PointScore::NONE };
            let scores = vec![score; points.len()];
            map.insert(ScanView::unordered(&points), &scores, &Pose::translation(f64::from(scan), 0.0, 0.0)).unwrap();
            let kept = book.figures(&map);
            assert_eq!(kept, FigureBook::default().figures(&map));
            assert_eq!(kept.cells_known as usize, map.known_cells().count());
        }
        assert!(book.figures(&map).mean_quality > 0.1);
    }
}
