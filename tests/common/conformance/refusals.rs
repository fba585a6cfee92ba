//! Limits, cancellation, and errors on which a caller can act.

use std::sync::Arc;
use std::time::Duration;

use glam::DVec3;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{CellSums, MAX_SEED_DISTANCE, PieceBatch, RvdError, SessionOptions};
use tessera::token::{Stopped, Token};

use super::input::{bumpy, shape, surface};
use super::{Claims, open, same_bits, sums};
use crate::points::noise;

pub fn no_seeds_and_too_many(claims: &Claims) {
    let surface = surface(&bumpy(2), None);
    let mut session = claims.backend().session(surface, SessionOptions::new(2000)).unwrap();
    assert!(matches!(session.set_seeds(&[]), Err(RvdError::NoSeeds)));
    let many = vec![DVec3::ZERO; 2001];
    assert!(matches!(session.set_seeds(&many), Err(RvdError::TooManySeeds { given: 2001, limit: 2000 })));
    session.set_seeds(&many[..2000]).unwrap();
}

pub fn seeds_out_of_range_are_named(claims: &Claims) {
    let surface = shape(Shape::Torus, 500, false);
    let near = noise(&surface, 50, 0.0, 9);
    let mut session = claims.backend().session(surface, SessionOptions::new(50)).unwrap();
    for (bad, at) in [(1.01 * MAX_SEED_DISTANCE, 7), (1e300, 0), (-f64::MAX, 49)] {
        let mut seeds = near.clone();
        seeds[at].y = bad;
        let error = session.set_seeds(&seeds).unwrap_err();
        assert!(matches!(error, RvdError::SeedTooFar { seed, .. } if seed == at), "{error}");
    }
    for bad in [f64::NAN, f64::INFINITY] {
        let mut seeds = near.clone();
        seeds[31].z = bad;
        let error = session.set_seeds(&seeds).unwrap_err();
        assert!(matches!(error, RvdError::NonFiniteSeed { seed: 31 }), "{error}");
    }
}

pub fn a_refusal_leaves_the_session_as_it_was(claims: &Claims) {
    let surface = shape(Shape::Torus, 500, false);
    let seeds = noise(&surface, 50, 0.0, 9);
    let (want, _) = sums(claims.backend(), &surface, &seeds);
    let mut session = open(claims.backend(), &surface, &seeds, SessionOptions::new(60));
    let mut got = CellSums::default();
    for wrong in [Vec::new(), vec![DVec3::X; 61], vec![DVec3::NAN; 3], vec![DVec3::splat(1e9); 50]] {
        session.set_seeds(&wrong).unwrap_err();
        session.sums(&mut got, &Token::default()).unwrap();
        same_bits("after a refusal", &got, &want);
    }
}

pub fn a_stopped_token_ends_a_pass_and_no_session(claims: &Claims) {
    let surface = shape(Shape::Torus, 2000, false);
    let seeds = noise(&surface, 500, 0.0, 9);
    let (want, _) = sums(claims.backend(), &surface, &seeds);
    let cancelled = Token::default();
    cancelled.cancel();
    let late = Token::with_time_limit(Duration::ZERO);
    let full = Token::default();
    full.stop(Stopped::Memory { used_bytes: 2, limit_bytes: 1 });
    let mut session = open(claims.backend(), &surface, &seeds, SessionOptions::new(seeds.len()));
    let (mut got, mut pieces) = (CellSums::default(), PieceBatch::default());
    for token in [cancelled, late, full] {
        let why = token.stopped().unwrap();
        // The first pass with these seeds, and one that has its neighbours.
        for _ in 0..2 {
            let error = session.sums(&mut got, &token).unwrap_err();
            assert!(matches!(&error, RvdError::Stopped(stopped) if *stopped == why), "{error}");
            let error = session.pieces(0..surface.facets().len() as u32, &mut pieces, &token).unwrap_err();
            assert!(matches!(&error, RvdError::Stopped(stopped) if *stopped == why), "{error}");
            if let Some(moving) = session.resident() {
                let error = moving.evaluate(&token).unwrap_err();
                assert!(matches!(&error, RvdError::Stopped(stopped) if *stopped == why), "{error}");
            }
            session.sums(&mut got, &Token::default()).unwrap();
            same_bits("after it was stopped", &got, &want);
        }
        session.set_seeds(&seeds).unwrap();
    }
    // Nothing is left over in a session of the same size either.
    let mut other = claims.backend().session(Arc::clone(&surface), SessionOptions::new(seeds.len())).unwrap();
    other.set_seeds(&seeds).unwrap();
    other.sums(&mut got, &Token::default()).unwrap();
    same_bits("another session", &got, &want);
}
