//! What is remembered of one place: counts and sums, in integers, of the evidence of every scan.
//!
//! Integers make it exact: the order of scans does not matter, and what a scan has brought can be taken away again.

use super::item::{HEIGHT_UNITS_PER_METRE, INTERPOLATED, Item, NAVIGABLE, OBSTACLE};
use super::navigability::navigability_of;
use super::normal_statistics::{NormalStatistics, StoredNormal};
use nalgebra::Vector3;

/// Weight of one return. A kept triangle over a whole cell weighs as much; when a correction moves it over several
/// cells, each gets quarters.
pub(super) const RETURN_WEIGHT: u32 = 4;

/// Counts and sums over pieces of evidence, 104 bytes. Counts are in quarters (see `RETURN_WEIGHT`).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Evidence {
    measured: u32,
    interpolated: u32,
    navigable: u32,
    obstacle: u32,
    /// Sum of F over the navigable evidence (4.1) [1/255].
    navigable_sum: u64,
    /// Sum of B over the obstacle evidence (4.2) [1/255].
    obstacle_sum: u64,
    /// Sum of D over the measured evidence (4.5) [1/65535].
    measured_quality: u64,
    /// Sum of D over the interpolated evidence [1/65535].
    interpolated_quality: u64,
    /// Sum of the heights of all evidence [m/512].
    height_sum: i64,
    /// Sum of the heights of the navigable evidence [m/512].
    ground_sum: i64,
    normals: NormalStatistics,
}

/// Whether evidence comes or goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Change {
    Add,
    Remove,
}

impl Evidence {
    /// Whether there is none: nothing was ever seen here. This is not the same as a navigability of 0.5.
    #[must_use]
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.measured == 0 && self.interpolated == 0
    }

    /// Points measured here.
    #[must_use]
    pub fn measured_count(&self) -> u64 {
        u64::from(self.measured / RETURN_WEIGHT)
    }

    /// Kept triangles over the middle of this place, rounded up.
    #[must_use]
    pub fn interpolated_count(&self) -> u64 {
        u64::from(self.interpolated.div_ceil(RETURN_WEIGHT))
    }

    /// n_phi: points and triangles with F > u_F.
    #[must_use]
    pub fn navigable_count(&self) -> f64 {
        f64::from(self.navigable) / f64::from(RETURN_WEIGHT)
    }

    /// n_alpha: points and triangles with B > u_B.
    #[must_use]
    pub fn obstacle_count(&self) -> f64 {
        f64::from(self.obstacle) / f64::from(RETURN_WEIGHT)
    }

    /// Whether anything here can be driven on.
    #[must_use]
    #[inline]
    pub fn has_ground(&self) -> bool {
        self.navigable > 0
    }

    /// Whether anything here says that the robot can or cannot drive here.
    #[must_use]
    #[inline]
    pub fn concerns_the_robot(&self) -> bool {
        self.navigable > 0 || self.obstacle > 0
    }

    /// Fbar, the mean F over phi (4.1), 0 without any.
    #[must_use]
    pub fn mean_navigable(&self) -> f64 {
        self.navigable_sum as f64 / (255.0 * f64::from(self.navigable.max(1)))
    }

    /// Bbar, the mean B over alpha (4.2), 0 without any.
    #[must_use]
    pub fn mean_obstacle(&self) -> f64 {
        self.obstacle_sum as f64 / (255.0 * f64::from(self.obstacle.max(1)))
    }

    /// C_nc (4.4) over both kinds of evidence; `None` without any. Obstacle evidence weighs `obstacle_weight`.
    #[must_use]
    pub fn navigability(&self, obstacle_weight: f64) -> Option<f64> {
        let (phi, alpha) = (u64::from(self.navigable), u64::from(self.obstacle));
        let value = || navigability_of(phi, self.mean_navigable(), alpha, self.mean_obstacle(), obstacle_weight);
        (!self.is_empty()).then(value)
    }

    /// Q_a (4.5): the mean D of the points; where there are none, of the interpolated evidence. `None` without any.
    #[must_use]
    pub fn quality(&self) -> Option<f64> {
        let mean = |sum: u64, count: u32| (count > 0).then(|| sum as f64 / (65535.0 * f64::from(count)));
        mean(self.measured_quality, self.measured).or_else(|| mean(self.interpolated_quality, self.interpolated))
    }

    /// The mean height of everything here [m, map frame], or `None` without any.
    #[must_use]
    pub fn height(&self) -> Option<f64> {
        mean_height(self.height_sum, self.weight())
    }

    /// The mean height of the navigable ground [m, map frame], or `None` without any.
    #[must_use]
    pub fn ground_height(&self) -> Option<f64> {
        self.ground_sum().mean()
    }

    /// The heights of the navigable ground.
    pub(super) fn ground_sum(&self) -> GroundSum {
        GroundSum { heights: self.ground_sum, count: u64::from(self.navigable) }
    }

    /// Whether some of the ground was measured for certain: there is more of it than there are triangles.
    pub(super) fn has_measured_ground(&self) -> bool {
        self.navigable > self.interpolated
    }

    /// The mean of n n^T over all normals here (see [`NormalStatistics::mean_moments`]).
    #[must_use]
    pub fn mean_moments(&self) -> [f32; 6] {
        self.normals.mean_moments(self.weight())
    }

    /// The expected incidence |v . n| of the surface here for the unit direction `v` of the map frame (4.9).
    #[must_use]
    pub fn expected_incidence(&self, v: &Vector3<f32>) -> f32 {
        self.normals.expected_incidence(self.weight(), v)
    }

    fn weight(&self) -> u64 {
        u64::from(self.measured) + u64::from(self.interpolated)
    }

    /// Adds or takes away `quarters` quarters of an item at a height [m/512], with its normal in the map's frame.
    #[inline]
    pub(super) fn change(&mut self, change: Change, item: &Item, quarters: u32, height: i32, normal: StoredNormal) {
        let weight = u64::from(quarters);
        let signed = match change {
            Change::Add => i64::from(quarters),
            Change::Remove => -i64::from(quarters),
        };
        // Wrapping, as a removal adds the negative; what was added can always be taken away, so nothing ever wraps
        // around for good. Four thousand million quarters in one place are a thousand million returns.
        let count = |count: &mut u32| *count = count.wrapping_add_signed(signed as i32);
        let sum = |sum: &mut u64, value: u64| *sum = sum.wrapping_add_signed((value * weight) as i64 * signed.signum());
        let kind = item.kind();
        if kind & INTERPOLATED == 0 {
            count(&mut self.measured);
            sum(&mut self.measured_quality, u64::from(item.quality));
        } else {
            count(&mut self.interpolated);
            sum(&mut self.interpolated_quality, u64::from(item.quality));
        }
        self.height_sum += i64::from(height) * signed;
        if kind & NAVIGABLE != 0 {
            count(&mut self.navigable);
            sum(&mut self.navigable_sum, u64::from(item.navigable));
            self.ground_sum += i64::from(height) * signed;
        }
        if kind & OBSTACLE != 0 {
            count(&mut self.obstacle);
            sum(&mut self.obstacle_sum, u64::from(item.obstacle));
        }
        self.normals.add(normal, signed);
    }

    /// Adds what other evidence says.
    pub(super) fn merge(&mut self, other: &Self) {
        self.measured += other.measured;
        self.interpolated += other.interpolated;
        self.navigable += other.navigable;
        self.obstacle += other.obstacle;
        self.navigable_sum += other.navigable_sum;
        self.obstacle_sum += other.obstacle_sum;
        self.measured_quality += other.measured_quality;
        self.interpolated_quality += other.interpolated_quality;
        self.height_sum += other.height_sum;
        self.ground_sum += other.ground_sum;
        self.normals.merge(&other.normals);
    }
}

