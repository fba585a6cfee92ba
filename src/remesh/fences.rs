//! How far edges of curves may be from their curves.
//!
//! Purpose: the chords of a curve are chosen to stay close to it, and what moves their ends afterwards, for the
//! sake of the mean or of a facet's shape, is not to undo that. [`Fences`] knows for every vertex of a curve the
//! points of the curve beside it, and how far from them its edges may be. Where chords are farther than they should be all
//! the same, it moves their ends a little ([`Fences::tighten`]).
//! Invariant: a chord that was farther than the limit may stay as far as it was; a corner moves on a boundary alone; where a
//! curve is straight, its edges stay on it.
//! Must not know: why else vertices move.

use glam::DVec3;

use super::triangle::{score, unit_normal};
use crate::mesh::csr::Csr;
use crate::token::Token;

/// A vertex that went too far goes back by these shares of its way.
const BACK: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// Facets' normals turn by at most this cosine by it.
const LEAST_COSINE: f64 = 0.8;
/// Passes over such vertices.
const SWEEPS: usize = 3;

/// Passes over vertices whose edges are too far from their curves, the steps that are tried there, and how far one goes
/// in all, corners less far: shares of the shortest edge of a curve there.
const TIGHTENINGS: usize = 8;
const STEPS: [f64; 4] = [0.1, 0.05, 0.025, 0.0125];
const REACH: f64 = 0.25;
const CORNER_REACH: f64 = 0.12;
/// Facets come to no less than this score by it, or than they had.
const ENOUGH: f64 = 34.0;

/// A curve is straight at an edge if it leaves the edge's line by no more than this share of it, so many edges to either
/// side. What is curved is off its chords anyway; what is straight, as the edge of a plate, would show any dent.
const STRAIGHT: f64 = 1e-3;
const BESIDE: usize = 3;

/// A point of an input curve.
#[derive(Clone, Copy, Debug)]
pub(super) struct CurveSample {
    /// Where it is.
    pub(super) position: DVec3,
    /// The result's edge for its stretch of the curve.
    pub(super) edge: [u32; 2],
    /// Area it stands for: its share of the curve's length times the length of the edge.
    pub(super) area: f64,
    /// How far the edge may be from the curve.
    pub(super) limit: f64,
}

/// One end of an edge of a curve.
#[derive(Clone, Copy)]
struct Side {
    /// The other end.
    other: u32,
    /// The curve's points between them: from and to, in `points`.
    points: [u32; 2],
    limit: f64,
    /// What the limit would be if the edge had been within it.
    goal: f64,
    /// Whether the curve is straight there and beside it.
    straight: bool,
}

/// See the module's head.
pub(super) struct Fences {
    points: Vec<DVec3>,
    /// By vertex.
    sides: Csr<Side>,
    start: Vec<DVec3>,
}

fn off(p: DVec3, [a, b]: [DVec3; 2]) -> f64 {
    let way = b - a;
    let squared = way.length_squared();
    let t = if squared > 0.0 { ((p - a).dot(way) / squared).clamp(0.0, 1.0) } else { 0.0 };
    p.distance(a + t * way)
}

/// Whether an edge of vertex `v` has one facet, of those `around` it.
fn on_boundary(around: &[u32], facets: &[[u32; 3]], v: u32) -> bool {
    let mut others: Vec<u32> = around.iter().flat_map(|&f| facets[f as usize]).filter(|&u| u != v).collect();
    others.sort_unstable();
    others.chunk_by(|a, b| a == b).any(|same| same.len() == 1)
}

/// Along the axes, across the edges and to the corners of a cube.
fn ways() -> impl Iterator<Item = DVec3> {
    let of = |k: i32| DVec3::new(f64::from(k % 3 - 1), f64::from(k / 3 % 3 - 1), f64::from(k / 9 - 1));
    (0..27).filter(|k| *k != 13).map(move |k| of(k).normalize())
}

