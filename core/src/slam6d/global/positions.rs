//! Keyframes by position: which are within reach of a place, without looking at all of them.

use std::collections::BTreeMap;

use nalgebra::Vector3;

/// Side of a cell [m].
const CELL_M: f64 = 10.0;

/// The positions of the keyframes in a grid of cubes.
#[derive(Debug, Default)]
pub(crate) struct Positions {
    cells: BTreeMap<[i32; 3], Vec<usize>>,
    of: Vec<Vector3<f64>>,
}

impl Positions {
    /// Appends the next keyframe.
    pub fn push(&mut self, position: Vector3<f64>) {
        self.cells.entry(cell(&position)).or_default().push(self.of.len());
        self.of.push(position);
    }

    /// Moves a keyframe.
    pub fn relocate(&mut self, keyframe: usize, position: Vector3<f64>) {
        let Some(known) = self.of.get_mut(keyframe) else { return };
        let (before, after) = (cell(known), cell(&position));
        *known = position;
        if before != after {
            if let Some(others) = self.cells.get_mut(&before) {
                others.retain(|other| *other != keyframe);
                if others.is_empty() {
                    self.cells.remove(&before);
                }
            }
            self.cells.entry(after).or_default().push(keyframe);
        }
    }

    /// The keyframes within `radius_m` of a place, ascending.
    pub fn within(&self, place: &Vector3<f64>, radius_m: f64) -> Vec<usize> {
        let near = |keyframe: &usize| self.of.get(*keyframe).is_some_and(|p| (p - place).norm() <= radius_m);
        let cells_across = 2.0 * radius_m / CELL_M + 1.0;
        let mut found: Vec<usize> = if cells_across.powi(3) > self.cells.len() as f64 {
            // The search would visit more cells than there are.
            (0..self.of.len()).filter(near).collect()
        } else {
            let (low, high) = (cell(&place.add_scalar(-radius_m)), cell(&place.add_scalar(radius_m)));
            let columns = (low[0]..=high[0]).flat_map(|x| (low[1]..=high[1]).map(move |y| (x, y)));
            let cells = columns.flat_map(|(x, y)| self.cells.range([x, y, low[2]]..=[x, y, high[2]]));
            cells.flat_map(|(_, keyframes)| keyframes.iter().copied()).filter(near).collect()
        };
        found.sort_unstable();
        found
    }
}

fn cell(position: &Vector3<f64>) -> [i32; 3] {
    // The conversion saturates; what lies that far away shares a cell.
    [position.x, position.y, position.z].map(|value| (value / CELL_M).floor() as i32)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn exactly_those_within_the_radius_are_found_also_after_some_have_moved(
            places in prop::collection::vec(prop::array::uniform3(-90.0..90.0_f64), 1..60),
            moves in prop::collection::vec((0..60_usize, prop::array::uniform3(-90.0..90.0_f64)), 0..20),
            at in prop::array::uniform3(-90.0..90.0_f64), radius in 0.0..70.0_f64,
        ) {
            let mut positions = Positions::default();
            let mut expected: Vec<Vector3<f64>> = places.into_iter().map(Vector3::from).collect();
            expected.iter().for_each(|p| positions.push(*p));
            for (keyframe, place) in moves {
                positions.relocate(keyframe, place.into());
                if let Some(known) = expected.get_mut(keyframe) {
                    *known = place.into();
                }
            }
            let at = Vector3::from(at);
            let expected: Vec<usize> = (0..expected.len()).filter(|k| (expected[*k] - at).norm() <= radius).collect();
            prop_assert_eq!(positions.within(&at, radius), expected);
        }
    }
}
