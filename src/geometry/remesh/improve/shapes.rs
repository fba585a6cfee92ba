//! Improvement of the worst triangles of the whole result, and edges of curves within their envelope.
//!
//! Purpose: after the iterations some triangles, most of them where curves come close to each other, have an angle far from the
//! others'. The vertices at and beside them wait in a queue, that with the costliest facets first. A vertex is relocated to
//! where its facets cost least; where no place is better, an edge of a poor facet is flipped. Independent vertices are looked at
//! at the same time. [`restore`] takes vertices that went too far from their curves back towards where they were. [`tighten`]
//! moves ends of edges that are too far from their curves even so.
//! Invariant: moves are short beside an edge. A vertex moves in the tangent plane; a vertex of a curve along the curve,
//! within a small tolerance across it; an end within that; a corner not at all. [`restore`] and [`tighten`] move only
//! vertices of curves, to where edges are nearer. No facet turns over. The same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

use glam::DVec3;

use super::objective::ShapeCost;
use super::{Place, Queue, Steps, cheapest, places_around};
use crate::mesh::csr::ascending;
use crate::remesh::constants::*;
use crate::remesh::features::envelope::CurveEnvelope;
use crate::remesh::manifold::{Flip, LocalMesh};
use crate::remesh::triangle::{Wanted, perimeter, score};
use crate::tasks;
use crate::token::Token;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Mobility {
    /// In the tangent plane; on a boundary as [`Self::End`].
    Free,
    /// Along a direction, unit.
    Along(DVec3),
    /// Within a small tolerance: the end of a curve.
    End,
    Fixed,
}

#[derive(Clone, Copy)]
pub(crate) struct MotionBounds<'a> {
    pub(crate) mobility: &'a [Mobility],
    pub(crate) envelope: &'a CurveEnvelope,
    /// No vertex leaves its curve by more than this, whatever the edge.
    pub(crate) off_curve: f64,
}

/// Improves the worst facets. Ends early where `token` is stopped.
pub(crate) fn improve_shapes(mesh: &mut LocalMesh, bounds: MotionBounds<'_>, token: &Token) {
    mesh.mark();
    let wanted = Wanted::new(POOR_SCORE, POOR_ANGLE);
    let corners = |f: usize| wanted.is_lacking(mesh.corners(f as u32)).then(|| mesh.facets()[f]).into_iter().flatten();
    let poor: Vec<u32> = tasks::flat_map(mesh.facets().len(), corners);
    // Their neighbours make room.
    let vertices = mesh.corners_around(&poor);
    let mut is_due = vec![false; mesh.positions.len()];
    vertices.iter().for_each(|&v| is_due[v as usize] = true);
    let count = mesh.positions.len();
    let mut shapes = Shapes {
        start: mesh.positions.clone(),
        mesh,
        bounds,
        wanted,
        cost: ShapeCost::unmeasured(),
        steps: Steps::new(count),
        queue: Queue::new(),
        latest: vec![f64::NAN; count],
        claims: vec![0; count],
        rounds: 0,
    };
    let mut left = MOVES_PER_VERTEX * vertices.len();
    shapes.push(vertices);
    loop {
        let batch = shapes.next_batch(left);
        if batch.is_empty() || token.is_stopped() {
            return;
        }
        left -= batch.len();
        let of = |place: &Place<()>| shapes.better_place(place.vertex(), place.badness());
        let places: Vec<Option<DVec3>> = tasks::map(batch.len(), |k| of(&batch[k]));
        let made = batch.into_iter().zip(places).flat_map(|(place, to)| shapes.make(place, to));
        let changed = ascending(made.filter(|&u| is_due[u as usize]).collect::<Vec<u32>>());
        changed.iter().for_each(|&u| shapes.steps.renew(u));
        shapes.push(changed);
    }
}

