//! Curves that are copies of each other.
//!
//! Purpose: [`CurveSeeds::share`] gives copies of a curve, as several sheets have that meet there, the same seeds: those of the copy
//! that has most.
//! Invariant: seeds of copies differ by a translation and the turns of the copies alone, up to rounding. Must not know: why there are copies.

use std::collections::HashMap;

use glam::{DMat3, DVec3};

use super::{CurveSeeds, INNER_POINTS, Segment};
use crate::mesh::features::Features;

/// A copy of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twin {
    pub curve: u32,
    /// Whether it runs against the first copy of its group, or with it.
    pub reversed: bool,
    /// A place on the curve, the same for all copies, unit frame.
    pub place: DVec3,
    /// How it is turned.
    pub turn: DMat3,
}

/// The seeds of a curve in order: those that are no corners, and what lies between neighbours.
#[derive(Clone, Default)]
struct Chain {
    inner: Vec<DVec3>,
    stretches: Vec<([DVec3; INNER_POINTS], f64)>,
}

impl Chain {
    fn reversed(mut self) -> Self {
        self.inner.reverse();
        self.stretches.reverse();
        self.stretches.iter_mut().for_each(|(between, _)| between.reverse());
        self
    }

    fn moved(mut self, from: &Twin, to: &Twin) -> Self {
        let by = to.place - from.place;
        let turn = (to.turn != from.turn).then(|| to.turn * from.turn.transpose());
        let place = |p: &mut DVec3| match turn {
            None => *p += by,
            Some(turn) => *p = to.place + turn * (*p - from.place),
        };
        self.inner.iter_mut().for_each(place);
        self.stretches.iter_mut().flat_map(|(between, _)| between).for_each(place);
        self
    }
}

impl CurveSeeds {
    /// Gives the curves of each group the same seeds. Each curve is in one group at most.
    pub fn share(&mut self, features: &Features, groups: &[Vec<Twin>]) {
        let mut chains = self.chains(features);
        for group in groups {
            let length = |twin: &Twin| chains[twin.curve as usize].stretches.len();
            let order = |a: &&Twin, b: &&Twin| length(a).cmp(&length(b)).then(b.curve.cmp(&a.curve));
            let Some(&model) = group.iter().max_by(order) else { continue };
            let chain = chains[model.curve as usize].clone();
            for twin in group.iter().filter(|twin| twin.curve != model.curve) {
                let same = chain.clone().moved(&model, twin);
                chains[twin.curve as usize] = if twin.reversed == model.reversed { same } else { same.reversed() };
            }
            self.shared.extend(group.iter().map(|twin| twin.curve));
        }
        self.shared.sort_unstable();
        self.seeds.truncate(self.corners);
        self.segments.clear();
        for (number, chain) in (0..).zip(chains) {
            let curve = &features.curves[number as usize];
            let first = self.seeds.len() as u32;
            let mut all: Vec<u32> = (first..first + chain.inner.len() as u32).collect();
            if curve.closed {
                all.push(first);
            } else {
                let corner = |v: u32| features.corners.binary_search(&v).map_or(first, |k| k as u32);
                all.insert(0, corner(curve.vertices[0]));
                all.push(corner(curve.vertices[curve.vertices.len() - 1]));
            }
            self.seeds.extend(chain.inner);
            let stretches = all.windows(2).zip(chain.stretches);
            self.segments.extend(stretches.map(|(ends, (between, edge))| Segment {
                ends: [ends[0], ends[1]],
                between,
                curve: number,
                edge,
            }));
        }
    }

    /// Whether a curve has copies with the same seeds.
    pub fn is_shared(&self, curve: u32) -> bool {
        self.shared.binary_search(&curve).is_ok()
    }

    /// For each seed, whether a shared curve has it.
    pub fn on_shared(&self) -> Vec<bool> {
        let mut on = vec![false; self.seeds.len()];
        let shared = self.segments.iter().filter(|segment| self.is_shared(segment.curve));
        shared.flat_map(|segment| segment.ends).for_each(|seed| on[seed as usize] = true);
        on
    }

    fn chains(&self, features: &Features) -> Vec<Chain> {
        let mut of_curve: Vec<Vec<&Segment>> = vec![Vec::new(); features.curves.len()];
        self.segments.iter().for_each(|segment| of_curve[segment.curve as usize].push(segment));
        let chain = |(curve, segments): (&crate::mesh::features::Curve, Vec<&Segment>)| {
            let from: HashMap<u32, &Segment> = segments.iter().map(|segment| (segment.ends[0], *segment)).collect();
            let corner = features.corners.binary_search(&curve.vertices[0]).ok().filter(|_| !curve.closed);
            let Some(start) = corner.map(|k| k as u32).or(segments.first().map(|s| s.ends[0])) else {
                return Chain::default();
            };
            let mut chain = Chain::default();
            let mut at = start;
            for k in 0..segments.len() {
                let Some(segment) = from.get(&at) else { break };
                if k > 0 || curve.closed {
                    chain.inner.push(self.seeds[at as usize]);
                }
                chain.stretches.push((segment.between, segment.edge));
                at = segment.ends[1];
            }
            chain
        };
        features.curves.iter().zip(of_curve).map(chain).collect()
    }
}
