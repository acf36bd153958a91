//! The points that stand for a scan: as many from each direction that surfaces face.

use std::f32::consts::{FRAC_PI_2, PI};

/// Bins of azimuth of a normal.
const AZIMUTHS: usize = 12;
/// Bins of its height, from down to up.
const HEIGHTS: usize = 5;
/// Bins of normals, and one for points without.
pub(super) const BINS: usize = AZIMUTHS * HEIGHTS + 1;

/// The bin of a normal.
fn bin(normal: [f32; 3]) -> usize {
    if normal == [0.0; 3] {
        return BINS - 1;
    }
    let elevation = normal[2].clamp(-1.0, 1.0).asin();
    let height = ((elevation / PI + 0.5) * HEIGHTS as f32) as usize;
    // Near the poles the azimuth says nothing.
    let azimuth = if elevation.abs() > 0.6 * FRAC_PI_2 {
        0
    } else {
        ((normal[1].atan2(normal[0]) / (2.0 * PI) + 0.5) * AZIMUTHS as f32) as usize
    };
    height.min(HEIGHTS - 1) * AZIMUTHS + azimuth.min(AZIMUTHS - 1)
}

/// The bin of every normal.
pub(super) fn bins(normals: &[[f32; 3]]) -> Vec<u8> {
    normals.iter().map(|normal| bin(*normal) as u8).collect()
}

/// The indices, ascending, of up to `most` points, drawn evenly over the directions their normals face (normal-space
/// sampling, Rusinkiewicz and Levoy 2001) and, within a direction, evenly over space: the points come in the order of
/// an index, where neighbours in space are neighbours.
pub(super) fn even_over_directions(bins: &[u8], most: usize) -> Vec<u32> {
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); BINS];
    for (index, bin) in bins.iter().enumerate() {
        if let Some(members) = members.get_mut(usize::from(*bin)) {
            members.push(index as u32);
        }
    }
    let share = level(&members.iter().map(Vec::len).collect::<Vec<_>>(), most);
    let mut chosen: Vec<u32> = Vec::with_capacity(most.min(bins.len()));
    for bin in &members {
        let take = bin.len().min(share);
        chosen.extend((0..take).map(|k| bin[(2 * k + 1) * bin.len() / (2 * take)]));
    }
    chosen.sort_unstable();
    chosen
}

/// The largest number that, taken from every bin as far as it goes, sums to no more than `most`.
fn level(sizes: &[usize], most: usize) -> usize {
    let total = |share: usize| sizes.iter().map(|size| (*size).min(share)).sum::<usize>();
    let (mut low, mut high) = (0, sizes.iter().copied().max().unwrap_or(0));
    while low < high {
        let middle = (low + high).div_ceil(2);
        if total(middle) <= most { low = middle } else { high = middle - 1 }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_wall_counts_as_much_as_a_wide_ground() {
        let mut normals = vec![[0.0, 0.0, 1.0]; 5000];
        normals.extend(vec![[1.0, 0.0, 0.0]; 150]);
        let chosen = even_over_directions(&bins(&normals), 300);
        assert_eq!(chosen.iter().filter(|index| **index >= 5000).count(), 150);
        assert_eq!(chosen.len(), 300);
    }

    #[test]
    fn few_points_are_all_chosen_and_none_gives_none() {
        assert_eq!(even_over_directions(&bins(&[[0.0; 3]; 3]), 300), [0, 1, 2]);
        assert!(even_over_directions(&[], 300).is_empty());
    }
}
