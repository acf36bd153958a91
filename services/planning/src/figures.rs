//! The map in two figures, kept tile by tile, so that they cost what has changed and not what is known.

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

/// One tile's share, with the tile's revision it holds for.
#[derive(Debug, Clone, Copy, Default)]
struct Share<T> {
    revision: Option<u64>,
    value: T,
}

impl<T: Copy> Share<T> {
    fn of(&mut self, tile: &Tile, count: impl Fn(&Tile) -> T) -> T {
        if self.revision != Some(tile.revision()) {
            *self = Self { revision: Some(tile.revision()), value: count(tile) };
        }
        self.value
    }
}

/// What every tile of one map brings to its figures.
#[derive(Debug, Default)]
pub(crate) struct FigureBook {
    tiles: HashMap<TileIndex, (Share<u32>, Share<f64>)>,
}

impl FigureBook {
    /// Known cells of the map.
    pub fn cells_known(&mut self, map: &InformationMap) -> u32 {
        let known = |tile: &Tile| tile.known_cells().count() as u32;
        map.tiles().map(|tile| self.tiles.entry(tile.index()).or_default().0.of(tile, known)).sum()
    }

    /// All figures of the map; sums in the order of its tiles, so that they do not depend on what was kept.
    pub fn figures(&mut self, map: &InformationMap) -> Figures {
        let cells_known = self.cells_known(map);
        let quality = |tile: &Tile| tile.known_cells().filter_map(|(_, cell)| cell.quality()).sum::<f64>();
        let sum: f64 = map.tiles().map(|tile| self.tiles.entry(tile.index()).or_default().1.of(tile, quality)).sum();
        Figures { cells_known, mean_quality: if cells_known == 0 { 0.0 } else { sum / f64::from(cells_known) } }
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
