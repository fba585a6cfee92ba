//! The seeds whose cells may meet a facet.
//!
//! Purpose: from any seed to all that count on a facet, and on demand to those that still count when every
//! seed has moved a little.
//! Invariant: a seed that is left out is farther from all three corners than another one of the list, whatever
//! way either moves within its [`Slack`], and so farther from the whole facet, as their bisector is linear
//! on it. A comparison that rounding could get wrong keeps the seed.
//! Must not know: pieces; how long a list is kept.

use glam::DVec3;

use crate::rvd::clip::SECURITY;
use crate::rvd::incident::Diagram;
use crate::rvd::start;

/// Seeds that a list may have; a facet with more is walked.
pub(super) const KEPT: usize = 64;
/// Seeds that are looked at around a facet that rows do not suffice for; one with more is walked.
const LOOKED_AT: usize = 1024;
/// Squared distances are compared with so much room, far more than their roundings.
const ROOM: f64 = 1.0 + 1e-14;

/// How far each seed may move before the lists are void.
#[derive(Clone, Copy)]
pub(super) struct Slack<'a> {
    /// By this share of its width; 0 for lists that serve the present place alone.
    pub share: f64,
    /// A length at each seed that differs between two of them by no more than their distance; unused where the share
    /// is 0.
    pub width: &'a [f64],
}

impl Slack<'_> {
    fn of(&self, seed: u32) -> f64 {
        if self.share > 0.0 { self.share * self.width[seed as usize] } else { 0.0 }
    }
}

/// One thread's scratch memory.
pub(super) struct Gatherer {
    len: usize,
    seed: [u32; KEPT],
    /// Squared distance to each corner.
    squared: [[f64; KEPT]; 3],
    looked_at: Vec<u32>,
    list: Vec<u32>,
}

impl Default for Gatherer {
    fn default() -> Self {
        Self { len: 0, seed: [0; KEPT], squared: [[0.0; KEPT]; 3], looked_at: Vec::new(), list: Vec::new() }
    }
}

/// The facet as seen from a seed.
struct View {
    seed: u32,
    origin: DVec3,
    corner: [DVec3; 3],
    /// From the seed to each corner, and to the farthest.
    distance: [f64; 3],
    radius: f64,
    slack: f64,
}

/// How a row was read.
enum Row {
    /// As far as the facet needs.
    Closed,
    /// To its end, which is at this squared distance.
    Ended(f64),
    /// Until there was no room.
    Full,
}

impl Gatherer {
    /// Those that were gathered last, in the order of their numbers.
    pub(super) fn list(&self) -> &[u32] {
        &self.list
    }

    /// Finds the seeds that count on the facet with these corners, beginning at any seed; the nearer, the
    /// sooner. Returns the one nearest to the facet's centroid, as far as was seen; `None` if there are too many.
    pub(super) fn gather(
        &mut self,
        diagram: Diagram<'_>,
        slack: Slack<'_>,
        corner: &[DVec3; 3],
        centroid: DVec3,
        start: u32,
    ) -> Option<u32> {
        let (mut seed, mut proved) = (start, false);
        loop {
            let view = View::new(diagram, slack, corner, seed);
            let row = self.compare(diagram, slack, &view);
            let best = self.nearest();
            if best != seed {
                seed = best;
                continue;
            }
            match row {
                Row::Closed => {}
                // A row that ends early may not hold the nearest one either.
                Row::Ended(reach2) if !proved && SECURITY * centroid.distance_squared(view.origin) > reach2 => {
                    (seed, proved) = (start::nearest(diagram, centroid, seed), true);
                    continue;
                }
                Row::Ended(_) | Row::Full => {
                    if !self.look_around(diagram, slack, &view) {
                        return None;
                    }
                    seed = self.nearest();
                }
            }
            self.choose(slack);
            return Some(seed);
        }
    }

    /// The seed nearest to the centroid of those kept, the lowest of several: the sum over the corners says it.
    fn nearest(&self) -> u32 {
        let key = |k: usize| (self.squared[0][k] + self.squared[1][k] + self.squared[2][k], self.seed[k]);
        let mut best = key(0);
        for k in 1..self.len {
            let new = key(k);
            if new.0 < best.0 || (new.0 == best.0 && new.1 < best.1) {
                best = new;
            }
        }
        best.1
    }

