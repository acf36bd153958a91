//! The three curves by which explorations are compared, over the robot's own time: what is known, how far it drove, and how
//! long it computed.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::OutputError;
use super::run_data::RunData;
use super::timeline::Timeline;

const SIZE: (u32, u32) = (900, 280);
const LINE: RGBColor = RGBColor(25, 60, 160);

/// One curve: its name and its points (minutes, value).
struct Curve {
    title: &'static str,
    points: Vec<(f64, f64)>,
}

fn failure(error: &dyn std::fmt::Display) -> OutputError {
    OutputError::Draw { what: "the curves of report.html", reason: error.to_string() }
}

/// The curves of a run in which a robot drove; `None` where none did, or fewer than two scans were planned on.
pub(super) fn curves(data: &RunData) -> Result<Option<String>, OutputError> {
    let curves = collect(data);
    if data.drive.track.is_empty() || curves.iter().any(|curve| curve.points.len() < 2) {
        return Ok(None);
    }
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE).map_err(|e| failure(&e))?;
        for (area, curve) in root.split_evenly((1, 3)).iter().zip(&curves) {
            draw(area, curve)?;
        }
        root.present().map_err(|e| failure(&e))?;
    }
    Ok(Some(svg))
}

fn collect(data: &RunData) -> [Curve; 3] {
    let begin = data.scans.first().map_or(0, |s| s.scan.header.stamp_ns);
    let minutes = |stamp: i64| (stamp - begin) as f64 / 60e9;
    let planned = || data.scans.iter().filter_map(|s| Some((s, s.first_plan?)));
    let known = planned().map(|(s, plan)| (minutes(s.scan.header.stamp_ns), f64::from(plan.cells_known))).collect();
    let driven = data.scans.iter().map(|s| {
        let stamp = s.scan.header.stamp_ns;
        (minutes(stamp), data.drive.driven_until(stamp))
    });
    let mut total = 0.0;
    let computed = data.scans.iter().filter_map(|s| {
        total += Timeline::of(s)?.end_to_end() as f64 * 1e-9;
        Some((minutes(s.scan.header.stamp_ns), total))
    });
    [
        Curve { title: "known cells", points: known },
        Curve { title: "driven [m]", points: driven.collect() },
        Curve { title: "from scan to plan, in all [s]", points: computed.collect() },
    ]
}

fn draw(area: &DrawingArea<SVGBackend<'_>, Shift>, curve: &Curve) -> Result<(), OutputError> {
    let last = curve.points.last().map_or(1.0, |p| p.0).max(1e-3);
    let most = curve.points.iter().map(|p| p.1).fold(1e-3, f64::max);
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .caption(curve.title, ("sans-serif", 15))
        .x_label_area_size(32)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..last, 0.0..most * 1.05)
        .map_err(|e| failure(&e))?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .x_labels(5)
        .x_desc("robot's time [min]")
        .draw()
        .map_err(|e| failure(&e))?;
    chart
        .draw_series(LineSeries::new(curve.points.iter().copied(), LINE.stroke_width(2)).point_size(2))
        .map_err(|e| failure(&e))?;
    Ok(())
}
