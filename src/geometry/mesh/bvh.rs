//! A bounding volume hierarchy over items that were halved across their longest extent (`arrange`).
//!
//! Purpose: [`Bvh`] finds candidates for the nearest item to a point. A node has the boxes of eight neighbours, and the tree
//! needs no further data: 28 bytes an item, built on all threads.
//! Invariant: boxes are rounded outwards, so that no candidate is missed. Must not know: the items in the boxes.

use glam::DVec3;
use rayon::prelude::*;

use crate::tasks;
use crate::token::Token;

/// Boxes in a node: as many as a processor compares at once with little left over.
const WIDTH: usize = 8;
/// Nodes that wait at most: seven of each level and the first, and 11 levels hold 2³¹ items.
const WAITING: usize = (WIDTH - 1) * 12 + 1;

/// Distance up to which single precision distinguishes boxes of a unit.
const NEAR_BY: f64 = 4.0;
/// Rounding of a point and of its difference from a box, of a unit: half an ulp and another, and as much again.
const ROUNDING: f32 = 2.0 * f32::EPSILON;

/// More items than these are shared out to threads.
const SEVERAL: usize = 4096;

/// Boxes side by side, axis by axis. Empty ones are at infinity.
#[derive(Clone)]
struct Node {
    low: [[f32; WIDTH]; 3],
    high: [[f32; WIDTH]; 3],
}

/// Boxes of items, boxes of eight of them, and so on up to one node.
pub(crate) struct Bvh {
    /// The lowest first: the boxes of the items themselves.
    levels: Vec<Vec<Node>>,
}

type Box = ([f32; 3], [f32; 3]);

impl Bvh {
    /// Around items with these corners, neighbours side by side.
    pub(crate) fn new<const N: usize>(items: &[[DVec3; N]]) -> Self {
        let lowest = |eight: &[[DVec3; N]]| Node::of(eight.iter().map(|corners| bounds(corners)));
        let mut level: Vec<Node> = items.par_chunks(WIDTH).map(lowest).collect();
        let mut levels = Vec::new();
        while level.len() > 1 {
            let next = level.par_chunks(WIDTH).map(|eight| Node::of(eight.iter().map(Node::bounds))).collect();
            levels.push(std::mem::replace(&mut level, next));
        }
        levels.push(level);
        Self { levels }
    }

    /// Calls `visit` with items, likely near ones first, until no box is within the bound. `visit` returns the bound: the
    /// squared distance from `p` of the best item; `first` is the initial bound. Boxes count as `slack` larger on each side.
    pub(crate) fn nearest(&self, p: DVec3, slack: f64, first: f64, mut visit: impl FnMut(usize) -> f64) {
        let mut bound = first;
        let near_by = p.abs().max_element() < NEAR_BY;
        let mut waiting = [(0.0, 0, 0); WAITING];
        let mut count = 1;
        waiting[0] = (0.0, self.levels.len() - 1, 0);
        while count > 0 {
            count -= 1;
            let (cost, level, index) = waiting[count];
            if cost > bound {
                continue;
            }
            let Some(node) = self.levels[level].get(index) else { continue };
            let costs = if near_by { node.quick_costs(p) } else { node.costs(p, slack) };
            // Boxes within the bound, the nearest last.
            let mut near = [(0.0, 0); WIDTH];
            let mut found = 0;
            // Empty lanes cost infinity. All are compared before any is looked at: which are within cannot be foretold.
            let most = bound.min(f64::MAX);
            let mut within = costs.iter().rev().fold(0u32, |bits, &cost| bits << 1 | u32::from(cost <= most));
            while within != 0 {
                let lane = within.trailing_zeros() as usize;
                within &= within - 1;
                let cost = costs[lane];
                let mut at = found;
                while at > 0 && near[at - 1].0 < cost {
                    near[at] = near[at - 1];
                    at -= 1;
                }
                near[at] = (cost, lane);
                found += 1;
            }
            if level > 0 {
                for &(cost, lane) in &near[..found] {
                    waiting[count] = (cost, level - 1, index * WIDTH + lane);
                    count += 1;
                }
            } else {
                for &(cost, lane) in near[..found].iter().rev() {
                    if cost > bound {
                        break;
                    }
                    bound = visit(index * WIDTH + lane);
                }
            }
        }
    }

    /// Calls `visit` with items whose boxes meet that of `corners`, until it returns true.
    pub(crate) fn overlapping(&self, corners: &[DVec3], mut visit: impl FnMut(usize) -> bool) {
        let (low, high) = bounds(corners);
        let mut waiting = vec![(self.levels.len() - 1, 0)];
        while let Some((level, index)) = waiting.pop() {
            let Some(node) = self.levels[level].get(index) else { continue };
            for lane in 0..WIDTH {
                let meets = |axis: usize| node.low[axis][lane] <= high[axis] && low[axis] <= node.high[axis][lane];
                if !(0..3).all(meets) {
                    continue;
                }
                let below = index * WIDTH + lane;
                if level > 0 {
                    waiting.push((level - 1, below));
                } else if visit(below) {
                    return;
                }
            }
        }
    }
}

/// The box around points.
fn bounds(corners: &[DVec3]) -> Box {
    let low = corners.iter().fold(DVec3::INFINITY, |low, &p| low.min(p));
    let high = corners.iter().fold(DVec3::NEG_INFINITY, |high, &p| high.max(p));
    (low.to_array().map(below), high.to_array().map(above))
}

