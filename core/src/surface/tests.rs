//! The surface as a whole, on analytic and recorded scans.

use nalgebra::Vector3;
use proptest::prelude::*;

use super::test_scans::{Shape, TestScan, ground, handheld_recording, pitching, pitching_recording, turning};
use super::*;
use crate::scan::{Grid, Point, ScanView};

fn build(scan: ScanView<'_>, threads: usize) -> SurfaceBuilder {
    let mut builder = SurfaceBuilder::new();
    builder.build(scan, &SurfaceConfig { threads, ..SurfaceConfig::default() }).unwrap();
    builder
}

fn horizontal(p: &Point) -> f32 {
    p.x.hypot(p.y)
}

/// The share of the returns with `wanted` that belong to the surface.
fn share_valid(scan: &[Point], surface: &Surface, wanted: impl Fn(&Point) -> bool) -> f64 {
    let chosen: Vec<usize> = (0..scan.len()).filter(|i| scan[*i].is_return() && wanted(&scan[*i])).collect();
    assert!(chosen.len() > 100, "only {} points to judge by", chosen.len());
    chosen.iter().filter(|i| surface.points()[**i].is_valid()).count() as f64 / chosen.len() as f64
}

#[test]
fn flat_ground_is_kept_to_twenty_metres_by_a_turning_head() {
    let scan = turning(&[ground(1.0)], 0.5, 10.0, 0.01, 1);
    let builder = build(scan.view(), 1);
    assert!(share_valid(&scan.points, builder.surface(), |p| horizontal(p) < 20.0) > 0.999);
}

#[test]
fn flat_ground_is_kept_to_twenty_metres_ahead_by_a_pitching_head() {
    let scan = pitching(&[ground(1.0)], 0.5, 10.0, 0.01, 2);
    let builder = build(scan.view(), 1);
    let ahead = |p: &Point| horizontal(p) < 20.0 && p.y.abs() < p.x;
    assert!(share_valid(&scan.points, builder.surface(), ahead) > 0.995);
}

/// Level ground, a wall 8 m ahead and a block in front of it.
fn yard() -> [Shape; 3] {
    [
        ground(1.0),
        Shape::Plane { normal: Vector3::x(), offset: 8.0 },
        Shape::Block { from: Vector3::new(3.0, -0.5, -1.0), to: Vector3::new(4.0, 0.5, 0.5) },
    ]
}

/// On which of the yard's surfaces a point lies: the ground, the wall, or the block.
fn surface_of(p: &Point) -> u8 {
    if (p.x - 8.0).abs() < 0.06 {
        1
    } else if p.z < -0.94 {
        0
    } else {
        2
    }
}

#[test]
fn a_depth_jump_is_discarded_by_either_head() {
    for scan in [turning(&yard(), 0.5, 30.0, 0.005, 3), pitching(&yard(), 0.5, 30.0, 0.005, 3)] {
        let builder = build(scan.view(), 1);
        let surface = builder.surface();
        for corners in surface.kept_triangles() {
            let of = corners.map(|i| surface_of(&scan.points[i]));
            let spans_block_and_wall = of.contains(&1) && of.contains(&2);
            assert!(!spans_block_and_wall, "{:?}", corners.map(|i| scan.points[i]));
        }
        let jumps = surface.discarded().iter().filter(|t| {
            let of = t.corners.map(|i| surface_of(&scan.points[i as usize]));
            of.contains(&1) && of.contains(&2)
        });
        assert!(jumps.count() > 20);
        let near_wall = |p: &Point| surface_of(p) == 1 && p.y.abs() < 6.0 && p.y.abs() > 2.0;
        assert!(share_valid(&scan.points, surface, near_wall) > 0.999);
    }
}

