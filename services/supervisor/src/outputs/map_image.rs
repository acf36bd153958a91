//! `map.png`: navigability and quality side by side, the trajectory and the last plan drawn on both. Where something can
//! be passed both under and over, the pictures show the lower level, hatched, and a third one shows what is above.

use mirador_ipc_schema::messages::{CANDIDATE_OPEN, MAP_TILE_SIDE, MapCell};

use mirador_viewers::colour::{CHOSEN, TRAJECTORY, blend, blue_to_yellow, red_to_green};

use super::canvas::{Canvas, Colour};
use super::run_data::{FinalMap, RunData};

/// Longer side of a panel [pixels].
const PANEL: f64 = 900.0;
/// A cell is at most this large [pixels].
const LARGEST_CELL: f64 = 12.0;
/// Free space around the panels [pixels].
const MARGIN: i64 = 16;
/// Height of the line above and of the line below the panels [pixels].
const LINE: i64 = 30;

const PAPER: Colour = [250, 250, 250];
const INK: Colour = [40, 40, 40];
const UNKNOWN: Colour = [205, 205, 205];
const CANDIDATE: Colour = [90, 30, 120];

/// One of the pictures.
struct Panel {
    title: &'static str,
    /// What is drawn of a cell, stored as `value * 65535`.
    value: fn(&MapCell) -> u16,
    colour: fn(f64) -> Colour,
    /// Draws what lies above the lowest level, and that palely where it does not.
    is_upper: bool,
}

const PANELS: [Panel; 3] = [
    Panel { title: "NAVIGABILITY", value: |cell| cell.navigability, colour: red_to_green, is_upper: false },
    Panel { title: "QUALITY", value: |cell| cell.quality, colour: blue_to_yellow, is_upper: false },
    Panel { title: "UPPER LEVEL", value: |cell| cell.navigability, colour: red_to_green, is_upper: true },
];

impl Panel {
    /// The colour at a place of the map [m], which is drawn at (x, y) [pixels].
    fn shade(&self, map: &FinalMap, at: (f64, f64), (x, y): (i64, i64)) -> Colour {
        let colour = |cell: &MapCell| (self.colour)(f64::from((self.value)(cell)) / 65535.0);
        let (lower, upper) = (map.at(at.0, at.1), map.above(at.0, at.1));
        match (lower, upper, self.is_upper) {
            (_, Some(upper), true) => colour(upper),
            (Some(lower), None, true) => blend(&[colour(lower), PAPER], 0.75),
            (Some(lower), Some(_), false) if (x + y).rem_euclid(6) < 2 => blend(&[colour(lower), INK], 0.5),
            (Some(lower), _, false) => colour(lower),
            (None, ..) => UNKNOWN,
        }
    }
}

/// The part of the map that is drawn, and how large.
struct Window {
    /// Lower left corner [m].
    x: f64,
    y: f64,
    /// Extent [m].
    width: f64,
    height: f64,
    /// Pixels a metre.
    scale: f64,
}

impl Window {
    /// Everything known and the trajectory, with a margin.
    fn around(data: &RunData) -> Self {
        let mut corners = known_corners(data);
        corners.extend(data.scans.iter().filter_map(|s| s.pose()).map(|p| [p.translation.x, p.translation.y]));
        corners.retain(|c| c[0].is_finite() && c[1].is_finite());
        let bound = |axis: usize, pick: fn(f64, f64) -> f64| corners.iter().map(|c| c[axis]).reduce(pick);
        let (x0, x1) = (bound(0, f64::min).unwrap_or(0.0), bound(0, f64::max).unwrap_or(0.0));
        let (y0, y1) = (bound(1, f64::min).unwrap_or(0.0), bound(1, f64::max).unwrap_or(0.0));
        let border = 1.0;
        let (width, height) = (x1 - x0 + 2.0 * border, y1 - y0 + 2.0 * border);
        let cell_m = if data.map.cell_m > 0.0 { data.map.cell_m } else { 0.25 };
        let scale = (PANEL / width.max(height)).min(LARGEST_CELL / cell_m);
        Self { x: x0 - border, y: y0 - border, width, height, scale }
    }

    /// Size of the panel [pixels].
    fn pixels(&self) -> (i64, i64) {
        let side = |metres: f64| (metres * self.scale).ceil().max(1.0) as i64;
        (side(self.width), side(self.height))
    }

    /// Place of a point of the map in the panel, y upwards [pixels].
    fn place(&self, x: f64, y: f64) -> (f64, f64) {
        ((x - self.x) * self.scale, (self.y + self.height - y) * self.scale)
    }
}

