use super::super::scan_poses::{MoveConfig, ScanPoses};
use super::super::test_world::*;
use super::super::{EvidenceBytesError, ScanEvidence, TILE_CELLS};
use super::*;
use crate::analysis::{GroundHeight, ScoreConfig, Scorer};
use crate::scan::{Grid, Point};
use crate::surface::{SurfaceBuilder, SurfaceConfig};
use nalgebra::Vector3;
use proptest::prelude::*;

/// A turning scanner 1 m over flat ground: `sweeps` columns, ground rings from 1 m out to `reach` metres.
fn flat_scan(sweeps: usize, step_deg: f64, reach: f64) -> (Vec<Point>, Vec<PointScore>, Grid) {
    let lowest = -(1.0f64.atan2(1.0));
    let highest = -(1.0f64.atan2(reach));
    let rows = ((highest - lowest) / step_deg.to_radians()) as usize + 1;
    let (mut points, mut scores) = (Vec::new(), Vec::new());
    for row in 0..rows {
        let range = 1.0 / -(lowest + row as f64 * step_deg.to_radians()).tan();
        for col in 0..sweeps {
            let azimuth = col as f64 * std::f64::consts::TAU / sweeps as f64;
            points.push(Point::new((range * azimuth.cos()) as f32, (range * azimuth.sin()) as f32, -1.0));
            let mut score = ground();
            // The turn is a full one: the last sweep is followed by the first.
            if row + 1 < rows {
                score.flags |= PointScore::KEPT_WITHOUT | PointScore::KEPT_WITHOUT << 3;
            }
            scores.push(score);
        }
    }
    (points, scores, Grid { rows, cols: sweeps })
}

fn flat_evidence(pose: &Pose) -> ScanEvidence {
    let (points, scores, grid) = flat_scan(720, 0.5, 15.0);
    evidence_of(&points, &scores, Some(grid), pose)
}

fn evidence_of(points: &[Point], scores: &[PointScore], grid: Option<Grid>, pose: &Pose) -> ScanEvidence {
    let scan = ScanView::with_grid(points, grid);
    Condenser::new().condense(scan, scores, pose, &MapConfig::default(), 1).unwrap().0.clone()
}

/// Unknown cells between the rings of a scan at the origin of which the rings reach beyond 13.4 m.
fn holes(map: &InformationMap) -> usize {
    let inside = |x: i32, y: i32| (25..2000).contains(&(x * x + y * y));
    let cells = (-50..50).flat_map(|x| (-50..50).map(move |y| CellIndex { x, y }));
    cells.filter(|c| inside(c.x, c.y)).filter(|&c| map.state(c) == CellState::Unknown).count()
}

#[test]
fn points_of_ground_make_a_cell_navigable_and_a_wall_blocks_it() {
    let mut map = empty_map();
    let points = [Point::new(0.1, 0.1, 0.0), Point::new(-0.1, 0.1, 0.0), Point::new(3.1, 0.1, 0.5)];
    let summary = map.insert(ScanView::unordered(&points), &[ground(), ground(), wall()], &Pose::identity()).unwrap();
    assert_eq!((summary.points, map.known_cells().count(), map.tiles().count()), (3, 3, 2));
    assert_eq!(map.known_count(), 3);
    let state = |x, y| map.state(map.cell_containing(x, y).unwrap());
    assert!(matches!(state(0.1, 0.1), CellState::Known(c) if c > 0.9));
    assert!(matches!(state(-0.1, 0.1), CellState::Known(c) if c > 0.9));
    assert!(matches!(state(3.1, 0.1), CellState::Known(c) if c < 0.1));
    assert_eq!(state(3.1, 0.5), CellState::Unknown);
}

#[test]
fn a_point_out_of_reach_is_known_but_says_nothing() {
    let map = map_of(&[(Point::new(1.0, 1.0, 4.0), crown())]);
    assert_eq!(map.state(map.cell_containing(1.0, 1.0).unwrap()), CellState::Known(0.5));
}

