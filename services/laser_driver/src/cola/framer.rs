//! Telegrams out of a stream of bytes, however it is cut into pieces.

const STX: u8 = 0x02;
const ETX: u8 = 0x03;
/// The longest telegram that is waited for: a scan of 1,082 ranges and intensities in text takes 12 kB.
const LONGEST: usize = 1 << 16;

/// A telegram as it goes over the wire.
pub(crate) fn wrapped(words: &str) -> Vec<u8> {
    [&[STX], words.as_bytes(), &[ETX]].concat()
}

/// Collects bytes until telegrams are whole. What is not between STX and ETX, or too long, is let go and counted.
#[derive(Debug, Default)]
pub(crate) struct Framer {
    bytes: Vec<u8>,
    /// Bytes of `bytes` that were handed out.
    used: usize,
    garbage: u64,
}

impl Framer {
    /// Takes in what came.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.used);
        self.used = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next whole telegram, without its frame.
    pub fn next(&mut self) -> Option<&[u8]> {
        let fresh = self.bytes.get(self.used..)?;
        let Some(start) = fresh.iter().position(|b| *b == STX) else {
            self.garbage += fresh.len() as u64;
            self.used = self.bytes.len();
            return None;
        };
        self.garbage += start as u64;
        self.used += start;
        let fresh = self.bytes.get(self.used..)?;
        match fresh.iter().position(|b| *b == ETX) {
            Some(end) => {
                let (begin, end) = (self.used, self.used + end);
                self.used = end + 1;
                // A telegram that was cut off before this one began is garbage.
                let telegram = self.bytes.get(begin + 1..end)?;
                let restart = telegram.iter().rposition(|b| *b == STX).map_or(0, |at| at + 1);
                self.garbage += restart as u64;
                telegram.get(restart..)
            }
            None => {
                if fresh.len() > LONGEST {
                    self.garbage += fresh.len() as u64;
                    self.used = self.bytes.len();
                }
                None
            }
        }
    }

    /// Bytes that belonged to no telegram.
    pub fn garbage(&self) -> u64 {
        self.garbage
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn all(framer: &mut Framer) -> Vec<Vec<u8>> {
        std::iter::from_fn(|| framer.next().map(<[u8]>::to_vec)).collect()
    }

    proptest! {
        #[test]
        fn telegrams_come_out_whole_however_the_stream_is_cut(
            texts in prop::collection::vec("[ -~]{0,40}", 1..8), noise in "[a-z]{0,9}", cut in 1..17usize,
        ) {
            let stream: Vec<u8> = texts.iter().flat_map(|t| [noise.as_bytes().to_vec(), wrapped(t)].concat()).collect();
            let mut framer = Framer::default();
            let mut seen = Vec::new();
            for piece in stream.chunks(cut) {
                framer.push(piece);
                seen.extend(all(&mut framer));
            }
            let expected: Vec<Vec<u8>> = texts.iter().map(|t| t.as_bytes().to_vec()).collect();
            prop_assert_eq!(seen, expected);
            prop_assert_eq!(framer.garbage(), (noise.len() * texts.len()) as u64);
        }

        #[test]
        fn any_bytes_are_taken_without_harm(pieces in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..50), 0..20)) {
            let mut framer = Framer::default();
            for piece in pieces {
                framer.push(&piece);
                for telegram in all(&mut framer) {
                    prop_assert!(!telegram.contains(&STX) && !telegram.contains(&ETX));
                }
            }
        }
    }

    #[test]
    fn a_telegram_without_an_end_is_given_up_and_a_cut_one_does_not_spoil_the_next() {
        let mut framer = Framer::default();
        framer.push(&[&[STX], &[b'x'; LONGEST + 2][..]].concat());
        assert_eq!(framer.next(), None);
        framer.push(&[&[STX], &b"sRA ha"[..], &wrapped("sRA whole")[..]].concat());
        assert_eq!(framer.next(), Some(&b"sRA whole"[..]));
        assert_eq!(framer.garbage(), LONGEST as u64 + 3 + 7);
    }
}
