//! The plots of the report, as SVG to be set into the page.

use plotters::prelude::*;

use super::OutputError;
use super::latency::STAGES;
use super::run_data::RunData;

/// One colour a stage.
const COLOURS: [RGBColor; 6] = [
    RGBColor(31, 119, 180),
    RGBColor(255, 127, 14),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
    RGBColor(60, 60, 60),
];
const UNALIGNED: RGBColor = RGBColor(200, 40, 35);
const TRAJECTORY: RGBColor = RGBColor(25, 60, 160);

fn failure(error: &dyn std::fmt::Display) -> OutputError {
    OutputError::Draw { what: "a plot of report.html", reason: error.to_string() }
}

/// Latency of every stage over the scans.
pub(super) fn latency(data: &RunData) -> Result<String, OutputError> {
    let series: Vec<_> = STAGES.iter().map(|stage| (stage.name, stage.durations(data))).collect();
    let values = || series.iter().flat_map(|(_, points)| points);
    let most = values().map(|(_, ms)| *ms).fold(1.0, f64::max);
    let last = values().map(|(scan, _)| *scan).max().unwrap_or(0).max(1);
    let mut svg = String::new();
    // The free space above is for the legend.
    {
        let root = SVGBackend::with_string(&mut svg, (860, 340)).into_drawing_area();
        root.fill(&WHITE).map_err(|e| failure(&e))?;
        let mut chart = ChartBuilder::on(&root)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(60)
            .build_cartesian_2d(0..last, 0.0..most * 1.35)
            .map_err(|e| failure(&e))?;
        chart.configure_mesh().light_line_style(WHITE).x_desc("scan").y_desc("ms").draw().map_err(|e| failure(&e))?;
        for ((name, points), colour) in series.iter().zip(COLOURS) {
            let style = colour.stroke_width(2);
            chart
                .draw_series(LineSeries::new(points.iter().copied(), style).point_size(2))
                .map_err(|e| failure(&e))?
                .label(*name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(200, 200, 200))
            .draw()
            .map_err(|e| failure(&e))?;
        root.present().map_err(|e| failure(&e))?;
    }
    Ok(svg)
}

/// The trajectory from above: scans in order, those that are not aligned at their guess.
pub(super) fn top_view(data: &RunData) -> Result<String, OutputError> {
    let place = |pose: mirador_core::geometry::Pose| (pose.translation.x, pose.translation.y);
    let aligned: Vec<_> =
        data.scans.iter().filter(|s| s.is_aligned()).filter_map(|s| Some((s.number(), place(s.pose()?)))).collect();
    let unaligned: Vec<_> = data.scans.iter().filter(|s| !s.is_aligned()).filter_map(|s| s.pose()).map(place).collect();
    let driven: Vec<_> = data.drive.track.iter().map(|p| (p[0], p[1])).collect();
    let all = || aligned.iter().map(|(_, p)| *p).chain(unaligned.iter().copied()).chain(driven.iter().copied());
    let range = |of: fn((f64, f64)) -> f64| {
        let (low, high) = (all().map(of).reduce(f64::min), all().map(of).reduce(f64::max));
        (low.unwrap_or(0.0), high.unwrap_or(0.0))
    };
    let ((x0, x1), (y0, y1)) = (range(|p| p.0), range(|p| p.1));
    // The same scale along both axes, with some air around.
    let half = (0.55 * (x1 - x0).max(y1 - y0)).max(1.0);
    let (cx, cy) = (0.5 * (x0 + x1), 0.5 * (y0 + y1));
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (540, 520)).into_drawing_area();
        root.fill(&WHITE).map_err(|e| failure(&e))?;
        let mut chart = ChartBuilder::on(&root)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(56)
            .build_cartesian_2d(cx - half..cx + half, cy - half..cy + half)
            .map_err(|e| failure(&e))?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc("x [m]")
            .y_desc("y [m]")
            .draw()
            .map_err(|e| failure(&e))?;
        let legs: Vec<_> = if driven.is_empty() { aligned.iter().map(|(_, p)| *p).collect() } else { driven };
        let line = LineSeries::new(legs, TRAJECTORY.stroke_width(2));
        chart.draw_series(line).map_err(|e| failure(&e))?;
        let scans = aligned.iter().map(|(n, p)| {
            EmptyElement::at(*p)
                + Circle::new((0, 0), 4, TRAJECTORY.filled())
                + Text::new(n.to_string(), (6, -12), ("sans-serif", 12).into_font())
        });
        chart.draw_series(scans).map_err(|e| failure(&e))?;
        let guesses = unaligned.iter().map(|p| Cross::new(*p, 5, UNALIGNED.stroke_width(2)));
        chart.draw_series(guesses).map_err(|e| failure(&e))?;
        root.present().map_err(|e| failure(&e))?;
    }
    Ok(svg)
}
