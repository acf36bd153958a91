//! Planes of bits, one a cell: what a sweep reads and writes a word of 64 cells at a time.

/// Bits of a word.
pub(super) const WORD: usize = 64;

/// A rectangle of bits in rows of whole words.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct BitPlane {
    /// Words of a row.
    pub stride: usize,
    pub words: Vec<u64>,
}

impl BitPlane {
    /// Makes it `rows` rows of `stride` words, all `fill`; the memory is reused.
    pub fn reset(&mut self, rows: usize, stride: usize, fill: u64) {
        self.stride = stride;
        self.words.clear();
        self.words.resize(rows * stride, fill);
    }

    #[inline]
    pub fn row(&self, row: usize) -> &[u64] {
        &self.words[row * self.stride..(row + 1) * self.stride]
    }

    #[inline]
    pub fn row_mut(&mut self, row: usize) -> &mut [u64] {
        &mut self.words[row * self.stride..(row + 1) * self.stride]
    }

    #[inline]
    pub fn rows(&self) -> usize {
        self.words.len().checked_div(self.stride).unwrap_or(0)
    }

    #[inline]
    pub fn has(&self, row: usize, bit: usize) -> bool {
        self.words[row * self.stride + bit / WORD] >> (bit % WORD) & 1 == 1
    }

    #[inline]
    pub fn set(&mut self, row: usize, bit: usize) {
        self.words[row * self.stride + bit / WORD] |= 1 << (bit % WORD);
    }

    /// Sets the bits `first..=last` of a row.
    #[inline]
    pub fn set_range(&mut self, row: usize, first: usize, last: usize) {
        let words = self.row_mut(row);
        let (low, high) = (first / WORD, last / WORD);
        let (head, tail) = (u64::MAX << (first % WORD), u64::MAX >> (WORD - 1 - last % WORD));
        if low == high {
            words[low] |= head & tail;
            return;
        }
        words[low] |= head;
        words[low + 1..high].fill(u64::MAX);
        words[high] |= tail;
    }

    /// The sixteen bits `16 group ..` of a row.
    #[inline]
    pub fn sixteen(&self, row: usize, group: usize) -> u16 {
        (self.words[row * self.stride + group / 4] >> (16 * (group % 4))) as u16
    }

    /// Adds sixteen bits at `16 group ..` of a row.
    #[inline]
    pub fn or_sixteen(&mut self, row: usize, group: usize, bits: u16) {
        self.words[row * self.stride + group / 4] |= u64::from(bits) << (16 * (group % 4));
    }

    /// The places `row * 64 stride + bit` of all set bits, ascending.
    pub fn ones(&self) -> impl Iterator<Item = usize> + '_ {
        self.words.iter().enumerate().flat_map(|(index, &word)| {
            let mut left = word;
            std::iter::from_fn(move || {
                let bit = (left != 0).then(|| left.trailing_zeros() as usize)?;
                left &= left - 1;
                Some(index * WORD + bit)
            })
        })
    }

    /// The number of set bits.
    #[cfg(test)]
    pub fn count(&self) -> usize {
        self.words.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Adds to `out` the bits of this plane, rows and columns exchanged. Both are of whole blocks of 64 x 64.
    pub fn or_transposed_into(&self, out: &mut Self) {
        let mut block = [0u64; WORD];
        for rows in 0..self.rows() / WORD {
            for column in 0..self.stride {
                let mut any = 0;
                for (k, line) in block.iter_mut().enumerate() {
                    *line = self.words[(rows * WORD + k) * self.stride + column];
                    any |= *line;
                }
                if any == 0 {
                    continue;
                }
                transpose(&mut block);
                for (k, line) in block.iter().enumerate() {
                    out.words[(column * WORD + k) * out.stride + rows] |= line;
                }
            }
        }
    }

    /// Every bit that has a set bit of `self` within the disc of `radius` cells (centre to centre), into `out`.
    pub fn dilate_into(&self, radius: f64, out: &mut Self) {
        out.reset(self.rows(), self.stride, 0);
        let reach = radius.floor() as isize;
        let mut spread = vec![0u64; self.stride];
        for row in (0..self.rows()).filter(|&row| self.row(row).iter().any(|&word| word != 0)) {
            for dy in -reach..=reach {
                let half = (radius * radius - (dy * dy) as f64).sqrt().floor() as usize;
                let Some(target) = row.checked_add_signed(dy).filter(|&r| r < out.rows()) else { continue };
                spread.copy_from_slice(self.row(row));
                for _ in 0..half {
                    spread_by_one(&mut spread);
                }
                for (to, from) in out.row_mut(target).iter_mut().zip(&spread) {
                    *to |= from;
                }
            }
        }
    }
}

