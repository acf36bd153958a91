//! What remains of a scored scan: evidence in 16-byte items, from which the map is made and remade when poses change.
//!
//! Every item has a place in the map frame of the moment the scan was condensed. A corrected pose moves the items as a
//! rigid body; the map gets what they then say. So the map is a function of summaries and poses, and nothing else.

use super::index::{CellIndex, LARGEST_COORDINATE};
use super::item::{HEIGHT_UNITS_PER_METRE, INTERPOLATED, Item};
use crate::geometry::Pose;
use flate2::Crc;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use thiserror::Error;

/// Version of the layout written by [`ScanEvidence::write`].
pub const EVIDENCE_FORMAT_VERSION: u8 = 1;

/// Begins the bytes of a summary; the last byte is the version.
const MARK: [u8; 4] = [b'M', b'S', b'E', EVIDENCE_FORMAT_VERSION];

/// Bytes before the items: mark, checksum, number of items, anchor, cell size, pose.
const HEAD_BYTES: usize = 4 + 4 + 8 + 3 * 4 + 4 + 8 + 7 * 8;

/// The compact summary of one scored scan.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanEvidence {
    /// Side of the cells it was condensed for [m].
    pub(super) cell_m: f64,
    /// The cell whose lower left corner positions are relative to.
    pub(super) anchor: CellIndex,
    /// The height heights are relative to [m/512].
    pub(super) anchor_height: i32,
    /// Pose of the scan when it was condensed.
    pub(super) map_from_scanner: Pose,
    pub(super) items: Vec<Item>,
}

/// Why bytes are not the summary of a scan.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum EvidenceBytesError {
    /// They do not begin like one of this version.
    #[error("scan evidence: the bytes do not begin as a summary of version {EVIDENCE_FORMAT_VERSION}")]
    NotEvidence,
    /// They end too early, or go on too long.
    #[error("scan evidence: {found} bytes, {expected} were announced")]
    Length {
        /// The number of bytes given.
        found: usize,
        /// The number they should have.
        expected: usize,
    },
    /// The checksum does not fit the rest.
    #[error("scan evidence: the checksum does not fit, the bytes are damaged")]
    Checksum,
    /// A value that no scan can have made.
    #[error("scan evidence: {what} is impossible, the bytes were not written by this program")]
    Impossible {
        /// What is wrong.
        what: &'static str,
    },
}

impl ScanEvidence {
    /// A summary without evidence.
    pub(super) fn empty() -> Self {
        Self {
            cell_m: 1.0,
            anchor: CellIndex { x: 0, y: 0 },
            anchor_height: 0,
            map_from_scanner: Pose::identity(),
            items: Vec::new(),
        }
    }

    /// Side of the cells the scan was condensed for [m]; it fits only maps of these cells.
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Pose of the scan when it was condensed.
    #[must_use]
    pub fn map_from_scanner(&self) -> &Pose {
        &self.map_from_scanner
    }

    /// Items that stand for returns.
    #[must_use]
    pub fn measured_items(&self) -> usize {
        self.items.len() - self.interpolated_items()
    }

    /// Items that stand for a cell covered by a triangle.
    #[must_use]
    pub fn interpolated_items(&self) -> usize {
        self.items.iter().filter(|item| item.kind() & INTERPOLATED != 0).count()
    }

    /// Length of what [`ScanEvidence::write`] writes: 100 bytes and 16 an item.
    #[must_use]
    pub fn bytes(&self) -> usize {
        HEAD_BYTES + self.items.len() * size_of::<Item>()
    }

