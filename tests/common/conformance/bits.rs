//! The same seeds give the same bits: on another run, with other capacities, threads and tuning, in a session that had other seeds.

use std::sync::Arc;

use glam::DVec3;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{Accumulate, Capacities, CellSums, PieceBatch, SessionOptions, Strategy, Tuning};
use tessera::token::Token;

use super::input::{bumpy, hard_sets, seed_sets, shape, surface, weights};
use super::{Claims, everything, open, reference, same_bits, sums, sums_with, tiny};
use crate::points::noise;
use crate::surfaces;

pub fn another_run_and_other_capacities_change_no_bit(claims: &Claims) {
    let mesh = bumpy(4);
    let surface = surface(&mesh, Some(&weights(&mesh)));
    let seeds = noise(&surface, 3000, 0.0, 5);
    let options = SessionOptions::new(seeds.len());
    let (first, _) = sums_with(claims.backend(), &surface, &seeds, options);
    same_bits("again", &first, &sums(claims.backend(), &surface, &seeds).0);
    let roomy = Capacities::new().with_neighbours(4).with_cells(2).with_pairs_percent(10);
    let narrow = Capacities::new().with_neighbours(4).with_polygon(4).with_cells(1).with_pairs_percent(1);
    let with = |capacities| sums_with(claims.backend(), &surface, &seeds, options.with_capacities(capacities));
    let ((a, by_roomy), (b, by_narrow)) = (with(roomy), with(narrow));
    same_bits("few neighbours and cells", &first, &a);
    same_bits("narrow", &first, &b);
    if claims.relaunches {
        assert!(by_roomy.relaunched_neighbours > 0 && by_roomy.relaunched_cells > 0, "{by_roomy:?}");
        assert!(by_narrow.relaunched_polygon > 0, "{by_narrow:?}");
    }
}

pub fn capacities_and_threads_change_no_diagram(claims: &Claims) {
    for (k, (answer, reference)) in claims.diagrams().iter().zip(reference()).enumerate() {
        let (name, surface, seeds) = (&answer.name, &answer.surface, &answer.seeds);
        let options = SessionOptions::new(seeds.len());
        let mut tight = open(claims.backend(), surface, seeds, options.with_capacities(tiny()));
        let mut tried = vec![("tiny capacities", everything(&mut *tight, surface))];
        // A device is slow where it is a program: one in four will do.
        for twin in claims.twins.iter().filter(|_| claims.by_precision(true, k % 4 == 0)) {
            tried.push(("a twin", everything(&mut *open(twin.as_ref(), surface, seeds, options), surface)));
        }
        for (who, (sums, pieces, stats)) in &tried {
            same_bits(&format!("{name}, {who}"), sums, &answer.sums);
            assert!(*pieces == answer.pieces, "{name}: pieces of {who}");
            assert_eq!(stats.pairs, answer.stats.pairs, "{name}: pairs of {who}");
        }
        // Nothing ran out where every pair had to look at few.
        if name.ends_with("many") && claims.backend().kind() == tessera::rvd::BackendKind::Serial {
            assert!(tried[0].1.2.relaunched() > reference.stats.relaunched(), "{name}: nothing was relaunched");
        }
    }
    if !claims.relaunches {
        return;
    }
    for shape in Shape::ALL {
        let surface = surface(&shape.build(250), None);
        for (set, seeds) in hard_sets(&surface, 500) {
            let name = format!("{shape}, {set}");
            let options = SessionOptions::new(seeds.len());
            let usual = everything(&mut *open(claims.backend(), &surface, &seeds, options), &surface);
            let mut session = open(claims.backend(), &surface, &seeds, options.with_capacities(tiny()));
            let (sums, pieces, stats) = everything(&mut *session, &surface);
            same_bits(&name, &usual.0, &sums);
            assert!(usual.1 == pieces, "{name}: pieces differ");
            assert!(stats.relaunched_neighbours > 0, "{name}: {stats:?}");
            assert!(stats.relaunched_polygon > 0, "{name}: {stats:?}");
            assert!(stats.relaunched_cells > 0, "{name}: {stats:?}");
        }
    }
}

