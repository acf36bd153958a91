//! Scores a scan without an order: the same formulas over lists of neighbours.

use nalgebra::Vector3;

use super::obstacle::step_score;
use super::point_score::PointScore;
use super::scorer::{LOW, Own, REACHABLE, Rule, Tally, VALID};
use crate::scan::Point;
use crate::surface::Surface;
use crate::threads::for_blocks;

/// Points handled together; a block of work is a whole number of these.
const CHUNK: usize = 1024;

/// The points' own scores, and B_l with what steps add to it.
#[derive(Debug, Default)]
pub(super) struct ScoreCloud {
    own: Vec<Own>,
    obstacle: Vec<f32>,
}

impl ScoreCloud {
    /// Scores every point into the record of the same index.
    pub(super) fn score(
        &mut self,
        rule: &Rule,
        points: &[Point],
        surface: &Surface,
        threads: usize,
        out: &mut [PointScore],
    ) -> Tally {
        self.own.resize(points.len(), Own::default());
        self.obstacle.resize(points.len(), 0.0);
        for_blocks(&mut self.own, CHUNK, threads, |first, block| {
            let range = first * CHUNK..first * CHUNK + block.len();
            for ((own, point), shape) in block.iter_mut().zip(&points[range.clone()]).zip(&surface.points()[range]) {
                *own = rule.own([point.x, point.y, point.z], shape.normal, shape.incidence);
            }
        });
        let own = &self.own;
        for_blocks(&mut self.obstacle, CHUNK, threads, |first, block| {
            for (k, obstacle) in block.iter_mut().enumerate() {
                *obstacle = with_steps(rule, own, surface, first * CHUNK + k);
            }
        });
        let obstacle = &self.obstacle;
        for_blocks(out, CHUNK, threads, |first, block| {
            for (k, record) in block.iter_mut().enumerate() {
                *record = record_of(rule, own, obstacle, surface, first * CHUNK + k);
            }
        });
        let mut tally = Tally::default();
        for record in out.iter() {
            tally.valid += u64::from(record.is_valid());
            tally.reachable += u64::from(record.is_reachable());
            tally.quality += u64::from(record.quality);
        }
        tally
    }
}

/// B_l of a point, raised where it steps up or down to a neighbour.
fn with_steps(rule: &Rule, own: &[Own], surface: &Surface, index: usize) -> f32 {
    let here = &own[index];
    let mut obstacle = here.obstacle;
    if here.state & LOW != 0 && rule.has_steps() {
        surface.for_each_neighbour(index, |neighbour| {
            let there = &own[neighbour];
            if there.state & VALID != 0 {
                let leg = [0, 1, 2].map(|axis| there.level[axis] - here.level[axis]);
                obstacle = obstacle.max(step_score(leg));
            }
        });
    }
    obstacle
}

/// The record of a point: its own scores and the means of its neighbours' (3.17 to 3.21), its quality and shape.
fn record_of(rule: &Rule, own: &[Own], obstacle: &[f32], surface: &Surface, index: usize) -> PointScore {
    let state = own[index].state;
    if state & VALID == 0 {
        return PointScore::NONE;
    }
    let shape = &surface.points()[index];
    let mut record = PointScore {
        flags: PointScore::VALID,
        quality: PointScore::quantise(shape.quality),
        area: shape.area,
        ..PointScore::NONE
    };
    record.set_normal(&Vector3::from(shape.normal));
    if state & REACHABLE == 0 {
        return record;
    }
    let (mut f, mut b, mut count) = (0.0f32, 0.0f32, 0.0f32);
    surface.for_each_neighbour(index, |neighbour| {
        if own[neighbour].state & VALID != 0 {
            f += own[neighbour].navigable;
            b += obstacle[neighbour];
            count += 1.0;
        }
    });
    let share = 1.0 / count.max(1.0);
    let [f, b] = rule.combine([own[index].navigable, obstacle[index]], [f * share, b * share]);
    record.flags |= PointScore::REACHABLE;
    (record.navigable, record.obstacle) = (PointScore::quantise(f), PointScore::quantise(b));
    record
}
