//! Promise: on real scans and CAD parts (`TESSERA_MESHES`, `TESSERA_SEEDS`) the diagram is the one that other exact programs find,
//! on every backend.

use std::collections::HashSet;
use std::sync::Arc;

use crate::backends::on_device;
use crate::points::Slack;
use crate::{points, surfaces};
use glam::DVec3;
use needs::needs;
use tessera::mesh::sample::sample;
use tessera::rvd::{Backend, CellSums, PieceBatch, SessionOptions, Surface};
use tessera::rvd::{Parallel, Serial};
use tessera::token::Token;

/// Centroids of white-noise cells against those of two independent exact programs, and the same
/// (facet, cell) incidences on all backends.
#[needs(meshes, seeds)]
#[test]
fn centroids_and_incidences_agree_with_the_oracle() {
    let parallel = Parallel::new(None).unwrap();
    let mut backends: Vec<(&dyn Backend, f64)> = vec![(&Serial, 1e-10), (&parallel, 1e-10)];
    // Single precision relative to the seed, of a cell some spacings wide.
    backends.extend(on_device().map(|gpu| (gpu as &dyn Backend, 1e-5)));
    for (mesh, seeds) in
        [("stanford-bunny.obj", "bunny10k"), ("rocker-arm.obj", "rocker5k"), ("nefertiti.obj", "nefertiti50k")]
    {
        let mesh = surfaces::real(mesh);
        let [given, want] = ["xyz", "lloyd1.xyz"].map(|kind| surfaces::points(&format!("{seeds}.{kind}")));
        let surface = Arc::new(Surface::new(&mesh, None).unwrap());
        let frame = surface.frame();
        let unit: Vec<DVec3> = given.iter().map(|&p| frame.to_unit(p)).collect();
        let spacing = (surface.area() / unit.len() as f64).sqrt();
        let mut reference: Option<PieceBatch> = None;
        for (backend, tolerance) in &backends {
            let name = backend.kind().name();
            let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(unit.len())).unwrap();
            let (mut sums, mut pieces, token) = (CellSums::default(), PieceBatch::default(), Token::default());
            session.set_seeds(&unit).unwrap();
            session.sums(&mut sums, &token).unwrap();
            let worst = (0..unit.len())
                .map(|i| sums.centroid(i, unit[i]).distance(frame.to_unit(want[i])) / spacing)
                .fold(0.0, f64::max);
            session.pieces(0..surface.facets().len() as u32, &mut pieces, &token).unwrap();
            let reference = reference.get_or_insert_with(|| pieces.clone());
            let (missing, added) = (differences(reference, &pieces), differences(&pieces, reference));
            println!(
                "{seeds}, {name}: worst centroid {worst:e} of the spacing; {} pieces, {} missing, {} added",
                pieces.len(),
                missing.len(),
                added.len()
            );
            assert!(worst < *tolerance, "{seeds}, {name}: {worst:e}");
            for area in missing.into_iter().chain(added) {
                assert!(area < 1e-10 * surface.area(), "{seeds}, {name}: a piece of area {area:e} is in one only");
            }
        }
    }
}

/// Areas of the pieces of `a` whose (facet, seed) is not in `b`.
fn differences(a: &PieceBatch, b: &PieceBatch) -> Vec<f64> {
    let known: HashSet<(u32, u32)> = b.facet.iter().copied().zip(b.seed.iter().copied()).collect();
    (0..a.len()).filter(|&i| !known.contains(&(a.facet[i], a.seed[i]))).map(|i| a.area(i)).collect()
}

/// 100,000 random points of the bunny lie in the cells of their nearest seeds, for white-noise
/// seeds and nothing iterated; the brute force is in f64. On every backend; the GPU's pieces have
/// vertices in single precision relative to their seeds, so a point may be that far outside.
#[needs(meshes)]
#[test]
fn a_hundred_thousand_points_lie_in_their_nearest_cells() {
    let mesh = surfaces::real("stanford-bunny.obj");
    let surface = Arc::new(Surface::new(&mesh, None).unwrap());
    let probes = points::on_surface(&surface, 100_000, &mut points::rng(99));
    let parallel = Parallel::new(None).unwrap();
    let mut backends: Vec<(&dyn Backend, f64)> = vec![(&Serial, 1e-9), (&parallel, 1e-9)];
    backends.extend(on_device().map(|gpu| (gpu as &dyn Backend, 1e-6)));
    for count in [20, 1000, 10_000] {
        let seeds: Vec<DVec3> =
            sample(&mesh, None, count, 5).iter().map(|p| surface.frame().to_unit(p.position)).collect();
        let nearest = points::nearest(&seeds, &probes);
        let spacing = (surface.area() / count as f64).sqrt();
        for (backend, margin) in &backends {
            let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(count)).unwrap();
            session.set_seeds(&seeds).unwrap();
            let mut pieces = PieceBatch::default();
            session.pieces(0..surface.facets().len() as u32, &mut pieces, &Token::default()).unwrap();
            let slack = Slack { margin: margin * spacing, rounding: 1e-6 * margin * spacing };
            let unresolved = points::outside_known(&pieces, &seeds, &probes, &nearest, slack);
            let name = backend.kind().name();
            println!("{name}, {count} seeds: {} of {} points unresolved", unresolved.len(), probes.len());
            assert!(unresolved.is_empty(), "{name}, {count} seeds: {:?}", unresolved.first());
        }
    }
}
