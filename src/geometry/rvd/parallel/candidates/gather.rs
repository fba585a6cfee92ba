//! The seeds whose cells may meet a facet.
//!
//! Purpose: from any seed to all that count on a facet, and on demand to those that still count when every
//! seed has moved a little.
//! Invariant: a seed that is left out is farther from all three corners than another one of the list, whatever way either
//! moves within its [`Skin`], and so farther from the whole facet, as their bisector is linear on it. A comparison that
//! rounding could get wrong keeps the seed. No later duplicate is listed. Must not know: pieces; how long a list is kept.

use std::marker::PhantomData;

use glam::DVec3;

use crate::knn::Point;
use crate::rvd::incident::{self, Diagram};
use crate::rvd::{clip::SECURITY, parallel::divide::facets::LISTED};

/// A list with more is made shorter here, not together with others.
const ENOUGH: usize = LISTED;
/// Seeds that are looked at around a facet that rows do not suffice for; one with more is walked.
const LOOKED_AT: usize = 2048;

/// How long a list may be; a facet with a longer one is walked.
#[derive(Clone, Copy)]
pub(crate) struct Few {
    /// Number of seeds before dominated ones are removed.
    seen: usize,
    /// Number of seeds after dominated ones are removed.
    kept: usize,
}

impl Few {
    /// Where rows of neighbours are at hand for the walk.
    pub(crate) const TO_DIVIDE: Self = Self { seen: 2 * LISTED, kept: LISTED };
    /// Where the walk has the list alone.
    pub(crate) const TO_WALK: Self = Self { seen: 16 * LISTED, kept: 4 * LISTED };
}

/// Among which seeds lists are made, how far those may move, and how long lists may be.
#[derive(Clone, Copy)]
pub(crate) struct Search<'a, P: Point> {
    pub diagram: Diagram<'a, P>,
    pub skin: Skin<'a>,
    pub few: Few,
}

/// Squared distances are compared with so much room, far more than their roundings.
pub(crate) const ROOM: f64 = 1.0 + 1e-14;

/// How far each seed may move before the lists are void: a share of a length, its width.
#[derive(Clone, Copy)]
pub(crate) struct Skin<'a> {
    /// The share; 0 if no seed moves.
    pub share: f64,
    /// Of each seed; unused where the share is 0.
    pub width: &'a [f64],
    /// The most skin that any has. Where that is infinite, widths of two seeds differ by no more than their distance.
    pub most: f64,
}

impl Skin<'_> {
    pub(crate) const NONE: Self = Self { share: 0.0, width: &[], most: 0.0 };

    pub(crate) fn of(&self, seed: u32) -> f64 {
        if self.share > 0.0 { self.share * self.width[seed as usize] } else { 0.0 }
    }

    pub(crate) fn is_none(&self) -> bool {
        self.share == 0.0
    }

    /// How far a seed may be that can move to within `reach` of a place which is `away` from a seed with skin `own`.
    pub(crate) fn farthest(&self, reach: f64, away: f64, own: f64) -> f64 {
        match self.most.is_finite() {
            true => reach + self.most,
            false => (reach + own + self.share * away) / (1.0 - self.share),
        }
    }
}

#[derive(Default)]
pub(crate) struct Gatherer<P> {
    of: PhantomData<P>,
    looked_at: Vec<u32>,
    kept: Vec<Kept>,
    /// Those that were gathered last; some may be beaten by others.
    pub list: Vec<u32>,
}

struct Kept {
    seed: u32,
    /// At each corner: distances that it has at least and at most, however it moves; squared ones until all are known.
    least: [f64; 3],
    most: [f64; 3],
}

/// The facet as seen from a seed.
struct View<P> {
    corner: [P; 3],
    distance: [f64; 3],
    skin: f64,
}

impl<P: Point> Gatherer<P> {
    /// Finds the seeds that count on the facet with these corners, beginning at any seed; the nearer, the sooner. Returns a
    /// seed of those that is nearer to the facet's centroid, if there is one, and whether there are few enough.
    pub(crate) fn gather(&mut self, by: Search<'_, P>, corner: &[P; 3], centroid: P, start: u32) -> (u32, bool) {
        if let Some(nearest) = self.read_row(by, corner, centroid, start) {
            return (nearest, true);
        }
        let nearest = incident::nearest(by.diagram, centroid, start);
        if nearest != start && self.read_row(by, corner, centroid, nearest).is_some() {
            return (nearest, true);
        }
        (nearest, self.look_around(by, &View::new(by, corner, nearest)))
    }

