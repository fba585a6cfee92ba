//! Edges of curves within their envelope.
//!
//! Purpose: [`restore`] takes vertices that went too far from their curves back towards where they were. [`tighten`] moves ends
//! of edges that are too far from their curves even so.
//! Invariant: only vertices of curves move, each to where its edges are nearer to the curves. No facet turns over or becomes
//! poor. Must not know: why a vertex went too far.

use super::relocation::{Steps, cheapest, places_around};
use crate::remesh::constants::{
    BACKTRACKING, FARTHEST_OF_CORNER, FARTHEST_TIGHTENED, FIRST_TIGHTENING_STEP, LEAST_GAIN, LEAST_SCORE,
    RESTORING_PASSES, TIGHTENING_PASSES, UNMEASURED_COSINE,
};
use crate::remesh::features::envelope::CurveEnvelope;
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::remesh::triangle::score;
use crate::token::Token;

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
            let back = BACKTRACKING.into_iter().map(|t| here.lerp(envelope.start(v), t));
            let (_, to) = cheapest((violation(here), here), LEAST_GAIN, back, cost);
            moved |= to != here;
            mesh.positions[v as usize] = to;
        }
        if !moved {
            return;
        }
    }
}

/// Moves vertices whose edges are farther from their curves than the goal a little, to where they are nearer. Corners, which
/// are `fixed`, move less, and only on boundaries, whose teeth may be narrower than an edge is long. Returns the corners that
/// moved.
pub(crate) fn tighten(mesh: &mut LocalMesh, envelope: &CurveEnvelope, fixed: &[bool], token: &Token) -> Vec<u32> {
    let excess = |mesh: &LocalMesh, v: u32| envelope.excess(&mesh.positions, v, mesh.positions[v as usize]);
    let may_move = |mesh: &LocalMesh, v: u32| !fixed[v as usize] || mesh.is_on_boundary(v);
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
    use crate::remesh::features::envelope::CurveSample;

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
            let moved = tighten(&mut mesh, &envelope, &[fixed; 5], &Token::default());
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
