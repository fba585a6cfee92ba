//! Seeds that move where a session keeps them: evaluations, steps and gradients are those of the reference's sums.
//!
//! A session whose seeds lie in the host's memory alone has none of this, and nothing to show.

use std::sync::Arc;

use glam::DVec3;
use tessera::mesh::sample::sample;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{CellSums, RvdError, Serial, Session, SessionOptions, Surface, Together, Tuning};
use tessera::token::{Stopped, Token};

use super::input::{shape, surface, weights};
use super::{Claims, Precision, open, sums, tiny};
use crate::points::{many_sets, noise};
use crate::sessions::{evaluate, minimise, probe, read};

fn session(claims: &Claims, surface: &Arc<Surface>, seeds: &[DVec3]) -> Box<dyn Session> {
    open(claims.backend(), surface, seeds, SessionOptions::new(seeds.len()))
}

fn close(name: &str, got: f64, want: f64, relative: f64) {
    assert!((got - want).abs() <= relative * want.abs(), "{name}: {got:e} for {want:e}");
}

/// Along the way to the centroids of all seeds, and of every third one alone.
pub fn the_gradient_is_that_of_the_energy(claims: &Claims) {
    let never = Token::default();
    for (shape, n) in [(Shape::Torus, 60), (Shape::Block, 80), (Shape::Hills, 50)] {
        let mesh = shape.build(600);
        for weighted in [false, true] {
            let given = weights(&mesh);
            let surface = surface(&mesh, weighted.then_some(&given[..]));
            let drawn = sample(&mesh, None, n, 1);
            let seeds: Vec<DVec3> = drawn.iter().map(|p| surface.frame().to_unit(p.position)).collect();
            let mut session = session(claims, &surface, &seeds);
            let Some(moving) = session.resident() else { return };
            for every in [1, 3] {
                let held: Vec<bool> = (0..n).map(|i| i % every != 0).collect();
                moving.hold(&held).unwrap();
                let here = moving.evaluate(&never).unwrap();
                let slope = moving.search_direction().unwrap();
                // Seeds move by this share of a cell's width in the mean. Truncation is up to 17 times the square
                // of it (beside sharp edges); in single precision the energies are known to 1e-6 or better,
                // and the step has to be long against that.
                let share = claims.by_precision(1e-4, 1e-2);
                let width = (surface.area() / n as f64).sqrt();
                let mut sums = CellSums::default();
                moving.read_sums(&mut sums).unwrap();
                let free = || (0..n).filter(|i| i % every == 0);
                let way = |i: usize| sums.moment[i].length_squared() / sums.mass[i] / sums.mass[i];
                let step = share * width * ((n / every) as f64 / free().map(way).sum::<f64>()).sqrt();
                let ahead = moving.probe(step, &never).unwrap();
                let behind = moving.probe(-step, &never).unwrap();
                let found = (ahead.energy - behind.energy) / (2.0 * step);
                let off = (found / slope - 1.0).abs();
                let name = format!("{shape}, weighted {weighted}, one in {every}");
                println!("{name}: off by {off:e}");
                assert!(off < claims.by_precision(1e-6, 5e-3), "{name}: {found:e}, not {slope:e}");
                // Without a history the direction is -g over twice the masses; what is held has no part in it.
                let rounding = claims.by_precision(1e-12, 1e-5);
                let part = |i: usize| 2.0 * sums.moment[i].length_squared();
                let squared: f64 = free().map(|i| 2.0 * part(i)).sum();
                assert!((here.gradient_squared / squared - 1.0).abs() < rounding, "{name}");
                let want: f64 = free().map(|i| part(i) / sums.mass[i]).sum();
                assert!((slope / want + 1.0).abs() < rounding, "{name}: {slope:e}, not {want:e}");
            }
        }
    }
}

