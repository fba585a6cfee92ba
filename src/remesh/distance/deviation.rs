//! The deviation of the input's vertices from the result.
//!
//! Purpose: [`InputDeviation`] knows for each vertex of the input the nearest facet in the one-ring of its own result
//! vertex.
//! Invariant: the same bits whatever the number of threads. Must not know: how the result is changed.

use glam::DVec3;
use rayon::prelude::*;

use super::nearest::RingQuery;
use crate::mesh::csr::Csr;
use crate::remesh::constants::{VERTICES_PER_CHECK, VERTICES_PER_TASK};
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::remesh::triangle::perimeter;
use crate::token::Token;

/// Where a vertex of the input lies, seen from the result.
#[derive(Clone, Copy, Debug)]
pub(in crate::remesh) struct Deviation {
    /// Distance from the nearest facet.
    pub(in crate::remesh) distance: f64,
    /// The distance divided by the facet's mean edge.
    pub(in crate::remesh) relative: f64,
    /// The corner of that facet that is nearest to the input's vertex.
    pub(in crate::remesh) corner: u32,
}

/// Of a vertex whose owner has no facets.
const UNKNOWN: Deviation = Deviation { distance: 0.0, relative: 0.0, corner: 0 };

/// See the module's head.
pub(in crate::remesh) struct InputDeviation<'a> {
    vertices: &'a Csr<DVec3>,
    /// In the order of `vertices`.
    list: Vec<Deviation>,
}

fn deviation(mesh: &LocalMesh, query: &mut RingQuery, vertex: DVec3) -> Deviation {
    let found = query.nearest(vertex);
    let Some(&t) = mesh.facets().get(found.facet as usize) else { return UNKNOWN };
    let p = mesh.places(t);
    let edge = perimeter(p) / 3.0;
    let to = p.map(|q| q.distance_squared(vertex));
    let corner = if to[0] <= to[1] && to[0] <= to[2] {
        t[0]
    } else if to[1] <= to[2] {
        t[1]
    } else {
        t[2]
    };
    let distance = found.squared.sqrt();
    Deviation { distance, relative: if edge > 0.0 { distance / edge } else { 0.0 }, corner }
}

impl<'a> InputDeviation<'a> {
    /// Measures all of them.
    pub(in crate::remesh) fn new(mesh: &LocalMesh, vertices: &'a Csr<DVec3>, token: &Token) -> Self {
        let (mut list, count) = (vec![UNKNOWN; vertices.all().len()], mesh.positions.len());
        // Tasks: a range of result vertices with its part of the list.
        let mut tasks = Vec::with_capacity(count / VERTICES_PER_TASK + 1);
        let mut rest = list.as_mut_slice();
        for begin in (0..count).step_by(VERTICES_PER_TASK) {
            let owners = begin as u32..(begin + VERTICES_PER_TASK).min(count) as u32;
            let count = vertices.range(owners.end - 1).end - vertices.range(owners.start).start;
            let (here, after) = rest.split_at_mut(count);
            rest = after;
            tasks.push((owners, here));
        }
        tasks.into_par_iter().for_each_init(RingQuery::default, |query, (owners, mut here)| {
            for owner in owners {
                let own = vertices.of(owner);
                let (list, after) = here.split_at_mut(own.len());
                here = after;
                if !own.is_empty() {
                    query.move_to(mesh, owner);
                    for (k, (to, vertex)) in list.iter_mut().zip(own).enumerate() {
                        // A one-ring may have many facets, and a cell many vertices of the input.
                        if k.is_multiple_of(VERTICES_PER_CHECK) && token.is_stopped() {
                            return;
                        }
                        *to = deviation(mesh, query, *vertex);
                    }
                }
            }
        });
        Self { vertices, list }
    }

    /// Those that `counts`, with their numbers, by falling relative deviation.
    pub(in crate::remesh) fn largest_first(&self, counts: impl Fn(&Deviation) -> bool) -> Vec<(usize, Deviation)> {
        let mut found: Vec<(usize, Deviation)> =
            self.list.iter().copied().enumerate().filter(|(_, d)| counts(d)).collect();
        found.sort_by(|a, b| b.1.relative.total_cmp(&a.1.relative).then(a.0.cmp(&b.0)));
        found
    }

    /// Where vertex `k` of the input is.
    pub(in crate::remesh) fn position(&self, k: usize) -> DVec3 {
        self.vertices.all()[k]
    }

    /// The largest distance among the input's vertices of each of so many result vertices.
    pub(in crate::remesh) fn by_owner(&self, owners: usize) -> Vec<f64> {
        let largest = |v: u32| self.list[self.vertices.range(v)].iter().map(|d| d.distance).fold(0.0, f64::max);
        (0..owners as u32).into_par_iter().map(largest).collect()
    }

    /// The largest distance of all.
    pub(in crate::remesh) fn largest(&self) -> f64 {
        self.list.iter().map(|d| d.distance).fold(0.0, f64::max)
    }
}
