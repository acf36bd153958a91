//! The colours of values, in pictures and in viewers alike.

/// Red, green, blue.
pub type Colour = [u8; 3];

/// The chosen view, and the path to it.
pub const CHOSEN: Colour = [220, 0, 180];
/// Where the scanner has been.
pub const TRAJECTORY: Colour = [25, 60, 160];
/// Zones of interest.
pub const ZONE: Colour = [230, 130, 20];
/// What has no value.
pub const UNKNOWN: Colour = [130, 130, 130];

/// Red at 0 (obstacle), yellow half-way, green at 1 (navigable).
#[must_use]
pub fn red_to_green(value: f64) -> Colour {
    blend(&[[200, 40, 35], [245, 205, 70], [40, 150, 65]], value)
}

/// Dark blue at 0, teal half-way, yellow at 1; rises in brightness throughout.
#[must_use]
pub fn blue_to_yellow(value: f64) -> Colour {
    blend(&[[50, 20, 100], [40, 120, 140], [90, 190, 100], [250, 230, 60]], value)
}

/// The colour at `value` in [0, 1] between evenly spaced stops, of which there are at least two; values outside are
/// those of the nearer end.
#[must_use]
pub fn blend(stops: &[Colour], value: f64) -> Colour {
    let place = value.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let k = (place as usize).min(stops.len() - 2);
    let share = place - k as f64;
    let mix = |c: usize| (f64::from(stops[k][c]) * (1.0 - share) + f64::from(stops[k + 1][c]) * share).round() as u8;
    [mix(0), mix(1), mix(2)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_begin_and_end_with_their_stops() {
        assert_eq!((blue_to_yellow(-1.0), blue_to_yellow(7.0)), ([50, 20, 100], [250, 230, 60]));
        assert_eq!(
            (red_to_green(0.0), red_to_green(0.5), red_to_green(1.0)),
            ([200, 40, 35], [245, 205, 70], [40, 150, 65])
        );
    }
}
