//! What counts as unexplored ground in range.

use super::super::config::PlanningConfig;
use super::super::multi_criteria::MultiCriteria;
use super::super::test_worlds::{at, map_of, plan_with};
use super::super::{ScannerModel, WorkArea};
use crate::information_map::{CellIndex, CellState};

#[test]
fn unexplored_ground_counts_as_far_as_it_returns_light_and_no_farther() {
    // A patch of known ground in a work area of which nothing else is known; nothing hides anything.
    let rows = vec![".".repeat(40); 40];
    let map = map_of(&rows, 0.3);
    let area = WorkArea { min: [-9.0, -6.0], max: [30.0, 21.0] };
    for ground_range_m in [2.0, 5.3, 9.6, 12.0] {
        let scanner = ScannerModel { ground_range_m, range_m: 12.0, ..ScannerModel::default() };
        let config = PlanningConfig { scanner, work_area: Some(area), ..PlanningConfig::default() };
        let plan = plan_with(&mut MultiCriteria::default(), &map, &at(6.0, 6.0), &config);
        assert!(plan.candidates.len() > 5);
        for candidate in &plan.candidates {
            let [x, y, _] = candidate.position;
            let here = map.cell_containing(x, y).unwrap();
            let reach = (ground_range_m / 0.3).floor() as i32;
            let disc = (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy)));
            let expected = disc.filter(|(dx, dy)| {
                let cell = CellIndex { x: here.x + dx, y: here.y + dy };
                let is_near = f64::from(dx * dx + dy * dy) <= (ground_range_m / 0.3).powi(2);
                let [cx, cy] = map.centre_of(cell);
                let is_in = (-9.0..=30.0).contains(&cx) && (-6.0..=21.0).contains(&cy);
                is_near && is_in && matches!(map.state(cell), CellState::Unknown)
            });
            assert_eq!(candidate.raw.unexplored_cells as usize, expected.count(), "{ground_range_m} m, {candidate:?}");
        }
    }
}
