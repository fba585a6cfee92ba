//! The envelope of the curves: how far the result's edges may leave them.
//!
//! Purpose: the chords of a curve are chosen to stay close to it. Later moves of their ends, for a smaller mean distance or a
//! better facet, must not undo that. [`CurveEnvelope`] knows the points of the curve beside each of its vertices, and how far
//! the edges there may be from them. It admits moves, takes back those that went too far, and moves ends of chords that are too
//! far from the curve even so ([`CurveEnvelope::tighten`]).
//! Invariant: a chord that was farther than the limit may stay as far as it was. A corner moves on a boundary alone. Where a
//! curve is straight, its edges stay on it.
//! Must not know: why else vertices move.

use glam::DVec3;

use crate::mesh::csr::Csr;
use crate::remesh::triangle::{score, unit_normal};
use crate::token::Token;

/// Shares of its move by which a vertex that went too far goes back.
const BACKTRACKING: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// A facet's normal keeps this cosine to that before a move.
const LEAST_COSINE: f64 = 0.8;
/// Passes over these vertices, at most.
const RESTORING_PASSES: usize = 3;

/// Passes over vertices whose edges are too far from their curves, at most.
const TIGHTENING_PASSES: usize = 8;
/// Steps that are tried there, as shares of the shortest edge of a curve at the vertex.
const STEPS: [f64; 4] = [0.1, 0.05, 0.025, 0.0125];
/// A vertex moves no farther than this share of that edge in all,
const FARTHEST: f64 = 0.25;
/// and a corner no farther than this one.
const FARTHEST_OF_CORNER: f64 = 0.12;
/// Facets keep this score, degrees, or what they had.
const LEAST_SCORE: f64 = 34.0;

/// A curve is straight at an edge if it leaves the edge's line by no more than this share of the edge. A curved one is off its
/// chords anyway; a straight one, such as the edge of a plate, shows any dent.
const STRAIGHTNESS: f64 = 1e-3;
/// So many edges to either side have to be straight as well.
const STRAIGHT_EDGES: usize = 3;

/// A point of an input curve.
#[derive(Clone, Copy, Debug)]
pub(in crate::remesh) struct CurveSample {
    /// Unit frame.
    pub(in crate::remesh) position: DVec3,
    /// The result's edge for its segment of the curve.
    pub(in crate::remesh) edge: [u32; 2],
    /// Area it stands for: its share of the curve's length times the length of the edge.
    pub(in crate::remesh) area: f64,
    /// How far the edge may be from the curve.
    pub(in crate::remesh) limit: f64,
}

