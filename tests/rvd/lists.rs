//! Promise: the lists of neighbours that the backend for many cores keeps from pass to pass are kept where seeds move little, and
//! change no bit.

use std::sync::Arc;

use crate::conformance::input::seed_sets;
use crate::conformance::open;
use crate::points::{on_surface, rng};
use crate::surfaces;
use glam::DVec3;
use rand::RngExt;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{Backend, CellSums, Parallel, SessionOptions, Surface};
use tessera::token::Token;

#[test]
fn lists_that_are_kept_change_nothing() {
    let backend = Parallel::new(Some(2)).unwrap();
    let flag = Token::default();
    let (mut kept, mut strays) = (0, 0);
    for (name, mesh) in surfaces::all() {
        let weights: Vec<f64> = (0..mesh.positions().len()).map(|v| 0.1 + (v % 7) as f64).collect();
        for weights in [None, Some(&weights[..])] {
            let surface = Arc::new(Surface::new(&mesh, weights).unwrap());
            for (kind, mut seeds) in seed_sets(&surface) {
                let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(seeds.len())).unwrap();
                let mut sums = CellSums::default();
                let mut later = if seeds.len() > 1 { seeds.pop() } else { None };
                for step in 0..16 {
                    // Lloyd's steps, which get smaller, a jump, one that goes astray, and a new seed.
                    session.set_seeds(&seeds).unwrap();
                    let stats = session.sums(&mut sums, &flag).unwrap();
                    kept += u32::from(stats.neighbours_ms == 0.0);
                    let mut fresh = backend.session(Arc::clone(&surface), SessionOptions::new(seeds.len())).unwrap();
                    fresh.set_seeds(&seeds).unwrap();
                    let mut want = CellSums::default();
                    fresh.sums(&mut want, &flag).unwrap();
                    assert!(sums == want, "{name}, {kind}, {}: step {step}", weights.is_some());
                    let jump = |i: usize| match step {
                        8 => 0.1,
                        11 if i == seeds.len() / 2 => 0.2,
                        _ => 0.0,
                    };
                    seeds = (0..seeds.len()).map(|i| sums.centroid(i, seeds[i]) + DVec3::splat(jump(i))).collect();
                    strays += u32::from(step > 11 && stats.neighbours_ms == 0.0);
                    if step == 13 {
                        seeds.extend(later.take());
                    }
                }
            }
        }
    }
    assert!(kept > 20, "lists were kept in {kept} passes");
    assert!(strays > 10, "lists were kept in {strays} passes with strays or after them");
}

/// Passes in which most seeds stay near where they were and some go astray, far enough to change cells that they
/// had nothing to do with, or come back.
#[test]
fn seeds_that_go_astray_change_nothing_elsewhere() {
    let backend = Parallel::new(Some(2)).unwrap();
    let flag = Token::default();
    let mut rng = rng(11);
    // Facets deep in cells, about as many facets as seeds, and facets with several cells; and most seeds in one place.
    let cases = [
        (Shape::Torus, 6000, 300, false),
        (Shape::Torus, 3000, 1500, false),
        (Shape::Torus, 600, 1500, false),
        (Shape::Sphere, 5000, 1200, true),
    ];
    for (shape, facets, count, crowded) in cases {
        let surface = Arc::new(Surface::new(&shape.build(facets), None).unwrap());
        let mut seeds: Vec<DVec3> = on_surface(&surface, count, &mut rng).into_iter().map(|x| x.1).collect();
        if crowded {
            let near = |p: &DVec3| p.x > 0.2 && p.y > 0.2;
            let others: Vec<DVec3> = on_surface(&surface, 20 * count, &mut rng).into_iter().map(|x| x.1).collect();
            seeds.iter_mut().zip(others.into_iter().filter(near)).skip(200).for_each(|(seed, p)| *seed = p);
        }
        let spacing = (surface.area() / count as f64).sqrt();
        let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(count)).unwrap();
        let (mut sums, mut want) = (CellSums::default(), CellSums::default());
        let mut kept = 0;
        for pass in 0..60 {
            session.set_seeds(&seeds).unwrap();
            kept += u32::from(session.sums(&mut sums, &flag).unwrap().neighbours_ms == 0.0);
            let mut fresh = open(&backend, &surface, &seeds, SessionOptions::new(seeds.len()));
            fresh.sums(&mut want, &flag).unwrap();
            assert!(sums == want, "{shape}, {count} seeds: pass {pass}");
            let mut by = |size: f64| size * DVec3::from_array([(); 3].map(|()| rng.random::<f64>() - 0.5));
            seeds.iter_mut().for_each(|seed| *seed += by(0.01 * spacing));
            for k in 0..pass % 6 {
                let who = (pass * 37 + k * 101) % count;
                seeds[who] += by([0.5, 2.0, 6.0][k % 3] * spacing);
            }
        }
        assert!(kept > 20, "{shape}, {count} seeds: lists were kept in {kept} passes");
    }
}

/// Seeds that go the same way pass after pass, and then turn: lists are made about places ahead of them, and serve until
/// they have left these behind.
#[test]
fn lists_made_ahead_of_seeds_change_nothing() {
    let backend = Parallel::new(Some(2)).unwrap();
    let flag = Token::default();
    // Facets that are smaller and larger than cells, with weights and without.
    for (facets, count, weighted) in [(6000, 600, false), (6000, 600, true), (1500, 1500, false)] {
        let mesh = Shape::Torus.build(facets);
        let weights: Vec<f64> = (0..mesh.positions().len()).map(|v| 0.1 + (v % 7) as f64).collect();
        let surface = Arc::new(Surface::new(&mesh, weighted.then_some(&weights[..])).unwrap());
        let mut seeds: Vec<DVec3> = on_surface(&surface, count, &mut rng(5)).into_iter().map(|x| x.1).collect();
        let spacing = (surface.area() / count as f64).sqrt();
        let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(count)).unwrap();
        let (mut sums, mut want) = (CellSums::default(), CellSums::default());
        // Cells that are as even as those of a run.
        for _ in 0..10 {
            session.set_seeds(&seeds).unwrap();
            session.sums(&mut sums, &flag).unwrap();
            seeds = (0..count).map(|i| sums.centroid(i, seeds[i])).collect();
        }
        let mut kept = 0;
        for pass in 0..50 {
            session.set_seeds(&seeds).unwrap();
            kept += u32::from(session.sums(&mut sums, &flag).unwrap().neighbours_ms == 0.0);
            let mut fresh = open(&backend, &surface, &seeds, SessionOptions::new(seeds.len()));
            fresh.sums(&mut want, &flag).unwrap();
            assert!(sums == want, "{facets} facets, {count} seeds: pass {pass}");
            // Around the axis of the torus, each seed at its own pace, and back in the end.
            let step = if pass < 40 { 0.05 * spacing } else { -0.08 * spacing };
            let away = |i: usize| step * (0.5 + 0.5 * (i % 7) as f64 / 6.0);
            seeds.iter_mut().enumerate().for_each(|(i, p)| *p += away(i) * DVec3::Z.cross(*p).normalize());
        }
        // A slack of a fifth of the spacing is used up after four or five such steps; made where seeds are, lists were kept
        // in 37 passes. About places ahead they serve for seven to nine.
        println!("{facets} facets, {count} seeds: lists were kept in {kept} passes");
        assert!(kept >= 41, "{facets} facets, {count} seeds: lists were kept in {kept} passes of 50");
    }
}
