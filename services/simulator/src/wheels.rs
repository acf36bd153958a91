//! From the motion of the robot to the speeds of its wheels.

/// Speeds of the left and right wheels [m/s] that drive a skid-steered robot at `linear` [m/s] and `angular` [rad/s],
/// where `track` is the distance of the wheels that turning goes by [m], see `sensors.odometry.track`. When a side would
/// have to be faster than `fastest` [m/s], both are slowed in proportion, so that the robot keeps to the same arc.
pub(crate) fn speeds(linear: f64, angular: f64, track: f64, fastest: f64) -> [f64; 2] {
    let half = 0.5 * track * angular;
    let sides = [linear - half, linear + half];
    let needed = sides[0].abs().max(sides[1].abs());
    if needed > fastest { sides.map(|side| side * fastest / needed) } else { sides }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ahead_both_sides_are_alike_and_to_the_left_the_right_is_faster() {
        assert_eq!(speeds(0.5, 0.0, 1.0, 1.5), [0.5, 0.5]);
        assert_eq!(speeds(0.5, 0.2, 1.0, 1.5), [0.4, 0.6]);
        assert_eq!(speeds(0.0, -0.2, 1.0, 1.5), [0.1, -0.1]);
    }

    #[test]
    fn too_fast_a_reference_keeps_its_arc() {
        let [left, right] = speeds(3.0, 2.0, 1.0, 1.5);
        assert!((right - 1.5).abs() < 1e-12 && (left / right - 0.5).abs() < 1e-12);
    }
}