/// Opposite corners of every known cell [m].
fn known_corners(data: &RunData) -> Vec<[f64; 2]> {
    let mut corners = Vec::new();
    for ((tile_x, tile_y), tile) in &data.map.tiles {
        let known = tile.cells.iter().enumerate().filter(|(_, cell)| cell.flags & 1 != 0);
        for (k, _) in known {
            let side = MAP_TILE_SIDE as f64;
            let column = f64::from(*tile_x) * side + (k % MAP_TILE_SIDE) as f64;
            let row = f64::from(*tile_y) * side + (k / MAP_TILE_SIDE) as f64;
            corners.push([column * data.map.cell_m, row * data.map.cell_m]);
            corners.push([(column + 1.0) * data.map.cell_m, (row + 1.0) * data.map.cell_m]);
        }
    }
    corners
}

/// Draws the map of a run.
pub(super) fn draw(data: &RunData) -> Canvas {
    let window = Window::around(data);
    let (width, height) = window.pixels();
    // Wide enough for the headings and the legend even where little is known.
    let column = width.max(220);
    let panels = PANELS.iter().filter(|panel| !panel.is_upper || !data.map.upper.is_empty());
    let count = panels.clone().count() as i64;
    let size = ((count + 1) * MARGIN + count * column, 2 * MARGIN + 2 * LINE + height);
    let mut canvas = Canvas::new(size.0.unsigned_abs() as usize, size.1.unsigned_abs() as usize, PAPER);
    for (k, panel) in (0..).zip(panels) {
        let (left, top) = (MARGIN + k * (column + MARGIN), MARGIN + LINE);
        canvas.text(left, MARGIN, 2, panel.title, INK);
        for y in 0..height {
            for x in 0..width {
                let at = (
                    window.x + (x as f64 + 0.5) / window.scale,
                    window.y + window.height - (y as f64 + 0.5) / window.scale,
                );
                canvas.set(left + x, top + y, panel.shade(&data.map, at, (x, y)));
            }
        }
        draw_plan(&mut canvas, data, &window, (left, top));
        draw_trajectory(&mut canvas, data, &window, (left, top));
        draw_legend(&mut canvas, left + column, top + height + 8, panel.colour);
    }
    draw_scale_bar(&mut canvas, &window, MARGIN + LINE + height + 8);
    canvas
}

fn draw_trajectory(canvas: &mut Canvas, data: &RunData, window: &Window, (left, top): (i64, i64)) {
    let place = |x: f64, y: f64| {
        let (x, y) = window.place(x, y);
        (x + left as f64, y + top as f64)
    };
    let aligned = data.scans.iter().filter(|s| s.is_aligned()).filter_map(|s| s.pose());
    let places: Vec<_> = aligned.map(|p| place(p.translation.x, p.translation.y)).collect();
    let driven: Vec<_> = data.drive.track.iter().map(|p| place(p[0], p[1])).collect();
    for leg in if driven.is_empty() { &places } else { &driven }.windows(2) {
        canvas.line(leg[0], leg[1], 1.0, TRAJECTORY);
    }
    for (k, at) in places.iter().enumerate() {
        canvas.disc(at.0, at.1, if k == 0 { 6.0 } else { 4.0 }, TRAJECTORY);
        canvas.disc(at.0, at.1, 2.0, PAPER);
    }
}

/// Candidates of the last plan, the chosen one and the path to it.
fn draw_plan(canvas: &mut Canvas, data: &RunData, window: &Window, (left, top): (i64, i64)) {
    let place = |[x, y, _]: [f64; 3]| {
        let (x, y) = window.place(x, y);
        (x + left as f64, y + top as f64)
    };
    let Some((plan, candidates)) = &data.last_plan else { return };
    for candidate in candidates.iter().filter(|c| c.status == CANDIDATE_OPEN) {
        let at = place(candidate.position);
        canvas.disc(at.0, at.1, 3.0, CANDIDATE);
    }
    let path = data.scans.iter().find(|s| s.number() == plan.header.scan()).map_or(&[][..], |s| &s.path);
    for leg in path.windows(2) {
        canvas.line(place(leg[0].position), place(leg[1].position), 0.5, CHOSEN);
    }
    if let Some(chosen) = usize::try_from(plan.chosen).ok().and_then(|k| candidates.get(k)) {
        let at = place(chosen.position);
        canvas.disc(at.0, at.1, 7.0, CHOSEN);
        canvas.disc(at.0, at.1, 4.0, PAPER);
    }
}

/// The colours from 0 to 1, right-aligned at `right`.
fn draw_legend(canvas: &mut Canvas, right: i64, y: i64, colour: fn(f64) -> Colour) {
    let length = 60;
    let left = right - length - 32;
    canvas.text(left - 8, y + 2, 2, "0", INK);
    for x in 0..length {
        canvas.rectangle(left + 8 + x, y, 1, 16, colour(x as f64 / (length - 1) as f64));
    }
    canvas.text(left + 14 + length, y + 2, 2, "1", INK);
}

