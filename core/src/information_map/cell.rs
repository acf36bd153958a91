//! What one cell remembers: counts and sums, in integers, of the evidence of every scan.

use super::bytes::{Reader, TruncatedMap};
use super::normal_statistics::NormalStatistics;
use nalgebra::Vector3;

/// Heights are stored in units of 1/1024 m.
pub(super) const HEIGHT_UNITS_PER_METRE: f64 = 1024.0;

/// Counts and sums over one kind of evidence (measured points, or interpolation over kept triangles), 40 bytes.
/// Sums are of the stored 16-bit scores, so a mean in [0, 1] is `sum / (65535 count)`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Evidence {
    /// All items.
    pub count: u32,
    /// n_phi: items with F > u_F.
    pub navigable_count: u32,
    /// n_alpha: items with B > u_B.
    pub obstacle_count: u32,
    /// Sum of F over the navigable items (4.1).
    pub navigable_sum: u64,
    /// Sum of B over the obstacle items (4.2).
    pub obstacle_sum: u64,
    /// Sum of D over all items (4.5).
    pub quality_sum: u64,
}

impl Evidence {
    /// The mean quality D over all items (4.5), or `None` without any.
    #[must_use]
    pub fn mean_quality(&self) -> Option<f64> {
        (self.count > 0).then(|| self.quality_sum as f64 / (65535.0 * f64::from(self.count)))
    }

    #[inline]
    fn add(&mut self, item: &Item) {
        // A cell that saturates has seen four thousand million points; its means stay right to within that ratio.
        if self.count == u32::MAX {
            return;
        }
        self.count += 1;
        self.quality_sum += u64::from(item.quality);
        if item.is_navigable {
            self.navigable_count += 1;
            self.navigable_sum += u64::from(item.navigable);
        }
        if item.is_obstacle {
            self.obstacle_count += 1;
            self.obstacle_sum += u64::from(item.obstacle);
        }
    }

    fn write(&self, out: &mut Vec<u8>) {
        for count in [self.count, self.navigable_count, self.obstacle_count] {
            out.extend_from_slice(&count.to_le_bytes());
        }
        for sum in [self.navigable_sum, self.obstacle_sum, self.quality_sum] {
            out.extend_from_slice(&sum.to_le_bytes());
        }
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, TruncatedMap> {
        Ok(Self {
            count: u32::from_le_bytes(reader.array()?),
            navigable_count: u32::from_le_bytes(reader.array()?),
            obstacle_count: u32::from_le_bytes(reader.array()?),
            navigable_sum: u64::from_le_bytes(reader.array()?),
            obstacle_sum: u64::from_le_bytes(reader.array()?),
            quality_sum: u64::from_le_bytes(reader.array()?),
        })
    }

    fn is_possible(&self) -> bool {
        let fits = |sum: u64, count: u32| sum <= u64::from(count) * 65535;
        self.navigable_count <= self.count
            && self.obstacle_count <= self.count
            && fits(self.navigable_sum, self.navigable_count)
            && fits(self.obstacle_sum, self.obstacle_count)
            && fits(self.quality_sum, self.count)
    }
}

/// One piece of evidence on its way into a cell: scores as stored (16 bits), height in the map frame [1/1024 m].
#[derive(Debug, Clone, Copy)]
pub(super) struct Item {
    pub navigable: u16,
    pub obstacle: u16,
    pub quality: u16,
    pub is_navigable: bool,
    pub is_obstacle: bool,
    pub height: i32,
    /// Unit normal in the map frame.
    pub normal: Vector3<f32>,
}

/// One cell, 152 bytes. All zero (the default) is the unknown state: nothing was ever seen here.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cell {
    /// Points that fell into the cell.
    pub measured: Evidence,
    /// Kept triangles that cover the cell without having a corner in it.
    pub interpolated: Evidence,
    /// Normals of all evidence, in the map frame.
    pub normals: NormalStatistics,
    /// Sum of the heights of all evidence [1/1024 m].
    height_sum: i64,
    /// Sum of the heights of the navigable evidence [1/1024 m].
    ground_sum: i64,
    /// Lowest navigable evidence [1/1024 m]; 0 when there is none.
    ground_min: i32,
}

impl Cell {
    /// Whether nothing was ever seen here. This is not the same as a navigability of 0.5.
    #[must_use]
    #[inline]
    pub fn is_unknown(&self) -> bool {
        self.measured.count == 0 && self.interpolated.count == 0
    }

    /// The number of pieces of evidence of either kind.
    #[must_use]
    pub fn evidence_count(&self) -> u64 {
        u64::from(self.measured.count) + u64::from(self.interpolated.count)
    }

    /// n_phi, the navigable evidence of either kind.
    #[must_use]
    #[inline]
    pub fn navigable_count(&self) -> u64 {
        u64::from(self.measured.navigable_count) + u64::from(self.interpolated.navigable_count)
    }

