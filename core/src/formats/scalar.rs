//! The scalar types of PLY, PCD and VTK, and where in a record the position and the intensity stand.

use super::cloud_reader::{Record, intensity_from};

/// A stored number type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// The order of a number's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Endian {
    Little,
    Big,
}

impl Scalar {
    /// Size [bytes].
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// The value at the start of `bytes`; NaN when they are too few.
    pub(super) fn read(self, bytes: &[u8], endian: Endian) -> f64 {
        let size = self.size();
        let Some(bytes) = bytes.get(..size) else { return f64::NAN };
        // Little-endian, widened to 8 bytes.
        let mut le = [0_u8; 8];
        for (i, slot) in le.iter_mut().take(size).enumerate() {
            let from = if endian == Endian::Little { i } else { size - 1 - i };
            *slot = bytes.get(from).copied().unwrap_or(0);
        }
        let bits = u64::from_le_bytes(le);
        match self {
            Self::I8 => f64::from(bits as u8 as i8),
            Self::U8 => f64::from(bits as u8),
            Self::I16 => f64::from(bits as u16 as i16),
            Self::U16 => f64::from(bits as u16),
            Self::I32 => f64::from(bits as u32 as i32),
            Self::U32 => f64::from(bits as u32),
            Self::I64 => bits as i64 as f64,
            Self::U64 => bits as f64,
            Self::F32 => f64::from(f32::from_bits(bits as u32)),
            Self::F64 => f64::from_bits(bits),
        }
    }
}

/// What a field of a record means to us.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    X,
    Y,
    Z,
    Intensity,
    Other,
}

impl Role {
    /// By the names that are in use, in any case.
    pub(super) fn of_name(name: &str) -> Self {
        match name.trim().trim_matches('"').to_lowercase().as_str() {
            "x" => Self::X,
            "y" => Self::Y,
            "z" => Self::Z,
            "intensity" | "scalar_intensity" | "intensities" | "reflectance" | "reflectivity" | "remission" => {
                Self::Intensity
            }
            _ => Self::Other,
        }
    }
}

/// Collects the fields of one record by their roles.
#[derive(Debug, Clone, Copy)]
pub(super) struct RecordBuilder {
    position: [f64; 3],
    intensity: f64,
}

impl RecordBuilder {
    pub(super) fn new() -> Self {
        Self { position: [f64::NAN; 3], intensity: 0.0 }
    }

    pub(super) fn set(&mut self, role: Role, value: f64) {
        match role {
            Role::X => self.position[0] = value,
            Role::Y => self.position[1] = value,
            Role::Z => self.position[2] = value,
            Role::Intensity => self.intensity = value,
            Role::Other => {}
        }
    }

    pub(super) fn build(self) -> Record {
        Record { position: self.position, intensity: intensity_from(self.intensity) }
    }
}

/// A field of a binary record that is read.
#[derive(Debug, Clone, Copy)]
pub(super) struct FieldAt {
    pub(super) role: Role,
    pub(super) scalar: Scalar,
    /// Bytes from the start of the record.
    pub(super) offset: usize,
}

/// The record that the fields find in `bytes`.
pub(super) fn record_from_bytes(fields: &[FieldAt], bytes: &[u8], endian: Endian) -> Record {
    let mut record = RecordBuilder::new();
    for field in fields {
        record.set(field.role, field.scalar.read(bytes.get(field.offset..).unwrap_or(&[]), endian));
    }
    record.build()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_is_read_in_both_byte_orders() {
        let cases: [(Scalar, Vec<u8>, f64); 10] = [
            (Scalar::I8, (-3_i8).to_le_bytes().to_vec(), -3.0),
            (Scalar::U8, vec![200], 200.0),
            (Scalar::I16, (-300_i16).to_le_bytes().to_vec(), -300.0),
            (Scalar::U16, 60_000_u16.to_le_bytes().to_vec(), 60_000.0),
            (Scalar::I32, (-70_000_i32).to_le_bytes().to_vec(), -70_000.0),
            (Scalar::U32, 4_000_000_000_u32.to_le_bytes().to_vec(), 4e9),
            (Scalar::I64, (-5_000_000_000_i64).to_le_bytes().to_vec(), -5e9),
            (Scalar::U64, 9_000_000_000_u64.to_le_bytes().to_vec(), 9e9),
            (Scalar::F32, 1.5_f32.to_le_bytes().to_vec(), 1.5),
            (Scalar::F64, (-2.25_f64).to_le_bytes().to_vec(), -2.25),
        ];
        for (scalar, mut bytes, value) in cases {
            assert_eq!(bytes.len(), scalar.size());
            assert_eq!(scalar.read(&bytes, Endian::Little), value);
            bytes.reverse();
            assert_eq!(scalar.read(&bytes, Endian::Big), value);
            assert!(scalar.read(&bytes[1..], Endian::Big).is_nan());
        }
    }
}