    /// Appends the summary as bytes; the same summary always gives the same bytes.
    pub fn write(&self, out: &mut Vec<u8>) {
        out.reserve(self.bytes());
        out.extend_from_slice(&MARK);
        let sum_at = out.len();
        out.extend_from_slice(&[0; 4]);
        out.extend_from_slice(&(self.items.len() as u64).to_le_bytes());
        for value in [self.anchor.x, self.anchor.y, self.anchor_height, 0] {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out.extend_from_slice(&self.cell_m.to_le_bytes());
        for value in pose_to_numbers(&self.map_from_scanner) {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out.extend_from_slice(bytemuck::cast_slice(&self.items));
        let mut crc = Crc::new();
        crc.update(&out[sum_at + 4..]);
        out[sum_at..sum_at + 4].copy_from_slice(&crc.sum().to_le_bytes());
    }

    /// The summary that [`ScanEvidence::write`] wrote.
    ///
    /// # Errors
    /// See [`EvidenceBytesError`]. Bytes of any other origin are refused, never trusted.
    pub fn read(bytes: &[u8]) -> Result<Self, EvidenceBytesError> {
        let impossible = |what| EvidenceBytesError::Impossible { what };
        let found = bytes.len();
        if !bytes.starts_with(&MARK) {
            return Err(EvidenceBytesError::NotEvidence);
        }
        let too_short = EvidenceBytesError::Length { found, expected: HEAD_BYTES };
        let (head, rest) = bytes.split_at_checked(HEAD_BYTES).ok_or(too_short)?;
        let mut crc = Crc::new();
        crc.update(&bytes[8..]);
        if crc.sum().to_le_bytes() != head[4..8] {
            return Err(EvidenceBytesError::Checksum);
        }
        let mut numbers = Numbers { rest: &head[8..] };
        let count = u64::from_le_bytes(numbers.take());
        let expected = usize::try_from(count).ok().and_then(|n| n.checked_mul(size_of::<Item>()));
        if expected != Some(rest.len()) {
            let expected = expected.and_then(|n| n.checked_add(HEAD_BYTES)).unwrap_or(usize::MAX);
            return Err(EvidenceBytesError::Length { found, expected });
        }
        let [x, y, anchor_height, zero] = [0; 4].map(|_: i32| i32::from_le_bytes(numbers.take()));
        let cell_m = f64::from_le_bytes(numbers.take());
        let pose = [0.0; 7].map(|_: f64| f64::from_le_bytes(numbers.take()));
        if !(cell_m.is_finite() && cell_m > 0.0) {
            return Err(impossible("the size of the cells"));
        }
        let map_from_scanner = pose_from_numbers(pose).ok_or(impossible("the pose"))?;
        let position = map_from_scanner.translation.vector;
        let is_near = |value: f64, anchor: i32| (value - f64::from(anchor)).abs() < 2.0;
        let is_anchored = is_near(position.x / cell_m, x)
            && is_near(position.y / cell_m, y)
            && is_near(position.z * HEIGHT_UNITS_PER_METRE, anchor_height);
        let is_on_map = x.unsigned_abs() <= LARGEST_COORDINATE.unsigned_abs()
            && y.unsigned_abs() <= LARGEST_COORDINATE.unsigned_abs()
            && anchor_height.unsigned_abs() <= 1 << 29;
        if zero != 0 || !is_anchored || !is_on_map {
            return Err(impossible("the anchor"));
        }
        let items = rest.chunks_exact(size_of::<Item>()).map(bytemuck::pod_read_unaligned).collect();
        Ok(Self { cell_m, anchor: CellIndex { x, y }, anchor_height, map_from_scanner, items })
    }
}

/// A pose as translation and unit quaternion, every bit of it.
#[must_use]
pub(super) fn pose_to_numbers(pose: &Pose) -> [f64; 7] {
    let (t, q) = (&pose.translation.vector, pose.rotation.quaternion());
    [t.x, t.y, t.z, q.i, q.j, q.k, q.w]
}

/// Undoes [`pose_to_numbers`]; `None` when it is no pose.
#[must_use]
pub(super) fn pose_from_numbers([x, y, z, i, j, k, w]: [f64; 7]) -> Option<Pose> {
    let quaternion = Quaternion::new(w, i, j, k);
    let is_pose = [x, y, z].iter().all(|v| v.is_finite()) && (quaternion.norm() - 1.0).abs() < 1e-6;
    is_pose.then(|| Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_unchecked(quaternion)))
}

/// Takes numbers off the front of a head whose length was checked.
struct Numbers<'a> {
    rest: &'a [u8],
}

impl Numbers<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut number = [0; N];
        let (first, rest) = self.rest.split_at(N);
        number.copy_from_slice(first);
        self.rest = rest;
        number
    }
}