/// A bar of a round length, about a fifth of the panel.
fn draw_scale_bar(canvas: &mut Canvas, window: &Window, y: i64) {
    let wanted = window.width / 5.0;
    let power = 10_f64.powf(wanted.max(1e-3).log10().floor());
    let round = [1.0, 2.0, 5.0].map(|f| f * power);
    let length = round.into_iter().filter(|l| *l <= wanted).fold(power, f64::max);
    let pixels = (length * window.scale).round() as i64;
    canvas.rectangle(MARGIN, y + 6, pixels, 4, INK);
    canvas.rectangle(MARGIN, y, 2, 16, INK);
    canvas.rectangle(MARGIN + pixels - 2, y, 2, 16, INK);
    let label = if length < 1.0 { format!("{length:.1} m") } else { format!("{length:.0} m") };
    canvas.text(MARGIN + pixels + 8, y + 2, 2, &label, INK);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outputs::testing::map_data;
    use mirador_ipc_schema::messages::MapTile;

    #[test]
    fn the_picture_is_as_large_as_the_known_part_asks_for() {
        // Two known cells of 0.5 m in a row, with 1 m around: 3.0 x 2.5 m at 24 pixels a metre.
        let canvas = draw(&map_data());
        assert_eq!(canvas.size(), (3 * 16 + 2 * 220, 2 * 16 + 2 * 30 + 60));
    }

    #[test]
    fn navigable_cells_are_green_obstacles_red_and_the_rest_grey() {
        let canvas = draw(&map_data());
        let pixel =
            |x_m: f64, y_m: f64| canvas.get(16 + ((x_m + 1.0) * 24.0) as usize, 46 + ((1.5 - y_m) * 24.0) as usize);
        assert_eq!(pixel(0.25, 0.25), [40, 150, 65]);
        assert_eq!(pixel(0.75, 0.25), [200, 40, 35]);
        assert_eq!(pixel(-0.5, 0.25), UNKNOWN);
        assert_eq!(pixel(0.25, 1.0), UNKNOWN);
    }

    #[test]
    fn a_deck_is_drawn_in_a_picture_of_its_own_and_hatched_over_the_road() {
        let mut data = map_data();
        let mut deck = MapTile { level: 1, levels: 2, ..MapTile::default() };
        deck.cells[1] = MapCell { navigability: 65535, flags: 1, ..MapCell::default() };
        data.map.take(&[deck]);
        let canvas = draw(&data);
        assert_eq!(canvas.size().0, 4 * 16 + 3 * 220);
        let at = |panel: usize, x: f64, y: f64| {
            let left = 16 + panel * (220 + 16);
            let pixel =
                |dx: usize| canvas.get(left + ((x + 1.0) * 24.0) as usize + dx, 46 + ((1.5 - y) * 24.0) as usize);
            (0..6).map(pixel).collect::<Vec<_>>()
        };
        assert!(at(2, 0.75, 0.25).iter().all(|c| *c == [40, 150, 65]), "the deck is navigable");
        assert!(at(2, 0.25, 0.25).iter().all(|c| *c == blend(&[[40, 150, 65], PAPER], 0.75)), "no deck here");
        let hatched = at(0, 0.75, 0.25);
        assert_eq!(hatched.iter().filter(|c| **c == [200, 40, 35]).count(), 4);
        assert!(at(0, 0.25, 0.25).iter().all(|c| *c == [40, 150, 65]), "nothing above is not hatched");
        // The tile comes again without the deck.
        let ground = MapTile { levels: 1, ..**data.map.tiles.get(&(0, 0)).unwrap() };
        data.map.take(&[ground]);
        assert_eq!(draw(&data).size().0, 3 * 16 + 2 * 220);
    }

    #[test]
    fn a_run_without_a_map_still_has_a_picture() {
        let canvas = draw(&RunData::default());
        assert!(canvas.size().0 > 400);
        assert!(canvas.png().is_ok());
    }

    #[test]
    fn every_letter_of_a_title_is_drawn() {
        for letter in PANELS.iter().flat_map(|panel| panel.title.chars()).filter(|letter| *letter != ' ') {
            let mut canvas = Canvas::new(12, 12, PAPER);
            canvas.text(1, 1, 1, &letter.to_string(), INK);
            let is_drawn = (0..144).any(|k| canvas.get(k % 12, k / 12) == INK);
            assert!(is_drawn, "{letter}");
        }
    }

    #[test]
    fn the_ends_of_the_colours_are_exact() {
        assert_eq!(
            (red_to_green(0.0), red_to_green(0.5), red_to_green(1.0)),
            ([200, 40, 35], [245, 205, 70], [40, 150, 65])
        );
        assert_eq!(blue_to_yellow(f64::NAN.max(1.0)), [250, 230, 60]);
    }
}