struct Shapes<'a> {
    mesh: &'a mut LocalMesh,
    start: Vec<DVec3>,
    bounds: MotionBounds<'a>,
    wanted: Wanted,
    cost: ShapeCost,
    steps: Steps,
    queue: Queue<()>,
    /// By vertex, the cost with which it is in the queue: other entries are old. NaN if it is not.
    latest: Vec<f64>,
    /// By vertex, the last round in which a vertex at or beside it was taken.
    claims: Vec<u32>,
    rounds: u32,
}

impl Shapes<'_> {
    fn push(&mut self, mut vertices: Vec<u32>) {
        vertices.retain(|&v| self.bounds.mobility[v as usize] != Mobility::Fixed);
        let at = |v: u32| self.mesh.positions[v as usize];
        let cost_of = |&v: &u32| self.cost.around(self.mesh, v, at(v), f64::INFINITY, f64::NEG_INFINITY);
        let costs: Vec<f64> = tasks::map(vertices.len(), |k| cost_of(&vertices[k]));
        vertices.into_iter().zip(costs).for_each(|(v, cost)| self.push_one(v, cost));
    }

    fn push_one(&mut self, v: u32, cost: f64) {
        self.latest[v as usize] = cost;
        self.queue.push(Place::new((), v, cost));
    }

    /// The costliest vertices, `most` at most, no two with a neighbour in common: none changes the costs of the others.
    fn next_batch(&mut self, most: usize) -> Vec<Place<()>> {
        self.rounds += 1;
        let (mut batch, mut waiting) = (Vec::new(), Vec::new());
        while batch.len() < most.min(SHAPES_AT_ONCE) && waiting.len() < SHAPES_AT_ONCE {
            let Some(place) = self.queue.pop() else { break };
            let v = place.vertex();
            if self.latest[v as usize] != place.badness() {
                continue;
            }
            let near = self.mesh.ring(v).iter().flat_map(|&f| self.mesh.facets()[f as usize]);
            if near.clone().any(|u| self.claims[u as usize] == self.rounds) {
                waiting.push(place);
            } else {
                batch.push(place);
                self.latest[v as usize] = f64::NAN;
            }
            near.for_each(|u| self.claims[u as usize] = self.rounds);
        }
        self.queue.extend(waiting);
        batch
    }

    /// Relocates a vertex, or flips an edge beside it if it has tried all places. Returns the vertices around what changed.
    fn make(&mut self, place: Place<()>, to: Option<DVec3>) -> Vec<u32> {
        let v = place.vertex();
        let Some(to) = to else {
            let Some(flip) = self.better_flip(v) else { return Vec::new() };
            self.mesh.apply(&flip);
            return self.mesh.corners_around(&flip.corners.concat());
        };
        if to != self.mesh.positions[v as usize] {
            self.mesh.positions[v as usize] = to;
            return self.mesh.neighbours(v);
        }
        self.steps.halve(v);
        self.push_one(v, place.badness());
        Vec::new()
    }

    /// Where a vertex whose facets cost so much goes in its next step. `None` if it has tried all.
    fn better_place(&self, v: u32, cost: f64) -> Option<DVec3> {
        let share = self.steps.next(v)?;
        let (mesh, MotionBounds { mobility, envelope, off_curve }) = (&*self.mesh, self.bounds);
        let (here, start) = (mesh.positions[v as usize], self.start[v as usize]);
        let mobility = match mobility[v as usize] {
            // Beyond its boundary the tangent plane is not near the surface.
            Mobility::Free if mesh.is_on_boundary(v) => Mobility::End,
            own => own,
        };
        let ring = mesh.ring(v);
        let edge = ring.iter().map(|&f| perimeter(mesh.corners(f))).sum::<f64>() / (3 * ring.len()) as f64;
        let normal = mesh.vertex_normal(v);
        let (x, y) = match mobility {
            // A crease has no tangent plane: any direction across the curve will do.
            Mobility::Along(curve) => {
                (curve, curve.cross(normal).try_normalize().unwrap_or_else(|| curve.any_orthonormal_vector()))
            }
            _ => normal.any_orthonormal_pair(),
        };
        let may_go = |p: &DVec3| {
            let moved = *p - start;
            let within = match mobility {
                Mobility::Along(curve) => {
                    let along = moved.dot(curve);
                    along.abs() <= FARTHEST_TANGENTIAL * edge
                        && (moved - along * curve).length() <= (FARTHEST_ACROSS * edge).min(off_curve)
                }
                Mobility::End => moved.length() <= (FARTHEST_OF_END * edge).min(off_curve),
                Mobility::Fixed => false,
                Mobility::Free => moved.length() <= FARTHEST_TANGENTIAL * edge,
            };
            within && envelope.admits(&mesh.positions, v, *p)
        };
        let places = places_around(here, share * FIRST_STEP * edge, [x, y]).take(DIRECTIONS);
        let cost_at = |p: DVec3, most: f64| self.cost.around(mesh, v, p, most, UNMEASURED_COSINE);
        Some(cheapest((cost, here), LEAST_GAIN_OF_PASS, places.filter(may_go), cost_at).1)
    }

    /// The flip of an edge of a poor facet around `v` that gains most.
    fn better_flip(&self, v: u32) -> Option<Flip> {
        let mesh = &*self.mesh;
        let is_poor = |f: &&u32| self.wanted.is_lacking(mesh.corners(**f));
        let gain = |flip: &Flip| {
            let before: f64 = flip.facets.iter().map(|&f| self.cost.of(mesh.corners(f))).sum();
            before - flip.corners.iter().map(|&t| self.cost.of(mesh.places(t))).sum::<f64>()
        };
        let sides = mesh.ring(v).iter().filter(is_poor).flat_map(|&f| (0..3).map(move |side| (f, side)));
        let flips = sides.filter_map(|(f, side)| mesh.flip(f, side, VALENCES));
        let best = flips.map(|flip| (gain(&flip), flip)).reduce(|a, b| if b.0 > a.0 { b } else { a });
        best.filter(|(gain, _)| *gain > LEAST_GAIN_OF_PASS).map(|(_, flip)| flip)
    }
}

