//! The deviation of the input's vertices from the result.
//!
//! Purpose: [`InputDeviation`] knows for each vertex of the input the nearest facet in the one-ring of its own result
//! vertex.
//! Invariant: the same bits whatever the number of threads. Must not know: how the result is changed.

use glam::DVec3;
use rayon::prelude::*;

use super::nearest::RingQuery;
use crate::mesh::csr::Csr;
use crate::remesh::constants::{ITEMS_PER_TASK, WORK_PER_VERTEX};
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::remesh::triangle::perimeter;
use crate::token::{Pace, Stopped, Token};

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
        let owner = |v: u32| std::iter::repeat_n(v, vertices.of(v).len());
        let owners: Vec<u32> = (0..mesh.positions.len() as u32).flat_map(owner).collect();
        let begin = || (RingQuery::default(), u32::MAX, Pace::default());
        let measure = |(query, at, pace): &mut (RingQuery, u32, Pace), (&owner, &vertex): (&u32, &DVec3)| {
            token.check_after(WORK_PER_VERTEX, pace)?;
            if *at != owner {
                query.move_to(mesh, owner);
                *at = owner;
            }
            Ok(deviation(mesh, query, vertex))
        };
        let pairs = owners.par_iter().zip(vertices.all()).with_min_len(ITEMS_PER_TASK);
        let list: Result<Vec<Deviation>, Stopped> = pairs.map_init(begin, measure).collect();
        Self { vertices, list: list.unwrap_or_else(|_| vec![UNKNOWN; owners.len()]) }
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