    /// The same as seen from seed `i`, whether there are nearer ones or not. Returns whether there are few enough.
    pub(crate) fn gather_from(&mut self, by: Search<'_, P>, corner: &[P; 3], i: u32) -> bool {
        self.read_row(by, corner, corner[0], i).is_some() || self.look_around(by, &View::new(by, corner, i))
    }

    /// Lists seed `i` and its row, as far as the facet needs it (\[LB12\]: no farther than twice its farthest corner).
    /// Returns the nearest to the centroid; `None` if the row ends before that.
    fn read_row(&mut self, by: Search<'_, P>, corner: &[P; 3], centroid: P, i: u32) -> Option<u32> {
        let Search { diagram, skin, .. } = by;
        let (row, complete) = diagram.table.row(i);
        let origin = diagram.seeds[i as usize];
        let squared = |a: P| a.distance_squared(origin);
        let radius2 = squared(corner[0]).max(squared(corner[1])).max(squared(corner[2]));
        let reach2 = if !skin.is_none() {
            let own = skin.of(i);
            let reach = 0.5 * skin.farthest(2.0 * radius2.sqrt() + own, 0.0, own);
            SECURITY * reach * reach
        } else {
            SECURITY * radius2
        };
        let last = diagram.seeds[*row.last()? as usize];
        // A later duplicate has the earlier one alone.
        if !complete && squared(last) <= reach2 || squared(diagram.seeds[row[0] as usize]) == 0.0 {
            return None;
        }
        let (mut nearest, mut least) = (i, centroid.distance_squared(origin));
        self.list.clear();
        self.list.push(i);
        for &j in row {
            let p = diagram.seeds[j as usize];
            if squared(p) > reach2 {
                break;
            }
            self.list.push(j);
            let distance = centroid.distance_squared(p);
            if distance < least {
                (nearest, least) = (j, distance);
            }
        }
        Some(nearest)
    }

    /// Lists all seeds around the facet that may be nearer at some corner than the view's. Returns whether they are few enough.
    fn look_around(&mut self, by: Search<'_, P>, view: &View<P>) -> bool {
        let Search { diagram, skin, few } = by;
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        for (corner, distance) in view.corner.iter().zip(view.distance) {
            let reach = skin.farthest(distance + view.skin, distance, view.skin) * (1.0 + 1e-9);
            (low, high) = (low.min(corner.place() - reach), high.max(corner.place() + reach));
        }
        self.list.clear();
        self.looked_at.clear();
        self.kept.clear();
        if !diagram.index.in_box(low, high, LOOKED_AT, &mut self.looked_at) {
            return false;
        }
        for &seed in &self.looked_at {
            let p = diagram.seeds[seed as usize];
            let [a, b, c] = [0, 1, 2].map(|c| view.corner[c].distance_squared(p));
            let own = view.skin + skin.of(seed);
            let [x, y, z] = [0, 1, 2].map(|c| (view.distance[c] + own) * (view.distance[c] + own) * ROOM);
            if (a <= x) | (b <= y) | (c <= z) {
                if self.kept.len() == few.seen {
                    return false;
                }
                self.kept.push(Kept { seed, least: [a, b, c], most: [a, b, c] });
            }
        }
        if self.kept.len() > ENOUGH {
            self.prune(skin);
        }
        self.list.extend(self.kept.iter().map(|kept| kept.seed));
        // The view's own seed is among them, if rounding did not put it beyond the box.
        !self.list.is_empty() && self.list.len() <= few.kept
    }

    /// Leaves out the seeds that another one beats at all corners.
    fn prune(&mut self, skin: Skin<'_>) {
        for kept in &mut self.kept {
            let own = skin.of(kept.seed);
            kept.least = kept.least.map(|squared| squared.sqrt() - own);
            kept.most = kept.most.map(|squared| (squared.sqrt() + own) * ROOM);
        }
        // The nearest ones beat most of the others, so that they are asked first.
        let key = |kept: &Kept| kept.most[0] + kept.most[1] + kept.most[2];
        self.kept.sort_unstable_by(|a, b| key(a).total_cmp(&key(b)).then(a.seed.cmp(&b.seed)));
        let mut left: Vec<Kept> = Vec::with_capacity(self.kept.len());
        for kept in self.kept.drain(..) {
            if !left.iter().any(|by| (0..3).all(|c| by.most[c] < kept.least[c])) {
                left.push(kept);
            }
        }
        self.kept = left;
    }
}

impl<P: Point> View<P> {
    fn new(by: Search<'_, P>, corner: &[P; 3], seed: u32) -> Self {
        let origin = by.diagram.seeds[seed as usize];
        let distance = corner.map(|p| p.distance(origin));
        Self { corner: *corner, distance, skin: by.skin.of(seed) }
    }
}
