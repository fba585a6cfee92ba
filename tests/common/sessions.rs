//! What tests do with a session, whichever backend it is of.
#![allow(dead_code)]

use std::sync::Arc;

use glam::DVec3;
use tessera::rvd::{
    Backend, CellSums, Evaluation, PassStats, PieceBatch, Point, Resident, Session, SessionOptions, Surface,
};
use tessera::token::Token;

/// A session with these seeds.
pub fn open(
    backend: &dyn Backend,
    surface: &Arc<Surface>,
    seeds: &[DVec3],
    options: SessionOptions,
) -> Box<dyn Session> {
    let mut session = backend.session(Arc::clone(surface), options).unwrap();
    session.set_seeds(seeds).unwrap();
    session
}

/// Sums and all pieces of a session.
pub fn everything(session: &mut dyn Session, surface: &Surface) -> (CellSums, PieceBatch, PassStats) {
    let (mut sums, mut pieces) = (CellSums::default(), PieceBatch::default());
    let stats = session.sums(&mut sums, &Token::default()).unwrap();
    session.pieces(0..surface.facets().len() as u32, &mut pieces, &Token::default()).unwrap();
    (sums, pieces, stats)
}

/// The sums of these seeds in a session of their own.
pub fn sums(backend: &dyn Backend, surface: &Arc<Surface>, seeds: &[DVec3]) -> (CellSums, PassStats) {
    sums_with(backend, surface, seeds, SessionOptions::new(seeds.len()))
}

/// The same, with these options.
pub fn sums_with(
    backend: &dyn Backend,
    surface: &Arc<Surface>,
    seeds: &[DVec3],
    options: SessionOptions,
) -> (CellSums, PassStats) {
    let mut out = CellSums::default();
    let stats = open(backend, surface, seeds, options).sums(&mut out, &Token::default()).unwrap();
    (out, stats)
}

/// Asserts the same bits, with a short message.
pub fn same_bits(name: &str, a: &CellSums, b: &CellSums) {
    let bits = |s: &CellSums, i: usize| {
        let m = s.moment[i];
        [s.mass[i], m.x, m.y, m.z, s.energy[i], s.area[i]].map(f64::to_bits)
    };
    assert_eq!(a.mass.len(), b.mass.len(), "{name}");
    let other: Vec<usize> = (0..a.mass.len()).filter(|&i| bits(a, i) != bits(b, i)).collect();
    let shown: Vec<_> = other.iter().take(5).map(|&i| (i, a.mass[i], b.mass[i] - a.mass[i])).collect();
    assert!(other.is_empty(), "{name}: {} cells differ, e.g. (cell, mass, change) {shown:?}", other.len());
}

/// Where the seeds of a session are.
pub fn read<P: Point>(seeds: &mut dyn Resident<P>) -> Vec<P> {
    let mut out = Vec::new();
    seeds.read(&mut out).unwrap();
    out
}

pub fn evaluate<P: Point>(seeds: &mut dyn Resident<P>) -> Evaluation {
    seeds.evaluate(&Token::default()).unwrap()
}

pub fn probe<P: Point>(seeds: &mut dyn Resident<P>, step: f64) -> Evaluation {
    seeds.probe(step, &Token::default()).unwrap()
}

/// Lloyd steps, then quasi-Newton steps with a backtracking search. The energies of all points, and what the quasi-Newton
/// steps took.
pub fn minimise<P: Point>(seeds: &mut dyn Resident<P>, lloyd: usize, newton: usize) -> (Vec<f64>, PassStats) {
    let mut here = evaluate(seeds);
    let mut energies = vec![here.energy];
    let mut stats = PassStats::default();
    for _ in 0..lloyd {
        seeds.to_centroids().unwrap();
        here = evaluate(seeds);
        energies.push(here.energy);
    }
    for _ in 0..newton {
        let slope = seeds.search_direction().unwrap();
        assert!(slope < 0.0);
        let mut step = 1.0;
        let mut next = probe(seeds, step);
        while next.energy > here.energy + 1e-4 * step * slope {
            assert!(step > 1e-9, "no step goes down");
            step *= 0.5;
            next = probe(seeds, step);
        }
        seeds.accept().unwrap();
        stats.add(&next.stats);
        here = next;
        energies.push(here.energy);
    }
    (energies, stats)
}