impl Fences {
    /// For edges of curves with their ends at `start`, `fixed` where they are corners; samples of one edge follow each other.
    pub(super) fn new(start: &[DVec3], fixed: &[bool], samples: &[CurveSample]) -> Self {
        let points: Vec<DVec3> = samples.iter().map(|s| s.position).collect();
        let mut edges: Vec<([u32; 2], Side)> = Vec::new();
        let mut from = 0;
        for same in samples.chunk_by(|a, b| a.edge == b.edge) {
            let range = [from, from + same.len() as u32];
            from = range[1];
            let ends = same[0].edge.map(|v| start[v as usize]);
            let own = same.iter().map(|s| off(s.position, ends)).fold(0.0, f64::max);
            let goal = same[0].limit;
            let [a, b] = same[0].edge;
            let side = |other| Side { other, points: range, limit: own.max(goal), goal, straight: false };
            edges.extend([([a, b], side(b)), ([b, a], side(a))]);
        }
        edges.sort_by_key(|e| e.0);
        let sides: Vec<(u32, Side)> = edges.into_iter().map(|([v, _], side)| (v, side)).collect();
        let mut fences = Self { points, sides: Csr::from_pairs(start.len(), &sides), start: start.to_vec() };
        fences.hold_straight(fixed);
        fences
    }

    /// Finds where curves are straight, and lowers the limits there.
    fn hold_straight(&mut self, fixed: &[bool]) {
        let own = &*self;
        let of = |v: u32| own.sides(v).iter().map(move |side| (v, own.is_straight(v, side, fixed)));
        let straight: Vec<(u32, bool)> = (0..self.start.len() as u32).flat_map(of).collect();
        for (side, (v, straight)) in self.sides.all_mut().iter_mut().zip(straight) {
            side.straight = straight;
            if straight {
                side.limit = STRAIGHT * self.start[v as usize].distance(self.start[side.other as usize]);
            }
        }
    }