#[test]
fn empty_unscored_and_absurd_points_are_counted_apart() {
    let mut map = empty_map();
    let points = [Point::EMPTY, Point::new(1.0, 1.0, 0.0), Point::new(-1e30, 0.0, 0.0), Point::new(0.0, 0.0, 9e3)];
    let scores = [PointScore::NONE, PointScore::NONE, ground(), ground()];
    let summary = map.insert(ScanView::unordered(&points), &scores, &Pose::identity()).unwrap();
    assert_eq!((summary.points, summary.points_without_score, summary.points_outside), (0, 1, 2));
    assert_eq!(map.known_cells().count(), 0);
}

#[test]
fn the_pose_moves_points_normals_and_heights() {
    let mut map = empty_map();
    let pose = Pose::new(Vector3::new(-20.0, -30.0, 2.0), Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
    map.insert(ScanView::unordered(&[Point::new(5.05, 0.1, -1.0)]), &[wall()], &pose).unwrap();
    let cell = map.cell(map.cell_containing(-20.1, -24.95).unwrap()).unwrap();
    assert!(cell.expected_incidence(&Vector3::y()) > 0.99);
    assert!(cell.expected_incidence(&Vector3::x()) < 0.01);
    assert!((cell.total().height().unwrap() - 1.0).abs() < 2e-3);
    assert_eq!(cell.total().ground_height(), None);
}

#[test]
fn counts_and_means_of_a_cell_are_those_of_its_points() {
    let (points, scores): (Vec<_>, Vec<_>) = (0..1000)
        .map(|k| {
            let t: f32 = k as f32 / 1000.0;
            let point = Point::new(0.29 * (t * 37.0).fract(), 0.29 * (t * 91.0).fract(), 0.1 * t);
            (point, score(0.7 + 0.3 * t, if k % 10 == 0 { 0.9 } else { 0.0 }, Vector3::z()))
        })
        .unzip();
    let mut map = empty_map();
    map.insert(ScanView::unordered(&points), &scores, &Pose::identity()).unwrap();
    let total = map.cell(CellIndex { x: 0, y: 0 }).unwrap().total();
    assert_eq!((total.measured_count(), total.navigable_count(), total.obstacle_count()), (1000, 1000.0, 100.0));
    let mean = scores.iter().map(|s| f64::from(s.navigable)).sum::<f64>() / (65535.0 * 1000.0);
    assert!((total.mean_navigable() - mean).abs() < 1e-3, "{} {mean}", total.mean_navigable());
    assert!((total.quality().unwrap() - 0.5).abs() < 1e-4);
    assert!((total.ground_height().unwrap() - 0.05).abs() < 2e-3);
    assert!((total.mean_obstacle() - 0.9).abs() < 5e-3);
}

#[test]
fn kept_triangles_close_the_gaps_between_the_rings() {
    let (points, scores, grid) = flat_scan(720, 0.5, 15.0);
    let pose = Pose::translation(0.0, 0.0, 1.0);
    let mut with = empty_map();
    let summary = with.insert(ScanView::ordered(&points, grid).unwrap(), &scores, &pose).unwrap();
    let mut without = empty_map();
    without.insert(ScanView::unordered(&points), &scores, &pose).unwrap();
    assert!(summary.triangles > 1000 && summary.triangles_clipped == 0);
    assert_eq!(holes(&with), 0);
    assert!(holes(&without) > 500);
    for (_, cell) in with.known_cells() {
        let total = cell.total();
        assert!(total.ground_height().unwrap().abs() < 3e-3);
        assert!(total.interpolated_count() <= 4);
    }
}

#[test]
fn a_scan_that_was_moved_and_turned_has_no_gaps_either() {
    let created = Pose::translation(0.0, 0.0, 1.0);
    let evidence = flat_evidence(&created);
    for turn in [0.002, 0.03, 0.2, 0.7, 3.0] {
        let there = Pose::new(Vector3::new(0.11, -0.07, 1.1), Vector3::new(0.001, -0.001, turn));
        let mut map = empty_map();
        map.add(&evidence, &created).unwrap();
        map.move_scan(&evidence, &created, &there).unwrap();
        assert_eq!(holes(&map), 0, "turned by {turn}");
        let mean: f64 = map.known_cells().filter_map(|(_, cell)| cell.total().ground_height()).sum::<f64>();
        assert!((mean / map.known_cells().count() as f64 - 0.1).abs() < 0.01);
    }
}

/// Ground scanned in a full turn at 5 deg a sweep, meshed and scored, as rows of rings or as columns of rings.
fn ring_scan(are_rings_rows: bool) -> (Vec<Point>, Vec<PointScore>, Grid) {
    const SWEEPS: usize = 72;
    const BEAMS: usize = 60;
    let at = |sweep: usize, beam: usize| {
        let azimuth = sweep as f32 * std::f32::consts::TAU / SWEEPS as f32;
        let range = 1.0 / (0.75f32 - 0.0118 * beam as f32).tan();
        Point::new(range * azimuth.cos(), range * azimuth.sin(), -1.0)
    };
    let (rows, cols) = if are_rings_rows { (BEAMS, SWEEPS) } else { (SWEEPS, BEAMS) };
    let place = |i: usize| if are_rings_rows { at(i % cols, i / cols) } else { at(i / cols, i % cols) };
    let points: Vec<Point> = (0..rows * cols).map(place).collect();
    let grid = Grid { rows, cols };
    let scan = ScanView::ordered(&points, grid).unwrap();
    let mut builder = SurfaceBuilder::new();
    let surface = builder.build(scan, &SurfaceConfig::default()).unwrap();
    let config = ScoreConfig { scanner_height_m: Some(1.0), ..ScoreConfig::default() };
    let level = nalgebra::UnitQuaternion::identity();
    let height = GroundHeight::resolve(&config, scan, surface, &level);
    let mut scores = vec![PointScore::NONE; points.len()];
    Scorer::new().score(scan, surface, &level, height, &config, &mut scores).unwrap();
    (points, scores, grid)
}

#[test]
fn a_full_turn_has_no_gap_where_it_closes() {
    for are_rings_rows in [true, false] {
        let (points, scores, grid) = ring_scan(are_rings_rows);
        let mut map = empty_map();
        map.insert(ScanView::ordered(&points, grid).unwrap(), &scores, &Pose::identity()).unwrap();
        // The seam lies between the directions -5 deg and 0: five cells wide at the farthest.
        for x in 5..60 {
            for y in -(x / 12)..=0 {
                let state = map.state(CellIndex { x, y });
                assert!(matches!(state, CellState::Known(c) if c > 0.6), "{x} {y}: {state:?}");
            }
        }
    }
}

#[test]
fn a_wall_between_distant_points_has_no_gap() {
    let points =
        [[3.0, 0.1, 0.0], [3.0, 3.1, 0.0], [3.0, 0.1, 0.5], [3.0, 3.1, 0.5]].map(|[x, y, z]| Point::new(x, y, z));
    let mut scores = [wall(); 4];
    scores[0].flags |= PointScore::KEPT_WITHOUT | PointScore::KEPT_WITHOUT << 3;
    let mut map = empty_map();
    map.insert(ScanView::ordered(&points, Grid { rows: 2, cols: 2 }).unwrap(), &scores, &Pose::identity()).unwrap();
    for k in 0..=10 {
        let state = map.state(map.cell_containing(3.0, 0.1 + 0.3 * f64::from(k)).unwrap());
        assert!(matches!(state, CellState::Known(c) if c < 0.1), "{k}: {state:?}");
    }
}

#[test]
fn a_scan_that_does_not_fit_its_scores_is_refused_and_changes_nothing() {
    let mut map = empty_map();
    let points = [Point::new(0.0, 0.0, 0.0); 3];
    let scan = ScanView::unordered(&points);
    assert_eq!(
        map.insert(scan, &[ground()], &Pose::identity()),
        Err(InsertError::CountMismatch { points: 3, scores: 1 })
    );
    let wrong = ScanView::with_grid(&points, Some(Grid { rows: usize::MAX, cols: 2 }));
    assert!(matches!(map.insert(wrong, &[ground(); 3], &Pose::identity()), Err(InsertError::GridMismatch { .. })));
    assert_eq!((map.revision(), map.tiles().count()), (0, 0));
}

#[test]
fn poses_that_are_not_finite_or_off_the_earth_are_refused_and_change_nothing() {
    let mut map = empty_map();
    let scan = ScanView::unordered(&[Point::EMPTY]);
    let nowhere = Pose::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(map.insert(scan, &[ground()], &nowhere), Err(InsertError::PoseNotFinite));
    let far = Pose::translation(0.0, 6e6, 0.0);
    let message = map.insert(scan, &[ground()], &far).unwrap_err().to_string();
    assert!(message.contains("6000000") && message.contains("nearer origin"), "{message}");
    let evidence = flat_evidence(&Pose::identity());
    map.add(&evidence, &Pose::identity()).unwrap();
    let before = map.clone();
    assert_eq!(map.move_scan(&evidence, &Pose::identity(), &nowhere), Err(InsertError::PoseNotFinite));
    assert!(matches!(map.move_scan(&evidence, &Pose::identity(), &far), Err(InsertError::PoseTooFar { .. })));
    assert!(map == before && map.revision() == before.revision());
}

#[test]
fn a_summary_for_other_cells_is_refused() {
    let mut map = InformationMap::new(MapConfig { cell_m: 0.5, ..MapConfig::default() }).unwrap();
    let error = map.add(&flat_evidence(&Pose::identity()), &Pose::identity()).unwrap_err();
    assert_eq!(error, InsertError::CellMismatch { found: 0.3, expected: 0.5 });
}

#[test]
fn only_what_a_scan_touched_has_changed_since() {
    let mut map = empty_map();
    map.insert(ScanView::unordered(&[Point::new(1.0, 1.0, 0.0)]), &[ground()], &Pose::identity()).unwrap();
    let before = map.revision();
    map.insert(ScanView::unordered(&[Point::new(-9.0, 1.0, 0.0)]), &[ground()], &Pose::identity()).unwrap();
    let changed: Vec<_> = map.tiles_changed_since(before).map(|tile| (tile.index().x, tile.index().y)).collect();
    assert_eq!(changed, [(-2, 0)]);
    assert_eq!(map.tiles_changed_since(0).count(), 2);
    assert_eq!(map.tile_bounds().map(|(low, high)| (low.x, high.x)), Some((-2, 0)));
}

#[test]
fn a_scan_taken_far_from_the_origin_keeps_its_precision() {
    let there = Pose::translation(1_999_999.9, -1_500_000.0, 800.0);
    let mut map = empty_map();
    map.insert(ScanView::unordered(&[Point::new(10.0, 0.0, -1.0)]), &[ground()], &there).unwrap();
    let cell = map.cell(map.cell_containing(2_000_009.9, -1_500_000.0).unwrap()).unwrap();
    assert!((cell.total().height().unwrap() - 799.0).abs() < 2e-3);
}

fn any_scan() -> impl Strategy<Value = (Vec<Point>, Vec<PointScore>)> {
    let item = (
        (-30.0..30.0f32, -30.0..30.0f32, -2.0..2.0f32),
        (0.0..1.0f32, 0.0..1.0f32, any::<u16>()),
        (-1.0..1.0f32, -1.0..1.0f32, 0.1..1.0f32),
    );
    prop::collection::vec(item, 16).prop_map(|items| {
        let points = items.iter().map(|(p, _, _)| Point::new(p.0, p.1, p.2)).collect();
        let scores = items
            .iter()
            .map(|(_, s, n)| {
                let mut score = score(s.0, s.1, Vector3::new(n.0, n.1, n.2).normalize());
                score.flags ^= s.2 & 0xf3;
                score
            })
            .collect();
        (points, scores)
    })
}

fn any_pose() -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(-40.0..40.0f64), prop::array::uniform3(-3.0..3.0f64))
        .prop_map(|(t, r)| Pose::new(Vector3::from(t), Vector3::from(r)))
}