/// Heights of ground, to be averaged over several slabs.
#[derive(Debug, Clone, Copy)]
pub(super) struct GroundSum {
    /// [m/512]
    heights: i64,
    count: u64,
}

impl GroundSum {
    /// With others.
    pub fn plus(self, other: Self) -> Self {
        Self { heights: self.heights + other.heights, count: self.count + other.count }
    }

    /// The mean height [m, map frame], or `None` without any.
    pub fn mean(self) -> Option<f64> {
        mean_height(self.heights, self.count)
    }
}

fn mean_height(sum: i64, count: u64) -> Option<f64> {
    (count > 0).then(|| sum as f64 / (HEIGHT_UNITS_PER_METRE * count as f64))
}

#[cfg(test)]
mod tests {
    use super::super::item::Place;
    use super::*;

    fn item(kind: u8) -> Item {
        let mut item = Item::new(Place { x: 0, y: 0, z: 0 }, kind, 1);
        (item.navigable, item.obstacle, item.quality, item.normal) = (204, 230, 32768, [0, 0, 127]);
        item
    }

    #[test]
    fn evidence_takes_the_stated_bytes() {
        assert_eq!(size_of::<Evidence>(), 104);
    }

    #[test]
    fn no_evidence_answers_nothing() {
        let none = Evidence::default();
        assert!(none.is_empty() && !none.has_ground());
        assert_eq!(
            (none.height(), none.ground_height(), none.quality(), none.navigability(3.0)),
            (None, None, None, None)
        );
    }

    #[test]
    fn heights_are_of_the_ground_and_measured_and_interpolated_are_apart() {
        let mut evidence = Evidence::default();
        evidence.change(Change::Add, &item(NAVIGABLE), 4, 1024, [0, 0, 127]);
        evidence.change(Change::Add, &item(NAVIGABLE | INTERPOLATED), 4, -512, [0, 0, 127]);
        evidence.change(Change::Add, &item(0), 4, 2560, [127, 0, 0]);
        assert_eq!((evidence.measured_count(), evidence.interpolated_count()), (2, 1));
        assert_eq!(evidence.ground_height(), Some(0.5));
        assert_eq!(evidence.height(), Some(2.0));
        assert!((evidence.mean_navigable() - 0.8).abs() < 1e-9);
        assert!((evidence.expected_incidence(&Vector3::z()) - (2.0f32 / 3.0).sqrt()).abs() < 1e-3);
    }

    #[test]
    fn what_is_taken_away_leaves_nothing_behind() {
        let kinds = [0, NAVIGABLE, OBSTACLE, NAVIGABLE | OBSTACLE, NAVIGABLE | INTERPOLATED];
        let mut evidence = Evidence::default();
        for change in [Change::Add, Change::Remove] {
            for (k, kind) in (0..).zip(kinds) {
                evidence.change(change, &item(kind), 3 + k as u32, 100 * k - 150, [3, -80, 90]);
            }
        }
        assert_eq!(evidence, Evidence::default());
    }
}
