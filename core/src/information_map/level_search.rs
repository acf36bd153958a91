//! The search behind [`LevelChoice`](super::LevelChoice): breadth first from where the robot stands over the levels of a
//! window of tiles.

use super::cell::Level;
use super::config::MapConfig;
use super::index::CellIndex;
use super::level_choice::Reach;
use super::navigability::CellState;
use super::tile::{TILE_CELLS, TILE_SIDE, Tile};

/// One bit a cell of a tile.
pub(crate) type CellBits = [u64; TILE_CELLS / 64];

#[inline]
fn has(bits: &CellBits, within: usize) -> bool {
    bits[within / 64] >> (within % 64) & 1 == 1
}

#[inline]
fn set(bits: &mut CellBits, within: usize) {
    bits[within / 64] |= 1 << (within % 64);
}

/// One level as the search sees it: from where to where its ground reaches [m, map frame], and whether it can be driven on.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    lowest: f32,
    highest: f32,
    is_passable: bool,
}

impl Node {
    fn new(level: &Level, config: &MapConfig, threshold: f64) -> Self {
        let state = level.state(config.obstacle_weight);
        Self {
            lowest: level.lowest as f32,
            highest: level.highest as f32,
            is_passable: matches!(state, CellState::Known(c) if c > threshold),
        }
    }

    /// Whether it is where something stands that reaches from `low` to `high`.
    #[inline]
    fn is_at(&self, low: f32, high: f32, step: f32) -> bool {
        self.lowest - step <= high && low <= self.highest + step
    }

    #[inline]
    fn leads_to(&self, other: &Self, step: f32) -> bool {
        if other.is_passable {
            self.highest.max(other.highest) - self.lowest.min(other.lowest) <= step
        } else {
            other.is_at(self.lowest, self.highest, step)
        }
    }
}

/// A level that is not the lowest of its cell.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Upper {
    within: u8,
    level: u8,
    node: Node,
}

/// The levels of a tile's cells as the search sees them, some 2 kB: all that it needs to know of a tile, so that who
/// searches again and again keeps them for as long as the tile does not change.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TileLevels {
    /// Those of the lowest level of every cell; not a number in unknown cells, which no comparison holds for.
    lowest: [f32; TILE_CELLS],
    highest: [f32; TILE_CELLS],
    passable: CellBits,
    /// Cells that have more than one.
    several: CellBits,
    /// The others, in the order of cells, upwards.
    upper: Vec<Upper>,
}

impl Default for TileLevels {
    fn default() -> Self {
        let (unknown, none) = ([f32::NAN; TILE_CELLS], CellBits::default());
        Self { lowest: unknown, highest: unknown, passable: none, several: none, upper: Vec::new() }
    }
}

impl TileLevels {
    /// Reads a whole tile.
    pub fn of(tile: &Tile, config: &MapConfig, threshold: f64) -> Self {
        let mut levels = Self::default();
        for (index, cell) in tile.known_cells() {
            let within = index.within_tile();
            match cell.undivided(config.clearance_m) {
                Some(level) => levels.put(within, &[level], config, threshold),
                None => levels.put(within, cell.levels(config.clearance_m).as_slice(), config, threshold),
            }
        }
        levels
    }

    /// Forgets all cells.
    pub fn clear(&mut self) {
        (self.lowest, self.highest) = ([f32::NAN; TILE_CELLS], [f32::NAN; TILE_CELLS]);
        (self.passable, self.several) = (CellBits::default(), CellBits::default());
        self.upper.clear();
    }

    /// Takes in the levels of a cell, upwards; cells come in their order, each once.
    #[inline]
    pub fn put(&mut self, within: usize, levels: &[Level], config: &MapConfig, threshold: f64) {
        let Some((lowest, upper)) = levels.split_first() else { return };
        let node = Node::new(lowest, config, threshold);
        (self.lowest[within], self.highest[within]) = (node.lowest, node.highest);
        if node.is_passable {
            set(&mut self.passable, within);
        }
        if !upper.is_empty() {
            set(&mut self.several, within);
            let node = |level| Node::new(level, config, threshold);
            let upper = (1..).zip(upper);
            self.upper.extend(upper.map(|(k, level)| Upper { within: within as u8, level: k, node: node(level) }));
        }
    }

    /// Whether any cell has more than one.
    pub fn has_several(&self) -> bool {
        !self.upper.is_empty()
    }

    #[inline]
    fn lowest_of(&self, within: usize) -> Node {
        Node { lowest: self.lowest[within], highest: self.highest[within], is_passable: has(&self.passable, within) }
    }

    /// Where the levels of a cell over the lowest are among `upper`.
    fn upper_of(&self, within: usize) -> std::ops::Range<usize> {
        let first = self.upper.partition_point(|upper| usize::from(upper.within) < within);
        let count = self.upper[first..].iter().take_while(|upper| usize::from(upper.within) == within).count();
        first..first + count
    }

    fn node(&self, within: usize, level: u8) -> Node {
        match level {
            0 => self.lowest_of(within),
            _ => self
                .upper
                .get(self.upper_of(within).start + usize::from(level) - 1)
                .map_or_else(|| self.lowest_of(within), |upper| upper.node),
        }
    }

    /// Memory beyond the struct itself [bytes].
    pub fn bytes(&self) -> usize {
        self.upper.capacity() * size_of::<Upper>()
    }
}

/// A level that waits for its neighbours to be looked at: its cell, counted from the window's low corner.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    x: u32,
    y: u32,
    level: u8,
}

