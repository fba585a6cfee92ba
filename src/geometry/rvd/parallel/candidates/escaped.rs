//! Seeds that have left their skin.
//!
//! Purpose: a few seeds that move farther than the others need not void the lists of all facets. Facets that an escaped seed
//! concerns get lists for one pass.
//! Invariant: all other seeds are within their skin. So a list holds that has no escaped seed, on a facet that none
//! reaches. An escaped seed reaches a facet where it may be nearer to some corner than a seed within its skin is.
//! Beyond that, the latter beats it at all three corners. Must not know: what becomes of a list.

use glam::DVec3;
use rayon::prelude::*;

use super::gather::{ROOM, Skin};
use crate::knn::Point;
use crate::rvd::{incident::Diagram, refill};

/// Seeds per task.
const CHUNK: usize = 2048;

/// The ends of a box around corners, whose coordinates are of the order of 1, may be rounded by less than this.
const ROUNDING: f64 = 1e-15;

/// Which seeds have escaped, and where they are.
#[derive(Default)]
pub(crate) struct Escaped<P> {
    /// From low to high x.
    all: Vec<(P, u32)>,
    /// Where those were that were there when lists were made, from low to high x.
    were: Vec<P>,
    /// The most skin that one of those has.
    skin: f64,
    has_escaped: Vec<bool>,
}

/// A facet as seen from a seed within its skin: to each corner, how far that may be at most.
#[derive(Clone, Copy)]
pub(crate) struct Reach<P> {
    pub corner: [P; 3],
    pub most: [f64; 3],
}

impl<P: Point> Reach<P> {
    pub(crate) fn of(diagram: Diagram<'_, P>, skin: Skin<'_>, corner: &[P; 3], seed: u32) -> Self {
        let (origin, own) = (diagram.seeds[seed as usize], skin.of(seed));
        Self { corner: *corner, most: corner.map(|c| (c.distance(origin) + own) * ROOM) }
    }

    /// A box around the places of all seeds that are nearer to some corner, roundings included.
    pub(crate) fn bounds(&self) -> Bounds {
        let mut bounds = Bounds::NONE;
        for (&corner, most) in self.corner.iter().zip(self.most) {
            let most = DVec3::splat(most * (1.0 + 1e-9) + ROUNDING);
            bounds = bounds.with(Bounds { low: corner.place() - most, high: corner.place() + most });
        }
        bounds
    }

    /// Whether a seed there may be nearer to some corner.
    pub(crate) fn holds(&self, p: P) -> bool {
        let near = |c: usize| self.corner[c].distance_squared(p) <= self.most[c] * self.most[c] * ROOM;
        near(0) || near(1) || near(2)
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Bounds {
    pub low: DVec3,
    pub high: DVec3,
}

impl Bounds {
    pub(crate) const NONE: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    /// The least box around both.
    pub(crate) fn with(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    pub(crate) fn width_squared(&self) -> f64 {
        self.low.distance_squared(self.high)
    }

    pub(crate) fn wider(self, by: f64) -> Self {
        let by = DVec3::splat(by * (1.0 + 1e-9) + ROUNDING);
        Self { low: self.low - by, high: self.high + by }
    }

    /// Whether a point may come to lie in it that moves by so much.
    pub(crate) fn is_within(&self, by: f64, p: DVec3) -> bool {
        let away = (self.low - p).max(p - self.high);
        away.x.max(away.y).max(away.z) <= by * (1.0 + 1e-9) + ROUNDING
    }

    /// Whether a point is in it, ends included.
    pub(crate) fn contains(&self, p: DVec3) -> bool {
        p.cmpge(self.low).all() && p.cmple(self.high).all()
    }
}

impl<P: Point> Escaped<P> {
    /// Finds those that are not within `used` of their skin about where they were; seeds that were not there have escaped
    /// too. Returns whether there are at most `most`; nothing is known of them otherwise.
    pub(crate) fn find(&mut self, seeds: &[P], were: &[P], (skin, used): (Skin<'_>, f64), most: usize) -> bool {
        let has_left = |i: usize| {
            let Some(was) = were.get(i) else { return true };
            let most = used * skin.of(i as u32);
            was.distance_squared(seeds[i]) > most * most
        };
        let indices = (0..seeds.len()).into_par_iter().with_min_len(CHUNK);
        indices.clone().map(has_left).collect_into_vec(&mut self.has_escaped);
        self.all.clear();
        if self.has_escaped.iter().filter(|has_escaped| **has_escaped).count() > most {
            return false;
        }
        let escaped = self.has_escaped.iter().enumerate().filter(|(_, has_escaped)| **has_escaped);
        self.all.extend(escaped.map(|(i, _)| (seeds[i], i as u32)));
        self.all.sort_unstable_by(|a, b| x(&a.0).total_cmp(&x(&b.0)).then(a.1.cmp(&b.1)));
        refill(&mut self.were, self.all.iter().filter_map(|&(_, i)| were.get(i as usize).copied()));
        self.were.sort_unstable_by(|a, b| x(a).total_cmp(&x(b)));
        let old = self.all.iter().filter(|(_, i)| (*i as usize) < were.len());
        self.skin = old.map(|(_, i)| skin.of(*i)).fold(0.0, f64::max);
        true
    }

    pub(crate) fn contains(&self, seed: u32) -> bool {
        self.has_escaped[seed as usize]
    }

    /// Those in a box, ends included.
    pub(crate) fn within(&self, bounds: Bounds) -> impl Iterator<Item = (P, u32)> {
        let first = self.all.partition_point(|(p, _)| x(p) < bounds.low.x);
        let along = self.all[first..].iter().take_while(move |(p, _)| x(p) <= bounds.high.x);
        along.copied().filter(move |(p, _)| bounds.contains(p.place()))
    }

    /// Where those were that may have been nearer to a facet in these bounds than the seed that it starts with.
    pub(crate) fn were_within(&self, bounds: Bounds) -> impl Iterator<Item = P> {
        let bounds = self.about(bounds);
        let first = self.were.partition_point(|p| x(p) < bounds.low.x);
        let along = self.were[first..].iter().take_while(move |p| x(*p) <= bounds.high.x);
        along.copied().filter(move |p| bounds.contains(p.place()))
    }

    /// Around bounds what escaped seeds had for skin.
    pub(crate) fn about(&self, bounds: Bounds) -> Bounds {
        bounds.wider(self.skin)
    }

    /// Whether one lies exactly on another seed.
    pub(crate) fn meet(&self, seeds: &[P]) -> bool {
        let on_another = |(i, &p): (usize, &P)| {
            let first = self.all.partition_point(|(q, _)| x(q) < x(&p));
            let along = self.all[first..].iter().take_while(|(q, _)| x(q) == x(&p));
            along.clone().any(|&(q, j)| q == p && j as usize != i)
        };
        !self.all.is_empty() && seeds.par_iter().enumerate().with_min_len(CHUNK).any(on_another)
    }
}

fn x<P: Point>(p: &P) -> f64 {
    p.place().x
}
