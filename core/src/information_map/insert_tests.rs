use super::*;
use crate::analysis::{GroundHeight, ScoreConfig, Scorer};
use crate::information_map::{CellState, MapBytesError, MapConfig, Zone, ZoneConfig};
use crate::scan::Point;
use crate::surface::{SurfaceBuilder, SurfaceConfig};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

fn empty_map() -> InformationMap {
    InformationMap::new(MapConfig::default()).unwrap()
}

fn score(navigable: f32, obstacle: f32, normal: Vector3<f32>) -> PointScore {
    let mut score = PointScore::NONE;
    score.flags = PointScore::VALID | PointScore::REACHABLE;
    score.navigable = PointScore::quantise(navigable);
    score.obstacle = PointScore::quantise(obstacle);
    score.quality = PointScore::quantise(0.5);
    score.set_normal(&normal);
    score
}

fn ground() -> PointScore {
    score(0.95, 0.0, Vector3::z())
}

fn wall() -> PointScore {
    score(0.0, 0.95, Vector3::x())
}

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

#[test]
fn points_of_ground_make_a_cell_navigable_and_a_wall_blocks_it() {
    let mut map = empty_map();
    let points = [Point::new(0.1, 0.1, 0.0), Point::new(-0.1, 0.1, 0.0), Point::new(3.1, 0.1, 0.5)];
    let summary = map.insert(ScanView::unordered(&points), &[ground(), ground(), wall()], &Pose::identity()).unwrap();
    assert_eq!((summary.points, summary.cells_touched, summary.new_cells, summary.tiles_changed), (3, 3, 3, 2));
    let state = |x, y| map.state(map.cell_containing(x, y).unwrap());
    assert!(matches!(state(0.1, 0.1), CellState::Known(c) if c > 0.9));
    assert!(matches!(state(-0.1, 0.1), CellState::Known(c) if c > 0.9));
    assert!(matches!(state(3.1, 0.1), CellState::Known(c) if c < 0.1));
    assert_eq!(state(3.1, 0.5), CellState::Unknown);
}

#[test]
fn a_point_out_of_reach_is_known_but_says_nothing() {
    let mut map = empty_map();
    let mut high = wall();
    high.flags &= !PointScore::REACHABLE;
    map.insert(ScanView::unordered(&[Point::new(1.0, 1.0, 4.0)]), &[high], &Pose::identity()).unwrap();
    assert_eq!(map.state(map.cell_containing(1.0, 1.0).unwrap()), CellState::Known(0.5));
}

#[test]
fn empty_unscored_and_absurd_points_are_counted_apart() {
    let mut map = empty_map();
    let points = [Point::EMPTY, Point::new(1.0, 1.0, 0.0), Point::new(1e30, 0.0, 0.0)];
    let scores = [PointScore::NONE, PointScore::NONE, ground()];
    let summary = map.insert(ScanView::unordered(&points), &scores, &Pose::identity()).unwrap();
    assert_eq!((summary.points, summary.points_without_score, summary.points_outside), (0, 1, 1));
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
    assert!((cell.height().unwrap() - 1.0).abs() < 1e-3);
    assert_eq!(cell.ground_height(), None);
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
    let holes = |map: &InformationMap| {
        let inside = |x: i32, y: i32| (25..2000).contains(&(x * x + y * y));
        (-50..50)
            .flat_map(|x| (-50..50).map(move |y| (x, y)))
            .filter(|&(x, y)| inside(x, y))
            .filter(|&(x, y)| map.state(CellIndex { x, y }) == CellState::Unknown)
            .count()
    };
    assert_eq!(holes(&with), 0);
    assert!(holes(&without) > 500);
    for (_, cell) in with.known_cells() {
        assert!((cell.ground_height().unwrap()).abs() < 2e-3);
        assert!(cell.interpolated.count <= 4);
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
    let wrong = ScanView { points: &points, grid: Some(Grid { rows: usize::MAX, cols: 2 }) };
    assert!(matches!(map.insert(wrong, &[ground(); 3], &Pose::identity()), Err(InsertError::GridMismatch { .. })));
    let nowhere = Pose::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(map.insert(scan, &[ground(); 3], &nowhere), Err(InsertError::PoseNotFinite));
    assert_eq!(map, empty_map());
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

fn insert_all(scans: &[(Vec<Point>, Vec<PointScore>)], order: impl Iterator<Item = usize>) -> InformationMap {
    let mut map = empty_map();
    for i in order {
        let (points, scores) = &scans[i];
        let scan = ScanView::ordered(points, Grid { rows: 4, cols: 4 }).unwrap();
        map.insert(scan, scores, &Pose::translation(i as f64, -2.0 * i as f64, 0.0)).unwrap();
    }
    map
}

proptest! {
    #[test]
    fn the_order_of_scans_does_not_matter_to_a_bit(scans in prop::collection::vec(any_scan(), 1..6)) {
        let forward = insert_all(&scans, 0..scans.len());
        let backward = insert_all(&scans, (0..scans.len()).rev());
        let cells = |map: &InformationMap| map.known_cells().map(|(i, c)| (i, *c)).collect::<Vec<_>>();
        prop_assert_eq!(cells(&forward), cells(&backward));
    }

    #[test]
    fn a_map_survives_its_bytes(scans in prop::collection::vec(any_scan(), 0..4)) {
        let mut map = insert_all(&scans, 0..scans.len());
        let zone = Zone { centre: Point3::new(1.0, 2.0, 3.0), normal: Vector3::new(0.0, 1.0, 0.0) };
        map.update_zones(&[zone], &Point3::new(60.0, 2.0, 0.0), &ZoneConfig::default());
        let bytes = map.to_bytes();
        let back = InformationMap::from_bytes(&bytes).unwrap();
        prop_assert_eq!(&back, &map);
        prop_assert_eq!(back.to_bytes(), bytes);
    }

    #[test]
    fn damaged_bytes_are_refused(scan in any_scan(), at in any::<prop::sample::Index>(), flip in 1..=255u8, cut in any::<prop::sample::Index>()) {
        let bytes = insert_all(&[scan], 0..1).to_bytes();
        let mut damaged = bytes.clone();
        damaged[at.index(bytes.len())] ^= flip;
        prop_assert!(InformationMap::from_bytes(&damaged).is_err());
        prop_assert!(InformationMap::from_bytes(&bytes[..cut.index(bytes.len())]).is_err());
    }

    #[test]
    fn garbage_with_a_right_checksum_is_read_or_refused_but_never_trusted_blindly(
        scan in any_scan(), at in any::<prop::sample::Index>(), junk in prop::collection::vec(any::<u8>(), 1..40),
    ) {
        let mut bytes = insert_all(&[scan], 0..1).to_bytes();
        bytes.truncate(bytes.len() - 4);
        let at = 12 + at.index(bytes.len() - 12);
        for (byte, junk) in bytes[at..].iter_mut().zip(junk) {
            *byte = junk;
        }
        let mut crc = flate2::Crc::new();
        crc.update(&bytes);
        bytes.extend_from_slice(&crc.sum().to_le_bytes());
        if let Ok(map) = InformationMap::from_bytes(&bytes) {
            prop_assert_eq!(map.to_bytes(), bytes);
        }
    }
}

#[test]
fn other_files_and_other_versions_are_told_apart() {
    assert_eq!(InformationMap::from_bytes(b"ply\n"), Err(MapBytesError::NotAMap));
    let mut bytes = empty_map().to_bytes();
    bytes[8] = 9;
    assert_eq!(InformationMap::from_bytes(&bytes), Err(MapBytesError::Version { found: 9 }));
}
