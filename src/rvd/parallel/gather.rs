//! The seeds whose cells may meet a facet.
//!
//! Purpose: from any seed to all that count on a facet, with their distances at its corners.
//! Invariant: no cell that meets the facet is missing, unless [`Gathered::unproved`]; then none is if
//! [`Gatherer::reaches`] holds for every piece. A comparison that rounding could get wrong keeps the seed.
//! Must not know: pieces.

use glam::DVec3;

use crate::rvd::clip::SECURITY;
use crate::rvd::incident::Diagram;
use crate::rvd::start;

/// Members that a facet may have; one with more is walked.
pub(super) const CELLS: usize = 16;
/// Seeds that may be kept before those that others beat are taken out.
const KEPT: usize = 64;
/// Neighbours of a member that are looked at, where one row does not suffice: relaxed cells have six,
/// and twelve more around those.
const AROUND: usize = 14;

/// Seeds whose cells may meet the facet.
pub(super) struct Members<const N: usize = CELLS> {
    pub len: usize,
    pub seed: [u32; N],
    /// |p - x|² at each corner, less that of the seed nearest to the centroid.
    pub farther: [[f64; N]; 3],
    /// Those are off by at most this.
    pub error: [f64; N],
    /// Every seed nearer to this one, squared, was looked at; below 0 if nobody has asked yet.
    reach2: [f64; N],
}

/// One thread's scratch memory.
#[derive(Default)]
pub(super) struct Gatherer {
    all: Members<KEPT>,
    members: Members,
    seen: Seen,
}

/// What was found besides the members.
pub(super) struct Gathered {
    /// The seed nearest to the centroid, the lowest of several.
    pub nearest: u32,
    /// The squared distance of the farthest corner from it.
    pub radius2: f64,
    /// The rows that were read do not say that there are no other members.
    pub unproved: bool,
}

/// The facet as seen from the seed nearest to its centroid.
struct View {
    seed: u32,
    origin: DVec3,
    /// From the seed to the corners.
    corner: [DVec3; 3],
    radius2: f64,
}

/// How a row was read.
enum Row {
    /// As far as the facet needs.
    Closed,
    /// To its end, which is not far enough.
    Ended,
    /// Until there was no room.
    Full,
}

/// Seeds that were looked at for one facet.
#[derive(Default)]
struct Seen {
    stamp: Vec<u32>,
    now: u32,
}

impl Seen {
    fn clear(&mut self, seeds: usize) {
        self.now = self.now.wrapping_add(1);
        if self.stamp.len() != seeds || self.now == 0 {
            self.stamp.clear();
            self.stamp.resize(seeds, 0);
            self.now = 1;
        }
    }

    /// Whether it was not there yet.
    fn insert(&mut self, seed: u32) -> bool {
        std::mem::replace(&mut self.stamp[seed as usize], self.now) != self.now
    }
}

impl<const N: usize> Default for Members<N> {
    fn default() -> Self {
        Self { len: 0, seed: [0; N], farther: [[0.0; N]; 3], error: [0.0; N], reach2: [0.0; N] }
    }
}

impl<const N: usize> Members<N> {
    #[inline(always)]
    fn put(&mut self, at: usize, seed: u32, farther: [f64; 3], error: f64) {
        self.seed[at] = seed;
        for (list, value) in self.farther.iter_mut().zip(farther) {
            list[at] = value;
        }
        self.error[at] = error;
    }

    fn at(&self, at: usize) -> ([f64; 3], f64) {
        ([0, 1, 2].map(|c| self.farther[c][at]), self.error[at])
    }

    /// Writes down a seed that may be nearer than the view's at some corner; of others nothing stays. There
    /// must be room.
    #[inline(always)]
    fn consider(&mut self, view: &View, j: u32, b: DVec3, b2: f64) {
        let farther = view.corner.map(|q| b2 - 2.0 * q.dot(b));
        // Five roundings each in |b|² and q·b, one in the difference, and 2|q||b| is at most |b|² + |q|².
        let error = 3.0 * f64::EPSILON * (2.0 * b2 + view.radius2);
        // Always written, not always kept: no branch to guess.
        self.put(self.len, j, farther, error);
        let least = if farther[0] < farther[1] { farther[0] } else { farther[1] };
        let least = if farther[2] < least { farther[2] } else { least };
        self.len += usize::from(least <= error);
    }
}

impl Gatherer {
    /// The last facet's members.
    pub(super) fn members(&self) -> &Members {
        &self.members
    }

    /// Whether every seed that could cut a piece of member `k` with this squared radius was looked at (\[LB12\]).
    pub(super) fn reaches(&self, k: usize, radius2: f64) -> bool {
        SECURITY * radius2 <= self.members.reach2[k]
    }

