//! The payload: points that depend on the message and on their place in it, so that a stale or mixed one is noticed.

use mirador_ipc_schema::messages::Point;

/// Point `index` of message `sequence`.
#[inline]
pub(super) fn point(sequence: u64, index: usize) -> Point {
    let x = index as f32;
    Point { x, y: 0.5 * x, z: -x, intensity: (sequence & 0xffff) as u16, time: (index & 0xffff) as u16 }
}

/// Whether the first and the last point are those of message `sequence` with `points` points.
pub(super) fn is_intact(items: &[Point], sequence: u64, points: usize) -> bool {
    items.len() == points
        && items.first() == Some(&point(sequence, 0))
        && items.last() == Some(&point(sequence, points.saturating_sub(1)))
}

/// Bytes of the stamp and the number at the head of a message that is copied; they take the place of its first point.
pub(super) const HEAD: usize = size_of::<Point>();

/// Writes the points of message `sequence`.
pub(super) fn fill(items: &mut [Point], sequence: u64) {
    for (index, item) in items.iter_mut().enumerate() {
        *item = point(sequence, index);
    }
}

/// Puts stamp and number at the head of the buffer.
pub(super) fn put_head(buffer: &mut [u8], stamp_ns: u64, sequence: u64) {
    for (to, from) in buffer.chunks_exact_mut(8).zip([stamp_ns, sequence]) {
        to.copy_from_slice(&from.to_ne_bytes());
    }
}

/// Stamp and number at the head of the buffer.
pub(super) fn head(buffer: &[u8]) -> Option<(u64, u64)> {
    let (stamp, rest) = buffer.split_first_chunk::<8>()?;
    let sequence = rest.first_chunk::<8>()?;
    Some((u64::from_ne_bytes(*stamp), u64::from_ne_bytes(*sequence)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::{cast_slice, cast_slice_mut};

    #[test]
    fn a_payload_of_another_message_is_noticed() {
        let items: Vec<Point> = (0..5).map(|i| point(3, i)).collect();
        assert!(is_intact(&items, 3, 5));
        assert!(!is_intact(&items, 4, 5) && !is_intact(&items, 3, 6) && !is_intact(&[], 3, 5));
    }

    #[test]
    fn the_head_of_a_copied_message_is_read_back() {
        let mut points = [Point::default(); 4];
        fill(&mut points, 9);
        put_head(cast_slice_mut(&mut points), 1234, 9);
        assert_eq!(head(cast_slice(&points)), Some((1234, 9)));
        assert_eq!(points[1..], [point(9, 1), point(9, 2), point(9, 3)]);
        assert_eq!(head(&cast_slice(&points)[..15]), None);
    }
}
