use super::super::test_worlds::storeys;
use super::*;
use crate::geometry::Pose;
use crate::information_map::{InformationMap, MapConfig};
use crate::scan::ScanView;
use proptest::prelude::*;

fn window() -> TileWindow {
    TileWindow { low: [-1, -1], cols: 4, rows: 4 }
}

fn updated(cache: &mut TileCache, map: &InformationMap, robot: &Point3<f64>, threads: usize) -> Vec<u32> {
    let mut table = Vec::new();
    cache.update(map, &window(), robot, &PlanningConfig::default(), threads, &mut table);
    table
}

/// The values of a known cell, by their bits.
type Values = (usize, [u32; 11]);

/// What the planner is to know of a tile; values of unknown cells mean nothing.
fn told(digest: &TileDigest) -> (Vec<Values>, [[u16; 16]; 5]) {
    let cells = &digest.cells;
    let values = |at: usize| {
        let [a, b, c, d, e, f] = std::array::from_fn(|k| cells.moments[k][at]);
        let (height, quality) = (cells.height[at], cells.quality[at]);
        let (ground, navigability) = (cells.ground[at], cells.navigability[at]);
        [a, b, c, d, e, f, height, quality, ground, navigability, digest.bounds.least_quality].map(f32::to_bits)
    };
    let known = (0..256).filter(|at| digest.known[at / 16] >> (at % 16) & 1 == 1);
    let planes = [digest.known, digest.grounded, digest.blocks, digest.navigable, digest.uneven];
    (known.map(|at| (at, values(at))).collect(), planes)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn what_is_kept_while_the_map_grows_and_the_robot_moves_is_what_is_read_anew(
        seeds in prop::collection::vec(any::<u64>(), 1..5), places in prop::collection::vec((0.0..10.0f64, 0.0..10.0f64, 0..3u8), 5),
    ) {
        let mut map = InformationMap::new(MapConfig::default()).unwrap();
        let mut kept = TileCache::default();
        for (seed, &(x, y, storey)) in seeds.iter().zip(&places) {
            let (points, scores) = storeys(*seed);
            map.insert(ScanView::unordered(&points), &scores, &Pose::identity()).unwrap();
            let robot = Point3::new(x, y, 3.0 * f64::from(storey));
            for threads in [1, 2] {
                let table = updated(&mut kept, &map, &robot, threads);
                let mut fresh = TileCache::default();
                let fresh_table = updated(&mut fresh, &map, &robot, 1);
                let config = PlanningConfig::default();
                let reach = Reach {
                    robot,
                    window_m: 0.0,
                    start_m: config.start_clearance_m,
                    max_step_m: ReliefLimits::between_levels(&config, 0.3),
                    navigable_threshold: config.navigable_threshold,
                };
                let choice = map.choose_levels_between(window().low(), window().high(), &reach);
                for (slot, fresh_slot) in table.iter().zip(&fresh_table) {
                    let (a, b) = (kept.digest(*slot), fresh.digest(*fresh_slot));
                    prop_assert_eq!(a.map(told), b.map(told));
                    let Some(digest) = a else { continue };
                    prop_assert!(!digest.differs_from(|within| choice.of(digest.index.cell(within.into()))));
                }
            }
        }
    }
}
