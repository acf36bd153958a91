//! Clouds without a header: little-endian f32, three a point (`.xyz32.bin`) or four (KITTI `.bin`).

use super::{
    cloud_reader::{CountHint, Record, RecordReader, intensity_from},
    error::FormatError,
    source::Source,
};

/// Reads records of `FLOATS` f32: x, y, z [m] and, as the fourth, intensity in [0, 1], which is spread over u16.
pub(super) struct RawFloatsReader<const FLOATS: usize> {
    source: Source,
    count: CountHint,
}

impl<const FLOATS: usize> RawFloatsReader<FLOATS> {
    const BYTES: usize = 4 * FLOATS;

    pub(super) fn new(source: Source) -> Result<Self, FormatError> {
        let size = source.remaining_at_most();
        if !source.is_packed() && !size.is_multiple_of(Self::BYTES as u64) {
            return Err(source.truncated(format!("{size} bytes are not a multiple of {} bytes a point", Self::BYTES)));
        }
        let count = usize::try_from(size / Self::BYTES as u64).unwrap_or(usize::MAX);
        let count = if source.is_packed() { CountHint::AtMost(count) } else { CountHint::Exact(count) };
        Ok(Self { source, count })
    }
}

impl<const FLOATS: usize> RecordReader for RawFloatsReader<FLOATS> {
    fn count(&self) -> CountHint {
        self.count
    }

    fn next(&mut self) -> Result<Option<Record>, FormatError> {
        let mut values = [0.0_f32; FLOATS];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut values);
        let size = bytes.len();
        match self.source.read_up_to(bytes)? {
            0 => return Ok(None),
            n if n < size => return Err(self.source.truncated(format!("a point takes {size} bytes, {n} are left"))),
            _ => {}
        }
        // Bits in file order; a big-endian machine has to turn them.
        let value = |i: usize| values.get(i).map(|v| f64::from(f32::from_bits(u32::from_le(v.to_bits()))));
        let [x, y, z] = [0, 1, 2].map(|i| value(i).unwrap_or(f64::NAN));
        let intensity = value(3).map_or(0, |unit| intensity_from(unit * 65535.0));
        Ok(Some(Record { position: [x, y, z], intensity }))
    }
}