    /// Finds the members of the facet with these corners. `None` if there are too many.
    pub(super) fn gather(
        &mut self,
        diagram: Diagram<'_>,
        corner: &[DVec3; 3],
        centroid: DVec3,
        start: u32,
    ) -> Option<Gathered> {
        let (mut seed, mut proved) = (start, false);
        loop {
            let origin = diagram.seeds[seed as usize];
            let from = corner.map(|p| p - origin);
            let squared = from.map(DVec3::length_squared);
            let radius2 = squared[0].max(squared[1]).max(squared[2]);
            let view = View { seed, origin, corner: from, radius2 };
            let row = self.compare(diagram, &view);
            let best = self.nearest(diagram, centroid, seed);
            if best != seed {
                seed = best;
                continue;
            }
            if let Row::Closed = row {
                return self.prune().then_some(Gathered { nearest: seed, radius2, unproved: false });
            }
            // A row that ends early may not hold the nearest one either.
            if !proved && SECURITY * centroid.distance_squared(origin) > self.all.reach2[0] {
                (seed, proved) = (start::nearest(diagram, centroid, seed), true);
                continue;
            }
            let done = matches!(row, Row::Ended) && self.expand(diagram, &view);
            return done.then_some(Gathered { nearest: seed, radius2, unproved: true });
        }
    }

    /// The seed nearest to the centroid of those kept, the first of which is `seed`.
    fn nearest(&self, diagram: Diagram<'_>, centroid: DVec3, seed: u32) -> u32 {
        let key = |i: u32| (centroid.distance_squared(diagram.seeds[i as usize]), i);
        let mut best = seed;
        for k in 1..self.all.len {
            let ([x, y, z], error) = self.all.at(k);
            // The mean over the corners says it of the centroid, but for roundings and ties.
            if x + y + z <= 4.0 * error {
                let (new, old) = (key(self.all.seed[k]), key(best));
                if new.0 < old.0 || (new.0 == old.0 && new.1 < old.1) {
                    best = self.all.seed[k];
                }
            }
        }
        best
    }

    /// Compares the row of the view's seed with it at the corners, up to the security radius of the whole
    /// facet (\[LB12\]).
    fn compare(&mut self, diagram: Diagram<'_>, view: &View) -> Row {
        let reach = SECURITY * view.radius2;
        let all = &mut self.all;
        all.put(0, view.seed, [0.0; 3], 0.0);
        all.len = 1;
        all.reach2[0] = 0.0;
        let (row, complete) = diagram.table.row(view.seed);
        let mut b2 = 0.0;
        for &j in row {
            let b = diagram.seeds[j as usize] - view.origin;
            b2 = b.length_squared();
            if b2 > reach {
                return Row::Closed;
            }
            if all.len == KEPT {
                return Row::Full;
            }
            all.consider(view, j, b, b2);
        }
        all.reach2[0] = b2;
        if complete { Row::Closed } else { Row::Ended }
    }

    /// Looks around every member, until all are known.
    fn expand(&mut self, diagram: Diagram<'_>, view: &View) -> bool {
        self.seen.clear(diagram.seeds.len());
        self.seen.insert(view.seed);
        self.all.reach2[1..].fill(-1.0);
        for &j in diagram.table.row(view.seed).0 {
            self.seen.insert(j);
        }
        loop {
            if !self.prune() {
                return false;
            }
            let (all, members) = (&mut self.all, &mut self.members);
            if members.reach2[..members.len].iter().all(|&r| r >= 0.0) {
                return true;
            }
            let known = members.len;
            all.len = 0;
            for k in 0..known {
                let (farther, error) = members.at(k);
                all.put(k, members.seed[k], farther, error);
                all.reach2[k] = members.reach2[k];
            }
            all.len = known;
            all.reach2[known..].fill(-1.0);
            for k in 0..known {
                if all.reach2[k] >= 0.0 {
                    continue;
                }
                let (row, complete) = diagram.table.row(all.seed[k]);
                let own = diagram.seeds[all.seed[k] as usize];
                for &j in &row[..row.len().min(AROUND)] {
                    if self.seen.insert(j) {
                        if all.len == KEPT {
                            return false;
                        }
                        let b = diagram.seeds[j as usize] - view.origin;
                        all.consider(view, j, b, b.length_squared());
                    }
                }
                all.reach2[k] = match row.get(AROUND - 1).or(row.last()) {
                    _ if complete && row.len() <= AROUND => f64::INFINITY,
                    Some(&last) => diagram.seeds[last as usize].distance_squared(own),
                    None => 0.0,
                };
            }
        }
    }

    /// Takes out the seeds that are farther than another one from all corners. Returns whether the rest
    /// are few enough.
    fn prune(&mut self) -> bool {
        let (all, members) = (&self.all, &mut self.members);
        members.len = 0;
        for a in 0..all.len {
            let (mine, error) = all.at(a);
            let mut least = f64::INFINITY;
            for b in 0..all.len {
                let (other, other_error) = all.at(b);
                let d = [0, 1, 2].map(|c| other[c] - mine[c]);
                let most = if d[0] > d[1] { d[0] } else { d[1] };
                let most = (if most > d[2] { most } else { d[2] }) + 2.0 * (error + other_error);
                least = if most < least { most } else { least };
            }
            if members.len == CELLS {
                return false;
            }
            members.put(members.len, all.seed[a], mine, error);
            members.reach2[members.len] = all.reach2[a];
            members.len += usize::from(least >= 0.0);
        }
        true
    }
}
