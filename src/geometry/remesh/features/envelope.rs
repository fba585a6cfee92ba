//! The envelope of the curves: how far the result's edges may leave them.
//!
//! Purpose: the chords of a curve are chosen to stay close to it. Later moves of their ends, for a smaller mean distance or a
//! better facet, must not undo that. [`CurveEnvelope`] knows the points of the curve beside each of its vertices, and how far
//! the edges there may be from them. It measures how far they are with a vertex at some place.
//! Invariant: a chord beyond the limit may stay as far. A corner moves on a boundary alone. Edges of a straight curve stay.
//! Must not know: why else vertices move.

use glam::DVec3;

use crate::mesh::closest_point::distance_to_segment as distance;
use crate::mesh::csr::Csr;
use crate::remesh::constants::{STRAIGHT_EDGES, STRAIGHTNESS};

#[derive(Clone, Copy, Debug)]
pub(crate) struct CurveSample {
    /// Unit frame.
    pub(crate) position: DVec3,
    /// The result's edge for its segment of the curve.
    pub(crate) edge: [u32; 2],
    /// Area it stands for: its share of the curve's length times the length of the edge.
    pub(crate) area: f64,
    /// How far the edge may be from the curve.
    pub(crate) limit: f64,
}

/// An edge of a curve, seen from one of its ends.
#[derive(Clone, Copy)]
struct Chord {
    other: u32,
    /// The curve's points between the ends: where they begin and end in the envelope's points.
    points: [u32; 2],
    /// How far the edge may be from them.
    limit: f64,
    /// The limit, if the edge had not been farther away already.
    goal: f64,
    /// Whether the curve is straight here and beside it.
    straight: bool,
}

pub(crate) struct CurveEnvelope {
    points: Vec<DVec3>,
    /// By vertex.
    chords: Csr<Chord>,
    /// Where the vertices were at first.
    pub(crate) start: Vec<DVec3>,
}

impl CurveEnvelope {
    /// For edges of curves with their ends at `start`; corners are `fixed`. Samples of one edge follow each other.
    pub(crate) fn new(start: &[DVec3], fixed: &[bool], samples: &[CurveSample]) -> Self {
        let points: Vec<DVec3> = samples.iter().map(|s| s.position).collect();
        let mut edges: Vec<([u32; 2], Chord)> = Vec::new();
        let mut from = 0;
        for same in samples.chunk_by(|a, b| a.edge == b.edge) {
            let range = [from, from + same.len() as u32];
            from = range[1];
            let ends = same[0].edge.map(|v| start[v as usize]);
            let own = same.iter().map(|s| distance(s.position, ends)).fold(0.0, f64::max);
            let goal = same[0].limit;
            let [a, b] = same[0].edge;
            let chord = |other| Chord { other, points: range, limit: own.max(goal), goal, straight: false };
            edges.extend([([a, b], chord(b)), ([b, a], chord(a))]);
        }
        edges.sort_by_key(|e| e.0);
        let chords: Vec<(u32, Chord)> = edges.into_iter().map(|([v, _], chord)| (v, chord)).collect();
        let mut envelope = Self { points, chords: Csr::from_pairs(start.len(), &chords), start: start.to_vec() };
        envelope.hold_straight(fixed);
        envelope
    }

    /// Finds where curves are straight, and lowers the limits there.
    fn hold_straight(&mut self, fixed: &[bool]) {
        let own = &*self;
        let of = |v: u32| own.chords.of(v).iter().map(move |chord| (v, own.is_straight(v, chord, fixed)));
        let straight: Vec<(u32, bool)> = (0..self.start.len() as u32).flat_map(of).collect();
        for (chord, (v, straight)) in self.chords.all_mut().iter_mut().zip(straight) {
            chord.straight = straight;
            if straight {
                chord.limit = STRAIGHTNESS * self.start[v as usize].distance(self.start[chord.other as usize]);
            }
        }
    }

