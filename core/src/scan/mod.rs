//! A scan as it lies in memory: points in the scanner's frame, ordered or not.

mod assembly;
mod point;

pub use assembly::{Assembled, HeadReading, PacketCounts, ScanAssembly, SweepBeam, SweepHead, TurningHead};
pub use point::Point;

/// The order of a scan from a turning or spinning laser: `rows` consecutive lines of `cols` points, in the order of
/// the file or of the sensor. The point of row r and column c has index `r * cols + c`. Whether a row is one sweep or
/// one beam, and about which axis the head turns, does not matter to anyone: neighbours in the grid are neighbours in
/// direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Number of lines.
    pub rows: usize,
    /// Number of points a line.
    pub cols: usize,
}

impl Grid {
    /// The number of cells, with or without a return.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.rows * self.cols
    }
}

/// A borrowed scan: points in the scanner's frame [m], and their order if they have one.
/// The points may lie in shared memory; nothing here copies them.
#[derive(Debug, Clone, Copy)]
pub struct ScanView<'a> {
    /// The points; cells without a return are [`Point::EMPTY`].
    pub points: &'a [Point],
    /// The order, if there is one: then `points.len() == grid.cells()`.
    pub grid: Option<Grid>,
}

impl<'a> ScanView<'a> {
    /// A scan with an order or without.
    #[must_use]
    pub fn with_grid(points: &'a [Point], grid: Option<Grid>) -> Self {
        Self { points, grid }
    }

    /// A scan with an order, or `None` when the number of points is not `rows * cols`.
    #[must_use]
    pub fn ordered(points: &'a [Point], grid: Grid) -> Option<Self> {
        (grid.cells() == points.len()).then_some(Self::with_grid(points, Some(grid)))
    }

    /// A scan without an order.
    #[must_use]
    pub fn unordered(points: &'a [Point]) -> Self {
        Self::with_grid(points, None)
    }

    /// The number of points with a return.
    #[must_use]
    pub fn returns(&self) -> usize {
        self.points.iter().filter(|p| p.is_return()).count()
    }
}
