//! Beams are cones, not lines: at an edge the spot of a beam falls on two surfaces, and the range is that of one of them
//! or a mixture (mixed pixels).

use nalgebra::Vector3;

use super::CastRows;
use crate::simulation::compiled_scene::{Hit, LANES};
use crate::simulation::ray_tree::Packet;

/// Rays of a spot besides its centre, on a ring that halves its area.
const RING: usize = 6;
/// Neighbouring beams that meet surfaces no farther from one plane than this and this share of the range are no edge.
const SAME_PLANE_M: f64 = 0.05;
const SAME_PLANE_SHARE: f64 = 0.005;
/// Surfaces nearer to one another are one [m].
const SAME_SURFACE_M: f64 = 0.05;
/// Where the spot's centre misses, so many rays of the ring must hit for a return.
const LEAST_ON_EDGE: usize = 3;

/// What a beam of the scan measures, its spot considered where an edge is near. `direction` is its centre, map frame;
/// `stack` is scratch.
pub(super) fn hit(
    cast: &CastRows<'_>,
    sweep: usize,
    beam: usize,
    direction: &Vector3<f64>,
    stack: &mut Vec<u32>,
) -> Option<Hit> {
    let centre = cast.hit(sweep, beam, direction);
    if !is_at_edge(cast, sweep, beam, centre.as_ref()) {
        return centre;
    }
    let mut ranges = [0.0; RING + 1];
    let mut count = 0;
    let mut any = centre;
    if let Some(hit) = &centre {
        ranges[0] = hit.range;
        count = 1;
    }
    for hit in ring(cast, direction, stack).into_iter().flatten() {
        ranges[count] = hit.range;
        count += 1;
        any = any.or(Some(hit));
    }
    if centre.is_none() && count < LEAST_ON_EDGE {
        return None;
    }
    let ranges = &mut ranges[..count];
    ranges.sort_unstable_by(f64::total_cmp);
    let range = mixed_range(ranges, cast.scanner.config.pulse_m)?;
    any.map(|hit| Hit { range: range.unwrap_or(hit.range), ..hit })
}

/// The range that a laser reports for a spot of these sorted ranges: `Some(None)` when they are one surface, which the
/// spot's centre tells best; `None` without any.
fn mixed_range(ranges: &[f64], pulse: f64) -> Option<Option<f64>> {
    let (first, last) = (ranges.first()?, ranges.last()?);
    let jump = |k: &usize| ranges[*k] - ranges[*k - 1];
    let Some(cut) = (1..ranges.len()).max_by(|a, b| jump(a).total_cmp(&jump(b))) else { return Some(None) };
    if jump(&cut) < SAME_SURFACE_M {
        return Some(None);
    }
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    if last - first < pulse {
        return Some(Some(mean(ranges)));
    }
    let (near, far) = ranges.split_at(cut);
    Some(Some(if near.len() >= far.len() { mean(near) } else { mean(far) }))
}

/// Whether a neighbouring beam meets something off the plane this one meets.
fn is_at_edge(cast: &CastRows<'_>, sweep: usize, beam: usize, centre: Option<&Hit>) -> bool {
    let neighbours =
        [(sweep.wrapping_sub(1), beam), (sweep + 1, beam), (sweep, beam.wrapping_sub(1)), (sweep, beam + 1)];
    let plane = centre.map(|hit| (cast.scene.normal(hit), hit));
    let own = centre.map(|hit| hit.triangle);
    neighbours.into_iter().any(|(sweep, beam)| {
        let Some(ray) = cast.ray(sweep, beam) else { return false };
        let other = (ray.triangle != super::NOTHING).then_some(ray.triangle);
        let (Some(_), Some((normal, hit))) = (other, plane) else { return other.is_some() != own.is_some() };
        if other == own {
            return false;
        }
        let scanner = cast.scanner;
        let to_neighbour = f64::from(ray.near) * (cast.rotation * scanner.beams[beam].ray(scanner.head(sweep)));
        let off = normal.dot(&to_neighbour) - cast.scene.plane_height(hit, &normal, &cast.origin);
        off.abs() > SAME_PLANE_M + SAME_PLANE_SHARE * hit.range
    })
}

/// The hits of the rays around the centre of a spot.
fn ring(cast: &CastRows<'_>, direction: &Vector3<f64>, stack: &mut Vec<u32>) -> [Option<Hit>; RING] {
    let radius = (cast.scanner.config.divergence_deg.to_radians() / 2.0).tan() * std::f64::consts::FRAC_1_SQRT_2;
    let helper = if direction.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let across = direction.cross(&helper).normalize();
    let up = across.cross(direction);
    let mut packet = Packet::<LANES>::new(cast.origin.coords.into());
    let range_max = cast.scanner.config.range_max_m as f32;
    let ray = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / RING as f64).sin_cos();
        (direction + radius * (cos * across + sin * up)).normalize()
    };
    for k in 0..RING {
        packet.set(k, ray(k).into(), range_max);
    }
    cast.scene.trace(&mut packet, stack);
    std::array::from_fn(|k| cast.scene.hit(&cast.origin, &ray(k), packet.triangle[k], packet.nearest[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_surface_is_measured_at_the_centre_of_the_spot() {
        assert_eq!(mixed_range(&[5.0, 5.01, 5.02], 0.6), Some(None));
        assert_eq!(mixed_range(&[5.0], 0.6), Some(None));
        assert_eq!(mixed_range(&[], 0.6), None);
    }

    #[test]
    fn two_near_surfaces_mix_and_of_two_distant_ones_the_larger_part_counts() {
        let mixed = mixed_range(&[5.0, 5.0, 5.4, 5.4], 0.6).unwrap().unwrap();
        assert!((mixed - 5.2).abs() < 1e-12);
        let far = mixed_range(&[5.0, 9.0, 9.2], 0.6).unwrap().unwrap();
        assert!((far - 9.1).abs() < 1e-12);
        let near = mixed_range(&[5.0, 5.2, 9.0, 9.2], 0.6).unwrap().unwrap();
        assert!((near - 5.1).abs() < 1e-12);
    }
}