fn summaries(scans: &[(Vec<Point>, Vec<PointScore>)], poses: &[Pose]) -> Vec<ScanEvidence> {
    let grid = Some(Grid { rows: 4, cols: 4 });
    scans.iter().zip(poses).map(|((points, scores), pose)| evidence_of(points, scores, grid, pose)).collect()
}

#[test]
fn the_number_of_threads_does_not_change_a_bit_of_the_map() {
    let [here, there] = [Pose::translation(0.0, 0.0, 1.0), Pose::new(Vector3::new(3.1, -2.0, 1.0), Vector3::z() * 0.4)];
    let (evidence, other) = (flat_evidence(&here), flat_evidence(&there));
    assert!(evidence.items.len() > 5000, "enough to be shared: {}", evidence.items.len());
    let build = |threads: usize| {
        let mut map = empty_map();
        map.set_threads(threads);
        let touched = [map.add(&evidence, &here), map.add(&other, &there), map.move_scan(&evidence, &here, &there)]
            .map(Result::unwrap);
        (map, touched)
    };
    let (alone, touched) = build(1);
    assert!(touched.iter().all(|tiles| *tiles > 20), "{touched:?}");
    for threads in [2, 3, 5] {
        let (shared, also_touched) = build(threads);
        assert!(shared == alone && also_touched == touched, "{threads} threads");
        let order = |map: &InformationMap| map.tiles().map(|tile| (tile.index(), tile.bytes())).collect::<Vec<_>>();
        assert_eq!(order(&shared), order(&alone));
    }
}

