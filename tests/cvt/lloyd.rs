//! Lloyd's iteration: the energy falls, empty cells are filled, edits take effect, cancelling stops.

use std::sync::Arc;

use crate::surfaces;
use glam::DVec3;
use tessera::cvt::{Cvt, CvtOptions, Projection, SeedEdit};
use tessera::mesh::TriMesh;
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::sample::sample;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{Parallel, Serial};
use tessera::rvd::{RvdError, Surface};
use tessera::token::{Stopped, Token};

fn drawn(mesh: &TriMesh, n: usize) -> Vec<DVec3> {
    sample(mesh, None, n, 1).into_iter().map(|p| p.position).collect()
}

fn open(mesh: &TriMesh, seeds: &[DVec3], options: CvtOptions) -> Cvt {
    Cvt::new(&Serial, Arc::new(Surface::new(mesh, None).unwrap()), seeds, options).unwrap()
}

#[test]
fn the_energy_falls_in_every_step() {
    for (name, mesh) in surfaces::all() {
        for projection in [Projection::Free, Projection::OnSurface] {
            let options = CvtOptions::new().with_projection(projection);
            let mut cvt = open(&mesh, &drawn(&mesh, 100), options);
            let mut before = f64::INFINITY;
            for _ in 0..15 {
                let step = cvt.lloyd(&Token::default()).unwrap();
                // Converged, the energy stands still to within the rounding of its sum.
                assert!(step.energy <= before * (1.0 + 1e-13), "{name}: {} after {before}", step.energy);
                assert_eq!(step.empty_cells, 0, "{name}");
                before = step.energy;
            }
        }
    }
}

#[test]
fn random_seeds_have_the_energy_of_random_seeds() {
    let mesh = Shape::Torus.build(20_000);
    let mut cvt = open(&mesh, &drawn(&mesh, 4000), CvtOptions::default());
    let mut ratios = Vec::new();
    for _ in 0..41 {
        ratios.push(cvt.lloyd(&Token::default()).unwrap().energy_ratio);
    }
    println!("E/E_hex: random {}, after 40 steps {}", ratios[0], ratios[40]);
    // A Poisson process has 1.985; 4000 cells scatter by about 1.5 %.
    assert!((ratios[0] - 1.985).abs() < 0.06);
    assert!(ratios[40] < 1.03 && ratios[40] > 0.98);
}

#[test]
fn projected_seeds_lie_on_the_surface() {
    let mesh = Shape::Sphere.build(800);
    let mut cvt = open(&mesh, &drawn(&mesh, 50), CvtOptions::new().with_projection(Projection::OnSurface));
    for _ in 0..3 {
        cvt.lloyd(&Token::default()).unwrap();
    }
    let tree = ClosestPoint::new(&mesh);
    for seed in cvt.seeds().unwrap() {
        assert!(tree.project(seed).position.distance(seed) < 1e-12);
    }
}

#[test]
fn seeds_without_a_cell_are_placed_anew() {
    let mesh = Shape::Sphere.build(2000);
    let mut seeds = drawn(&mesh, 40);
    seeds.extend(vec![seeds[0]; 30]);
    seeds.extend(vec![DVec3::splat(500.0); 30]);
    let mut cvt = open(&mesh, &seeds, CvtOptions::default());
    let first = cvt.lloyd(&Token::default()).unwrap();
    assert_eq!(first.empty_cells, 60);
    let mut last = first;
    for _ in 0..20 {
        last = cvt.lloyd(&Token::default()).unwrap();
    }
    assert_eq!(last.empty_cells, 0);
    assert!(last.energy_ratio < 1.15, "{}", last.energy_ratio);
}

#[test]
fn edits_are_all_or_nothing_and_stay_within_the_room() {
    let mesh = Shape::Sphere.build(500);
    let seeds = drawn(&mesh, 10);
    let mut cvt = open(&mesh, &seeds, CvtOptions::new().with_max_seeds(12));
    let near = |a: DVec3, b: DVec3| a.distance(b) < 1e-12;
    cvt.edit(&[
        SeedEdit::Move { index: 3, to: DVec3::X },
        SeedEdit::Add { at: DVec3::Y },
        SeedEdit::Remove { index: 0 },
    ])
    .unwrap();
    let now = cvt.seeds().unwrap();
    assert_eq!(now.len(), 10);
    assert!(near(now[3], DVec3::X) && near(now[0], DVec3::Y), "the last seed takes the index of the removed one");

    let refused = cvt.edit(&[SeedEdit::Remove { index: 1 }, SeedEdit::Move { index: 99, to: DVec3::X }]);
    assert!(matches!(refused, Err(RvdError::NoSuchSeed { seed: 99, seeds: 9 })));
    let refused = cvt.edit(&vec![SeedEdit::Add { at: DVec3::Z }; 3]);
    assert!(matches!(refused, Err(RvdError::TooManySeeds { limit: 12, .. })));
    assert!(matches!(cvt.edit(&[SeedEdit::Add { at: DVec3::NAN }]), Err(RvdError::NonFiniteSeed { seed: 10 })));
    assert!(matches!(cvt.edit(&vec![SeedEdit::Remove { index: 0 }; 10]), Err(RvdError::NoSeeds)));
    assert_eq!(cvt.seeds().unwrap(), now);
    cvt.lloyd(&Token::default()).unwrap();
}

#[test]
fn cancelling_leaves_the_seeds_as_they_were() {
    let mesh = Shape::Sphere.build(5000);
    let backend = Parallel::new(Some(2)).unwrap();
    let surface = Arc::new(Surface::new(&mesh, None).unwrap());
    let mut cvt = Cvt::new(&backend, surface, &drawn(&mesh, 100), CvtOptions::default()).unwrap();
    let before = cvt.seeds().unwrap();
    let token = Token::default();
    token.cancel();
    assert!(matches!(cvt.lloyd(&token), Err(RvdError::Stopped(Stopped::Cancelled))));
    assert_eq!(cvt.seeds().unwrap(), before);
}

#[test]
fn bad_seeds_are_refused_by_name() {
    let mesh = Shape::Sphere.build(500);
    let surface = Arc::new(Surface::new(&mesh, None).unwrap());
    let open = |seeds: &[DVec3]| Cvt::new(&Serial, Arc::clone(&surface), seeds, CvtOptions::default()).err().unwrap();
    assert!(matches!(open(&[]), RvdError::NoSeeds));
    assert!(matches!(open(&[DVec3::X, DVec3::NAN]), RvdError::NonFiniteSeed { seed: 1 }));
    assert!(matches!(open(&[DVec3::X, DVec3::X * 1e9]), RvdError::SeedTooFar { seed: 1, .. }));
}
