//! What the surface, the scores and the zones of one scan cost.
//!
//!     cargo run --release -p mirador-core --example analysis_timing -- [threads] [repetitions] [wall height, m]
//!
//! Scans a walled yard by ray casting: 720 sweeps of 541 beams with 1 cm of noise, of which the default wall height (5 m) lets
//! about 175,000 return. Prints the median, 90th and 99th percentile of every stage over the repetitions [ms].

use std::error::Error;
use std::time::Instant;

use mirador_core::analysis::{GroundHeight, PointScore, ScoreConfig, Scorer, ZoneConfig, ZoneFinder};
use mirador_core::scan::{Point, ScanView};
use mirador_core::simulation::{CompiledScene, ScanPose, ScanSeed, Scanner, ScannerConfig, Scene};
use mirador_core::surface::{SurfaceBuilder, SurfaceConfig};
use nalgebra::UnitQuaternion;

/// A yard of 30 m by 24 m with cars, trunks and a kerb.
fn yard(wall_height: f64) -> String {
    let walls = [([-15, -12], [15, -12]), ([15, -12], [15, 12]), ([15, 12], [-15, 12]), ([-15, 12], [-15, -12])];
    let walls: String = walls
        .iter()
        .map(|(from, to)| {
            format!("[[wall]]\nfrom_m = {from:?}\nto_m = {to:?}\nheight_m = {wall_height}\nthickness_m = 0.3\n")
        })
        .collect();
    let trunks: String = [(4, 3), (-2, 5), (7, -3), (-8, 1)]
        .iter()
        .map(|(x, y)| format!("[[cylinder]]\nlabel = \"tree\"\nx_m = {x}\ny_m = {y}\nradius_m = 0.15\nheight_m = 3\n"))
        .collect();
    let cars: String = [(-6, -5, 35), (2, 7, 80), (9, 5, 10)]
        .iter()
        .map(|(x, y, yaw)| {
            format!(
                "[[box]]\nlabel = \"vehicle\"\nx_m = {x}\ny_m = {y}\nyaw_deg = {yaw}\nlength_m = 4.2\nwidth_m = 1.8\nheight_m = 1.4\n"
            )
        })
        .collect();
    format!(
        "name = \"yard\"\nstart = {{ x_m = 0, y_m = 0 }}\narea = {{ x_m = [-20, 20], y_m = [-20, 20] }}\n\
         terrain = {{ margin_m = 30 }}\n{walls}{trunks}{cars}"
    )
}

/// Percentiles of some times [ms].
fn line(name: &str, times: &mut [f64]) {
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times.get(((times.len() - 1) as f64 * share) as usize).copied().unwrap_or(f64::NAN);
    println!("{name:<30} p50 {:7.3}  p90 {:7.3}  p99 {:7.3} ms", at(0.5), at(0.9), at(0.99));
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let number = |k: usize, default: f64| arguments.get(k).map_or(Ok(default), |text| text.parse::<f64>());
    let (threads, repetitions) = (number(1, 2.0)? as usize, number(2, 101.0)?.max(1.0) as usize);
    let scene = CompiledScene::new(Scene::from_toml(&yard(number(3, 5.0)?), "yard")?)?;
    let scanner = Scanner::new(ScannerConfig::default())?;
    let pose = scene.level_scanner_pose(&ScanPose { x: 0.0, y: 0.0, yaw: 0.0 }, 1.0).ok_or("no ground")?;
    let mut points = vec![Point::EMPTY; scanner.grid().cells()];
    scanner.scan(&scene, &pose, ScanSeed { seed: 1, scan: 0 }, 2, &mut points, None)?;
    let scan = ScanView::ordered(&points, scanner.grid()).ok_or("not a grid")?;
    println!("{} cells, {} returns, {threads} threads, {repetitions} repetitions", points.len(), scan.returns());

    let config = SurfaceConfig { threads, ..SurfaceConfig::default() };
    let mut builder = SurfaceBuilder::new();
    let mut times = Vec::new();
    for _ in 0..repetitions + 3 {
        let begin = Instant::now();
        builder.build(scan, &config)?;
        times.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    line("surface", times.get_mut(3..).unwrap_or_default());

    // Sweep by sweep, as the scanner delivers them: what each costs, and what is left when the last one is there.
    let (cols, sweeps) = (scanner.grid().cols, scanner.grid().rows);
    let (mut sweep_times, mut left_times) = (Vec::new(), Vec::new());
    for _ in 0..repetitions {
        builder.begin(cols, &config)?;
        for sweep in 1..sweeps {
            let begin = Instant::now();
            builder.advance(&points[..sweep * cols])?;
            sweep_times.push(begin.elapsed().as_secs_f64() * 1e3);
        }
        let begin = Instant::now();
        builder.finish(&points)?;
        left_times.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    line("surface, one sweep of many", &mut sweep_times);
    line("surface, left after the last", &mut left_times);

    let cloud: Vec<Point> = points.iter().filter(|p| p.is_return()).copied().collect();
    let mut cloud_times = Vec::new();
    for _ in 0..repetitions.min(11) {
        let begin = Instant::now();
        builder.build(ScanView::unordered(&cloud), &config)?;
        cloud_times.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    line("surface, without an order", &mut cloud_times);

    builder.build(scan, &config)?;
    let surface = builder.surface();
    let scores = ScoreConfig { threads, ..ScoreConfig::default() };
    let level = UnitQuaternion::identity();
    let (mut scorer, mut finder) = (Scorer::new(), ZoneFinder::new());
    let (mut records, mut zones) = (vec![PointScore::NONE; points.len()], Vec::new());
    let (mut ground_times, mut score_times, mut zone_times) = (Vec::new(), Vec::new(), Vec::new());
    let mut summary = None;
    for _ in 0..repetitions {
        let begin = Instant::now();
        let ground = GroundHeight::resolve(&scores, scan, surface, &level);
        ground_times.push(begin.elapsed().as_secs_f64() * 1e3);
        let begin = Instant::now();
        summary = Some(scorer.score(scan, surface, &level, ground, &scores, &mut records)?);
        score_times.push(begin.elapsed().as_secs_f64() * 1e3);
        let begin = Instant::now();
        finder.find(surface, scan, &ZoneConfig::default(), &mut zones)?;
        zone_times.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    line("ground height", &mut ground_times);
    line("scores F, B", &mut score_times);
    line("zones", &mut zone_times);
    println!("{summary:?}, {} discarded triangles, {} zones", surface.discarded().len(), zones.len());
    Ok(())
}