/// Component by component, by the energies of a seed moved along an axis, against the moments of the sums.
pub fn every_component_of_the_gradient_is_right(claims: &Claims) {
    let mesh = Shape::Torus.build(400);
    let given = weights(&mesh);
    for weighted in [None, Some(&given[..])] {
        let surface = surface(&mesh, weighted);
        let drawn = sample(&mesh, None, 12, 1);
        let mut seeds: Vec<DVec3> = drawn.iter().map(|p| surface.frame().to_unit(p.position)).collect();
        let mut session = session(claims, &surface, &seeds);
        let mut sums = CellSums::default();
        session.sums(&mut sums, &Token::default()).unwrap();
        let gradient: Vec<DVec3> = sums.moment.iter().map(|&m| -2.0 * m).collect();
        let norm = gradient.iter().map(|g| g.length_squared()).sum::<f64>().sqrt();
        let mut energy = |seeds: &[DVec3]| {
            session.set_seeds(seeds).unwrap();
            session.sums(&mut sums, &Token::default()).unwrap();
            sums.energy.iter().sum::<f64>()
        };
        // Rounding of E over the step, and its square.
        let (step, tolerance) = claims.by_precision((1e-5, 1e-7), (3e-3, 1e-2));
        for i in 0..seeds.len() {
            for axis in 0..3 {
                let place = seeds[i][axis];
                seeds[i][axis] = place + step;
                let ahead = energy(&seeds);
                seeds[i][axis] = place - step;
                let found = (ahead - energy(&seeds)) / (2.0 * step);
                seeds[i][axis] = place;
                let off = (found - gradient[i][axis]).abs() / norm;
                assert!(off < tolerance, "seed {i}, axis {axis}: {found:e}, off by {off:e} of the gradient");
            }
        }
    }
}

pub fn a_step_goes_to_the_centroids(claims: &Claims) {
    let surface = shape(Shape::Torus, 1500, true);
    let (single, double) = (claims.precision() == Precision::Single, claims.precision() == Precision::Double);
    for (name, seeds) in many_sets(&surface, 800) {
        let want = sums(&Serial, &surface, &seeds).0;
        let mut session = session(claims, &surface, &seeds);
        let Some(moving) = session.resident() else { return };
        let evaluation = evaluate(moving);
        // Energy and area are sums of f32 pieces, each good to about 1e-6 and without a common error; the
        // gradient of a cell is as good as its boundary.
        let slack = |single: f64| claims.by_precision(1e-9, single);
        let gradient_squared = want.moment.iter().map(|m| 4.0 * m.length_squared()).sum();
        close(&format!("{name}, energy"), evaluation.energy, want.energy.iter().sum(), slack(2e-6));
        close(&format!("{name}, area"), evaluation.area, surface.area(), slack(1e-6));
        close(&format!("{name}, gradient"), evaluation.gradient_squared, gradient_squared, slack(1e-4));
        // A cell that is nearly a point may be none in floats.
        let smallest = |least: f64| want.area.iter().filter(|a| **a <= least * surface.area()).count();
        let most = if single { smallest(1e-8) } else { smallest(0.0) };
        assert!((smallest(0.0)..=most).contains(&evaluation.empty_cells), "{name}: {}", evaluation.empty_cells);
        let mut own = CellSums::default();
        moving.read_sums(&mut own).unwrap();
        close(&format!("{name}, sums"), own.energy.iter().sum(), evaluation.energy, 1e-12);
        moving.to_centroids().unwrap();
        let moved = read(moving);
        let h = (surface.area() / seeds.len() as f64).sqrt();
        if name == "nearly in one place" {
            // Where a seed is is known to 4e-12 of the box, so the boundary of two that are 1e-9 apart to a hundredth.
            continue;
        }
        for (i, p) in moved.iter().enumerate() {
            let target = want.centroid(i, seeds[i]);
            let mean = want.mass.iter().sum::<f64>() / seeds.len() as f64;
            // Moment and mass are good to 1e-5 of those of a mean cell, so that a float does not know well the middle of a cell
            // that is nearly a point; a long step rounds to 1e-7 of itself.
            let slack = match double {
                true if want.mass[i] < 1e-4 * mean => 0.1 * h,
                true => 1e-7 * h + 1e-11 * target.distance(seeds[i]),
                false => h * (1e-5 * mean / want.mass[i]).clamp(1e-4, 0.1) + 1e-6 * target.distance(seeds[i]),
            };
            assert!(p.distance(target) < slack, "{name}: seed {i} is off by {:e}", p.distance(target));
        }
    }
}