#[test]
fn neighbourhood_of_discarded_triangles_is_mutual_and_means_two_common_corners() {
    let scan = turning(&yard(), 1.0, 30.0, 0.0, 4);
    let builder = build(scan.view(), 1);
    let list = builder.surface().discarded();
    let mut links = 0;
    for (index, triangle) in list.iter().enumerate() {
        for neighbour in triangle.neighbours.iter().filter(|n| **n != DiscardedTriangle::NONE) {
            let other = &list[*neighbour as usize];
            assert_eq!(triangle.corners.iter().filter(|c| other.corners.contains(c)).count(), 2);
            assert!(other.neighbours.contains(&(index as u32)));
            links += 1;
        }
    }
    assert!(links > list.len() / 2);
}

#[test]
fn the_normals_of_noisy_ground_are_as_good_as_calibrated() {
    let scan = turning(&[ground(1.0)], 0.5, 0.0, 0.01, 5);
    let builder = build(scan.view(), 1);
    // Distances [m] and the calibrated median and 90th percentile [deg], with a little room.
    for (from, to, median, high) in
        [(0.6, 1.0, 1.3, 2.9), (1.0, 1.5, 0.9, 1.9), (2.0, 3.0, 0.5, 1.2), (5.0, 8.0, 0.3, 0.6)]
    {
        let mut errors: Vec<f32> = (0..scan.points.len())
            .filter(|i| (from..to).contains(&horizontal(&scan.points[*i])))
            .filter_map(|i| builder.surface().normal(i))
            .map(|n| n.z.clamp(-1.0, 1.0).acos().to_degrees())
            .collect();
        errors.sort_by(f32::total_cmp);
        let (half, most) = (errors[errors.len() / 2], errors[errors.len() * 9 / 10]);
        assert!(half < median && most < high, "{from} to {to} m: median {half}, 90 % {most}");
    }
}

#[test]
fn normals_face_the_scanner_and_areas_are_those_of_the_grid() {
    let wall = [Shape::Plane { normal: Vector3::x(), offset: 5.0 }];
    let scan = turning(&wall, 0.5, 30.0, 0.0, 6);
    let builder = build(scan.view(), 1);
    let facing =
        (0..scan.points.len()).find(|i| horizontal(&scan.points[*i]) < 5.001 && scan.points[*i].z.abs() < 0.05);
    let index = facing.unwrap();
    let normal = builder.surface().normal(index).unwrap();
    assert!((normal - Vector3::new(-1.0, 0.0, 0.0)).norm() < 1e-3);
    let cell = (5.0 * 0.5f32.to_radians()).powi(2);
    let point = &builder.surface().points()[index];
    assert!((point.area / cell - 1.0).abs() < 0.02);
    assert!(point.incidence > 0.999 && point.quality > 0.999);
}

#[test]
fn the_seam_of_a_full_turn_is_closed() {
    let scan = turning(&[ground(1.0)], 1.0, -10.0, 0.0, 7);
    let builder = build(scan.view(), 1);
    let surface = builder.surface();
    assert!(surface.topology().unwrap().wraps_rows);
    let last_row = (scan.grid.rows - 1) * scan.grid.cols;
    for col in 1..scan.grid.cols - 1 {
        assert_eq!(surface.kept_bits(last_row + col).count_ones(), 2);
        let mut neighbours = Vec::new();
        surface.for_each_neighbour(col, |n| neighbours.push(n));
        assert!(neighbours.contains(&(last_row + col)), "{neighbours:?}");
    }
    let row_area = |row: usize| {
        surface.points()[row * scan.grid.cols..(row + 1) * scan.grid.cols].iter().map(|p| p.area).sum::<f32>()
    };
    assert!((row_area(0) / row_area(90) - 1.0).abs() < 0.05, "{} {}", row_area(0), row_area(90));
}

/// The kept triangles as sets of points, sorted.
fn kept_set(surface: &Surface, point_of: impl Fn(usize) -> usize) -> Vec<[usize; 3]> {
    let mut set: Vec<[usize; 3]> = surface
        .kept_triangles()
        .map(|t| {
            let mut t = t.map(&point_of);
            t.sort_unstable();
            t
        })
        .collect();
    set.sort_unstable();
    set
}

