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

/// Bytes of the stamp and the number at the head of a message that is copied.
pub(super) const HEAD: usize = 16;

/// Writes message `sequence` into a buffer: room for the head, then bytes of the points.
pub(super) fn fill_bytes(buffer: &mut [u8], sequence: u64) {
    for (index, bytes) in buffer.chunks_exact_mut(size_of::<Point>()).enumerate().skip(HEAD / size_of::<Point>()) {
        let p = point(sequence, index);
        let (xyz, rest) = bytes.split_at_mut(12);
        for (to, from) in xyz.chunks_exact_mut(4).zip([p.x, p.y, p.z]) {
            to.copy_from_slice(&from.to_ne_bytes());
        }
        for (to, from) in rest.chunks_exact_mut(2).zip([p.intensity, p.time]) {
            to.copy_from_slice(&from.to_ne_bytes());
        }
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

    #[test]
    fn a_payload_of_another_message_is_noticed() {
        let items: Vec<Point> = (0..5).map(|i| point(3, i)).collect();
        assert!(is_intact(&items, 3, 5));
        assert!(!is_intact(&items, 4, 5) && !is_intact(&items, 3, 6) && !is_intact(&[], 3, 5));
    }

    #[test]
    fn the_head_of_a_copied_message_is_read_back() {
        let mut buffer = vec![0; 64];
        fill_bytes(&mut buffer, 9);
        put_head(&mut buffer, 1234, 9);
        assert_eq!(head(&buffer), Some((1234, 9)));
        assert_eq!(buffer[16..20], 1.0_f32.to_ne_bytes());
        assert_eq!(buffer[60..62], 9_u16.to_ne_bytes());
        assert_eq!(head(&buffer[..15]), None);
    }
}
