//! The seeds of a curve in their order.
//!
//! Purpose: [`Chain`] has a curve's vertices and its seeds, and says where on the curve the seeds are.
//! Invariant: both of a closed curve end where they begin. Must not know: how seeds are placed.

use glam::DVec3;

use super::polyline::Polyline;

/// A curve and its seeds in order. Both of a closed one end where they begin.
pub(crate) struct Chain {
    pub(crate) vertices: Vec<u32>,
    pub(crate) seeds: Vec<u32>,
    pub(crate) closed: bool,
    pub(crate) boundary: bool,
}

impl Chain {
    pub(crate) fn edges(&self) -> impl Iterator<Item = [u32; 2]> {
        self.seeds.windows(2).map(|pair| [pair[0], pair[1]])
    }

    /// For each seed, in the order of the curve, the edge of the curve that it is on, and where, 0 to 1. `places` are those of the vertices.
    /// `None` if their order on the curve is not that of the chain.
    pub(crate) fn along(&self, places: &[DVec3], at: impl Fn(u32) -> DVec3) -> Option<Vec<(u32, usize, f64)>> {
        let line = Polyline::new(places.to_vec(), self.closed);
        let length = line.length();
        let last = self.seeds.len() - 1;
        let own = if self.closed { &self.seeds[..last] } else { &self.seeds[..] };
        let place = |(k, &seed): (usize, &u32)| match k {
            0 if !self.closed => 0.0,
            k if !self.closed && k == last => length,
            _ => line.nearest(at(seed)),
        };
        let mut all: Vec<(f64, u32)> = own.iter().enumerate().map(|own| (place(own), *own.1)).collect();
        if self.closed {
            let turns = all.windows(2).filter(|pair| pair[1].0 < pair[0].0).count();
            if turns > 1 || turns == 1 && all[all.len() - 1].0 > all[0].0 {
                return None;
            }
            let first = (0..all.len()).min_by(|&a, &b| all[a].0.total_cmp(&all[b].0))?;
            all.rotate_left(first);
        } else if all.windows(2).any(|pair| pair[1].0 < pair[0].0) {
            return None;
        }
        Some(all.into_iter().map(|(s, seed)| line.edge_at(s).map_or((seed, 0, 0.0), |(k, t)| (seed, k, t))).collect())
    }
}
