//! Data packets of Velodyne's VLP-16 and HDL-32E, after their user manuals (63-9243, chapter 9; 63-9113, appendix A):
//! twelve blocks of a mark, the azimuth [1/100 deg] and 32 channels of range [2 mm] and strength, then the time within the
//! hour [us], the return mode and the model.

use std::f32::consts::TAU;

/// Bytes of a data packet.
pub(super) const PACKET: usize = 1206;
const BLOCK: usize = 100;
const BLOCKS: usize = 12;
/// Bytes that begin a block.
const MARK: [u8; 2] = [0xff, 0xee];
/// A count of range [m].
const RANGE_UNIT: f32 = 0.002;
/// A count of azimuth [rad].
const AZIMUTH_UNIT: f32 = TAU / 36_000.0;
const TURN: u32 = 36_000;

/// Elevations in the order of firing [deg]: VLP-16 manual, table 9-1.
const VLP16_DEG: [f32; 16] =
    [-15.0, 1.0, -13.0, 3.0, -11.0, 5.0, -9.0, 7.0, -7.0, 9.0, -5.0, 11.0, -3.0, 13.0, -1.0, 15.0];
/// HDL-32E: the lower and the upper half of the lasers fire in turns, 4/3 deg apart.
const HDL32_LOWEST_DEG: f32 = -30.67;
const HDL32_STEP_DEG: f32 = 4.0 / 3.0;

/// A model of laser.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Model {
    /// 16 lasers, two firings of all a block.
    Vlp16,
    /// 32 lasers, one firing a block.
    Hdl32e,
}

impl Model {
    /// Lasers.
    pub fn lasers(self) -> usize {
        match self {
            Self::Vlp16 => 16,
            Self::Hdl32e => 32,
        }
    }

    /// Firings of all lasers in a block.
    fn firings(self) -> usize {
        32 / self.lasers()
    }

    /// From one firing of all lasers to the next [us].
    pub fn firing_us(self) -> f32 {
        match self {
            Self::Vlp16 => 55.296,
            Self::Hdl32e => 46.08,
        }
    }

    /// From laser to laser within a firing [us].
    fn laser_us(self) -> f32 {
        match self {
            Self::Vlp16 => 2.304,
            Self::Hdl32e => 1.152,
        }
    }

    /// Elevation of a laser by its place in the order of firing [rad].
    fn elevation(self, laser: usize) -> f32 {
        let degrees = match self {
            Self::Vlp16 => VLP16_DEG[laser],
            Self::Hdl32e => {
                let place = if laser.is_multiple_of(2) { laser / 2 } else { 16 + laser / 2 };
                HDL32_LOWEST_DEG + HDL32_STEP_DEG * place as f32
            }
        };
        degrees.to_radians()
    }

    /// The place of a laser among all, from the lowest up.
    fn place(self, laser: usize) -> usize {
        if laser.is_multiple_of(2) { laser / 2 } else { self.lasers() / 2 + laser / 2 }
    }

    fn of_code(code: u8) -> Option<Self> {
        match code {
            // 0x22 is the VLP-16 and the Puck LITE.
            0x22 => Some(Self::Vlp16),
            0x21 => Some(Self::Hdl32e),
            _ => None,
        }
    }
}

/// What is wrong with a packet of the right size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PacketFault {
    /// A block does not begin with its mark.
    NoMark,
    /// An azimuth over 360 degrees.
    Azimuth,
    /// A model that is not known.
    Model(u8),
}

/// One range of a laser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shot {
    /// The place of its laser among all, from the lowest up.
    pub place: usize,
    /// Position [m]: x ahead, y to the left, z up. NaN without a return.
    pub position: [f32; 3],
    /// Strength of the return, 0 to 255.
    pub strength: u8,
    /// After the first shot of the packet [us].
    pub time_us: f32,
}

/// A firing of all lasers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Firing {
    /// Azimuth of its first laser, clockwise from straight ahead, in counts of 1/100 deg.
    pub azimuth: u32,
    /// After the first firing of the packet [us].
    pub time_us: f32,
    block: usize,
    half: usize,
    /// Turn of the head from this firing to the next [rad].
    turn: f32,
}

/// A checked data packet.
#[derive(Debug, Clone, Copy)]
pub(super) struct DataPacket<'a> {
    bytes: &'a [u8],
    pub model: Model,
    /// Two returns of each shot are sent as two blocks of the same azimuth.
    is_dual: bool,
}

impl<'a> DataPacket<'a> {
    /// Checks a payload; `None` when it is no data packet by its size.
    pub fn parse(payload: &'a [u8]) -> Option<Result<Self, PacketFault>> {
        if payload.len() != PACKET {
            return None;
        }
        Some(Self::check(payload))
    }

    fn check(bytes: &'a [u8]) -> Result<Self, PacketFault> {
        let code = bytes[PACKET - 1];
        let model = Model::of_code(code).ok_or(PacketFault::Model(code))?;
        let packet = Self { bytes, model, is_dual: bytes[PACKET - 2] == 0x39 };
        for block in 0..BLOCKS {
            if bytes[block * BLOCK..][..2] != MARK {
                return Err(PacketFault::NoMark);
            }
            if packet.azimuth(block) >= TURN {
                return Err(PacketFault::Azimuth);
            }
        }
        Ok(packet)
    }

    fn azimuth(&self, block: usize) -> u32 {
        let at = block * BLOCK + 2;
        u32::from(u16::from_le_bytes([self.bytes[at], self.bytes[at + 1]]))
    }

    /// The firings, in the order of time. Of two returns the one that is sent first (the last, or the strongest) is taken.
    pub fn firings(&self) -> impl Iterator<Item = Firing> + '_ {
        let (step, each) = (if self.is_dual { 2 } else { 1 }, self.model.firings());
        (0..BLOCKS / step).flat_map(move |order| {
            let block = order * step;
            // The head turns evenly: what it turns during a block is the way to the next one, or from the last.
            let (from, to) = if block + step < BLOCKS { (block, block + step) } else { (block - step, block) };
            let block_turn = (self.azimuth(to) + TURN - self.azimuth(from)) % TURN;
            (0..each).map(move |half| Firing {
                azimuth: (self.azimuth(block) + block_turn * half as u32 / each as u32) % TURN,
                time_us: self.model.firing_us() * (order * each + half) as f32,
                block,
                half,
                turn: block_turn as f32 * AZIMUTH_UNIT / each as f32,
            })
        })
    }

    /// The shots of a firing.
    pub fn shots(&self, firing: Firing) -> impl Iterator<Item = Shot> + '_ {
        let model = self.model;
        (0..model.lasers()).map(move |laser| {
            let at = firing.block * BLOCK + 4 + 3 * (firing.half * model.lasers() + laser);
            let range = f32::from(u16::from_le_bytes([self.bytes[at], self.bytes[at + 1]])) * RANGE_UNIT;
            let after = model.laser_us() * laser as f32;
            let azimuth = firing.azimuth as f32 * AZIMUTH_UNIT + firing.turn * after / model.firing_us();
            let (sin, cos) = model.elevation(laser).sin_cos();
            // The sensor's azimuth goes clockwise, ours does not.
            let direction = [cos * azimuth.cos(), -cos * azimuth.sin(), sin];
            let range = if range > 0.0 { range } else { f32::NAN };
            Shot {
                place: model.place(laser),
                position: direction.map(|d| d * range),
                strength: self.bytes[at + 2],
                time_us: firing.time_us + after,
            }
        })
    }
}
