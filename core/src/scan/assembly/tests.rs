use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::geometry::Pose;
use crate::simulation::{
    CompiledScene, EncoderTick, LaserSweep, Noise, ScanSeed, Scanner, ScannerConfig, Scene, TurningLaser,
};

/// What a turning laser says in one scan of a world, robot at rest.
struct Said {
    scene: CompiledScene,
    scanner: Scanner,
    pose: Pose,
    sweeps: Vec<LaserSweep>,
    ticks: Vec<EncoderTick>,
}

fn said(config: ScannerConfig) -> Said {
    let scene = CompiledScene::new(Scene::builtin("simple").unwrap()).unwrap();
    let start = scene.scene().start;
    let pose = scene.leaning_scanner_pose(&start, 1.0, 0.8).unwrap();
    let mut laser = TurningLaser::new(config.clone(), Noise::new(1, 1)).unwrap();
    let (mut sweeps, mut ticks) = (Vec::new(), Vec::new());
    laser.start(3.0);
    laser.advance(1e6, &scene, &pose, &mut sweeps, &mut ticks);
    Said { scene, scanner: Scanner::new(config).unwrap(), pose, sweeps, ticks }
}

fn ns(time: f64) -> i64 {
    (time * 1e9).round() as i64
}

fn reading(tick: &EncoderTick) -> HeadReading {
    HeadReading { stamp_ns: ns(tick.time), angle: tick.angle, reading: tick.reading }
}

fn add(assembly: &mut ScanAssembly, sweep: &LaserSweep) {
    let head = SweepHead {
        stamp_ns: ns(sweep.time),
        duration_ns: ns(sweep.duration).unsigned_abs(),
        first_angle: sweep.first_angle,
        angle_step: sweep.angle_step,
        sweep: sweep.sweep,
    };
    let beam = |beam: &crate::simulation::LaserBeam| SweepBeam {
        range: beam.range,
        intensity: beam.intensity,
        time: beam.time,
    };
    assembly.add_sweep(head, sweep.beams.iter().map(beam));
}

fn small() -> ScannerConfig {
    ScannerConfig { sweeps: 600, beams: 28, beam_step_deg: 10.0, noise_m: 0.0, ..ScannerConfig::default() }
}

fn assembly_of(said: &Said) -> ScanAssembly {
    let home = said.scanner.config().first_sweep_deg.to_radians();
    ScanAssembly::new(TurningHead::new(said.scanner.grid(), home))
}

fn write(assembly: &ScanAssembly) -> (Option<Assembled>, Vec<Point>) {
    let mut points = vec![Point::EMPTY; assembly.head().grid().cells()];
    let assembled = assembly.write(2, &mut points).unwrap();
    (assembled, points)
}

fn bytes(points: &[Point]) -> &[u8] {
    bytemuck::cast_slice(points)
}

#[test]
fn a_scan_of_sweeps_lies_on_the_surfaces_that_the_ray_cast_scanner_sees() {
    let said = said(ScannerConfig { noise_m: 0.0, ..ScannerConfig::default() });
    let mut assembly = assembly_of(&said);
    said.ticks.iter().for_each(|tick| assembly.add_reading(reading(tick)));
    said.sweeps.iter().for_each(|sweep| add(&mut assembly, sweep));
    assert!(assembly.is_complete());
    let (assembled, points) = write(&assembly);
    let assembled = assembled.unwrap();
    assert!(assembled.counts.is_clean(), "{assembled:?}");
    assert_eq!(assembled.begin_ns, 3_000_000_000);
    assert_eq!(assembled.duration_ns, 719 * 20_000_000 + 15_000_000);
    let mut cast = vec![Point::EMPTY; points.len()];
    said.scanner.scan(&said.scene, &said.pose, ScanSeed { seed: 1, scan: 0 }, 2, &mut cast, None).unwrap();
    let both = points.iter().zip(&cast).filter(|(a, b)| a.is_return() && b.is_return()).count();
    let either = points.iter().zip(&cast).filter(|(a, b)| a.is_return() || b.is_return()).count();
    assert!(both as f64 > 0.98 * either as f64, "{both} of {either}");
    assert_eq!(assembled.returns, points.iter().filter(|point| point.is_return()).count());
    // Half a count of the encoder, and what its straight line between two readings misses of the motor's ripple; the
    // beam's own time is good to a fraction of a microsecond.
    let azimuth_error = 0.5 * std::f64::consts::TAU / 16384.0 + 1e-6;
    let mut worst: f64 = 0.0;
    for (cell, (point, other)) in points.iter().zip(&cast).enumerate().step_by(7) {
        if !point.is_return() {
            continue;
        }
        // The true hit is at most so far away, hence the surface is, too.
        let allowed = f64::from(point.range()) * azimuth_error + 2e-5;
        let place = said.pose * point.position();
        let distance = said.scene.distance_to_surface(&place, 0.1).unwrap();
        assert!(distance <= allowed, "cell {cell}: {distance} m, allowed {allowed} m");
        worst = worst.max(distance);
        if other.is_return() {
            // The ripple of the motor puts a sweep at most a step beside that of an even turn.
            let (a, b) = (point.vector().cast::<f64>(), other.vector().cast::<f64>());
            let azimuth = |v: Vector3<f64>| v.y.atan2(v.x);
            let beside = (azimuth(a) - azimuth(b)).sin().abs();
            assert!(beside < 0.0085 || a.xy().norm() < 0.1 * a.norm(), "cell {cell}: {beside} rad");
            assert_eq!(point.time.abs_diff(other.time) / 2, 0, "cell {cell}");
        }
    }
    assert!(worst > 1e-4, "the bound is no farther away than it must be: {worst}");
}

