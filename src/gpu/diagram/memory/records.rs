//! Records for the device from the surface and the seeds.
//!
//! Purpose: f64 in, the shaders' records out; how many slots each facet's set of cells gets. Invariant: frames are computed in
//! f64 and rounded once. Must not know: the device.

use rayon::prelude::*;

use crate::diagram::layout::BY_CELL;
use crate::diagram::space::{DeviceSpace, FacetRecord};
use geometry::rvd::{Point, Surface};

/// What a facet is expected to meet: a triangle of area a and perimeter p meets about
/// 1 + a / h² + 0.9 p / h cells of spacing h (measured within a few percent on relaxed seeds).
pub(crate) fn expected_cells<P: Point>(surface: &Surface<P>, seeds: usize) -> Vec<f64> {
    let h2 = surface.area() / seeds.max(1) as f64;
    let estimate = |f: usize| {
        if surface.skips(f) {
            return 0.0;
        }
        // No facet meets more cells than there are seeds.
        mean_cells((surface.facet_area(f as u32), perimeter(surface, f)), h2).min(seeds as f64)
    };
    (0..surface.facets().len()).into_par_iter().map(estimate).collect()
}

fn perimeter<P: Point>(surface: &Surface<P>, f: usize) -> f64 {
    let [a, b, c] = surface.corners(f as u32);
    a.distance(b) + b.distance(c) + c.distance(a)
}

/// Mean area and mean perimeter of the facets that have an area.
pub(crate) fn mean_facet<P: Point>(surface: &Surface<P>) -> (f64, f64) {
    let live: Vec<usize> = (0..surface.facets().len()).filter(|&f| !surface.skips(f)).collect();
    let count = live.len().max(1) as f64;
    (surface.area() / count, live.iter().map(|&f| perimeter(surface, f)).sum::<f64>() / count)
}

/// Cells of spacing `h2.sqrt()` that a facet of the mean area and perimeter meets.
pub(crate) fn mean_cells((area, perimeter): (f64, f64), h2: f64) -> f64 {
    1.0 + area / h2 + 0.9 * perimeter / h2.sqrt()
}

/// Log2 of every facet's slots: at least `cells`, and twice what is expected. `cells` below the
/// default shrinks the expectation too, since it asks for a small start.
pub(crate) fn first_slots(expected: &[f64], cells: usize, default_cells: usize) -> Vec<u8> {
    let share = (cells as f64 / default_cells as f64).min(1.0);
    let log2 = |cells_in_facet: f64| {
        if cells_in_facet == 0.0 {
            return 0;
        }
        let wanted = ((2.0 * share * cells_in_facet) as usize).max(cells).max(1);
        wanted.next_power_of_two().ilog2().min(30) as u8
    };
    expected.iter().map(|&e| log2(e)).collect()
}

/// The records of all facets. Degenerate ones are zero but for their slots.
pub(crate) fn facets<P: DeviceSpace>(surface: &Surface<P>, slots_log2: &[u8]) -> Vec<P::Facet> {
    let mut records: Vec<P::Facet> = (0..surface.facets().len())
        .into_par_iter()
        .map(|f| if surface.skips(f) { P::Facet::default() } else { P::facet(surface, f) })
        .collect();
    assign_slots(&mut records, slots_log2);
    records
}

/// Lays the sets of cells one behind the other. What is [`BY_CELL`] stays so.
pub(crate) fn assign_slots(records: &mut [impl FacetRecord], slots_log2: &[u8]) {
    let mut begin = 0u32;
    for (record, &log2) in records.iter_mut().zip(slots_log2) {
        record.set_slots(begin, (record.slots().1 & BY_CELL) | ((1u32 << log2) - 1));
        begin = begin.wrapping_add(1 << log2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagram::layout;

    #[test]
    fn slots_follow_expectation_and_capacity() {
        assert_eq!(first_slots(&[0.0, 2.7, 9.0, 5000.0], 16, 16), vec![0, 4, 5, 14]);
        assert_eq!(first_slots(&[0.0, 2.7, 5000.0], 2, 16), vec![0, 1, 11]);
        let log2 = [4, 0, 3];
        let mut records = vec![layout::Facet::default(); 3];
        assign_slots(&mut records, &log2);
        assert_eq!(
            records.iter().map(|r| (r.slot_begin, r.slot_mask)).collect::<Vec<_>>(),
            [(0, 15), (16, 0), (17, 7)]
        );
    }
}