#[test]
fn rows_for_columns_and_backward_columns_give_the_same_surface() {
    // Without the filter: rows before columns is not quite columns before rows.
    let config = SurfaceConfig { filter_radius_m: 0.0, ..SurfaceConfig::default() };
    let scan = turning(&yard(), 1.0, 30.0, 0.005, 8);
    let Grid { rows, cols } = scan.grid;
    let mut builder = SurfaceBuilder::new();
    let straight = kept_set(builder.build(scan.view(), &config).unwrap(), |i| i);
    let across = kept_set(builder.build(scan.transposed().view(), &config).unwrap(), |i| (i % rows) * cols + i / rows);
    assert_eq!(straight, across);
    let back = |i: usize| (i / cols) * cols + cols - 1 - i % cols;
    let backward = TestScan { points: (0..rows * cols).map(|i| scan.points[back(i)]).collect(), grid: scan.grid };
    assert_eq!(straight, kept_set(builder.build(backward.view(), &config).unwrap(), back));
}

#[test]
fn scans_of_no_or_few_cells_have_no_surface() {
    let mut builder = SurfaceBuilder::new();
    let config = SurfaceConfig::default();
    for (rows, cols) in [(0, 0), (0, 5), (5, 0), (1, 1), (1, 40), (40, 1)] {
        let points = vec![Point::new(2.0, 0.1, 0.0); rows * cols];
        let surface = builder.build(ScanView::ordered(&points, Grid { rows, cols }).unwrap(), &config).unwrap();
        assert_eq!((surface.len(), surface.valid_count()), (rows * cols, 0));
    }
    assert!(builder.build(ScanView::unordered(&[]), &config).unwrap().is_empty());
    let points = [Point::EMPTY, Point::new(1.0, 0.0, 0.0), Point::new(0.0, 0.0, 0.0)];
    assert_eq!(builder.build(ScanView::unordered(&points), &config).unwrap().valid_count(), 0);
}

#[test]
fn a_grid_that_is_not_that_of_the_points_is_refused() {
    let points = vec![Point::EMPTY; 5];
    let scan = ScanView::with_grid(&points, Some(Grid { rows: 2, cols: 3 }));
    let error = SurfaceBuilder::new().build(scan, &SurfaceConfig::default()).unwrap_err();
    assert_eq!(error, SurfaceError::GridMismatch { points: 5, rows: 2, cols: 3 });
}

#[test]
fn a_cloud_without_order_gets_normals_areas_and_neighbours() {
    let points: Vec<Point> =
        (0..2500).map(|i| Point::new(2.0 + (i % 50) as f32 * 0.05, (i / 50) as f32 * 0.05 - 1.25, -1.0)).collect();
    let builder = build(ScanView::unordered(&points), 1);
    let surface = builder.surface();
    assert_eq!(surface.valid_count(), points.len());
    let middle = 25 * 50 + 25;
    assert!((surface.normal(middle).unwrap() - Vector3::z()).norm() < 1e-3);
    assert!((surface.points()[middle].area / 0.0025 - 1.0).abs() < 0.3);
    let mut count = 0;
    surface.for_each_neighbour(middle, |n| {
        count += 1;
        assert!((points[n].vector() - points[middle].vector()).norm() < 0.11);
    });
    assert_eq!(count, SurfaceConfig::default().neighbours);
}

#[test]
fn a_builder_that_goes_from_order_to_none_and_back_forgets_the_last_scan() {
    let scan = turning(&yard(), 2.0, 10.0, 0.0, 9);
    let mut builder = SurfaceBuilder::new();
    let config = SurfaceConfig::default();
    let first = builder.build(scan.view(), &config).unwrap().points().to_vec();
    let cloud = builder.build(ScanView::unordered(&scan.points), &config).unwrap();
    assert!(cloud.topology().is_none() && (0..cloud.len()).all(|i| cloud.kept_bits(i) == 0));
    assert_eq!(builder.build(scan.view(), &config).unwrap().points(), first);
}