/// An edge of a curve, seen from one of its ends.
#[derive(Clone, Copy)]
struct Chord {
    /// The other end.
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

/// See the module's head.
pub(in crate::remesh) struct CurveEnvelope {
    points: Vec<DVec3>,
    /// By vertex.
    chords: Csr<Chord>,
    /// Where the vertices were at first.
    start: Vec<DVec3>,
}

/// Distance of `p` from a segment.
fn distance(p: DVec3, [a, b]: [DVec3; 2]) -> f64 {
    let along = b - a;
    let squared = along.length_squared();
    let t = if squared > 0.0 { ((p - a).dot(along) / squared).clamp(0.0, 1.0) } else { 0.0 };
    p.distance(a + t * along)
}

/// Whether an edge of vertex `v` has one facet. `ring` are the facets around it.
fn on_boundary(ring: &[u32], facets: &[[u32; 3]], v: u32) -> bool {
    let mut others: Vec<u32> = ring.iter().flat_map(|&f| facets[f as usize]).filter(|&u| u != v).collect();
    others.sort_unstable();
    others.chunk_by(|a, b| a == b).any(|same| same.len() == 1)
}

/// Directions to the faces, edges and corners of a cube.
fn directions() -> impl Iterator<Item = DVec3> {
    let of = |k: i32| DVec3::new(f64::from(k % 3 - 1), f64::from(k / 3 % 3 - 1), f64::from(k / 9 - 1));
    (0..27).filter(|k| *k != 13).map(move |k| of(k).normalize())
}

impl CurveEnvelope {
    /// For edges of curves with their ends at `start`; corners are `fixed`. Samples of one edge follow each other.
    pub(in crate::remesh) fn new(start: &[DVec3], fixed: &[bool], samples: &[CurveSample]) -> Self {
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
        let of = |v: u32| own.chords(v).iter().map(move |chord| (v, own.is_straight(v, chord, fixed)));
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
        let holds = |v: u32, chord: &Chord| {
            let between = &self.points[chord.points[0] as usize..chord.points[1] as usize];
            is_near(self.start[v as usize]) && between.iter().all(|&p| is_near(p))
        };
        // As far as the curve goes on without a corner.
        let goes_on = |mut from: u32, mut to: u32| {
            for _ in 0..STRAIGHT_EDGES {
                let next = match self.chords(to) {
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

    fn chords(&self, v: u32) -> &[Chord] {
        self.chords.of(v)
    }

    /// How far the edges of vertex `v` are from their curves with it at `p`, as a multiple of their limits.
    fn violation(&self, positions: &[DVec3], v: u32, p: DVec3) -> f64 {
        let of = |chord: &Chord| {
            if chord.straight {
                // It may slide along the line.
                let origin = self.start[v as usize];
                let way = (self.start[chord.other as usize] - origin).normalize_or_zero();
                return (p - origin).reject_from_normalized(way).length() / chord.limit;
            }
            let ends = [p, positions[chord.other as usize]];
            let between = &self.points[chord.points[0] as usize..chord.points[1] as usize];
            let farthest = between.iter().map(|&q| distance(q, ends)).fold(0.0, f64::max);
            // The ends of the chord at first: they may slide along the curve no farther than the limit.
            let own = distance(self.start[v as usize], ends).min(p.distance(self.start[v as usize]));
            let other = distance(self.start[chord.other as usize], ends);
            farthest.max(own).max(other.min(positions[chord.other as usize].distance(self.start[chord.other as usize])))
                / chord.limit
        };
        self.chords(v).iter().map(of).fold(0.0, f64::max)
    }

    /// How far the edges of vertex `v` and the curve are apart with it at `p`, in both directions, as a multiple of the goal.
    fn excess(&self, positions: &[DVec3], v: u32, p: DVec3) -> f64 {
        let (chords, start) = (self.chords(v), self.start[v as usize]);
        let goal = chords.iter().map(|chord| chord.goal).fold(f64::INFINITY, f64::min);
        // The vertex has to be near the curve, and its first place near one of the edges.
        let cut = |chord: &Chord| distance(start, [p, positions[chord.other as usize]]) / goal;
        let beside = |chord: &Chord| {
            let between = &self.points[chord.points[0] as usize..chord.points[1] as usize];
            let ends = [between[0], between[between.len() - 1]];
            let next = if start.distance(ends[0]) < start.distance(ends[1]) { ends[0] } else { ends[1] };
            between.windows(2).map(|w| distance(p, [w[0], w[1]])).fold(distance(p, [start, next]), f64::min) / goal
        };
        let at = |u: u32| if u == v { p } else { positions[u as usize] };
        // A sharp bend of the curve may be nearer to the next edge than to its own.
        let near = |q: DVec3, other: u32| {
            let chords = |u: u32| self.chords(u).iter().map(move |s| distance(q, [at(u), at(s.other)]));
            chords(v).chain(chords(other)).fold(f64::INFINITY, f64::min)
        };
        let edges = chords.iter().map(|chord| {
            let between = &self.points[chord.points[0] as usize..chord.points[1] as usize];
            let cut = near(self.start[chord.other as usize], chord.other);
            between.iter().map(|&q| near(q, chord.other)).fold(cut, f64::max) / chord.goal
        });
        let own = chords.iter().map(cut).fold(f64::INFINITY, f64::min);
        let astray = chords.iter().map(beside).fold(f64::INFINITY, f64::min);
        edges.fold(own.max(astray), f64::max)
    }

    /// Moves vertices whose edges are farther from their curves than the goal a little, to where they are nearer. Corners move
    /// less, and only on boundaries, whose teeth may be narrower than an edge is long. Returns the corners that moved.
    pub(in crate::remesh) fn tighten(
        &self,
        positions: &mut [DVec3],
        facets: &[[u32; 3]],
        fixed: &[bool],
        token: &Token,
    ) -> Vec<u32> {
        let vertices: Vec<u32> = (0..self.start.len() as u32).filter(|&v| !self.chords(v).is_empty()).collect();
        let excess = |positions: &[DVec3], v: u32| self.excess(positions, v, positions[v as usize]);
        if vertices.iter().all(|&v| excess(positions, v) <= 1.0) {
            return Vec::new();
        }
        let rings = Csr::one_rings(positions.len(), facets);
        let first = positions.to_vec();
        let spoils = |positions: &[DVec3], v: u32, p: DVec3| {
            rings.of(v).iter().map(|&f| &facets[f as usize]).any(|t| {
                let (before, now) = (t.map(|u| first[u as usize]), t.map(|u| positions[u as usize]));
                let after = t.map(|u| if u == v { p } else { positions[u as usize] });
                unit_normal(before).dot(unit_normal(after)) < LEAST_COSINE
                    || score(after) < LEAST_SCORE.min(score(now)).min(score(before))
            })
        };
        let mut moved = Vec::new();
        for _ in 0..TIGHTENING_PASSES {
            let mut any = false;
            for &v in &vertices {
                if token.is_stopped() {
                    return moved;
                }
                let here = positions[v as usize];
                let mut best = (self.excess(positions, v, here), here);
                if best.0 <= 1.0 || fixed[v as usize] && !on_boundary(rings.of(v), facets, v) {
                    continue;
                }
                let chords = self.chords(v).iter();
                let edge = chords.map(|s| here.distance(positions[s.other as usize])).fold(f64::INFINITY, f64::min);
                let reach = edge * if fixed[v as usize] { FARTHEST_OF_CORNER } else { FARTHEST };
                for (step, direction) in STEPS.iter().flat_map(|&s| directions().map(move |d| (s, d))) {
                    let p = here + step * edge * direction;
                    let excess = self.excess(positions, v, p);
                    if excess < best.0 && p.distance(first[v as usize]) <= reach && !spoils(positions, v, p) {
                        best = (excess, p);
                    }
                }
                if best.1 != here {
                    any = true;
                    positions[v as usize] = best.1;
                    moved.extend(fixed[v as usize].then_some(v));
                }
            }
            if !any {
                break;
            }
        }
        moved.sort_unstable();
        moved.dedup();
        moved
    }

    /// Whether vertex `v` may go to `p`: its edges stay within their limits, or come nearer to them.
    pub(in crate::remesh) fn admits(&self, positions: &[DVec3], v: u32, p: DVec3) -> bool {
        if self.chords(v).is_empty() {
            return true;
        }
        let then = self.violation(positions, v, p);
        then <= 1.0 || then < self.violation(positions, v, positions[v as usize])
    }

    /// Takes vertices that went too far back towards where they were, as long as no facet turns by it.
    pub(in crate::remesh) fn restore(&self, positions: &mut [DVec3], facets: &[[u32; 3]], token: &Token) {
        let rings = Csr::one_rings(positions.len(), facets);
        let turns = |positions: &[DVec3], v: u32, p: DVec3| {
            rings.of(v).iter().map(|&f| &facets[f as usize]).any(|t| {
                let before = unit_normal(t.map(|u| positions[u as usize]));
                let after = unit_normal(t.map(|u| if u == v { p } else { positions[u as usize] }));
                before.dot(after) < LEAST_COSINE
            })
        };
        for _ in 0..RESTORING_PASSES {
            let mut moved = false;
            for v in 0..self.start.len() as u32 {
                if self.chords(v).is_empty() {
                    continue;
                }
                if token.is_stopped() {
                    return;
                }
                let here = positions[v as usize];
                let mut best = (self.violation(positions, v, here), here);
                for t in BACKTRACKING {
                    if best.0 <= 1.0 {
                        break;
                    }
                    let p = here.lerp(self.start[v as usize], t);
                    let violation = self.violation(positions, v, p);
                    if violation < best.0 && !turns(positions, v, p) {
                        best = (violation, p);
                    }
                }
                moved |= best.1 != here;
                positions[v as usize] = best.1;
            }
            if !moved {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vertex_that_leaves_its_curve_goes_back_as_far_as_it_must() {
        let start = [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X, DVec3::Y];
        let sample = |edge: [u32; 2], position: DVec3| CurveSample { position, edge, area: 0.1, limit: 0.1 };
        // Not quite straight.
        let samples = [sample([0, 1], 0.5 * DVec3::X), sample([1, 2], DVec3::new(1.5, 0.004, 0.0))];
        let envelope = CurveEnvelope::new(&start, &[false; 4], &samples);
        let mut moved = start;
        moved[1] += DVec3::new(0.1, 0.3, 0.0);
        moved[3] *= 5.0;
        assert!(envelope.admits(&start, 3, 9.0 * DVec3::Y), "a vertex of no curve may go anywhere");
        assert!(!envelope.admits(&start, 1, moved[1]) && envelope.admits(&start, 1, DVec3::new(1.05, 0.05, 0.0)));
        envelope.restore(&mut moved, &[], &Token::default());
        // Back by three quarters of its way, one of the steps.
        assert!(moved[1].distance(DVec3::new(1.025, 0.075, 0.0)) < 1e-12, "{}", moved[1]);
        assert_eq!(moved[3], 5.0 * DVec3::Y);
    }

    /// Nobody leaves a line where the curve is one, but may slide along it; a bend nearby leaves room, a corner does not.
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

    /// A tooth of a curve beside its edge: ends of the edge come nearer to it, corners of a boundary a little, others not
    /// at all.
    #[test]
    fn ends_of_an_edge_that_is_too_far_from_its_curve_move_a_little() {
        let start = [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X, DVec3::new(1.0, 1.2, 0.0), DVec3::new(1.0, -1.2, 0.0)];
        let sample = |edge: [u32; 2], x: f64, y: f64| {
            let position = DVec3::new(x, y, 0.0);
            CurveSample { position, edge, area: 0.1, limit: 0.02 }
        };
        let envelope = CurveEnvelope::new(&start, &[false; 5], &[sample([0, 1], 0.6, -0.06), sample([1, 2], 1.5, 0.0)]);
        let tooth = |at: &[DVec3; 5]| distance(DVec3::new(0.6, -0.06, 0.0), [at[0], at[1]]);
        let (open, closed) = ([[0, 1, 3], [1, 2, 3]], [[0, 1, 3], [1, 2, 3], [1, 0, 4], [2, 1, 4]]);
        let mut free = start;
        assert!(envelope.tighten(&mut free, &open, &[false; 5], &Token::default()).is_empty());
        assert!(tooth(&free) < 0.7 * tooth(&start), "{free:?}");
        let mut corners = start;
        let moved = envelope.tighten(&mut corners, &open, &[true; 5], &Token::default());
        assert!(!moved.is_empty() && tooth(&corners) < 0.9 * tooth(&start), "{corners:?}");
        // Of the edge as it is by then, a little longer.
        assert!((0..5).all(|v| corners[v].distance(start[v]) <= FARTHEST_OF_CORNER * 1.1), "{corners:?}");
        let mut inside = start;
        assert!(!envelope.tighten(&mut inside, &closed, &[true; 5], &Token::default()).contains(&1));
        assert_eq!(inside[1], start[1]);
    }
}
