//! What the source found in its own worlds, whose sizes and shapes it does not give (section 10).

/// The figures of one experiment of the source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Literature {
    /// Name of the experiment.
    pub experiment: &'static str,
    /// Metres driven.
    pub metres: f64,
    /// Mean quality of the cells.
    pub quality: f64,
    /// Share of the reachable cells that is covered.
    pub coverage: f64,
    /// Scans.
    pub scans: f64,
}

/// Where the figures are from.
pub(super) const SOURCE: &str = "the source's simulated experiments, in its own worlds";

const fn of(experiment: &'static str, metres: f64, quality: f64, coverage: f64, scans: f64) -> Literature {
    Literature { experiment, metres, quality, coverage, scans }
}

/// Every simulated experiment of the source.
pub const LITERATURE: [Literature; 8] = [
    of("simple I", 106.0, 0.6846, 0.925, 12.0),
    of("simple II", 107.0, 0.6904, 0.941, 10.0),
    of("simple III", 128.0, 0.7503, 0.936, 13.0),
    of("simple IV", 116.0, 0.5013, 0.914, 8.0),
    of("structured I", 352.0, 0.6813, 0.95, 43.0),
    of("structured II", 397.0, 0.726, 0.948, 39.0),
    of("unstructured I", 424.0, 0.7833, 0.8835, 60.0),
    of("unstructured II", 290.0, 0.6013, 0.8071, 46.0),
];
