//! Vertices of flat places, for places far from the input.
//!
//! Purpose: where no flip and no move brings a place nearer, as between three corners of a boundary, [`exchange`] puts a vertex there. It is
//! taken from where the surface is nearly flat, so the number of vertices stays.
//! Invariant: both places are then nearer to the input than the first one was. A manifold stays one, no facet turns over, edges of curves
//! stay. The same bits whatever the number of threads. Must not know: seeds, diagrams, files.

use std::collections::HashSet;

use glam::DVec3;

use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::csr::ascending;
use crate::mesh::facet_set::{FacetSet, sample_points, squared_distance};
use crate::mesh::measure::facet_quality;
use crate::remesh::constants::{LONG_EDGE, MEASURED_COSINE};
use crate::remesh::distance::{HausdorffEstimate, InputSamples, Reference, farthest_places};
use crate::remesh::manifold::LocalMesh;
use crate::remesh::triangle::{Wanted, perimeter, unit_normal};
use crate::tasks;
use crate::token::Token;

/// Vertices that change places, share of all.
const MOST_EXCHANGED: f64 = 0.002;
/// Vertices that are tried for each that may change places: those where the result is nearest.
const TRIED: usize = 16;
/// The place that a vertex leaves is at most this far from the input afterwards, shares of the distance where it goes.
const LEFT: f64 = 0.7;
/// Where it goes, distances fall to this share, or are as they were.
const GAINED: f64 = 0.8;

/// A vertex that may leave its place: how far the input is from there afterwards, and the neighbour that takes its edges.
struct Spare {
    distance: f64,
    vertex: u32,
    to: u32,
}

/// The input, by result vertex.
struct Input<'a> {
    reference: &'a Reference<'a>,
    /// Edges that are longer have their midpoint as a place too, unit frame.
    long: f64,
}

/// Puts vertices that are `free` to the farthest places. Returns those that went, with their new places, unit frame.
pub(crate) fn exchange(
    mesh: &mut LocalMesh,
    (samples, reference): (&InputSamples, &Reference<'_>),
    free: &[bool],
    wanted: Wanted,
    token: &Token,
) -> Vec<(u32, DVec3)> {
    let most = (MOST_EXCHANGED * mesh.positions.len() as f64).ceil() as usize;
    let edges = (0..mesh.facets().len() as u32).map(|f| perimeter(mesh.corners(f)) / 3.0).sum::<f64>();
    let input = Input { reference, long: LONG_EDGE * edges / mesh.facets().len() as f64 };
    let estimate = HausdorffEstimate::of(mesh, samples, None, token);
    let mut near: Vec<(f64, u32)> = estimate.by_vertex.into_iter().zip(0..).collect();
    near.retain(|&(_, v)| free[v as usize] && !mesh.is_on_boundary(v) && !mesh.is_on_curve(v));
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.truncate(TRIED * most);
    let mut spares: Vec<Spare> = tasks::flat_map(near.len(), |k| input.spare(mesh, near[k].1, wanted));
    spares.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.vertex.cmp(&b.vertex)));
    let (mut exchanged, mut spares) = (Vec::new(), spares.into_iter());
    // What is measured at a place is true as long as no vertex there has changed.
    let mut touched: HashSet<u32> = HashSet::new();
    for place in input.farthest(mesh, samples, TRIED * most, token) {
        if exchanged.len() == most || token.is_stopped() {
            break;
        }
        let around = mesh.corners_around(&mesh.facets()[place.facet as usize]);
        if around.iter().any(|v| touched.contains(v)) {
            continue;
        }
        let Some(cavity) = input.cavity(mesh, &place, wanted) else { continue };
        touched.extend(around);
        let is_apart = |of: &Spare| mesh.neighbours(of.vertex).iter().all(|v| !touched.contains(v));
        let mut near = spares.by_ref().take_while(|of| of.distance < LEFT * place.distance);
        let Some(Spare { vertex, to, .. }) = near.find(is_apart) else { break };
        touched.extend(mesh.neighbours(vertex));
        let gone = mesh.collapse(vertex, to);
        mesh.insert(vertex, place.position, &cavity, &gone);
        exchanged.push((vertex, place.position));
    }
    exchanged
}

