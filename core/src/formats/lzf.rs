//! LZF, the packing of PCD's `binary_compressed` (format of Marc Lehmann's liblzf).
//!
//! A control byte below 32 announces `control + 1` literal bytes. Any other is a back reference: its upper three bits
//! are the length minus 2 (7: one more byte is added to it), its lower five bits and the next byte the distance minus 1.

/// The most bytes that one packed byte can stand for: a reference of three bytes gives at most 264.
pub(super) const MOST_EXPANSION: u64 = 88;

/// Unpacks a block; `None` when it is damaged or does not give exactly `size` bytes. Grows with what is really there,
/// so that a wrong `size` allocates nothing.
pub(super) fn unpack(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    let mut out: Vec<u8> = Vec::new();
    let mut input = packed;
    while let Some((&control, rest)) = input.split_first() {
        if control < 32 {
            let (literals, rest) = rest.split_at_checked(usize::from(control) + 1)?;
            out.extend_from_slice(literals);
            input = rest;
        } else {
            let mut length = usize::from(control >> 5) + 2;
            let mut rest = rest;
            if length == 9 {
                let (&more, after) = rest.split_first()?;
                length += usize::from(more);
                rest = after;
            }
            let (&low, rest) = rest.split_first()?;
            let distance = (usize::from(control & 31) << 8 | usize::from(low)) + 1;
            let start = out.len().checked_sub(distance)?;
            // The source may overlap what is being written, so bytes go one by one.
            for from in start..start + length {
                out.push(*out.get(from)?);
            }
            input = rest;
        }
        if out.len() > size {
            return None;
        }
    }
    (out.len() == size).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn literals_and_overlapping_references_unpack() {
        // "ab", then 6 bytes from 2 back, then "c".
        let packed = [1, b'a', b'b', 4 << 5, 1, 0, b'c'];
        assert_eq!(unpack(&packed, 9).unwrap(), b"ababababc");
    }

    #[test]
    fn a_long_reference_takes_its_length_from_one_more_byte() {
        let packed = [0, b'z', 7 << 5, 100, 0];
        assert_eq!(unpack(&packed, 110).unwrap(), [b'z'; 110]);
    }

    #[test]
    fn a_reference_before_the_start_or_a_wrong_size_is_refused() {
        assert!(unpack(&[0, b'a', 1 << 5, 9], 4).is_none());
        assert!(unpack(&[0, b'a'], 2).is_none());
        assert!(unpack(&[3, b'a'], 4).is_none());
        assert!(unpack(&[0, b'a'], usize::MAX).is_none());
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300), size in 0..5000_usize) {
            if let Some(out) = unpack(&bytes, size) {
                prop_assert_eq!(out.len(), size);
                prop_assert!(out.len() as u64 <= bytes.len() as u64 * MOST_EXPANSION);
            }
        }
    }
}
