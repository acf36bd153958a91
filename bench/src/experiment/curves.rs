//! The three curves that everybody plots: coverage, distance and computing time over the time of the mission.

use plotters::prelude::*;

use super::{ExperimentError, Group, RunRecord};
use crate::exploration::Step;

/// Points along a curve.
const SAMPLES: usize = 160;
/// Size of a plot [pixels].
const SIZE: (u32, u32) = (430, 300);
/// One colour a curve.
pub(super) const COLOURS: [RGBColor; 10] = [
    RGBColor(200, 30, 60),
    RGBColor(31, 119, 180),
    RGBColor(44, 160, 44),
    RGBColor(255, 127, 14),
    RGBColor(148, 103, 189),
    RGBColor(90, 90, 90),
    RGBColor(23, 170, 190),
    RGBColor(140, 86, 75),
    RGBColor(188, 170, 34),
    RGBColor(227, 119, 194),
];

/// What is plotted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Curve {
    Coverage,
    Distance,
    Computing,
}

impl Curve {
    pub const ALL: [Self; 3] = [Self::Coverage, Self::Distance, Self::Computing];

    fn title(self) -> &'static str {
        match self {
            Self::Coverage => "coverage [%]",
            Self::Distance => "distance driven [m]",
            Self::Computing => "computing time [s]",
        }
    }

    /// The value after every scan.
    fn values(self, run: &RunRecord) -> Vec<f64> {
        let mut computed = 0.0;
        let value = |step: &Step| match self {
            Self::Coverage => 100.0 * step.coverage,
            Self::Distance => step.metres,
            Self::Computing => {
                computed += step.computing_ms / 1e3;
                computed
            }
        };
        run.steps.iter().map(value).collect()
    }
}

/// The lowest, middle and highest value over the runs at a time [min].
struct Band {
    minutes: f64,
    low: f64,
    middle: f64,
    high: f64,
}

/// A run that has ended keeps what it came to; before its first scan there is nothing.
fn bands(group: &Group, curve: Curve, longest_s: f64) -> Vec<Band> {
    let runs: Vec<(Vec<f64>, &RunRecord)> = group.runs.iter().map(|run| (curve.values(run), run)).collect();
    let own_longest = group.runs.iter().filter_map(RunRecord::last).map(|s| s.mission_s).fold(0.0, f64::max);
    let times = (0..=SAMPLES).map(|k| longest_s * k as f64 / SAMPLES as f64);
    // Beyond its last run's end a curve says nothing more.
    times
        .take_while(|&time| time <= own_longest + longest_s / SAMPLES as f64)
        .map(|time| {
            let at = |(values, run): &(Vec<f64>, &RunRecord)| {
                let done = run.steps.iter().take_while(|step| step.mission_s <= time).count();
                done.checked_sub(1).and_then(|k| values.get(k).copied()).unwrap_or(0.0)
            };
            let mut values: Vec<f64> = runs.iter().map(at).collect();
            values.sort_unstable_by(f64::total_cmp);
            let nth = |k: usize| values.get(k).copied().unwrap_or(0.0);
            Band {
                minutes: time / 60.0,
                low: nth(0),
                middle: nth((values.len().max(1) - 1) / 2),
                high: nth(values.len().max(1) - 1),
            }
        })
        .collect()
}

/// A plot as SVG: the median of every group, within the band of its lowest and highest run.
pub(super) fn plot(groups: &[&Group], curve: Curve) -> Result<String, ExperimentError> {
    let failure =
        |e: &dyn std::fmt::Display| ExperimentError::Draw { what: curve.title().into(), reason: e.to_string() };
    let ends = groups.iter().flat_map(|group| group.runs.iter().filter_map(RunRecord::last));
    let longest_s = ends.map(|step| step.mission_s).fold(60.0, f64::max);
    let all: Vec<Vec<Band>> = groups.iter().map(|group| bands(group, curve, longest_s)).collect();
    let most = all.iter().flatten().map(|band| band.high).fold(1e-3, f64::max);
    let top = if curve == Curve::Coverage { 100.0 } else { 1.05 * most };
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE).map_err(|e| failure(&e))?;
        let mut chart = ChartBuilder::on(&root)
            .margin(8)
            .caption(curve.title(), ("sans-serif", 15))
            .x_label_area_size(34)
            .y_label_area_size(46)
            .build_cartesian_2d(0.0..longest_s / 60.0, 0.0..top)
            .map_err(|e| failure(&e))?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(230, 230, 230))
            .x_desc("mission time [min]")
            .label_style(("sans-serif", 12))
            .draw()
            .map_err(|e| failure(&e))?;
        for (bands, colour) in all.iter().zip(COLOURS.iter().cycle()) {
            let there = bands.iter().map(|band| (band.minutes, band.high));
            let back = bands.iter().rev().map(|band| (band.minutes, band.low));
            let outline: Vec<(f64, f64)> = there.chain(back).collect();
            chart.draw_series([Polygon::new(outline, colour.mix(0.1))]).map_err(|e| failure(&e))?;
        }
        for (bands, colour) in all.iter().zip(COLOURS.iter().cycle()) {
            let line = bands.iter().map(|band| (band.minutes, band.middle));
            chart.draw_series(LineSeries::new(line, colour.stroke_width(2))).map_err(|e| failure(&e))?;
        }
        root.present().map_err(|e| failure(&e))?;
    }
    Ok(svg)
}
