//! Edges of a result that lie on curves.
//!
//! Purpose: [`Rails`] knows for each such edge its stretch of the curve, and follows splits, collapses and moves.
//! Invariant: the stretches of a curve cover what they covered. Must not know: metrics, which vertices move.

use std::collections::HashMap;

use glam::DVec3;

use crate::mesh::edges::undirected;
use crate::remesh::features::polyline::{Polyline, Stretch};
use crate::remesh::manifold::LocalMesh;

pub(super) struct Rails {
    lines: Vec<Polyline>,
    /// By the ends of the edge, lower one first, in whose order the arc lengths are.
    stretches: HashMap<[u32; 2], Stretch>,
}

/// A vertex of a curve between its two neighbours there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beside {
    /// Neighbours before and after it along the curve.
    pub(super) ends: [u32; 2],
    /// How far they are along the curve; below 0 and above.
    pub(super) reach: [f64; 2],
    curve: u32,
    here: f64,
}

impl Rails {
    pub(super) fn new(lines: Vec<Polyline>, stretches: &[([u32; 2], Stretch)]) -> Self {
        let mut rails = Self { lines, stretches: HashMap::new() };
        stretches.iter().for_each(|&(edge, stretch)| rails.insert(edge, stretch));
        rails
    }

    fn insert(&mut self, edge: [u32; 2], Stretch { curve, ends: [a, b] }: Stretch) {
        let ends = if edge[0] < edge[1] { [a, b] } else { [b, a] };
        self.stretches.insert(undirected(edge), Stretch { curve, ends });
    }

    /// The stretch of an edge in this direction.
    fn of(&self, edge: [u32; 2]) -> Option<Stretch> {
        let &Stretch { curve, ends: [a, b] } = self.stretches.get(&undirected(edge))?;
        Some(Stretch { curve, ends: if edge[0] < edge[1] { [a, b] } else { [b, a] } })
    }

    /// All edges, lower end first, ascending.
    pub(super) fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges: Vec<[u32; 2]> = self.stretches.keys().copied().collect();
        edges.sort_unstable();
        edges
    }

    /// The neighbours of a vertex along curves, ascending.
    pub(super) fn around(&self, mesh: &LocalMesh, v: u32) -> Vec<u32> {
        let mut around = mesh.neighbours(v);
        around.retain(|&u| u != v && self.stretches.contains_key(&undirected([u, v])));
        around
    }

    /// A vertex with two neighbours on one curve, one to each side.
    pub(super) fn beside(&self, mesh: &LocalMesh, v: u32) -> Option<Beside> {
        let [a, b] = self.around(mesh, v)[..] else { return None };
        let (first, second) = (self.of([v, a])?, self.of([v, b])?);
        let reach = [first, second].map(|s| s.ends[1] - s.ends[0]);
        let (ends, reach) = if reach[0] < reach[1] { ([a, b], reach) } else { ([b, a], [reach[1], reach[0]]) };
        let is_between = first.curve == second.curve && reach[0] < 0.0 && reach[1] > 0.0;
        is_between.then_some(Beside { ends, reach, curve: first.curve, here: first.ends[0] })
    }

    /// The point of the curve so far after a vertex.
    pub(super) fn after(&self, beside: &Beside, by: f64) -> DVec3 {
        self.lines[beside.curve as usize].at(beside.here + by)
    }

    /// The point of the curve in the middle of an edge.
    pub(super) fn middle(&self, edge: [u32; 2]) -> Option<DVec3> {
        let Stretch { curve, ends: [a, b] } = self.of(edge)?;
        Some(self.lines[curve as usize].at(a.midpoint(b)))
    }

    /// A vertex in the middle of an edge.
    pub(super) fn split(&mut self, edge: [u32; 2], new: u32) {
        let Some(Stretch { curve, ends: [a, b] }) = self.of(edge) else { return };
        self.stretches.remove(&undirected(edge));
        let middle = a.midpoint(b);
        self.insert([edge[0], new], Stretch { curve, ends: [a, middle] });
        self.insert([new, edge[1]], Stretch { curve, ends: [middle, b] });
    }

    /// A vertex with two neighbours on a curve becomes one of them.
    pub(super) fn collapse(&mut self, mesh: &LocalMesh, from: u32, to: u32) {
        let Some(beside) = self.beside(mesh, from) else { return };
        let [a, b] = beside.ends;
        // Arc lengths that ascend, also across the beginning of a closed curve.
        let ends = beside.reach.map(|reach| beside.here + reach);
        self.stretches.remove(&undirected([a, from]));
        self.stretches.remove(&undirected([from, b]));
        if [a, b].contains(&to) {
            self.insert([a, b], Stretch { curve: beside.curve, ends });
        }
    }

    /// A vertex moves along its curve.
    pub(super) fn shift(&mut self, v: u32, beside: &Beside, by: f64) {
        for (end, reach) in beside.ends.into_iter().zip(beside.reach) {
            let ends = [beside.here + by, beside.here + reach];
            self.insert([v, end], Stretch { curve: beside.curve, ends });
        }
    }

    /// Vertices have other numbers.
    pub(super) fn renumber(&mut self, number: &[u32]) {
        let old = std::mem::take(&mut self.stretches);
        self.stretches = old.into_iter().map(|(edge, s)| (edge.map(|v| number[v as usize]), s)).collect();
    }
}