prop_compose! {
    /// Grids of up to 50 x 14 cells, some cells empty, zero, or anywhere.
    fn any_grid()(rows in 1..50usize, cols in 1..14usize, smooth in any::<bool>())(
        cells in prop::collection::vec((0..10u8, prop::array::uniform3(-3.0..3.0f32)), rows * cols),
        rows in Just(rows), cols in Just(cols), smooth in Just(smooth),
    ) -> TestScan {
        let points = cells.iter().enumerate().map(|(i, (kind, p))| match kind {
            0 => Point::EMPTY,
            1 => Point::new(0.0, 0.0, 0.0),
            2 => Point::new(f32::INFINITY, p[1], p[2]),
            _ if smooth => Point::new(4.0 + 0.05 * p[0], 0.04 * (i % cols) as f32, 0.04 * (i / cols) as f32 - 0.3),
            _ => Point::new(p[0], p[1], p[2]),
        }).collect();
        TestScan { points, grid: Grid { rows, cols } }
    }
}

proptest! {
    #[test]
    fn any_grid_gives_consistent_bits_unit_normals_and_the_same_for_any_threads(scan in any_grid()) {
        let one = build(scan.view(), 1);
        let surface = one.surface();
        for (index, point) in surface.points().iter().enumerate() {
            prop_assert!(surface.kept_bits(index).count_ones() + u32::from(surface.triangles[index] >> 4).count_ones() <= 2);
            if point.is_valid() {
                let n = Vector3::from(point.normal);
                prop_assert!((n.norm() - 1.0).abs() < 1e-4);
                prop_assert!(scan.points[index].is_return());
                prop_assert!((0.0..=1.0).contains(&point.quality) && point.area >= 0.0);
            }
            surface.for_each_neighbour(index, |n| assert!(n != index && surface.points()[n].area >= 0.0));
        }
        for corners in surface.kept_triangles() {
            for corner in corners { prop_assert!(scan.points[corner].is_return()); }
        }
        for threads in [2, 3] {
            assert_same(surface, build(scan.view(), threads).surface());
        }
        assert_same(surface, build_by_sweeps(&scan, 3).surface());
    }

    #[test]
    fn any_cloud_gives_unit_normals_and_the_same_for_any_threads(cells in prop::collection::vec(prop::array::uniform3(-2.0..2.0f32), 0..200)) {
        let points: Vec<Point> = cells.iter().map(|p| Point::new(p[0], p[1], p[2])).collect();
        let one = build(ScanView::unordered(&points), 1);
        let two = build(ScanView::unordered(&points), 3);
        prop_assert_eq!(one.surface().points(), two.surface().points());
        for (point, at) in one.surface().points().iter().zip(&points) {
            if point.is_valid() {
                prop_assert!((Vector3::from(point.normal).norm() - 1.0).abs() < 1e-4);
                prop_assert!(Vector3::from(point.normal).dot(&at.vector()) <= 1e-4);
            }
        }
    }
}

#[test]
fn a_noisy_scan_gives_the_same_bits_for_any_number_of_threads() {
    let scan = turning(&yard(), 1.0, 30.0, 0.01, 10);
    let one = build(scan.view(), 1);
    for threads in [2, 3, 7] {
        let other = build(scan.view(), threads);
        assert_eq!(one.surface().points(), other.surface().points());
        assert_eq!(one.surface().triangles, other.surface().triangles);
        assert_eq!(one.surface().links, other.surface().links);
    }
}

/// The builder after a scan was given to it in portions of so many sweeps.
fn build_by_sweeps(scan: &TestScan, portion: usize) -> SurfaceBuilder {
    let mut builder = SurfaceBuilder::new();
    builder.begin(scan.grid.cols, &SurfaceConfig::default()).unwrap();
    let (cols, rows) = (scan.grid.cols, scan.grid.rows);
    for sweeps in (0..rows).step_by(portion) {
        builder.advance(&scan.points[..sweeps * cols]).unwrap();
    }
    builder.finish(&scan.points).unwrap();
    builder
}

/// Whether two surfaces are the same to the last bit.
fn assert_same(a: &Surface, b: &Surface) {
    assert_eq!(a.topology(), b.topology());
    assert!(a.points() == b.points(), "the points differ");
    assert!(a.triangles == b.triangles && a.links == b.links, "the triangles differ");
    assert!(a.discarded() == b.discarded(), "the discarded triangles differ");
}

