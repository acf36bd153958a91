//! Numbers of a scene file with their ranges: a wrong one is refused where it is read, so that its line is known.

use std::ops::RangeInclusive;

use serde::Deserialize;

/// A length above zero [m].
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
pub(super) struct Length(pub(super) f64);

impl TryFrom<f64> for Length {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        in_range(value, 1e-3..=1e4).map(Self)
    }
}

/// A coordinate or an angle.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(try_from = "f64")]
pub(super) struct Number(pub(super) f64);

impl TryFrom<f64> for Number {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        in_range(value, -1e5..=1e5).map(Self)
    }
}

/// A factor other than 0; a negative one mirrors.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
pub(super) struct Factor(pub(super) f64);

impl TryFrom<f64> for Factor {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        in_range(value.abs(), 1e-6..=1e6).map(|_| Self(value))
    }
}

/// The number of steps of a flight of stairs.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "u32")]
pub(super) struct Steps(pub(super) u32);

impl TryFrom<u32> for Steps {
    type Error = String;

    fn try_from(value: u32) -> Result<Self, String> {
        if (1..=100).contains(&value) { Ok(Self(value)) } else { Err(format!("{value} steps, allowed are 1 to 100")) }
    }
}

/// From a lower to an upper end [m].
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "[f64; 2]")]
pub(super) struct Interval(pub(super) [f64; 2]);

impl TryFrom<[f64; 2]> for Interval {
    type Error = String;

    fn try_from(ends: [f64; 2]) -> Result<Self, String> {
        in_range(ends[0], -1e5..=1e5)?;
        in_range(ends[1], -1e5..=1e5)?;
        if ends[1] - ends[0] >= 1.0 {
            Ok(Self(ends))
        } else {
            Err(format!("{ends:?} must be [lower, upper], at least 1 m apart"))
        }
    }
}

fn in_range(value: f64, range: RangeInclusive<f64>) -> Result<f64, String> {
    if range.contains(&value) {
        Ok(value)
    } else {
        Err(format!("{value} is out of range, allowed are {} to {}", range.start(), range.end()))
    }
}