/// Sorts items so that neighbours are adjacent: each eight of a node, each eight such nodes, and so on, are one part of items that
/// were halved across their longest extent. `place` gives the place of an item. Coincident items keep their order.
/// Ends early once the token is stopped.
pub(crate) fn arrange<T: Copy + Default + Send + Sync>(
    items: &mut Vec<T>,
    place: &(dyn Fn(&T) -> DVec3 + Sync),
    token: &Token,
) {
    let mut placed: Vec<(DVec3, u32)> = tasks::map(items.len(), |i| (place(&items[i]), i as u32));
    halve(&mut placed, token);
    if token.check().is_err() {
        return;
    }
    *items = tasks::map(placed.len(), |k| items[placed[k].1 as usize]);
}

fn halve(placed: &mut [(DVec3, u32)], token: &Token) {
    let mut part = 1;
    while part * WIDTH < placed.len() {
        part *= WIDTH;
    }
    if part == 1 || placed.len() > SEVERAL && token.check().is_err() {
        return;
    }
    let (low, high) = placed.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p.0), h.max(p.0)));
    let axis = (high - low).max_position();
    let middle = placed.len().div_ceil(part).div_ceil(2) * part;
    placed.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let (one, other) = placed.split_at_mut(middle);
    if one.len() > SEVERAL {
        rayon::join(|| halve(one, token), || halve(other, token));
    } else {
        halve(one, token);
        halve(other, token);
    }
}

impl Node {
    fn of(boxes: impl Iterator<Item = Box>) -> Self {
        let mut node = Self { low: [[f32::INFINITY; WIDTH]; 3], high: [[f32::NEG_INFINITY; WIDTH]; 3] };
        for (lane, (low, high)) in boxes.enumerate() {
            for axis in 0..3 {
                node.low[axis][lane] = low[axis];
                node.high[axis][lane] = high[axis];
            }
        }
        node
    }

    fn bounds(&self) -> Box {
        let low = self.low.map(|lanes| lanes.into_iter().fold(f32::INFINITY, f32::min));
        (low, self.high.map(|lanes| lanes.into_iter().fold(f32::NEG_INFINITY, f32::max)))
    }

    /// As [`Node::costs`], hardly less, for a slack up to [`ROUNDING`]; in single precision, three times as fast.
    #[inline]
    fn quick_costs(&self, p: DVec3) -> [f64; WIDTH] {
        let slack = ROUNDING * (1.0 + p.abs().max_element() as f32);
        let larger = |a: f32, b: f32| if a > b { a } else { b };
        let mut costs = [0.0; WIDTH];
        for (axis, x) in p.as_vec3().to_array().into_iter().enumerate() {
            let (low, high) = (&self.low[axis], &self.high[axis]);
            for lane in 0..WIDTH {
                let apart = larger(larger(low[lane] - x, x - high[lane]) - slack, 0.0);
                costs[lane] += apart * apart;
            }
        }
        // The squares and their sum are rounded four times.
        costs.map(|cost| f64::from(cost) * (1.0 - 8.0 * f64::from(f32::EPSILON)))
    }

    /// Squared distance of `p` from each box.
    #[inline]
    fn costs(&self, p: DVec3, slack: f64) -> [f64; WIDTH] {
        // Comparisons and not `max`, which looks for NaN and is several times slower.
        let larger = |a: f64, b: f64| if a > b { a } else { b };
        let mut costs = [0.0; WIDTH];
        for (axis, x) in p.to_array().into_iter().enumerate() {
            let (low, high) = (&self.low[axis], &self.high[axis]);
            for lane in 0..WIDTH {
                let apart = larger(f64::from(low[lane]) - x, x - f64::from(high[lane])) - slack;
                let apart = larger(apart, 0.0);
                costs[lane] += apart * apart;
            }
        }
        costs
    }
}

/// The next number of single precision that is not above.
fn below(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) > x { near.next_down() } else { near }
}

fn above(x: f64) -> f32 {
    -below(-x)
}

/// The Morton code (1966) of a point with coordinates in [-1, 1]: its order keeps neighbours
/// close in memory. There are 2²⁰ cells per axis, and points outside are clamped to the box.
pub(crate) fn morton(unit: DVec3) -> u64 {
    let spread = |x: f64| {
        // The cast saturates.
        let mut bits = (((x + 1.0) * (1u64 << 20) as f64) as u64).min((1 << 21) - 1);
        bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
        bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
        bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
        bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
        (bits | bits << 2) & 0x1249_2492_4924_9249
    };
    spread(unit.x) | spread(unit.y) << 1 | spread(unit.z) << 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_nearest_of_any_number() {
        let point = |i: usize| DVec3::new((i as f64).sin(), (i as f64 * 0.7).cos(), (i % 7) as f64 * 0.1);
        for n in [1, 2, 7, 8, 9, 63, 64, 65, 600] {
            let items: Vec<[DVec3; 1]> = (0..n).map(|i| [point(i)]).collect();
            let tree = Bvh::new(&items);
            for p in (0..50).map(|i| 1.7 * point(1000 + 3 * i)).chain([point(n - 1), DVec3::splat(1e100)]) {
                let (mut best, mut visited) = (f64::INFINITY, 0);
                tree.nearest(p, 0.0, f64::INFINITY, |i| {
                    visited += 1;
                    best = best.min(items[i][0].distance_squared(p));
                    best
                });
                let expected = items.iter().map(|t| t[0].distance_squared(p)).fold(f64::INFINITY, f64::min);
                assert_eq!(best, expected);
                assert!(visited <= n);
                // Outward rounding makes a box hardly nearer than its items.
                if expected > 1e-6 {
                    tree.nearest(p, 0.0, 0.5 * expected, |_| panic!("nothing is that near"));
                }
            }
        }
        assert!(f64::from(below(0.1)) <= 0.1 && f64::from(above(0.1)) >= 0.1 && below(-1e-60) < 0.0);
        assert_eq!((below(0.5), above(-2.0)), (0.5, -2.0));
    }
}