pub fn tuning_changes_no_bit(claims: &Claims) {
    // Every shape where pairs are found in several ways; a few where tuning has nothing to tune.
    for shape in Shape::ALL.into_iter().step_by(if claims.relaunches { 1 } else { 4 }) {
        // From some cells per facet to hundreds.
        let mesh = shape.build(60);
        let given = weights(&mesh);
        let surface = surface(&mesh, (shape != Shape::Torus).then_some(&given[..]));
        for (set, seeds) in hard_sets(&surface, 1500) {
            let with = |strategy, accumulate| {
                let tuning = Tuning::new().with_strategy(strategy).with_accumulate(accumulate);
                let options = SessionOptions::new(seeds.len()).with_tuning(tuning);
                everything(&mut *open(claims.backend(), &surface, &seeds, options), &surface)
            };
            let (sums, pieces, _) = with(Strategy::Facet, Accumulate::Direct);
            for (strategy, accumulate) in [
                (Strategy::Facet, Accumulate::TwoPhase),
                (Strategy::Cell, Accumulate::TwoPhase),
                (Strategy::Auto, Accumulate::Auto),
            ] {
                let name = format!("{shape}, {set}, {strategy:?}, {accumulate:?}");
                let (other_sums, other_pieces, _) = with(strategy, accumulate);
                same_bits(&name, &sums, &other_sums);
                assert!(pieces == other_pieces, "{name}: pieces differ");
            }
        }
    }
}

pub fn a_session_takes_one_seed_set_after_another(claims: &Claims) {
    let (_, mesh) = surfaces::all().swap_remove(0);
    let surface = surface(&mesh, None);
    let mut sets: Vec<Vec<DVec3>> = seed_sets(&surface).into_iter().map(|(_, seeds)| seeds).collect();
    sets.extend([(500, 1), (2000, 2), (17, 3), (500, 1)].map(|(n, seed)| noise(&surface, n, 0.0, seed)));
    let most = sets.iter().map(Vec::len).max().unwrap();
    let mut reused = claims.backend().session(Arc::clone(&surface), SessionOptions::new(most)).unwrap();
    for (k, seeds) in sets.iter().enumerate() {
        reused.set_seeds(seeds).unwrap();
        let (got, _, _) = everything(&mut *reused, &surface);
        same_bits(&format!("set {k}"), &got, &sums(claims.backend(), &surface, seeds).0);
    }
}

pub fn parts_of_the_surface_make_the_whole(claims: &Claims) {
    let surface = shape(Shape::Torus, 700, true);
    let seeds = noise(&surface, 900, 0.0, 11);
    let mut session = open(claims.backend(), &surface, &seeds, SessionOptions::new(seeds.len()));
    let whole = everything(&mut *session, &surface).1;
    let (mut parts, mut part) = (PieceBatch::default(), PieceBatch::default());
    let facets = surface.facets().len() as u32;
    for first in (0..facets).step_by(37) {
        session.pieces(first..(first + 37).min(facets), &mut part, &Token::default()).unwrap();
        parts.extend(&part);
    }
    assert!(whole == parts);
    session.pieces(5..5, &mut part, &Token::default()).unwrap();
    assert!(part.is_empty(), "no facet, no piece");
}

/// Seeds that move a little, a lot, or one of them far: what a backend keeps from pass to pass changes nothing.
pub fn seeds_that_move_have_the_sums_of_new_ones(claims: &Claims) {
    let surface = shape(Shape::Torus, 700, true);
    for (set, mut seeds) in seed_sets(&surface) {
        let mut session = claims.backend().session(Arc::clone(&surface), SessionOptions::new(seeds.len())).unwrap();
        let mut got = CellSums::default();
        for step in 0..10 {
            session.set_seeds(&seeds).unwrap();
            session.sums(&mut got, &Token::default()).unwrap();
            same_bits(&format!("{set}, step {step}"), &got, &sums(claims.backend(), &surface, &seeds).0);
            let jump = |i: usize| match step {
                5 => 0.1,
                7 if i == seeds.len() / 2 => 0.2,
                _ => 0.0,
            };
            seeds = (0..seeds.len()).map(|i| got.centroid(i, seeds[i]) + DVec3::splat(jump(i))).collect();
        }
    }
}