pub fn energies_along_the_direction_have_the_slope_of_the_gradient(claims: &Claims) {
    let surface = shape(Shape::Sphere, 1200, true);
    let seeds = noise(&surface, 300, 0.01, 3);
    let mut session = session(claims, &surface, &seeds);
    let Some(moving) = session.resident() else { return };
    let here = evaluate(moving);
    let slope = moving.search_direction().unwrap();
    // Without a history the direction is -g over twice the masses, the way to the centroids.
    let mut sums = CellSums::default();
    moving.read_sums(&mut sums).unwrap();
    let cells = || sums.moment.iter().zip(&sums.mass);
    close("slope", slope, -cells().map(|(m, mass)| 2.0 * m.length_squared() / mass).sum::<f64>(), 1e-5);
    // The steps are small against a cell, 0.1, and the energies' differences large against their rounding.
    let longest = (surface.area() / 300.0).sqrt() * 0.01;
    let step = longest * (300.0 / cells().map(|(m, mass)| m.length_squared() / mass / mass).sum::<f64>()).sqrt();
    let (ahead, behind) = (probe(moving, step), probe(moving, -step));
    close("difference", (ahead.energy - behind.energy) / (2.0 * step), slope, 2e-3);
    // And the slopes at both ends are those of the energies beyond them, on average.
    close("slopes", 0.5 * (ahead.slope + behind.slope), slope, 2e-2);
    // x was never left.
    let again = evaluate(moving);
    assert_eq!((again.energy, again.gradient_squared), (here.energy, here.gradient_squared));
    for (p, q) in read(moving).iter().zip(&seeds) {
        // As a device splits them.
        assert!(p.distance(*q) < 1e-10);
    }
}

pub fn quasi_newton_steps_go_down(claims: &Claims) {
    let surface = shape(Shape::Torus, 2000, false);
    let seeds = noise(&surface, 500, 0.0, 4);
    let mut session = session(claims, &surface, &seeds);
    let Some(moving) = session.resident() else { return };
    let (energies, _) = minimise(moving, 5, 25);
    assert!(energies.windows(2).all(|e| e[1] < e[0]), "{energies:?}");
    let (last, moved) = (energies.last().unwrap(), read(moving));
    let ratio = last / surface.hexagonal_energy(500);
    eprintln!("energies {:?}, ratio {ratio}", &energies[..6]);
    // Lloyd alone is at about 1.06 then.
    assert!(ratio < 1.03, "{ratio}");
    let reference = |seeds: &[DVec3]| sums(&Serial, &surface, seeds).0.energy.iter().sum::<f64>();
    close("energy", *last, reference(&moved), 1e-6);
    // The session goes on from there.
    let mut sums = CellSums::default();
    session.sums(&mut sums, &Token::default()).unwrap();
    close("session", sums.energy.iter().sum(), *last, 1e-9);
    session.set_seeds(&seeds[..400]).unwrap();
    let moving = session.resident().unwrap();
    close("fewer", evaluate(moving).energy, reference(&seeds[..400]), 1e-6);
    assert_eq!(read(moving).len(), 400);
}

pub fn a_run_has_the_same_bits_twice(claims: &Claims) {
    let surface = shape(Shape::Torus, 800, true);
    for (name, seeds) in [("noise", noise(&surface, 400, 0.0, 5)), many_sets(&surface, 400).swap_remove(6)] {
        let run = |backend: &dyn tessera::rvd::Backend, capacities| {
            let options = SessionOptions::new(400).with_capacities(capacities);
            let mut session = open(backend, &surface, &seeds, options);
            session.resident().map(|moving| (minimise(moving, 3, 8).0, read(moving)))
        };
        let usual = tessera::rvd::Capacities::default();
        let first = run(claims.backend(), usual);
        assert!(first == run(claims.backend(), usual), "{name}: another run");
        // Integers have one sum; floats may be added up in another order (`Capacities`).
        let tight = run(claims.backend(), tiny());
        match claims.precision() {
            Precision::Single => assert!(first == tight, "{name}: other capacities"),
            Precision::Double => {
                let Some(((a, _), (b, _))) = first.as_ref().zip(tight.as_ref()) else { continue };
                close(&format!("{name}, other capacities"), b[0], a[0], 1e-12);
                close(&format!("{name}, other capacities, at the end"), b[a.len() - 1], a[a.len() - 1], 1e-3);
            }
        }
        for twin in &claims.twins {
            assert!(first == run(twin.as_ref(), usual), "{name}: a twin");
        }
    }
}

