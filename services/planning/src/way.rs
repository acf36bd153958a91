//! How far the robot has come along a path.

/// The robot has left the path when it is farther from it than this [m].
const OFF_M: f64 = 1.0;

/// The bends of the path up to where it comes nearest to the robot, and that place; empty when the robot is not on it.
pub(crate) fn driven(path: &[[f64; 2]], robot: [f64; 2]) -> Vec<[f64; 2]> {
    let mut nearest: Option<(f64, usize, [f64; 2])> = None;
    for (k, piece) in path.windows(2).enumerate() {
        let (from, to) = (piece[0], piece[1]);
        let along = [to[0] - from[0], to[1] - from[1]];
        let length_sq = along[0] * along[0] + along[1] * along[1];
        let share = (robot[0] - from[0]) * along[0] + (robot[1] - from[1]) * along[1];
        let share = if length_sq > 0.0 { (share / length_sq).clamp(0.0, 1.0) } else { 0.0 };
        let place = [from[0] + share * along[0], from[1] + share * along[1]];
        let distance = (robot[0] - place[0]).hypot(robot[1] - place[1]);
        if nearest.is_none_or(|(least, ..)| distance < least) {
            nearest = Some((distance, k, place));
        }
    }
    match nearest {
        Some((distance, last, place)) if distance <= OFF_M => {
            path.iter().take(last + 1).copied().chain([place]).collect()
        }
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_driven_ends_beside_the_robot_and_is_none_when_it_is_elsewhere() {
        let path = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]];
        assert_eq!(driven(&path, [4.3, 1.0]), [[0.0, 0.0], [4.0, 0.0], [4.0, 1.0]]);
        assert_eq!(driven(&path, [0.5, -0.2]), [[0.0, 0.0], [0.5, 0.0]]);
        assert_eq!(driven(&path, [4.1, 4.9]), path);
        assert!(driven(&path, [0.0, 3.0]).is_empty() && driven(&[[1.0, 1.0]], [1.0, 1.0]).is_empty());
        assert!(driven(&path, [f64::NAN, 0.0]).is_empty());
    }
}