#[test]
fn a_scan_given_sweep_by_sweep_gives_the_same_bits_as_the_whole() {
    let closed = turning(&yard(), 1.0, 30.0, 0.01, 31);
    // With rows for columns every line is a full circle.
    let circles = closed.transposed();
    let open = pitching(&yard(), 1.0, 30.0, 0.01, 32);
    for scan in [closed, circles, open] {
        let whole = build(scan.view(), 2);
        assert!(whole.surface().discarded().len() > 20);
        for portion in [1, 7, 100] {
            assert_same(build_by_sweeps(&scan, portion).surface(), whole.surface());
        }
    }
}

#[test]
fn a_scan_may_end_after_any_sweep() {
    let scan = turning(&yard(), 2.0, 20.0, 0.01, 33);
    for rows in [0, 1, 8, 15, 16, 17, 20, 33, 34, 90, 179, 180] {
        let cut = TestScan {
            points: scan.points[..rows * scan.grid.cols].to_vec(),
            grid: Grid { rows, cols: scan.grid.cols },
        };
        assert_same(build_by_sweeps(&cut, 1).surface(), build(cut.view(), 1).surface());
    }
}

#[test]
fn sweeps_that_turn_out_to_be_circles_after_all_give_the_same_bits() {
    let mut scan = turning(&yard(), 1.0, 30.0, 0.01, 34).transposed();
    // The first twenty lines have a gap at the seam.
    for row in 0..20 {
        for col in 0..4 {
            scan.points[row * scan.grid.cols + col] = Point::EMPTY;
        }
    }
    let whole = build(scan.view(), 1);
    assert!(whole.surface().topology().unwrap().wraps_cols);
    assert_same(build_by_sweeps(&scan, 5).surface(), whole.surface());
}

#[test]
fn sweeps_out_of_turn_are_refused_and_change_nothing() {
    let scan = turning(&yard(), 2.0, 20.0, 0.0, 35);
    let (cols, config) = (scan.grid.cols, SurfaceConfig::default());
    let mut builder = SurfaceBuilder::new();
    assert_eq!(builder.advance(&scan.points), Err(SurfaceError::NotBegun));
    assert_eq!(builder.finish(&scan.points).err(), Some(SurfaceError::NotBegun));
    let wrong = SurfaceConfig { gamma_max: 0.0, ..SurfaceConfig::default() };
    assert!(matches!(builder.begin(cols, &wrong), Err(SurfaceError::Config(_))));
    builder.begin(cols, &config).unwrap();
    builder.advance(&scan.points[..30 * cols]).unwrap();
    let refused = |points: usize| SurfaceError::NotWholeSweeps { points, cols, before: 30 * cols };
    assert_eq!(builder.advance(&scan.points[..30 * cols + 1]), Err(refused(30 * cols + 1)));
    assert_eq!(builder.advance(&scan.points[..20 * cols]), Err(refused(20 * cols)));
    builder.finish(&scan.points).unwrap();
    assert_same(builder.surface(), build(scan.view(), 1).surface());
    builder.begin(0, &config).unwrap();
    assert_eq!(builder.advance(&scan.points[..1]), Err(SurfaceError::NotWholeSweeps { points: 1, cols: 0, before: 0 }));
    assert!(builder.finish(&[]).unwrap().is_empty());
}

#[test]
fn an_empty_scan_has_no_surface() {
    let points = vec![Point::EMPTY; 90 * 40];
    for scan in [ScanView::ordered(&points, Grid { rows: 90, cols: 40 }).unwrap(), ScanView::unordered(&points)] {
        let builder = build(scan, 2);
        let surface = builder.surface();
        assert_eq!((surface.len(), surface.valid_count()), (points.len(), 0));
        assert_eq!((surface.kept_count(), surface.discarded().len()), (0, 0));
    }
}