#[test]
fn the_bits_do_not_depend_on_the_threads_and_a_wrong_slice_is_refused() {
    let said = said(small());
    let mut assembly = assembly_of(&said);
    said.sweeps.iter().for_each(|sweep| add(&mut assembly, sweep));
    said.ticks.iter().for_each(|tick| assembly.add_reading(reading(tick)));
    let (_, two) = write(&assembly);
    let mut points = vec![Point::EMPTY; two.len()];
    for threads in [1, 3, 8] {
        assembly.write(threads, &mut points).unwrap();
        assert_eq!(bytes(&points), bytes(&two));
    }
    assert_eq!(assembly.write(1, &mut points[1..]), Err(600 * 28));
}

#[test]
fn a_gap_of_the_encoder_empties_only_the_beams_it_cannot_place() {
    let said = said(small());
    let mut assembly = assembly_of(&said);
    said.sweeps.iter().for_each(|sweep| add(&mut assembly, sweep));
    // Readings 101 to 104 and 301 to 310 are lost: 50 ms are bridged, 110 ms are not.
    let lost = |tick: &&EncoderTick| !(101..=104).contains(&tick.reading) && !(301..=310).contains(&tick.reading);
    said.ticks.iter().filter(lost).for_each(|tick| assembly.add_reading(reading(tick)));
    let (assembled, points) = write(&assembly);
    let counts = assembled.unwrap().counts;
    assert_eq!((counts.missing_readings, counts.missing_sweeps), (14, 0));
    assert!(counts.unplaced_beams > 0);
    let mut whole = assembly_of(&said);
    said.sweeps.iter().for_each(|sweep| add(&mut whole, sweep));
    said.ticks.iter().for_each(|tick| whole.add_reading(reading(tick)));
    for (cell, (point, other)) in points.iter().zip(&write(&whole).1).enumerate() {
        let after_ms = 20.0 * (cell / 28) as f64 + 15.0 / 27.0 * (cell % 28) as f64;
        if (3000.1..3109.9).contains(&after_ms) {
            assert!(!point.is_return(), "cell {cell}");
        } else if !(2999.0..3111.0).contains(&after_ms) {
            assert_eq!(point.is_return(), other.is_return(), "cell {cell}");
            assert!(!point.is_return() || (point.vector() - other.vector()).norm() < 1e-3 * (1.0 + point.range()));
        }
    }
}

#[test]
fn a_broken_off_turn_before_the_scan_is_left_out() {
    let said = said(small());
    let mut assembly = assembly_of(&said);
    let earlier = |time: f64| time - 2.0;
    for tick in said.ticks.iter().take(40) {
        assembly.add_reading(reading(&EncoderTick { time: earlier(tick.time), ..*tick }));
    }
    for sweep in said.sweeps.iter().take(20) {
        add(&mut assembly, &LaserSweep { time: earlier(sweep.time), ..sweep.clone() });
    }
    said.ticks.iter().for_each(|tick| assembly.add_reading(reading(tick)));
    said.sweeps.iter().for_each(|sweep| add(&mut assembly, sweep));
    let (assembled, points) = write(&assembly);
    let counts = assembled.unwrap().counts;
    assert_eq!((counts.unfit, counts.missing_sweeps, counts.missing_readings), (60, 0, 0));
    let mut whole = assembly_of(&said);
    said.ticks.iter().for_each(|tick| whole.add_reading(reading(tick)));
    said.sweeps.iter().for_each(|sweep| add(&mut whole, sweep));
    assert_eq!(bytes(&points), bytes(&write(&whole).1));
}