    /// Keeps of the row of the view's seed what may be nearer at some corner, up to the security radius of the
    /// whole facet (\[LB12\]).
    fn compare(&mut self, diagram: Diagram<'_>, slack: Slack<'_>, view: &View) -> Row {
        // For those beyond, with a slack of at most the share of what their width can be there.
        let reach = if slack.share > 0.0 {
            2.0 * (view.radius + view.slack) / (1.0 - slack.share)
        } else {
            2.0 * view.radius
        };
        let reach2 = 0.25 * SECURITY * reach * reach;
        let within = view.within();
        self.len = 0;
        self.consider(diagram, slack, view, &within, view.seed);
        let (row, complete) = diagram.table.row(view.seed);
        let mut b2 = 0.0;
        for &j in row {
            b2 = diagram.seeds[j as usize].distance_squared(view.origin);
            if b2 > reach2 {
                return Row::Closed;
            }
            if self.len == KEPT {
                return Row::Full;
            }
            self.consider(diagram, slack, view, &within, j);
        }
        if complete { Row::Closed } else { Row::Ended(b2) }
    }

    /// Keeps of all seeds around the facet what may be nearer at some corner than the view's seed. Returns whether
    /// there are few enough.
    fn look_around(&mut self, diagram: Diagram<'_>, slack: Slack<'_>, view: &View) -> bool {
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        for (corner, distance) in view.corner.iter().zip(view.distance) {
            let reach = (distance * (1.0 + slack.share) + 2.0 * view.slack) / (1.0 - slack.share) * (1.0 + 1e-9);
            (low, high) = (low.min(*corner - reach), high.max(*corner + reach));
        }
        let mut around = std::mem::take(&mut self.looked_at);
        around.clear();
        let mut few = diagram.index.in_box(low, high, LOOKED_AT, &mut around);
        let within = view.within();
        self.len = 0;
        for &j in &around {
            if self.len == KEPT {
                few = false;
                break;
            }
            self.consider(diagram, slack, view, &within, j);
        }
        self.looked_at = around;
        // The view's own seed is there, if not a place on the box's rim that rounding moved.
        few && self.len > 0
    }

    /// Writes down a seed that may be nearer than the view's at some corner; of others nothing stays. There
    /// must be room.
    #[inline(always)]
    fn consider(&mut self, diagram: Diagram<'_>, slack: Slack<'_>, view: &View, within: &[f64; 3], j: u32) {
        let p = diagram.seeds[j as usize];
        let squared = view.corner.map(|corner| corner.distance_squared(p));
        let near = if slack.share > 0.0 {
            let own = slack.of(j);
            (0..3).any(|c| {
                let within = view.distance[c] + view.slack + own;
                squared[c] <= within * within * ROOM
            })
        } else {
            // All three, not one after the other: no branch to guess.
            (squared[0] <= within[0]) | (squared[1] <= within[1]) | (squared[2] <= within[2])
        };
        self.seed[self.len] = j;
        for (list, value) in self.squared.iter_mut().zip(squared) {
            list[self.len] = value;
        }
        self.len += usize::from(near);
    }

    /// Lists those kept, in order, and with slack only those that no other one beats at all corners.
    fn choose(&mut self, slack: Slack<'_>) {
        self.list.clear();
        if slack.share > 0.0 && self.len > 1 {
            let mut least = [[0.0; KEPT]; 3];
            for k in 0..self.len {
                let own = slack.of(self.seed[k]);
                for c in 0..3 {
                    let distance = self.squared[c][k].sqrt();
                    (least[c][k], self.squared[c][k]) = (distance - own, (distance + own) * ROOM);
                }
            }
            let most = &self.squared;
            for (k, &seed) in self.seed[..self.len].iter().enumerate() {
                let beaten = (0..self.len).any(|by| (0..3).all(|c| most[c][by] < least[c][k]));
                if !beaten {
                    self.list.push(seed);
                }
            }
        } else {
            self.list.extend_from_slice(&self.seed[..self.len]);
        }
        self.list.sort_unstable();
    }
}

impl View {
    fn new(diagram: Diagram<'_>, slack: Slack<'_>, corner: &[DVec3; 3], seed: u32) -> Self {
        let origin = diagram.seeds[seed as usize];
        let distance = corner.map(|p| p.distance(origin));
        let radius = distance[0].max(distance[1]).max(distance[2]);
        Self { seed, origin, corner: *corner, distance, radius, slack: slack.of(seed) }
    }

    /// A seed that is nearer at a corner is within these squared distances of it.
    fn within(&self) -> [f64; 3] {
        self.distance.map(|d| d * d * ROOM)
    }
}