#[test]
fn a_scan_all_at_one_range_is_a_sphere_around_the_scanner() {
    let ball = turning(&[ground(1.0)], 1.0, 60.0, 0.0, 36);
    let points: Vec<Point> = (0..ball.points.len())
        .map(|i| {
            let (az, el) =
                (((i / ball.grid.cols) as f32).to_radians(), ((i % ball.grid.cols) as f32 - 60.0).to_radians());
            Point::new(2.0 * el.cos() * az.cos(), 2.0 * el.cos() * az.sin(), 2.0 * el.sin())
        })
        .collect();
    let builder = build(ScanView::ordered(&points, ball.grid).unwrap(), 2);
    let surface = builder.surface();
    assert_eq!((surface.valid_count(), surface.discarded().len()), (points.len(), 0));
    for (point, at) in surface.points().iter().zip(&points) {
        assert!(Vector3::from(point.normal).dot(&at.vector()) < -2.0 * 0.999 && point.incidence > 0.999);
    }
}

/// The returns of a scan in an order that says nothing.
fn shuffled(scan: &TestScan) -> Vec<Point> {
    let returns: Vec<Point> = scan.points.iter().filter(|p| p.is_return()).copied().collect();
    // A step that has no divisor in common with any length below it: every point once.
    let count = returns.len();
    let step = (count / 2..).find(|step| (2..=*step).take_while(|d| d * d <= *step).all(|d| step % d != 0)).unwrap();
    assert!(step > 1 && !count.is_multiple_of(step));
    (0..count).map(|k| returns[k * step % count]).collect()
}

#[test]
fn a_cloud_without_order_is_meshed_like_the_scan_it_was() {
    let scan = turning(&yard(), 0.5, 30.0, 0.005, 37);
    let config = SurfaceConfig { filter_radius_m: 0.0, ..SurfaceConfig::default() };
    let mut builder = SurfaceBuilder::new();
    let ordered = builder.build(scan.view(), &config).unwrap();
    let kept = ordered.kept_count();
    let area = |surface: &Surface, points: &[Point]| -> f64 {
        let near = surface.points().iter().zip(points).filter(|(_, p)| horizontal(p) < 10.0);
        near.map(|(shape, _)| f64::from(shape.area)).sum()
    };
    let whole = area(ordered, &scan.points);
    let cloud = shuffled(&scan);
    let surface = builder.build(ScanView::unordered(&cloud), &config).unwrap();
    println!("{} of {kept} triangles, {:.1} of {whole:.1} m^2", surface.kept_count(), area(surface, &cloud));
    assert!(surface.kept_count() as f64 > 0.7 * kept as f64);
    assert!((area(surface, &cloud) / whole - 1.0).abs() < 0.15);
    assert!((0..cloud.len()).all(|i| surface.kept_bits(i) == 0));
}

#[test]
fn a_recorded_scan_of_a_pitching_head_becomes_a_surface() {
    let Some(scan) = pitching_recording("a_recorded_scan_of_a_pitching_head_becomes_a_surface") else { return };
    let builder = build(scan.view(), 1);
    let surface = builder.surface();
    let share = share_valid(&scan.points, surface, |_| true);
    println!("normals for {:.2} % of the returns, {} discarded", 100.0 * share, surface.discarded().len());
    assert!(share > 0.95);
    for (point, at) in surface.points().iter().zip(&scan.points) {
        assert!(point.normal.iter().all(|v| v.is_finite()) && point.area.is_finite() && point.quality.is_finite());
        assert!(!point.is_valid() || at.is_return());
    }
}

#[test]
fn a_recorded_cloud_without_order_becomes_a_surface() {
    let Some(points) = handheld_recording("a_recorded_cloud_without_order_becomes_a_surface") else { return };
    let builder = build(ScanView::unordered(&points), 1);
    let share = share_valid(&points, builder.surface(), |_| true);
    let (kept, discarded) = (builder.surface().kept_count(), builder.surface().discarded().len());
    println!("normals for {:.2} % of {} points, {kept} triangles, {discarded} discarded", 100.0 * share, points.len());
    assert!(share > 0.97 && kept > points.len() / 4);
    for point in builder.surface().points() {
        assert!(point.normal.iter().all(|v| v.is_finite()) && point.area.is_finite() && point.quality.is_finite());
    }
}