fn built(summaries: &[ScanEvidence], poses: &[Pose], order: impl Iterator<Item = usize>) -> InformationMap {
    let mut map = empty_map();
    order.for_each(|k| {
        map.add(&summaries[k], &poses[k]).unwrap();
    });
    map
}

proptest! {
    #[test]
    fn the_order_of_scans_does_not_matter_to_a_bit(
        scans in prop::collection::vec(any_scan(), 1..6), poses in prop::collection::vec(any_pose(), 6),
    ) {
        let summaries = summaries(&scans, &poses);
        let forward = built(&summaries, &poses, 0..scans.len());
        prop_assert!(forward == built(&summaries, &poses, (0..scans.len()).rev()));
    }

    #[test]
    fn a_map_whose_scans_were_moved_is_the_map_made_from_scratch_to_the_last_bit(
        scans in prop::collection::vec(any_scan(), 1..5), created in prop::collection::vec(any_pose(), 5),
        moves in prop::collection::vec((0..5usize, any_pose()), 1..12),
    ) {
        let summaries = summaries(&scans, &created);
        let mut map = built(&summaries, &created, 0..scans.len());
        let mut poses = ScanPoses::default();
        (0..scans.len()).for_each(|k| poses.added(k as u64, created[k]));
        let limits = MoveConfig { min_shift_m: 0.0, min_turn_deg: 0.0 };
        for (k, pose) in &moves {
            poses.correct((k % scans.len()) as u64, pose, &limits);
            while let Some(due) = poses.next_move() {
                map.move_scan(&summaries[due.scan as usize], &due.from, &due.to).unwrap();
                poses.moved(&due);
            }
        }
        let now: Vec<Pose> = poses.iter().map(|(_, pose)| *pose).collect();
        prop_assert!(map == built(&summaries, &now, (0..scans.len()).rev()));
        prop_assert_eq!(map.known_count(), map.known_cells().count());
        // And back to where they were.
        for (k, summary) in summaries.iter().enumerate() {
            map.move_scan(summary, &now[k], &created[k]).unwrap();
        }
        prop_assert!(map == built(&summaries, &created, 0..scans.len()));
    }

    #[test]
    fn a_summary_survives_its_bytes(scan in any_scan(), pose in any_pose()) {
        let summary = &summaries(&[scan], &[pose])[0];
        let mut bytes = Vec::new();
        summary.write(&mut bytes);
        prop_assert_eq!(bytes.len(), summary.bytes());
        prop_assert_eq!(&ScanEvidence::read(&bytes).unwrap(), summary);
    }

    #[test]
    fn damaged_bytes_are_refused(scan in any_scan(), at in any::<prop::sample::Index>(), flip in 1..=255u8) {
        let mut bytes = Vec::new();
        summaries(&[scan], &[Pose::identity()])[0].write(&mut bytes);
        let length = bytes.len();
        prop_assert!(ScanEvidence::read(&bytes[..at.index(length)]).is_err());
        bytes[at.index(length)] ^= flip;
        prop_assert!(ScanEvidence::read(&bytes).is_err());
    }

    #[test]
    fn garbage_with_a_right_checksum_never_harms_a_map(
        junk in prop::collection::vec(any::<u8>(), 92..400),
    ) {
        let mut bytes = vec![b'M', b'S', b'E', 1, 0, 0, 0, 0];
        let items = (junk.len() - 84) / 16;
        bytes.extend_from_slice(&(items as u64).to_le_bytes());
        bytes.extend_from_slice(&junk[..84 + 16 * items]);
        let mut crc = flate2::Crc::new();
        crc.update(&bytes[8..]);
        bytes[4..8].copy_from_slice(&crc.sum().to_le_bytes());
        if let Ok(evidence) = ScanEvidence::read(&bytes) {
            let mut map = empty_map();
            let _ = map.add(&evidence, &Pose::identity());
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_summary(rows in 1..50usize, cols in 1..50usize, seed in any::<u32>()) {
        let at = |k: usize, salt: u32| {
            let hash = (k as u32 ^ seed).wrapping_mul(2_654_435_761).wrapping_add(salt).wrapping_mul(2_246_822_519);
            (hash >> 8) as f32 / 16_777_216.0
        };
        let points: Vec<_> =
            (0..rows * cols).map(|k| Point::new(8.0 * at(k, 1), 8.0 * at(k, 2), 3.0 * at(k, 3))).collect();
        let scores: Vec<_> = (0..rows * cols).map(|k| {
            let mut score = score(at(k, 4), at(k, 5), Vector3::z());
            score.flags |= PointScore::KEPT_WITHOUT << (k % 4);
            score
        }).collect();
        let scan = ScanView::ordered(&points, Grid { rows, cols }).unwrap();
        let condense = |threads| {
            let mut condenser = Condenser::new();
            let (evidence, summary) =
                condenser.condense(scan, &scores, &Pose::identity(), &MapConfig::default(), threads).unwrap();
            (evidence.clone(), summary)
        };
        let one = condense(1);
        prop_assert_eq!(one.1.points, rows * cols);
        prop_assert_eq!(&one, &condense(2));
        prop_assert_eq!(&one, &condense(7));
    }
}

#[test]
fn a_condenser_used_again_says_the_same_as_a_new_one() {
    let mut used = Condenser::new();
    let config = MapConfig::default();
    let (points, scores, grid) = flat_scan(720, 0.5, 15.0);
    let large = ScanView::ordered(&points, grid).unwrap();
    used.condense(large, &scores, &Pose::translation(3.0, 0.0, 1.0), &config, 2).unwrap();
    let small = ScanView::unordered(&points[..500]);
    let again = used.condense(small, &scores[..500], &Pose::identity(), &config, 2).unwrap().0.clone();
    assert_eq!(again, evidence_of(&points[..500], &scores[..500], None, &Pose::identity()));
    let last = used.condense(large, &scores, &Pose::identity(), &config, 1).unwrap().0;
    assert_eq!(*last, evidence_of(&points, &scores, Some(grid), &Pose::identity()));
}

#[test]
fn other_bytes_and_other_versions_are_told_apart() {
    assert_eq!(ScanEvidence::read(b"ply\n"), Err(EvidenceBytesError::NotEvidence));
    let mut bytes = Vec::new();
    flat_evidence(&Pose::identity()).write(&mut bytes);
    bytes[3] = 9;
    assert_eq!(ScanEvidence::read(&bytes), Err(EvidenceBytesError::NotEvidence));
}

#[test]
fn memory_is_stated_by_tile_and_grows_with_what_is_known() {
    let mut map = empty_map();
    assert_eq!(map.bytes(), 0);
    map.add(&flat_evidence(&Pose::identity()), &Pose::identity()).unwrap();
    let known = map.known_cells().count();
    assert!(map.bytes() > known * 112);
    assert!(map.bytes() < map.tiles().count() * (TILE_CELLS * 112 * 2 + 2048));
}