#[test]
fn a_laser_that_runs_freely_gives_the_sweeps_between_home_and_the_end() {
    let said = said(small());
    let mut assembly = assembly_of(&said);
    // Sweeps are numbered since the device was switched on and are 7 ms late to the head's timer.
    said.ticks.iter().for_each(|tick| assembly.add_reading(reading(tick)));
    for number in 0..900_u32 {
        let like = &said.sweeps[number as usize % said.sweeps.len()];
        let time = 3.007 + 0.02 * (f64::from(number) - 100.0);
        add(&mut assembly, &LaserSweep { time, sweep: 5000 + number, ..like.clone() });
    }
    let (assembled, points) = write(&assembly);
    let assembled = assembled.unwrap();
    assert_eq!((assembled.begin_ns, assembled.counts.missing_sweeps), (3_007_000_000, 0));
    assert_eq!(assembled.counts.outside + assembled.counts.surplus, 300);
    assert!(points[..28].iter().any(Point::is_return));
}

#[test]
fn without_a_sweep_or_without_a_reading_there_is_no_scan() {
    let said = said(small());
    let mut assembly = assembly_of(&said);
    assert!(assembly.is_empty() && write(&assembly).0.is_none());
    said.sweeps.iter().for_each(|sweep| add(&mut assembly, sweep));
    let (assembled, points) = write(&assembly);
    assert!(assembled.is_none() && points.iter().all(|point| !point.is_return()));
    assembly.clear();
    said.ticks.iter().for_each(|tick| assembly.add_reading(reading(tick)));
    assert!(write(&assembly).0.is_none());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]
    #[test]
    fn any_order_repetition_and_loss_of_sweeps_empties_exactly_the_lost_rows(
        seed: u64, lost in proptest::collection::btree_set(0..600_u32, 0..50),
        repeated in proptest::collection::vec(0..600_usize, 0..30),
    ) {
        use rand_chacha::{ChaCha8Rng, rand_core::{Rng, SeedableRng}};
        let said = said(ScannerConfig { beams: 4, beam_step_deg: 60.0, ..small() });
        let mut whole = assembly_of(&said);
        said.ticks.iter().for_each(|tick| whole.add_reading(reading(tick)));
        said.sweeps.iter().for_each(|sweep| add(&mut whole, sweep));
        let expected = write(&whole).1;

        let mut packets: Vec<usize> = (0..said.sweeps.len() + said.ticks.len()).collect();
        packets.extend(&repeated);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for k in (1..packets.len()).rev() {
            packets.swap(k, (rng.next_u64() % (k as u64 + 1)) as usize);
        }
        let mut assembly = assembly_of(&said);
        for packet in packets {
            match said.sweeps.get(packet) {
                Some(sweep) if !lost.contains(&sweep.sweep) => add(&mut assembly, sweep),
                Some(_) => {}
                None => assembly.add_reading(reading(&said.ticks[packet - said.sweeps.len()])),
            }
        }
        let (assembled, points) = write(&assembly);
        let counts = assembled.unwrap().counts;
        prop_assert_eq!(counts.missing_sweeps as usize, lost.len());
        prop_assert_eq!(counts.unfit + counts.surplus + counts.missing_readings + counts.unplaced_beams, 0);
        let again = repeated.iter().filter(|sweep| !lost.contains(&(**sweep as u32))).count();
        prop_assert_eq!(counts.repeated as usize, again);
        prop_assert_eq!(assembly.is_complete(), lost.is_empty());
        for (row, (line, other)) in points.chunks(4).zip(expected.chunks(4)).enumerate() {
            if lost.contains(&(row as u32)) {
                prop_assert!(line.iter().all(|point| !point.is_return()));
            } else {
                prop_assert_eq!(bytes(line), bytes(other));
            }
        }
    }

    #[test]
    fn packets_of_any_content_give_no_more_points_than_ranges(
        readings in proptest::collection::vec((any::<i64>(), any::<f64>(), any::<u32>()), 0..40),
        sweeps in proptest::collection::vec(
            (any::<i64>(), any::<u64>(), any::<f64>(), any::<u32>(), any::<f32>(), 0..6_usize), 0..40,
        ),
    ) {
        let mut assembly = ScanAssembly::new(TurningHead::new(Grid { rows: 5, cols: 4 }, 0.0));
        for (stamp_ns, angle, reading) in readings {
            assembly.add_reading(HeadReading { stamp_ns, angle, reading });
        }
        let mut ranges = 0;
        for (stamp_ns, duration_ns, first_angle, sweep, range, beams) in sweeps {
            let head = SweepHead { stamp_ns, duration_ns, first_angle, angle_step: 0.1, sweep };
            assembly.add_sweep(head, (0..beams).map(|_| SweepBeam { range, intensity: 1, time: 0 }));
            ranges += if range.is_finite() && range > 0.0 { beams } else { 0 };
        }
        let _ = assembly.is_complete();
        let (_, points) = write(&assembly);
        prop_assert!(points.iter().filter(|point| point.is_return()).count() <= ranges);
    }
}
