//! A robot that drives a planned way on true ground, as far as it goes.

use mirador_core::navigation::NavigationConfig;
use mirador_core::simulation::CellKind;
use serde::{Deserialize, Serialize};

use super::World;

/// A robot that gives a target up goes back by so much, where it can turn [m], as the driver does from an edge.
const BACK_M: f64 = 1.0;

/// A target that was given up, because something stops the robot on the way to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GivenUp {
    /// On the way from which scan, from 0.
    pub after_scan: usize,
    /// Where [m, map frame].
    pub position: [f64; 2],
    /// What is there.
    pub what: String,
}

/// A way as it was driven.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drive {
    /// Its corners, the robot's place before it first [m, map frame].
    pub way: Vec<[f64; 3]>,
    /// What the robot drove, the way back from where it was stopped included [m].
    pub metres: f64,
    /// Where something stopped the robot, and what: it has gone back a little from there.
    pub stopped_at: Option<([f64; 2], CellKind)>,
}

impl Drive {
    /// Drives from `from` along a planned path.
    pub fn along(world: &World, from: [f64; 3], path: &[[f64; 3]]) -> Self {
        let planned: Vec<[f64; 3]> = std::iter::once(from).chain(path.iter().copied()).collect();
        for (k, piece) in planned.windows(2).enumerate() {
            let [a, b] = [piece[0], piece[1]];
            let Some((position, kind)) = world.first_stop([a[0], a[1]], [b[0], b[1]]) else { continue };
            let mut way = planned[..=k].to_vec();
            way.push([position[0], position[1], a[2] + share_of(a, b, position) * (b[2] - a[2])]);
            let forth = length(&way);
            let back = go_back(&mut way, BACK_M);
            return Self { way, metres: forth + back, stopped_at: Some((position, kind)) };
        }
        Self { metres: length(&planned), way: planned, stopped_at: None }
    }

    /// Where the robot ends.
    pub fn end(&self) -> Option<[f64; 3]> {
        self.way.last().copied()
    }

    /// The corners seen from above.
    pub fn flat(&self) -> Vec<[f64; 2]> {
        self.way.iter().map(|&[x, y, _]| [x, y]).collect()
    }
}

impl GivenUp {
    pub(super) fn new(after_scan: usize, position: [f64; 2], kind: CellKind) -> Self {
        let what = match kind {
            CellKind::Reachable | CellKind::Isolated => "ground that no way leads to",
            CellKind::TooNear => "too near to an obstacle or an edge",
            CellKind::Obstacle => "an obstacle",
            CellKind::Steep => "too steep",
            CellKind::Void => "no ground",
        };
        Self { after_scan, position, what: what.to_owned() }
    }
}

/// After so many targets given up in a row a mission ends, as in the graph.
pub(super) fn most_given_up() -> usize {
    NavigationConfig::default().max_give_ups as usize
}

/// What the map is told of a place where a target was given up [m].
pub(super) fn obstruction_radius_m() -> f64 {
    NavigationConfig::default().recovery.obstruction_radius_m
}

fn flat_distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn length(way: &[[f64; 3]]) -> f64 {
    way.windows(2).map(|pair| flat_distance(pair[0], pair[1])).sum()
}

fn share_of(a: [f64; 3], b: [f64; 3], position: [f64; 2]) -> f64 {
    let whole = flat_distance(a, b);
    if whole > 0.0 { (position[0] - a[0]).hypot(position[1] - a[1]) / whole } else { 0.0 }
}

/// Takes up to `metres` off the end of a way; returns how many.
fn go_back(way: &mut Vec<[f64; 3]>, metres: f64) -> f64 {
    let mut left = metres;
    while let [.., a, b] = way[..] {
        let whole = flat_distance(a, b);
        way.pop();
        if whole > left {
            let share = left / whole;
            way.push([0, 1, 2].map(|axis| b[axis] + share * (a[axis] - b[axis])));
            return metres;
        }
        left -= whole;
    }
    metres - left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_back_is_taken_off_the_end_and_ends_at_the_beginning() {
        let way = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 0.5, 1.0]];
        let mut back = way.to_vec();
        assert_eq!(go_back(&mut back, 1.0), 1.0);
        assert_eq!(back, [[0.0, 0.0, 0.0], [2.5, 0.0, 0.0]]);
        let mut whole = way.to_vec();
        assert_eq!((go_back(&mut whole, 9.0), whole), (3.5, vec![[0.0, 0.0, 0.0]]));
    }

    #[test]
    fn a_robot_stops_before_a_house_and_drives_a_free_way_to_its_end() {
        let world = World::named("simple").unwrap();
        let start = world.scene.scene().start;
        let from = [start.x, start.y, 0.0];
        let there = [start.x + 1.0, start.y, 0.0];
        let free = Drive::along(&world, from, &[there]);
        assert_eq!((free.end(), free.metres, free.stopped_at), (Some(there), 1.0, None));
        let area = world.scene.scene().area;
        let beyond = [area.x_m[1] + 50.0, start.y, 0.0];
        let stopped = Drive::along(&world, from, &[beyond]);
        let ([x, _], _) = stopped.stopped_at.unwrap();
        let end = stopped.end().unwrap();
        assert!(x < beyond[0] && (x - end[0] - BACK_M).abs() < 1e-9, "{stopped:?}");
        assert!((stopped.metres - (x - start.x) - BACK_M).abs() < 1e-9, "there and back: {stopped:?}");
    }
}