/// Every set bit also sets its two neighbours.
fn spread_by_one(row: &mut [u64]) {
    let mut carry = 0;
    for at in 0..row.len() {
        let word = row[at];
        let next = row.get(at + 1).copied().unwrap_or(0);
        row[at] = word | word << 1 | carry | word >> 1 | next << (WORD - 1);
        carry = word >> (WORD - 1);
    }
}

/// Exchanges rows and columns of 64 x 64 bits: halves are swapped across the diagonal, then quarters, down to bits.
fn transpose(block: &mut [u64; WORD]) {
    let (mut width, mut mask) = (WORD / 2, 0x0000_0000_ffff_ffffu64);
    while width > 0 {
        for group in (0..WORD).step_by(2 * width) {
            let (upper, lower) = block[group..group + 2 * width].split_at_mut(width);
            for (a, b) in upper.iter_mut().zip(lower) {
                let swapped = (*a >> width ^ *b) & mask;
                *a ^= swapped << width;
                *b ^= swapped;
            }
        }
        width /= 2;
        mask ^= mask << width;
    }
}

/// The first set bit of `row` in `from..=to`.
#[inline]
pub(super) fn next_one(row: &[u64], from: usize, to: usize) -> Option<usize> {
    next(row, from, to, 0)
}

/// The first clear bit of `row` in `from..=to`.
#[inline]
pub(super) fn next_zero(row: &[u64], from: usize, to: usize) -> Option<usize> {
    next(row, from, to, u64::MAX)
}

#[inline]
fn next(row: &[u64], from: usize, to: usize, flip: u64) -> Option<usize> {
    if from > to {
        return None;
    }
    let mut word = from / WORD;
    let mut bits = (row[word] ^ flip) & (u64::MAX << (from % WORD));
    while bits == 0 {
        word += 1;
        if word > to / WORD {
            return None;
        }
        bits = row[word] ^ flip;
    }
    let found = word * WORD + bits.trailing_zeros() as usize;
    (found <= to).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plane(rows: usize, stride: usize, ones: &[(usize, usize)]) -> BitPlane {
        let mut plane = BitPlane::default();
        plane.reset(rows, stride, 0);
        ones.iter().for_each(|&(row, bit)| plane.set(row % rows, bit % (stride * WORD)));
        plane
    }

    proptest! {
        #[test]
        fn a_range_sets_exactly_its_bits(a in 0..200usize, b in 0..200usize) {
            let (first, last) = (a.min(b), a.max(b));
            let mut plane = plane(2, 4, &[]);
            plane.set_range(1, first, last);
            for bit in 0..256 {
                prop_assert_eq!(plane.has(1, bit), (first..=last).contains(&bit));
                prop_assert!(!plane.has(0, bit));
            }
        }

        #[test]
        fn a_transposed_plane_has_rows_for_columns(ones in prop::collection::vec((0..128usize, 0..192usize), 0..80)) {
            let from = plane(128, 3, &ones);
            let mut to = plane(192, 2, &[]);
            from.or_transposed_into(&mut to);
            for row in 0..128 {
                for bit in 0..192 {
                    prop_assert_eq!(from.has(row, bit), to.has(bit, row));
                }
            }
            prop_assert_eq!(from.count(), from.ones().count());
        }

        #[test]
        fn the_next_bit_is_the_first_of_its_kind(ones in prop::collection::vec(0..192usize, 0..40), from in 0..192usize, to in 0..192usize) {
            let places: Vec<_> = ones.iter().map(|&bit| (0, bit)).collect();
            let plane = plane(1, 3, &places);
            let first = |kind: bool| (from..=to).find(|&bit| plane.has(0, bit) == kind);
            prop_assert_eq!(next_one(plane.row(0), from, to), first(true));
            prop_assert_eq!(next_zero(plane.row(0), from, to), first(false));
        }

        #[test]
        fn dilation_reaches_exactly_the_disc(ones in prop::collection::vec((20..44usize, 20..108usize), 0..6), radius in 0.0..6.0f64) {
            let from = plane(64, 2, &ones);
            let mut to = BitPlane::default();
            from.dilate_into(radius, &mut to);
            for row in 0..64usize {
                for bit in 0..128usize {
                    let near = ones.iter().any(|&(r, b)| {
                        let (dy, dx) = (r as f64 - row as f64, b as f64 - bit as f64);
                        dy * dy + dx * dx <= radius * radius
                    });
                    prop_assert_eq!(to.has(row, bit), near, "{} {}", row, bit);
                }
            }
        }
    }
}