/// A place of the input, and the facet that is nearest to it.
struct Far {
    distance: f64,
    facet: u32,
    position: DVec3,
}

impl Input<'_> {
    fn midpoints(&self, f: u32) -> impl Iterator<Item = DVec3> {
        let [a, b, c] = self.reference.corners(f);
        let long = self.long;
        [[a, b], [b, c], [c, a]].into_iter().filter(move |[a, b]| a.distance(*b) > long).map(|[a, b]| (a + b) / 2.0)
    }

    /// Of the cells of some vertices, with the distances from some facets.
    fn places(&self, vertices: &[u32], facets: &[[DVec3; 3]]) -> Vec<(DVec3, f64)> {
        let met = ascending(vertices.iter().flat_map(|&v| self.reference.facets.of(v)).copied());
        let midpoints = met.into_iter().flat_map(|f| self.midpoints(f));
        let own = vertices.iter().flat_map(|&v| self.reference.vertices.of(v)).copied();
        own.chain(midpoints).map(|p| (p, distance(p, facets))).collect()
    }

    /// How far facets are from the cells of some vertices.
    fn off(&self, facets: &[[DVec3; 3]], vertices: &[u32]) -> f64 {
        let met = ascending(vertices.iter().flat_map(|&v| self.reference.facets.of(v)).copied());
        let met = FacetSet::new(met.into_iter().map(|f| self.reference.corners(f)));
        let (groups, mut hint) = (met.all_groups(), 0);
        let points = facets.iter().flat_map(|&t| sample_points(t));
        points.fold(0.0f64, |off, p| off.max(met.distance(p, &groups, &mut hint, off))).sqrt()
    }

    /// At most this many places, by falling distance.
    fn farthest(&self, mesh: &LocalMesh, samples: &InputSamples, most: usize, token: &Token) -> Vec<Far> {
        let Ok(whole) = TriMesh::new(mesh.positions.clone(), mesh.facets().to_vec()) else { return Vec::new() };
        let Ok(closest) = ClosestPoint::unless(&whole, token) else { return Vec::new() };
        let measure = |position: DVec3| {
            let near = closest.project(position);
            Far { distance: near.position.distance(position), facet: near.facet, position }
        };
        let of_facet = |f: usize| {
            let midpoints = (!token.is_stopped()).then(|| self.midpoints(f as u32));
            midpoints.into_iter().flatten().map(measure)
        };
        let mut found: Vec<Far> = tasks::flat_map(self.reference.surface.facets().len(), of_facet);
        let places = farthest_places(mesh, samples, token);
        let mut some = places.chunks(most);
        loop {
            // Stable: of places that are as far, the first stays the first.
            found.sort_by(|a, b| b.distance.total_cmp(&a.distance));
            found.truncate(most);
            let Some(next) = some.next().filter(|_| !token.is_stopped()) else { return found };
            // The distances are at most the estimates.
            if found.get(most - 1).is_some_and(|least| least.distance >= next[0].0) {
                return found;
            }
            found.extend(tasks::flat_map(next.len(), |k| [measure(next[k].1)]));
        }
    }

    /// `None` if a vertex has to stay.
    fn spare(&self, mesh: &LocalMesh, vertex: u32, wanted: Wanted) -> Option<Spare> {
        let (ring, own) = (mesh.neighbours(vertex), mesh.ring(vertex));
        let outer: Vec<_> = mesh.facets_around(&ring).into_iter().filter(|f| !own.contains(f)).collect();
        let outer = corners_of(mesh, &outer);
        let own = corners_of(mesh, own);
        let before = self.places(&ring, &[&own[..], &outer].concat());
        let into = |&to: &u32| {
            let after = mesh.collapse_corners(vertex, to);
            let turns = |&(f, t): &(u32, [u32; 3])| mesh.is_turned(f, mesh.places(t), MEASURED_COSINE);
            if to == vertex || !mesh.may_collapse(vertex, to) || after.iter().any(turns) {
                return None;
            }
            let new: Vec<[DVec3; 3]> = after.into_iter().map(|(_, t)| mesh.places(t)).collect();
            if lack(&new, wanted) > lack(&own, wanted) {
                return None;
            }
            let facets = [&new[..], &outer].concat();
            let farther =
                before.iter().map(|&(p, before)| (distance(p, &facets), before)).filter(|(now, was)| now > was);
            Some(Spare { distance: farther.map(|(now, _)| now).fold(self.off(&new, &ring), f64::max), vertex, to })
        };
        ring.iter().filter_map(into).min_by(|a, b| a.distance.total_cmp(&b.distance))
    }

    /// The facets whose place those around a vertex take best: the nearest one and some beside it. `None` if none is good enough.
    fn cavity(&self, mesh: &LocalMesh, place: &Far, wanted: Wanted) -> Option<Vec<u32>> {
        let corners = mesh.facets()[place.facet as usize];
        let near = mesh.corners_around(&corners);
        let facets = mesh.facets_around(&near);
        let before = self.places(&near, &corners_of(mesh, &facets));
        let beside = |k: usize| {
            let edge = [corners[k], corners[(k + 1) % 3]];
            mesh.beside(edge).into_iter().map(|(g, _)| g).find(|&g| g != place.facet && !mesh.is_curve(edge))
        };
        let beside: Vec<u32> = (0..3).filter_map(beside).collect();
        let try_with = |subset: u32| {
            let chosen = beside.iter().enumerate().filter(|(k, _)| subset >> k & 1 == 1).map(|(_, &g)| g);
            let cavity: Vec<u32> = std::iter::once(place.facet).chain(chosen).collect();
            let (old, mean) = (corners_of(mesh, &cavity), cavity.iter().map(|&f| mesh.marked_normal(f)).sum::<DVec3>());
            let at = |v: u32| mesh.positions[v as usize];
            let new: Vec<[DVec3; 3]> =
                mesh.fan(&cavity)?.into_iter().map(|[a, b]| [at(a), at(b), place.position]).collect();
            let faces = |&t: &[DVec3; 3]| unit_normal(t).dot(mean.normalize_or_zero()) >= MEASURED_COSINE;
            let off = self.off(&new, &near);
            let is_off = || off > self.off(&old, &near).max(GAINED * place.distance);
            if !new.iter().all(faces) || lack(&new, wanted) > lack(&old, wanted) || is_off() {
                return None;
            }
            let rest: Vec<u32> = facets.iter().copied().filter(|f| !cavity.contains(f)).collect();
            let after = [new, corners_of(mesh, &rest)].concat();
            let mut largest = off;
            for &(p, before) in &before {
                let now = distance(p, &after);
                if now > before.max(GAINED * place.distance) {
                    return None;
                }
                largest = if now == before { largest } else { largest.max(now) };
            }
            Some((largest, cavity))
        };
        let all = (0..1u32 << beside.len()).filter_map(try_with);
        all.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, cavity)| cavity)
    }
}

fn corners_of(mesh: &LocalMesh, facets: &[u32]) -> Vec<[DVec3; 3]> {
    facets.iter().map(|&f| mesh.corners(f)).collect()
}

fn lack(facets: &[[DVec3; 3]], wanted: Wanted) -> f64 {
    facets.iter().map(|&corners| wanted.lack(corners, facet_quality(corners))).fold(0.0, f64::max)
}

fn distance(p: DVec3, facets: &[[DVec3; 3]]) -> f64 {
    facets.iter().map(|&corners| squared_distance(p, corners)).fold(f64::INFINITY, f64::min).sqrt()
}