    /// Whether the curve is straight along one of the chords of vertex `v` and beside it.
    fn is_straight(&self, v: u32, chord: &Chord, fixed: &[bool]) -> bool {
        let (origin, way) = (self.start[v as usize], self.start[chord.other as usize] - self.start[v as usize]);
        let most = STRAIGHTNESS * way.length();
        let Some(way) = way.try_normalize() else { return false };
        let is_near = |p: DVec3| (p - origin).reject_from_normalized(way).length() <= most;
        let holds =
            |v: u32, chord: &Chord| is_near(self.start[v as usize]) && self.between(chord).iter().all(|&p| is_near(p));
        // As far as the curve goes on without a corner.
        let goes_on = |mut from: u32, mut to: u32| {
            for _ in 0..STRAIGHT_EDGES {
                let next = match self.chords.of(to) {
                    _ if fixed[to as usize] => return true,
                    [a, b] if a.other == from => b,
                    [a, b] if b.other == from => a,
                    _ => return true,
                };
                if !holds(next.other, next) {
                    return false;
                }
                (from, to) = (to, next.other);
            }
            true
        };
        holds(v, chord) && goes_on(v, chord.other) && goes_on(chord.other, v)
    }

    /// The curve's points between the ends of a chord.
    fn between(&self, chord: &Chord) -> &[DVec3] {
        &self.points[chord.points[0] as usize..chord.points[1] as usize]
    }

    pub(crate) fn vertices(&self) -> Vec<u32> {
        (0..self.start.len() as u32).filter(|&v| !self.chords.of(v).is_empty()).collect()
    }

    /// The shortest edge of a curve at a vertex.
    pub(crate) fn shortest_edge(&self, positions: &[DVec3], v: u32) -> f64 {
        let lengths = self.chords.of(v).iter().map(|s| positions[v as usize].distance(positions[s.other as usize]));
        lengths.fold(f64::INFINITY, f64::min)
    }

    /// How far the edges of vertex `v` are from their curves with it at `p`, as a multiple of their limits.
    pub(crate) fn violation(&self, positions: &[DVec3], v: u32, p: DVec3) -> f64 {
        let of = |chord: &Chord| {
            if chord.straight {
                // It may slide along the line.
                let origin = self.start[v as usize];
                let way = (self.start[chord.other as usize] - origin).normalize_or_zero();
                return (p - origin).reject_from_normalized(way).length() / chord.limit;
            }
            let ends = [p, positions[chord.other as usize]];
            let farthest = self.between(chord).iter().map(|&q| distance(q, ends)).fold(0.0, f64::max);
            // The ends of the chord at first: they may slide along the curve no farther than the limit.
            let own = distance(self.start[v as usize], ends).min(p.distance(self.start[v as usize]));
            let other = distance(self.start[chord.other as usize], ends);
            farthest.max(own).max(other.min(positions[chord.other as usize].distance(self.start[chord.other as usize])))
                / chord.limit
        };
        self.chords.of(v).iter().map(of).fold(0.0, f64::max)
    }

    /// How far the edges of vertex `v` and the curve are apart with it at `p`, in both directions, as a multiple of the goal.
    pub(crate) fn excess(&self, positions: &[DVec3], v: u32, p: DVec3) -> f64 {
        let (chords, start) = (self.chords.of(v), self.start[v as usize]);
        let goal = chords.iter().map(|chord| chord.goal).fold(f64::INFINITY, f64::min);
        // The vertex has to be near the curve, and its first place near one of the edges.
        let cut = |chord: &Chord| distance(start, [p, positions[chord.other as usize]]) / goal;
        let beside = |chord: &Chord| {
            let between = self.between(chord);
            let ends = [between[0], between[between.len() - 1]];
            let next = if start.distance(ends[0]) < start.distance(ends[1]) { ends[0] } else { ends[1] };
            between.windows(2).map(|w| distance(p, [w[0], w[1]])).fold(distance(p, [start, next]), f64::min) / goal
        };
        let at = |u: u32| if u == v { p } else { positions[u as usize] };
        // A sharp bend of the curve may be nearer to the next edge than to its own.
        let near = |q: DVec3, other: u32| {
            let chords = |u: u32| self.chords.of(u).iter().map(move |s| distance(q, [at(u), at(s.other)]));
            chords(v).chain(chords(other)).fold(f64::INFINITY, f64::min)
        };
        let edges = chords.iter().map(|chord| {
            let cut = near(self.start[chord.other as usize], chord.other);
            self.between(chord).iter().map(|&q| near(q, chord.other)).fold(cut, f64::max) / chord.goal
        });
        let own = chords.iter().map(cut).fold(f64::INFINITY, f64::min);
        let astray = chords.iter().map(beside).fold(f64::INFINITY, f64::min);
        edges.fold(own.max(astray), f64::max)
    }