/// A search over a window of tiles, row by row. Its memory is reused.
#[derive(Debug, Default)]
pub(crate) struct LevelSearch {
    cols: usize,
    /// What is reached of the lowest levels, by the tile's place in the window.
    reached: Vec<CellBits>,
    /// What is reached of the others, tile by tile, and where each tile's begin.
    upper_reached: Vec<bool>,
    upper_first: Vec<u32>,
    /// Cells of which another level than the lowest was reached first: place of the tile, cell, level.
    higher: Vec<(u32, u8, u8)>,
    queue: Vec<Waiting>,
}

/// The eight cells around one.
const AROUND: [(i32, i32); 8] = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)];

impl LevelSearch {
    /// Searches a window of `cols` tiles a row, of which `corner` is the low corner. The order of the search is fixed.
    pub fn run(&mut self, tiles: &[Option<&TileLevels>], corner: CellIndex, cols: usize, reach: &Reach, cell_m: f64) {
        self.begin(tiles, cols);
        let Some(here) = CellIndex::containing(reach.robot.x / cell_m, reach.robot.y / cell_m) else { return };
        let (x, y) = (here.x - corner.x, here.y - corner.y);
        let (z, step) = (reach.robot.z as f32, reach.max_step_m as f32);
        let start = (reach.start_m / cell_m).clamp(0.0, 1e5).ceil() as i32;
        for (dx, dy) in (-start..=start).flat_map(|x| (-start..=start).map(move |y| (x, y))) {
            if (f64::from(dx).powi(2) + f64::from(dy).powi(2)).sqrt() * cell_m <= reach.start_m {
                self.visit(tiles, x + dx, y + dy, |node| node.is_at(z, z, step));
            }
        }
        let mut next = 0;
        while let Some(&Waiting { x, y, level }) = self.queue.get(next) {
            next += 1;
            let (place, within) = self.place(x, y);
            let Some(from) = tiles[place].map(|tile| tile.node(within, level)) else { continue };
            for (dx, dy) in AROUND {
                self.visit(tiles, x as i32 + dx, y as i32 + dy, |node| from.leads_to(node, step));
            }
        }
        self.higher.sort_unstable();
    }

    fn begin(&mut self, tiles: &[Option<&TileLevels>], cols: usize) {
        self.cols = cols;
        self.reached.clear();
        self.reached.resize(tiles.len(), CellBits::default());
        self.upper_first.clear();
        let mut count = 0;
        for tile in tiles {
            self.upper_first.push(count as u32);
            count += tile.map_or(0, |tile| tile.upper.len());
        }
        self.upper_reached.clear();
        self.upper_reached.resize(count, false);
        self.higher.clear();
        self.queue.clear();
    }

    #[inline]
    fn place(&self, x: u32, y: u32) -> (usize, usize) {
        const SIDE: u32 = TILE_SIDE as u32;
        let (tile_x, tile_y) = ((x / SIDE) as usize, (y / SIDE) as usize);
        (tile_y * self.cols + tile_x, (y % SIDE * SIDE + x % SIDE) as usize)
    }

    /// Reaches the levels of a cell that `touches` holds for; the search goes on from those that can be driven on.
    #[inline]
    fn visit(&mut self, tiles: &[Option<&TileLevels>], x: i32, y: i32, touches: impl Fn(&Node) -> bool) {
        let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y)) else { return };
        let (place, within) = self.place(x, y);
        if x as usize >= self.cols * TILE_SIDE as usize {
            return;
        }
        let Some(Some(tile)) = tiles.get(place) else { return };
        if !has(&self.reached[place], within) {
            let node = tile.lowest_of(within);
            if touches(&node) {
                set(&mut self.reached[place], within);
                if node.is_passable {
                    self.queue.push(Waiting { x, y, level: 0 });
                }
            }
        }
        if has(&tile.several, within) {
            self.visit_upper(tile, place, within, [x, y], touches);
        }
    }

    fn visit_upper(
        &mut self,
        tile: &TileLevels,
        place: usize,
        within: usize,
        [x, y]: [u32; 2],
        touches: impl Fn(&Node) -> bool,
    ) {
        let own = tile.upper_of(within);
        let first = self.upper_first[place] as usize;
        let flags = first + own.start..first + own.end;
        for (at, upper) in flags.clone().zip(&tile.upper[own]) {
            if self.upper_reached[at] || !touches(&upper.node) {
                continue;
            }
            let is_first = !has(&self.reached[place], within) && !self.upper_reached[flags.clone()].contains(&true);
            self.upper_reached[at] = true;
            if is_first {
                self.higher.push((place as u32, within as u8, upper.level));
            }
            if upper.node.is_passable {
                self.queue.push(Waiting { x, y, level: upper.level });
            }
        }
    }

    /// The level that was reached first of a cell of the tile at a place of the window; the lowest where none was.
    pub fn level_of(&self, place: usize, within: u8) -> usize {
        let found = self.higher.binary_search_by_key(&(place as u32, within), |&(place, within, _)| (place, within));
        found.map_or(0, |at| usize::from(self.higher[at].2))
    }

    /// Cells of which another level than the lowest was reached first: place of the tile, cell, level.
    pub fn higher(&self) -> &[(u32, u8, u8)] {
        &self.higher
    }

    /// The cells of which any level was reached.
    pub fn reached_cells(&self, tiles: &[Option<&TileLevels>], place: usize) -> CellBits {
        let mut bits = self.reached[place];
        if let Some(tile) = tiles[place] {
            let flags = &self.upper_reached[self.upper_first[place] as usize..];
            for (upper, _) in tile.upper.iter().zip(flags).filter(|(_, reached)| **reached) {
                set(&mut bits, usize::from(upper.within));
            }
        }
        bits
    }
}
