//! Promise: cells find the facets that they meet (strategy `cell`), and what they cannot prove is left to propagation, with the same
//! bits.

use std::sync::Arc;

use crate::points::noise;
use crate::sessions::{everything, open, same_bits};
use glam::{DVec3, dvec3};
use needs::needs;
use tessera::mesh::TriMesh;
use tessera::rvd::{Backend, CellSums, PassStats, PieceBatch, SessionOptions, Strategy, Surface, Tuning};

fn square() -> TriMesh {
    let corners = vec![dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 0.)];
    TriMesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

/// Sums and all pieces of one session.
fn both(
    backend: &dyn Backend,
    surface: &Arc<Surface>,
    seeds: &[DVec3],
    options: SessionOptions,
) -> (CellSums, PieceBatch, PassStats) {
    everything(&mut *open(backend, surface, seeds, options), surface)
}

#[needs(gpu)]
#[test]
fn cells_find_the_facets_of_two_triangles() {
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&square(), None).unwrap());
    let mut proved = 0;
    for sample in 31..34 {
        let seeds = noise(&surface, 5000, 0.0, sample);
        let with = |strategy| {
            let tuning = Tuning::new().with_strategy(strategy);
            both(gpu, &surface, &seeds, SessionOptions::new(seeds.len()).with_tuning(tuning))
        };
        let (by_facet, by_cell, chosen) = (with(Strategy::Facet), with(Strategy::Cell), with(Strategy::Auto));
        same_bits("cell", &by_facet.0, &by_cell.0);
        same_bits("auto", &by_facet.0, &chosen.0);
        assert!(by_facet.1 == by_cell.1 && by_facet.1 == chosen.1);
        proved += u32::from(by_cell.2.relaunched_facets == 0);
    }
    // Falling back is for what rounding broke, not the rule.
    assert!(proved > 0);
}

#[needs(gpu)]
#[test]
fn what_cells_cannot_prove_is_left_to_propagation() {
    let gpu = require_gpu!();
    let surface = Arc::new(Surface::new(&square(), None).unwrap());
    let [a, b, c] = surface.facets()[0].map(|v| surface.positions()[v as usize]);
    let centroid = (a + b + c) / 3.0;
    // All as far from the centroid, so that none is the nearer one.
    let ring: Vec<DVec3> = (0..40)
        .map(|k| {
            let (sin, cos) = (f64::from(k) / 40.0 * std::f64::consts::TAU).sin_cos();
            centroid + 0.2 * dvec3(cos, sin, 0.0)
        })
        .collect();
    // Out of the range of floats, so that the host ends the pairs.
    let mut far = noise(&surface, 40, 0.0, 1);
    for p in &mut far {
        p.z += 1000.0;
    }
    for (name, seeds) in [("ring", ring), ("far", far)] {
        let with = |strategy| {
            let tuning = Tuning::new().with_strategy(strategy);
            both(gpu, &surface, &seeds, SessionOptions::new(seeds.len()).with_tuning(tuning))
        };
        let (by_facet, by_cell) = (with(Strategy::Facet), with(Strategy::Cell));
        assert!(by_cell.2.relaunched_facets > 0, "{name}: {:?}", by_cell.2);
        same_bits(name, &by_facet.0, &by_cell.0);
        assert!(by_facet.1 == by_cell.1, "{name}: pieces differ");
    }
}