    /// Whether the curve is straight along one of the sides of vertex `v` and beside it.
    fn is_straight(&self, v: u32, side: &Side, fixed: &[bool]) -> bool {
        let (origin, way) = (self.start[v as usize], self.start[side.other as usize] - self.start[v as usize]);
        let most = STRAIGHT * way.length();
        let Some(way) = way.try_normalize() else { return false };
        let is_near = |p: DVec3| (p - origin).reject_from_normalized(way).length() <= most;
        let holds = |v: u32, side: &Side| {
            let between = &self.points[side.points[0] as usize..side.points[1] as usize];
            is_near(self.start[v as usize]) && between.iter().all(|&p| is_near(p))
        };
        // As far as the curve goes on without a corner.
        let goes_on = |mut from: u32, mut to: u32| {
            for _ in 0..BESIDE {
                let next = match self.sides(to) {
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
        holds(v, side) && goes_on(v, side.other) && goes_on(side.other, v)
    }

    fn sides(&self, v: u32) -> &[Side] {
        self.sides.of(v)
    }

    /// By how much of their limits the edges of vertex `v` leave their curves if it is at `p`.
    fn share(&self, positions: &[DVec3], v: u32, p: DVec3) -> f64 {
        let of = |side: &Side| {
            if side.straight {
                // Whoever slides along a line stays on it.
                let origin = self.start[v as usize];
                let way = (self.start[side.other as usize] - origin).normalize_or_zero();
                return (p - origin).reject_from_normalized(way).length() / side.limit;
            }
            let ends = [p, positions[side.other as usize]];
            let between = &self.points[side.points[0] as usize..side.points[1] as usize];
            let far = between.iter().map(|&q| off(q, ends)).fold(0.0, f64::max);
            // The points where the curve was cut: ends of edges slide no farther along it either.
            let cut = off(self.start[v as usize], ends).min(p.distance(self.start[v as usize]));
            let other = off(self.start[side.other as usize], ends);
            far.max(cut).max(other.min(positions[side.other as usize].distance(self.start[side.other as usize])))
                / side.limit
        };
        self.sides(v).iter().map(of).fold(0.0, f64::max)
    }

    /// By how much of what they should be the edges of vertex `v` and the curve are apart if it is at `p`.
    fn excess(&self, positions: &[DVec3], v: u32, p: DVec3) -> f64 {
        let (sides, start) = (self.sides(v), self.start[v as usize]);
        let goal = sides.iter().map(|side| side.goal).fold(f64::INFINITY, f64::min);
        // The vertex is near some part of the curve, and the place where that was cut near one of the edges.
        let cut = |side: &Side| off(start, [p, positions[side.other as usize]]) / goal;
        let beside = |side: &Side| {
            let between = &self.points[side.points[0] as usize..side.points[1] as usize];
            let ends = [between[0], between[between.len() - 1]];
            let next = if start.distance(ends[0]) < start.distance(ends[1]) { ends[0] } else { ends[1] };
            between.windows(2).map(|w| off(p, [w[0], w[1]])).fold(off(p, [start, next]), f64::min) / goal
        };
        let at = |u: u32| if u == v { p } else { positions[u as usize] };
        // A tip of the curve may be nearer to the next edge than to its own.
        let near = |q: DVec3, other: u32| {
            let chords = |u: u32| self.sides(u).iter().map(move |s| off(q, [at(u), at(s.other)]));
            chords(v).chain(chords(other)).fold(f64::INFINITY, f64::min)
        };
        let edges = sides.iter().map(|side| {
            let between = &self.points[side.points[0] as usize..side.points[1] as usize];
            let cut = near(self.start[side.other as usize], side.other);
            between.iter().map(|&q| near(q, side.other)).fold(cut, f64::max) / side.goal
        });
        let own = sides.iter().map(cut).fold(f64::INFINITY, f64::min);
        let astray = sides.iter().map(beside).fold(f64::INFINITY, f64::min);
        edges.fold(own.max(astray), f64::max)
    }

    /// Moves vertices whose edges are farther from their curves than they should be a little, to where they are nearer;
    /// corners less, and only those of boundaries, whose teeth may be narrower than an edge is long. Returns the corners
    /// that moved.
    pub(super) fn tighten(
        &self,
        positions: &mut [DVec3],
        facets: &[[u32; 3]],
        fixed: &[bool],
        token: &Token,
    ) -> Vec<u32> {
        let vertices: Vec<u32> = (0..self.start.len() as u32).filter(|&v| !self.sides(v).is_empty()).collect();
        let far = |positions: &[DVec3], v: u32| self.excess(positions, v, positions[v as usize]);
        if vertices.iter().all(|&v| far(positions, v) <= 1.0) {
            return Vec::new();
        }
        let around = Csr::one_rings(positions.len(), facets);
        let first = positions.to_vec();
        let spoils = |positions: &[DVec3], v: u32, p: DVec3| {
            around.of(v).iter().map(|&f| &facets[f as usize]).any(|t| {
                let (before, now) = (t.map(|u| first[u as usize]), t.map(|u| positions[u as usize]));
                let after = t.map(|u| if u == v { p } else { positions[u as usize] });
                unit_normal(before).dot(unit_normal(after)) < LEAST_COSINE
                    || score(after) < ENOUGH.min(score(now)).min(score(before))
            })
        };
        let mut moved = Vec::new();
        for _ in 0..TIGHTENINGS {
            let mut any = false;
            for &v in &vertices {
                if token.is_stopped() {
                    return moved;
                }
                let here = positions[v as usize];
                let mut best = (self.excess(positions, v, here), here);
                if best.0 <= 1.0 || fixed[v as usize] && !on_boundary(around.of(v), facets, v) {
                    continue;
                }
                let sides = self.sides(v).iter();
                let edge = sides.map(|s| here.distance(positions[s.other as usize])).fold(f64::INFINITY, f64::min);
                let reach = edge * if fixed[v as usize] { CORNER_REACH } else { REACH };
                for (step, way) in STEPS.iter().flat_map(|&s| ways().map(move |w| (s, w))) {
                    let p = here + step * edge * way;
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
    pub(super) fn allow(&self, positions: &[DVec3], v: u32, p: DVec3) -> bool {
        if self.sides(v).is_empty() {
            return true;
        }
        let then = self.share(positions, v, p);
        then <= 1.0 || then < self.share(positions, v, positions[v as usize])
    }

    /// Brings vertices that went too far back on their way, as far as no facet turns by it.
    pub(super) fn restore(&self, positions: &mut [DVec3], facets: &[[u32; 3]], token: &Token) {
        let around = Csr::one_rings(positions.len(), facets);
        let turns = |positions: &[DVec3], v: u32, p: DVec3| {
            around.of(v).iter().map(|&f| &facets[f as usize]).any(|t| {
                let before = unit_normal(t.map(|u| positions[u as usize]));
                let after = unit_normal(t.map(|u| if u == v { p } else { positions[u as usize] }));
                before.dot(after) < LEAST_COSINE
            })
        };
        for _ in 0..SWEEPS {
            let mut moved = false;
            for v in 0..self.start.len() as u32 {
                if self.sides(v).is_empty() {
                    continue;
                }
                if token.is_stopped() {
                    return;
                }
                let here = positions[v as usize];
                let mut best = (self.share(positions, v, here), here);
                for t in BACK {
                    if best.0 <= 1.0 {
                        break;
                    }
                    let p = here.lerp(self.start[v as usize], t);
                    let share = self.share(positions, v, p);
                    if share < best.0 && !turns(positions, v, p) {
                        best = (share, p);
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
    fn who_leaves_its_curve_goes_back_as_far_as_it_must() {
        let start = [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X, DVec3::Y];
        let sample = |edge: [u32; 2], position: DVec3| CurveSample { position, edge, area: 0.1, limit: 0.1 };
        // Not quite straight.
        let samples = [sample([0, 1], 0.5 * DVec3::X), sample([1, 2], DVec3::new(1.5, 0.004, 0.0))];
        let fences = Fences::new(&start, &[false; 4], &samples);
        let mut moved = start;
        moved[1] += DVec3::new(0.1, 0.3, 0.0);
        moved[3] *= 5.0;
        assert!(fences.allow(&start, 3, 9.0 * DVec3::Y), "who is on no curve may go anywhere");
        assert!(!fences.allow(&start, 1, moved[1]) && fences.allow(&start, 1, DVec3::new(1.05, 0.05, 0.0)));
        fences.restore(&mut moved, &[], &Token::default());
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
        let fences = Fences::new(&straight, &[false; 9], &samples(&straight));
        for k in 1..8 {
            assert!(!fences.allow(&straight, k, step(k, 0.0, 0.05)), "{k}");
            assert!(fences.allow(&straight, k, step(k, 0.3, 0.0005)), "{k}");
        }
        let bent = ends(0.5);
        let fences = Fences::new(&bent, &[false; 9], &samples(&bent));
        let allowed: Vec<bool> = (1..8).map(|k| fences.allow(&bent, k, step(k, 0.0, 0.05))).collect();
        assert_eq!(allowed, [false, false, false, false, true, true, true]);
        let mut corner = [false; 9];
        corner[7] = true;
        let fences = Fences::new(&bent, &corner, &samples(&bent));
        assert!((1..7).all(|k| !fences.allow(&bent, k, step(k, 0.0, 0.05))));
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
        let fences = Fences::new(&start, &[false; 5], &[sample([0, 1], 0.6, -0.06), sample([1, 2], 1.5, 0.0)]);
        let tooth = |at: &[DVec3; 5]| off(DVec3::new(0.6, -0.06, 0.0), [at[0], at[1]]);
        let (open, closed) = ([[0, 1, 3], [1, 2, 3]], [[0, 1, 3], [1, 2, 3], [1, 0, 4], [2, 1, 4]]);
        let mut free = start;
        assert!(fences.tighten(&mut free, &open, &[false; 5], &Token::default()).is_empty());
        assert!(tooth(&free) < 0.7 * tooth(&start), "{free:?}");
        let mut corners = start;
        let moved = fences.tighten(&mut corners, &open, &[true; 5], &Token::default());
        assert!(!moved.is_empty() && tooth(&corners) < 0.9 * tooth(&start), "{corners:?}");
        // Of the edge as it is by then, a little longer.
        assert!((0..5).all(|v| corners[v].distance(start[v]) <= CORNER_REACH * 1.1), "{corners:?}");
        let mut inside = start;
        assert!(!fences.tighten(&mut inside, &closed, &[true; 5], &Token::default()).contains(&1));
        assert_eq!(inside[1], start[1]);
    }
}