/// Takes vertices that went too far back, no farther than they must.
pub(crate) fn restore(mesh: &mut LocalMesh, envelope: &CurveEnvelope, token: &Token) {
    mesh.mark();
    let vertices = envelope.vertices();
    for _ in 0..RESTORING_PASSES {
        let mut moved = false;
        for &v in &vertices {
            if token.is_stopped() {
                return;
            }
            let here = mesh.positions[v as usize];
            // What is within the limit costs the same: the first such place is taken.
            let violation = |p| envelope.violation(&mesh.positions, v, p).max(1.0);
            let cost = |p, _| if mesh.turns(v, p, UNMEASURED_COSINE) { f64::INFINITY } else { violation(p) };
            let back = BACKTRACKING.into_iter().map(|t| here.lerp(envelope.start[v as usize], t));
            let (_, to) = cheapest((violation(here), here), LEAST_GAIN, back, cost);
            moved |= to != here;
            mesh.positions[v as usize] = to;
        }
        if !moved {
            return;
        }
    }
}

/// Moves vertices whose edges are farther from curves than the goal a little nearer. Corners, which are `fixed`, move less,
/// and only on boundaries, whose teeth may be narrower than an edge is long. Those that nothing moves, as several sheets have them, `stay`.
/// Returns the corners that moved.
pub(crate) fn tighten(
    mesh: &mut LocalMesh,
    envelope: &CurveEnvelope,
    (fixed, stay): (&[bool], &[bool]),
    token: &Token,
) -> Vec<u32> {
    let excess = |mesh: &LocalMesh, v: u32| envelope.excess(&mesh.positions, v, mesh.positions[v as usize]);
    let may_move = |mesh: &LocalMesh, v: u32| !fixed[v as usize] || mesh.is_on_boundary(v) && !stay[v as usize];
    let mut vertices = envelope.vertices();
    vertices.retain(|&v| may_move(mesh, v));
    if vertices.iter().all(|&v| excess(mesh, v) <= 1.0) {
        return Vec::new();
    }
    mesh.mark();
    let (first, mut steps) = (mesh.positions.clone(), Steps::new(mesh.positions.len()));
    for _ in 0..TIGHTENING_PASSES {
        let mut tried = false;
        for &v in &vertices {
            if token.is_stopped() {
                break;
            }
            let (here, now) = (mesh.positions[v as usize], excess(mesh, v));
            let Some(share) = steps.next(v).filter(|_| now > 1.0) else { continue };
            tried = true;
            let edge = envelope.shortest_edge(&mesh.positions, v);
            let reach = edge * if fixed[v as usize] { FARTHEST_OF_CORNER } else { FARTHEST_TIGHTENED };
            let spoils = |p| {
                let worse = |&f: &u32| score(mesh.corners_with(f, v, p)) < LEAST_SCORE.min(score(mesh.corners(f)));
                mesh.turns(v, p, UNMEASURED_COSINE) || mesh.ring(v).iter().any(worse)
            };
            let cost = |p, most| {
                let excess = envelope.excess(&mesh.positions, v, p).max(1.0);
                if excess < most && spoils(p) { f64::INFINITY } else { excess }
            };
            let (x, y) = mesh.vertex_normal(v).any_orthonormal_pair();
            let places = places_around(here, share * FIRST_TIGHTENING_STEP * edge, [x, y]);
            let within = places.filter(|p| p.distance(first[v as usize]) <= reach);
            let (_, to) = cheapest((now, here), LEAST_GAIN, within, cost);
            if to == here {
                steps.halve(v);
            }
            mesh.positions[v as usize] = to;
        }
        if !tried {
            break;
        }
    }
    vertices.retain(|&v| fixed[v as usize] && mesh.positions[v as usize] != first[v as usize]);
    vertices
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use glam::DVec3;

    use super::*;
    use crate::mesh::measure::least_angle;
    use crate::remesh::features::envelope::CurveSample;

    #[test]
    fn the_hub_of_a_wheel_goes_to_its_middle_and_no_farther_than_it_may() {
        let mut positions = vec![DVec3::new(0.6, 0.2, 0.0)];
        positions.extend((0..6).map(|k| {
            let (sin, cos) = (f64::from(k) / 6.0 * std::f64::consts::TAU).sin_cos();
            DVec3::new(cos, sin, 0.0)
        }));
        let facets: Vec<[u32; 3]> = (0..6).map(|k| [0, 1 + k, 1 + (k + 1) % 6]).collect();
        let wheel = LocalMesh::new(positions, facets, HashSet::new());
        let worst = |m: &LocalMesh| (0..6).map(|f| least_angle(m.corners(f))).fold(f64::INFINITY, f64::min);
        let envelope = CurveEnvelope::new(&[DVec3::ZERO; 7], &[false; 7], &[]);
        let improved = |hub: Mobility, off_curve: f64| {
            let mut mobility = vec![Mobility::End; 7];
            mobility[0] = hub;
            let mut mesh = wheel.clone();
            let bounds = MotionBounds { mobility: &mobility, envelope: &envelope, off_curve };
            improve_shapes(&mut mesh, bounds, &Token::default());
            mesh
        };
        let farthest =
            |m: &LocalMesh| m.positions.iter().zip(&wheel.positions).map(|(p, q)| p.distance(*q)).fold(0.0, f64::max);
        assert!(farthest(&improved(Mobility::End, f64::INFINITY)) < 0.1, "ends have a tolerance");
        assert!(farthest(&improved(Mobility::End, 0.01)) <= 0.01, "and no more than that");
        let free = improved(Mobility::Free, f64::INFINITY);
        assert!(worst(&free) > worst(&wheel) + 5.0, "{} after {}", worst(&free), worst(&wheel));
        assert!(free.positions[0].distance(wheel.positions[0]) < 0.45);
        assert_eq!(free.positions[0].z, 0.0);
        // A tooth of the boundary that no curve holds.
        let tooth = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.2, 0.0)];
        let mut mesh = LocalMesh::new(tooth.to_vec(), vec![[0, 1, 2]], HashSet::new());
        let bounds = MotionBounds { mobility: &[Mobility::Free; 3], envelope: &envelope, off_curve: f64::INFINITY };
        improve_shapes(&mut mesh, bounds, &Token::default());
        for (p, q) in mesh.positions.iter().zip(tooth) {
            assert!(p.distance(q) < 0.07, "{q} went to {p}");
        }
    }

    #[test]
    fn a_vertex_that_leaves_its_curve_goes_back_as_far_as_it_must() {
        let start = [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X, DVec3::Y];
        let sample = |edge: [u32; 2], position: DVec3| CurveSample { position, edge, area: 0.1, limit: 0.1 };
        // Not quite straight.
        let samples = [sample([0, 1], 0.5 * DVec3::X), sample([1, 2], DVec3::new(1.5, 0.004, 0.0))];
        let envelope = CurveEnvelope::new(&start, &[false; 4], &samples);
        let mut mesh = LocalMesh::new(start.to_vec(), Vec::new(), HashSet::new());
        mesh.positions[1] += DVec3::new(0.1, 0.3, 0.0);
        mesh.positions[3] *= 5.0;
        restore(&mut mesh, &envelope, &Token::default());
        // Back by three quarters of its way, one of the steps.
        assert!(mesh.positions[1].distance(DVec3::new(1.025, 0.075, 0.0)) < 1e-12, "{}", mesh.positions[1]);
        assert_eq!(mesh.positions[3], 5.0 * DVec3::Y);
    }

    /// A tooth of a curve beside its edge: ends of the edge come nearer to it, corners of a boundary a little, others not
    /// at all.
    #[test]
    fn ends_of_an_edge_that_is_too_far_from_its_curve_move_a_little() {
        let start = [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X, DVec3::new(1.0, 1.2, 0.0), DVec3::new(1.0, -1.2, 0.0)];
        let tooth = DVec3::new(0.6, -0.06, 0.0);
        let sample = |edge: [u32; 2], position: DVec3| CurveSample { position, edge, area: 0.1, limit: 0.02 };
        let samples = [sample([0, 1], tooth), sample([1, 2], 1.5 * DVec3::X)];
        let envelope = CurveEnvelope::new(&start, &[false; 5], &samples);
        let off = |at: &[DVec3]| {
            let (along, to) = ((at[1] - at[0]).normalize(), tooth - at[0]);
            (to - to.dot(along) * along).length()
        };
        let open = vec![[0, 1, 3], [1, 2, 3]];
        let closed = vec![[0, 1, 3], [1, 2, 3], [1, 0, 4], [2, 1, 4]];
        let tightened = |facets: &Vec<[u32; 3]>, fixed: bool| {
            let mut mesh = LocalMesh::new(start.to_vec(), facets.clone(), HashSet::new());
            let moved = tighten(&mut mesh, &envelope, (&[fixed; 5], &[false; 5]), &Token::default());
            (mesh.positions, moved)
        };
        let (free, moved) = tightened(&open, false);
        assert!(moved.is_empty() && off(&free) < 0.7 * off(&start), "{free:?}");
        let (corners, moved) = tightened(&open, true);
        assert!(!moved.is_empty() && off(&corners) < 0.9 * off(&start), "{corners:?}");
        // Of the edge as it is by then, a little longer.
        assert!((0..5).all(|v| corners[v].distance(start[v]) <= FARTHEST_OF_CORNER * 1.1), "{corners:?}");
        let (inside, moved) = tightened(&closed, true);
        assert!(!moved.contains(&1));
        assert_eq!(inside[1], start[1]);
    }
}
