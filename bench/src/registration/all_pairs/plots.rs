//! The plots of the page, as SVG.

use plotters::prelude::*;

use super::rows::success_rate;
use super::{Attempt, Entrant};
use crate::registration::RegistrationBenchError;

/// Size of a plot [pixels].
const SIZE: (u32, u32) = (430, 300);
/// One colour a method.
pub(super) const COLOURS: [RGBColor; 8] = [
    RGBColor(31, 119, 180),
    RGBColor(200, 30, 60),
    RGBColor(44, 160, 44),
    RGBColor(255, 127, 14),
    RGBColor(148, 103, 189),
    RGBColor(23, 170, 190),
    RGBColor(140, 86, 75),
    RGBColor(90, 90, 90),
];

/// A curve for each method.
type Curves = Vec<Vec<(f64, f64)>>;

/// The share of pairs [%] whose figure is at most x, for each method; x is logarithmic.
pub(super) fn share_within(
    entrants: &[Entrant],
    title: &str,
    x_desc: &str,
    of: fn(&Attempt) -> Option<f64>,
) -> Result<String, RegistrationBenchError> {
    let curves: Curves = entrants
        .iter()
        .map(|entrant| {
            let mut values: Vec<f64> = entrant.attempts.iter().filter_map(of).map(|v| v.max(1e-6)).collect();
            values.sort_unstable_by(f64::total_cmp);
            let share = |k: usize| 100.0 * k as f64 / entrant.attempts.len().max(1) as f64;
            values.iter().enumerate().flat_map(|(k, value)| [(*value, share(k)), (*value, share(k + 1))]).collect()
        })
        .collect();
    let all = || curves.iter().flatten().map(|(x, _)| *x);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max));
    let (low, high) = if low < high { (0.9 * low, 1.1 * high) } else { (1e-3, 1.0) };
    draw(title, |root, failure| {
        let mut chart = ChartBuilder::on(root)
            .margin(8)
            .margin_right(16)
            .caption(title, ("sans-serif", 15))
            .x_label_area_size(34)
            .y_label_area_size(46)
            .build_cartesian_2d((low..high).log_scale(), 0.0..100.0)
            .map_err(|e| failure(&e))?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(230, 230, 230))
            .x_desc(x_desc)
            .y_desc("pairs [%]")
            .x_labels(6)
            .x_label_formatter(&|x| crate::report::number(*x))
            .label_style(("sans-serif", 12))
            .draw()
            .map_err(|e| failure(&e))?;
        for (curve, colour) in curves.iter().zip(COLOURS.iter().cycle()) {
            let line = LineSeries::new(curve.iter().copied(), colour.stroke_width(2));
            chart.draw_series(line).map_err(|e| failure(&e))?;
        }
        Ok(())
    })
}

/// The share of successes [%] among the pairs of each metre of distance.
pub(super) fn success_over_distance(entrants: &[Entrant], farthest_m: f64) -> Result<String, RegistrationBenchError> {
    let steps = 8_usize;
    let width = farthest_m / steps as f64;
    let curves: Curves = entrants
        .iter()
        .map(|entrant| {
            let bin = |k: usize| {
                let within = (k as f64 * width, (k + 1) as f64 * width);
                let of_bin = |a: &&Attempt| a.distance_m >= within.0 && a.distance_m < within.1;
                let attempts: Vec<Attempt> = entrant.attempts.iter().filter(of_bin).cloned().collect();
                (!attempts.is_empty()).then(|| ((k as f64 + 0.5) * width, 100.0 * success_rate(&attempts)))
            };
            (0..steps).filter_map(bin).collect()
        })
        .collect();
    let title = "success over the distance of the scans";
    draw(title, |root, failure| {
        let mut chart = ChartBuilder::on(root)
            .margin(8)
            .margin_right(16)
            .caption(title, ("sans-serif", 15))
            .x_label_area_size(34)
            .y_label_area_size(46)
            .build_cartesian_2d(0.0..farthest_m, 0.0..105.0)
            .map_err(|e| failure(&e))?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(230, 230, 230))
            .x_desc("distance [m]")
            .y_desc("successes [%]")
            .label_style(("sans-serif", 12))
            .draw()
            .map_err(|e| failure(&e))?;
        for (curve, colour) in curves.iter().zip(COLOURS.iter().cycle()) {
            let line = LineSeries::new(curve.iter().copied(), colour.stroke_width(2)).point_size(3);
            chart.draw_series(line).map_err(|e| failure(&e))?;
        }
        Ok(())
    })
}

type Failure<'a> = &'a dyn Fn(&dyn std::fmt::Display) -> RegistrationBenchError;

fn draw(
    title: &str,
    fill: impl FnOnce(
        &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
        Failure<'_>,
    ) -> Result<(), RegistrationBenchError>,
) -> Result<String, RegistrationBenchError> {
    let failure =
        |e: &dyn std::fmt::Display| RegistrationBenchError::Draw { what: title.to_owned(), reason: e.to_string() };
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE).map_err(|e| failure(&e))?;
        fill(&root, &failure)?;
        root.present().map_err(|e| failure(&e))?;
    }
    Ok(svg)
}
