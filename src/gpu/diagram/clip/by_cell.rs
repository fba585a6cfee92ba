//! The per-cell side of the work.
//!
//! Purpose: \[HYWZ17\] gives a thread to each facet, and to each cell where a facet meets more than 20 cells: a facet of many
//! cells is a long walk, and few facets are few threads. Here both sides end in the same list of pairs. By facet, pairs are
//! found across bisectors from the facet's first cell, a ring of cells a round. By cell, the stage `reach` lets each seed enter
//! the facets that it reaches, nearly all of them in one round. [`choose`] says which facets are found by cell, [`Grid`] is
//! where seeds look for them. Invariant: what is listed by cell is still closed under propagation, so nothing is missed. The
//! stage `verify` proves that nothing else was added. Facets without that proof, or with pairs that the device cannot end, are
//! left to propagation: same pairs, same bits. Measured on a software adapter (clip phase, two cores): two triangles and 20,000
//! cells, 12.2 ms by cell against 12.7 by facet; 192 facets and 50,000 cells, 68 against 38, and as much again in each pass
//! that has to begin anew. A mesh finer than its cells takes several times longer. The rounds that are saved cost little there.
//! Must not know: how facets are clipped.

use super::{Clip, Result};
use crate::buffers::write;
use crate::diagram::lane;
use crate::diagram::layout::{BY_CELL, Params, State, failure};
use crate::diagram::memory::Memory;
use crate::diagram::neighbours::Neighbours;
use crate::diagram::plan::size;
use crate::diagram::space::{DeviceSpace, FacetRecord};
use crate::dispatch::Stage;
use geometry::rvd::{CELLS_PER_FACET, PassStats, Point, Strategy, Surface};
use geometry::token::Token;

/// Grid cells along a side at most.
const MOST_CELLS: f64 = 64.0;

/// Facets whose pairs are found by cell, of those that are expected to meet so many cells. No strategy changes a bit of a result.
pub(crate) fn choose(expected: &[f64], strategy: Strategy) -> Vec<u32> {
    let least = match strategy {
        Strategy::Facet => return Vec::new(),
        Strategy::Cell => 0.0,
        Strategy::Auto => CELLS_PER_FACET,
    };
    (0..expected.len() as u32).filter(|&f| expected[f as usize] > least).collect()
}

/// The facets near each place of the unit box.
#[derive(Debug, Default)]
pub(crate) struct Grid {
    /// Grid cells along each side; 0 if no facet is in it.
    pub side: u32,
    /// Where each grid cell's facets begin in this list, one more for the end, and then the facets.
    pub near: Vec<u32>,
}

impl Grid {
    /// Of `facets`, each made larger by two spacings of `seeds` seeds: few of its cells have their
    /// seed farther away, and those are found from their neighbours.
    pub(crate) fn new<P: Point>(surface: &Surface<P>, facets: &[u32], seeds: usize) -> Self {
        if facets.is_empty() {
            return Self { side: 0, near: Vec::new() };
        }
        let reach = 2.0 * (surface.area() / seeds.max(1) as f64).sqrt();
        // Not finer than what facets are made larger by, or each would be in many cells.
        let side = (0.5 / reach).min((facets.len() as f64).sqrt()).clamp(1.0, MOST_CELLS).floor() as usize;
        let place = |x: f64| ((x + 0.5) * side as f64).clamp(0.0, side as f64 - 1.0) as usize;
        let mut boxes = vec![Vec::new(); side * side * side];
        for &f in facets {
            let corners = surface.corners(f).map(P::place);
            let low = (corners[0].min(corners[1]).min(corners[2]) - reach).to_array().map(place);
            let high = (corners[0].max(corners[1]).max(corners[2]) + reach).to_array().map(place);
            for z in low[2]..=high[2] {
                for y in low[1]..=high[1] {
                    for x in low[0]..=high[0] {
                        boxes[(z * side + y) * side + x].push(f);
                    }
                }
            }
        }
        let mut begin = boxes.len() as u32 + 1;
        let mut near = Vec::with_capacity(boxes.iter().map(|b| b.len() + 1).sum::<usize>() + 1);
        for list in &boxes {
            near.push(begin);
            begin += list.len() as u32;
        }
        near.push(begin);
        near.extend(boxes.into_iter().flatten());
        Self { side: side as u32, near }
    }
}

