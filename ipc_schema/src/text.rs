//! Short texts of fixed capacity inside messages: UTF-8, filled up with zeros.

/// Packs as much of `text` as fits, cut at a character boundary.
#[must_use]
pub fn pack<const N: usize>(text: &str) -> [u8; N] {
    let mut end = text.len().min(N);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let mut out = [0; N];
    out[..end].copy_from_slice(&text.as_bytes()[..end]);
    out
}

/// The text up to the first zero; bytes that are not UTF-8 end it.
#[must_use]
pub fn unpack(bytes: &[u8]) -> &str {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    match std::str::from_utf8(&bytes[..end]) {
        Ok(text) => text,
        Err(error) => std::str::from_utf8(&bytes[..error.valid_up_to()]).unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_text_that_fits_comes_back(text in "[a-zäöü ]{0,10}") {
            let packed = pack::<32>(&text);
            prop_assert_eq!(unpack(&packed), text);
        }

        #[test]
        fn any_bytes_unpack_to_something(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
            prop_assert!(unpack(&bytes).len() <= bytes.len());
        }
    }

    #[test]
    fn a_text_that_is_too_long_is_cut_between_characters() {
        assert_eq!(unpack(&pack::<3>("aéé")), "aé");
        assert_eq!(unpack(&pack::<2>("aéé")), "a");
    }
}