    /// n_alpha, the obstacle evidence of either kind.
    #[must_use]
    pub fn obstacle_count(&self) -> u64 {
        u64::from(self.measured.obstacle_count) + u64::from(self.interpolated.obstacle_count)
    }

    /// The mean height of everything seen here [m, map frame], or `None` for an unknown cell.
    #[must_use]
    pub fn height(&self) -> Option<f64> {
        mean_height(self.height_sum, self.evidence_count())
    }

    /// The mean height of the navigable ground [m, map frame], or `None` without navigable evidence.
    #[must_use]
    pub fn ground_height(&self) -> Option<f64> {
        mean_height(self.ground_sum, self.navigable_count())
    }

    /// The lowest navigable ground [m, map frame], or `None` without navigable evidence.
    #[must_use]
    pub fn lowest_ground(&self) -> Option<f64> {
        (self.navigable_count() > 0).then(|| f64::from(self.ground_min) / HEIGHT_UNITS_PER_METRE)
    }

    /// The expected incidence |v . n| of the cell's surface for the unit direction `v` of the map frame (4.9).
    #[must_use]
    pub fn expected_incidence(&self, v: &Vector3<f32>) -> f32 {
        self.normals.expected_incidence(self.evidence_count(), v)
    }

    #[inline]
    pub(super) fn add_measured(&mut self, item: &Item) {
        self.add_shared(item);
        self.measured.add(item);
    }

    #[inline]
    pub(super) fn add_interpolated(&mut self, item: &Item) {
        self.add_shared(item);
        self.interpolated.add(item);
    }

    #[inline]
    fn add_shared(&mut self, item: &Item) {
        if item.is_navigable {
            let first = self.navigable_count() == 0;
            self.ground_min = if first { item.height } else { self.ground_min.min(item.height) };
            self.ground_sum += i64::from(item.height);
        }
        self.height_sum += i64::from(item.height);
        self.normals.add(&item.normal);
    }

    pub(super) fn write(&self, out: &mut Vec<u8>) {
        self.measured.write(out);
        self.interpolated.write(out);
        self.normals.write(out);
        out.extend_from_slice(&self.height_sum.to_le_bytes());
        out.extend_from_slice(&self.ground_sum.to_le_bytes());
        out.extend_from_slice(&self.ground_min.to_le_bytes());
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, TruncatedMap> {
        Ok(Self {
            measured: Evidence::read(reader)?,
            interpolated: Evidence::read(reader)?,
            normals: NormalStatistics::read(reader)?,
            height_sum: i64::from_le_bytes(reader.array()?),
            ground_sum: i64::from_le_bytes(reader.array()?),
            ground_min: i32::from_le_bytes(reader.array()?),
        })
    }

    /// Whether the counts and sums can have come from evidence; used to refuse damaged files.
    pub(super) fn is_possible(&self) -> bool {
        let within = |sum: i64, count: u64| i128::from(sum).abs() <= i128::from(count) << 31;
        self.measured.is_possible()
            && self.interpolated.is_possible()
            && self.normals.is_possible(self.evidence_count())
            && within(self.height_sum, self.evidence_count())
            && within(self.ground_sum, self.navigable_count())
            && !self.is_unknown()
    }
}

fn mean_height(sum: i64, count: u64) -> Option<f64> {
    (count > 0).then(|| sum as f64 / (HEIGHT_UNITS_PER_METRE * count as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ground(height: i32) -> Item {
        Item {
            navigable: 60_000,
            obstacle: 0,
            quality: 30_000,
            is_navigable: true,
            is_obstacle: false,
            height,
            normal: Vector3::z(),
        }
    }

    #[test]
    fn a_cell_takes_the_stated_bytes() {
        assert_eq!(size_of::<Cell>(), 152);
    }

    #[test]
    fn an_unknown_cell_answers_nothing() {
        let cell = Cell::default();
        assert!(cell.is_unknown());
        assert_eq!(cell.height(), None);
        assert_eq!(cell.ground_height(), None);
        assert_eq!(cell.lowest_ground(), None);
        assert_eq!(cell.measured.mean_quality(), None);
    }

    #[test]
    fn heights_are_of_the_ground_and_measured_and_interpolated_are_apart() {
        let mut cell = Cell::default();
        cell.add_measured(&ground(2048));
        cell.add_interpolated(&ground(1024));
        cell.add_measured(&Item { is_navigable: false, ..ground(6144) });
        assert_eq!((cell.measured.count, cell.interpolated.count), (2, 1));
        assert_eq!(cell.ground_height(), Some(1.5));
        assert_eq!(cell.lowest_ground(), Some(1.0));
        assert_eq!(cell.height(), Some(3.0));
        assert!(cell.is_possible());
    }

    #[test]
    fn ground_under_the_map_origin_keeps_its_negative_height() {
        let mut cell = Cell::default();
        cell.add_measured(&ground(-512));
        cell.add_measured(&ground(-1536));
        assert_eq!(cell.ground_height(), Some(-1.0));
        assert_eq!(cell.lowest_ground(), Some(-1.5));
    }
}