impl<P: DeviceSpace> Clip<P> {
    /// Leaves `facets` to propagation. For these seeds only: other seeds may be proved.
    pub(crate) fn leave_to_propagation(
        &mut self,
        memory: &mut Memory<P>,
        mut facets: Vec<u32>,
        stats: &mut PassStats,
    ) -> Result<()> {
        facets.sort_unstable();
        facets.dedup();
        stats.relaunched_facets += facets.len() as u64;
        for &f in &facets {
            mark(&mut memory.facets[f as usize], false);
        }
        self.demoted.extend(facets);
        memory.upload_facets()
    }

    /// Gives all that [`Self::leave_to_propagation`] took back to the cells.
    pub(crate) fn promote(&mut self, memory: &mut Memory<P>) -> Result<()> {
        if self.demoted.is_empty() {
            return Ok(());
        }
        for f in std::mem::take(&mut self.demoted) {
            mark(&mut memory.facets[f as usize], true);
        }
        memory.upload_facets()
    }

    pub(crate) fn upload_near(&self, memory: &Memory<P>) -> Result<()> {
        Ok(write(&self.cx.device, &memory.there()?.buffers.near, 0, &self.near.near)?)
    }

    /// Facets with pieces that cells entered and that are not proved, after a pass that ended with `state`.
    pub(crate) fn unproved(
        &self,
        memory: &Memory<P>,
        rows: &Neighbours<P>,
        state: State,
        token: &Token,
    ) -> Result<Vec<u32>> {
        let params = Params { emit_count: state.length, ..self.params(memory, rows) };
        let (device, there) = (&self.cx.device, memory.there()?);
        let buffers = &there.buffers;
        memory.write_params(params)?;
        memory.write_state(State { failures: 0, ..state })?;
        let mut encoder = device.encoder();
        let bindings = &there.bindings.windows[memory.windows.present].verify;
        let (pipeline, items) = (&self.cx.pipelines.verify, state.length.into());
        let stage = Stage { pipeline, bindings, items, size: size::ITEM, arguments: None };
        memory.encode(&mut encoder, lane::CLIP, &[stage], token)?;
        let mut unproved = 0;
        buffers.staging.read_with(device, encoder, &buffers.state, 0..1, |s: &[State]| unproved = s[0].failures)?;
        if unproved == 0 {
            return Ok(Vec::new());
        }
        let failures: Vec<[u32; 2]> = memory.read(|b| &b.failures, 0..unproved as usize)?;
        Ok(failures.iter().filter_map(|&e| failure(e)).map(|f| f.0).collect())
    }

    /// Leaves all facets to propagation, for the rest of the session.
    pub(crate) fn leave_all_to_propagation(&mut self, memory: &mut Memory<P>) {
        for record in &mut memory.facets {
            mark(record, false);
        }
        self.demoted.clear();
        self.near.side = 0;
    }
}

/// Whether `facet` is found by cell in the present pass.
pub(crate) fn is_by_cell<P: DeviceSpace>(memory: &Memory<P>, facet: u32) -> bool {
    memory.facets[facet as usize].slots().1 & BY_CELL != 0
}

/// Says whether a facet is found by cell.
pub(crate) fn mark(facet: &mut impl FacetRecord, by_cell: bool) {
    let (begin, mask) = facet.slots();
    facet.set_slots(begin, if by_cell { mask | BY_CELL } else { mask & !BY_CELL });
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::mesh::shapes::Shape;

    #[test]
    fn the_grid_holds_every_facet_where_it_is() {
        let surface = Surface::new(&Shape::Torus.build(800), None).unwrap();
        let facets: Vec<u32> = (0..surface.facets().len() as u32).step_by(3).collect();
        let grid = Grid::new(&surface, &facets, 20_000);
        let side = grid.side as usize;
        assert!(side > 4);
        assert_eq!(grid.near[side.pow(3)] as usize, grid.near.len());
        for &f in &facets {
            for v in surface.facets()[f as usize] {
                let p = ((surface.positions()[v as usize] + 0.5) * side as f64).to_array();
                let [x, y, z] = p.map(|x| x.clamp(0.0, side as f64 - 1.0) as usize);
                let place = (z * side + y) * side + x;
                let list = &grid.near[grid.near[place] as usize..grid.near[place + 1] as usize];
                assert!(list.contains(&f));
            }
        }
        assert_eq!(Grid::new(&surface, &[], 10).side, 0);
    }

    #[test]
    fn strategies_choose_facets() {
        let expected = [0.0, 3.0, 20.0, 20.5];
        assert!(choose(&expected, Strategy::Facet).is_empty());
        assert_eq!(choose(&expected, Strategy::Cell), [1, 2, 3]);
        assert_eq!(choose(&expected, Strategy::Auto), [3]);
    }
}