pub fn held_seeds_do_not_move(claims: &Claims) {
    let surface = shape(Shape::Sphere, 500, false);
    let seeds = noise(&surface, 200, 0.0, 6);
    let held: Vec<bool> = (0..200).map(|i| i % 3 == 0).collect();
    let mut session = session(claims, &surface, &seeds);
    let Some(moving) = session.resident() else { return };
    let before = read(moving);
    moving.hold(&held).unwrap();
    let evaluation = evaluate(moving);
    let sums = sums(&Serial, &surface, &seeds).0;
    let free = |i: &usize| !held[*i];
    let want: f64 = (0..200).filter(free).map(|i| 4.0 * sums.moment[i].length_squared()).sum();
    close("gradient", evaluation.gradient_squared, want, 1e-4);
    minimise(moving, 3, 6);
    let after = read(moving);
    for i in 0..200 {
        assert_eq!(before[i] == after[i], held[i], "seed {i}");
    }
    assert!(moving.hold(&held[..100]).is_err());
}

pub fn twins_stay_and_clusters_spread(claims: &Claims) {
    let surface = shape(Shape::Torus, 800, false);
    let sets = many_sets(&surface, 400);
    let by_name = |name: &str| sets.iter().find(|s| s.0 == name).unwrap().1.clone();
    let twins = by_name("twins");
    let mut apart = session(claims, &surface, &twins);
    let Some(moving) = apart.resident() else { return };
    let evaluation = evaluate(moving);
    assert_eq!((evaluation.empty_cells, evaluation.stats.duplicate_seeds), (201, 201));
    let before = read(moving);
    moving.to_centroids().unwrap();
    let after = read(moving);
    assert!((200..401).all(|i| before[i] == after[i]), "a later duplicate has moved");
    assert!((0..200).all(|i| before[i] != after[i]));
    let mut session = session(claims, &surface, &by_name("cluster"));
    let (energies, _) = minimise(session.resident().unwrap(), 10, 10);
    assert!(energies.windows(2).all(|e| e[1] < e[0]), "{energies:?}");
}

pub fn a_seed_that_leaves_the_range_is_named_and_x_stays(claims: &Claims) {
    let surface = shape(Shape::Sphere, 300, false);
    let seeds = noise(&surface, 50, 0.0, 7);
    let mut held = vec![false; 50];
    held[0] = true;
    let mut session = session(claims, &surface, &seeds);
    let Some(moving) = session.resident() else { return };
    moving.hold(&held).unwrap();
    let here = evaluate(moving);
    moving.search_direction().unwrap();
    let never = Token::default();
    // Seed 0 is held, so seed 1 is the first that leaves.
    let far = moving.probe(1e12, &never).unwrap_err();
    assert!(matches!(far, RvdError::SeedTooFar { seed: 1, boxes } if boxes > 1e6), "{far}");
    let infinite = moving.probe(f64::INFINITY, &never).unwrap_err();
    assert!(matches!(infinite, RvdError::NonFiniteSeed { .. }), "{infinite}");
    // Far, but within the range: single precision leaves it to the host.
    let evaluation = moving.probe(100.0 / here.gradient_squared.sqrt(), &never).unwrap();
    assert!(evaluation.energy > here.energy);
    assert!(claims.precision() == Precision::Double || evaluation.stats.host_searches > 0);
    assert!(moving.probe(-0.0, &never).unwrap().energy == here.energy);
    let cancelled = Token::default();
    cancelled.cancel();
    assert!(matches!(moving.evaluate(&cancelled), Err(RvdError::Stopped(Stopped::Cancelled))));
    assert_eq!(evaluate(moving).energy, here.energy);
}

/// Lloyd steps one by one and as many at a time as a submission may have: the same evaluations, the same places.
pub fn steps_taken_together_are_those_taken_one_by_one(claims: &Claims) {
    let surface = shape(Shape::Torus, 1500, true);
    let seeds = noise(&surface, 400, 0.0, 9);
    let relaxed = |together: Option<usize>| {
        let tuning = together.map_or(Tuning::new(), |most| Tuning::new().with_together(Together::AtMost(most)));
        let options = SessionOptions::new(seeds.len()).with_tuning(tuning);
        let mut session = open(claims.backend(), &surface, &seeds, options);
        let moving = session.resident()?;
        let mut evaluations = Vec::new();
        while evaluations.len() < 12 {
            let (before, most) = (evaluations.len(), if together.is_some() { 12 - evaluations.len() } else { 1 });
            moving.relax(most, &mut evaluations, &Token::default()).unwrap();
            assert!(evaluations.len() > before && evaluations.len() <= before + most);
        }
        let figures: Vec<[f64; 3]> = evaluations.iter().map(|e| [e.energy, e.gradient_squared, e.area]).collect();
        Some((figures, read(moving)))
    };
    assert!(relaxed(None) == relaxed(Some(8)));
}
