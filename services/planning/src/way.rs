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

/// The same way when it turns out at its end that the robot is `off` from where it took itself to be [m]: as it knew where it
/// was at the beginning, each place is moved by its share of the way.
pub(crate) fn corrected(way: &[[f64; 2]], off: [f64; 2]) -> Vec<[f64; 2]> {
    let lengths: Vec<f64> =
        way.windows(2).map(|piece| (piece[1][0] - piece[0][0]).hypot(piece[1][1] - piece[0][1])).collect();
    let total: f64 = lengths.iter().sum();
    let along = std::iter::once(0.0).chain(lengths.iter().scan(0.0, |sum, length| {
        *sum += length;
        Some(*sum)
    }));
    let share = |at: f64| if total > 0.0 { at / total } else { 1.0 };
    way.iter().zip(along).map(|(place, at)| [place[0] + share(at) * off[0], place[1] + share(at) * off[1]]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_robot_was_off_at_the_end_came_about_on_the_way() {
        let way = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.0]];
        assert_eq!(corrected(&way, [1.0, -0.5]), [[0.0, 0.0], [3.75, -0.375], [4.0, 0.5]]);
        assert!(corrected(&[], [1.0, 1.0]).is_empty());
        assert_eq!(corrected(&[[2.0, 2.0]], [1.0, 0.0]), [[3.0, 2.0]]);
    }

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