    /// Whether vertex `v` may go to `p`: its edges stay within their limits, or come nearer to them.
    pub(crate) fn admits(&self, positions: &[DVec3], v: u32, p: DVec3) -> bool {
        if self.chords.of(v).is_empty() {
            return true;
        }
        let then = self.violation(positions, v, p);
        then <= 1.0 || then < self.violation(positions, v, positions[v as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vertex_of_a_curve_stays_near_it() {
        let start = [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X, DVec3::Y];
        let sample = |edge: [u32; 2], position: DVec3| CurveSample { position, edge, area: 0.1, limit: 0.1 };
        // Not quite straight.
        let samples = [sample([0, 1], 0.5 * DVec3::X), sample([1, 2], DVec3::new(1.5, 0.004, 0.0))];
        let envelope = CurveEnvelope::new(&start, &[false; 4], &samples);
        let mut moved = start;
        moved[1] += DVec3::new(0.1, 0.3, 0.0);
        assert!(envelope.admits(&start, 3, 9.0 * DVec3::Y), "a vertex of no curve may go anywhere");
        assert!(!envelope.admits(&start, 1, moved[1]) && envelope.admits(&start, 1, DVec3::new(1.05, 0.05, 0.0)));
    }

    /// No vertex leaves a line where the curve is one, but may slide along it; a bend nearby leaves room, a corner does not.
    #[test]
    fn straight_curves_stay_straight() {
        let ends = |bend: f64| -> Vec<DVec3> {
            (0..9).map(|k| DVec3::new(f64::from(k), if k == 8 { bend } else { 0.0 }, 0.0)).collect()
        };
        let samples = |at: &[DVec3]| -> Vec<CurveSample> {
            let of = |k: u32| {
                let edge = [k, k + 1];
                let position = edge.map(|v| at[v as usize]).iter().sum::<DVec3>() * 0.5;
                CurveSample { position, edge, area: 0.1, limit: 0.08 }
            };
            (0..8).map(of).collect()
        };
        let step = |k: u32, x: f64, y: f64| DVec3::new(f64::from(k) + x, y, 0.0);
        let straight = ends(0.0);
        let envelope = CurveEnvelope::new(&straight, &[false; 9], &samples(&straight));
        for k in 1..8 {
            assert!(!envelope.admits(&straight, k, step(k, 0.0, 0.05)), "{k}");
            assert!(envelope.admits(&straight, k, step(k, 0.3, 0.0005)), "{k}");
        }
        let bent = ends(0.5);
        let envelope = CurveEnvelope::new(&bent, &[false; 9], &samples(&bent));
        let allowed: Vec<bool> = (1..8).map(|k| envelope.admits(&bent, k, step(k, 0.0, 0.05))).collect();
        assert_eq!(allowed, [false, false, false, false, true, true, true]);
        let mut corner = [false; 9];
        corner[7] = true;
        let envelope = CurveEnvelope::new(&bent, &corner, &samples(&bent));
        assert!((1..7).all(|k| !envelope.admits(&bent, k, step(k, 0.0, 0.05))));
    }
}
