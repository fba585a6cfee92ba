//! What every session checks of new seeds.
//!
//! Invariant: seeds that were taken are finite and within [`MAX_SEED_DISTANCE`]. Must not know: backends.

use glam::DVec3;

use super::error::{MAX_SEED_DISTANCE, RvdError};
use super::surface;

/// What every session checks of new seeds.
pub fn check_seeds(seeds: &[DVec3], limit: usize) -> Result<(), RvdError> {
    if seeds.is_empty() {
        return Err(RvdError::NoSeeds);
    }
    if seeds.len() > limit {
        return Err(RvdError::TooManySeeds { given: seeds.len(), limit });
    }
    seeds.iter().enumerate().try_for_each(|(seed, &p)| check_seed(seed, p))
}

/// What every session checks of one seed.
pub fn check_seed(seed: usize, p: DVec3) -> Result<(), RvdError> {
    if !p.is_finite() {
        return Err(RvdError::NonFiniteSeed { seed });
    }
    let boxes = p.abs().max_element();
    if boxes > MAX_SEED_DISTANCE {
        return Err(RvdError::SeedTooFar { seed, boxes });
    }
    Ok(())
}

/// Checks new seeds and takes them, on the grid of [`surface::snap`].
pub fn take_seeds(seeds: &[DVec3], limit: usize, into: &mut Vec<DVec3>) -> Result<(), RvdError> {
    check_seeds(seeds, limit)?;
    into.clear();
    into.extend(seeds.iter().map(|&p| surface::snap(p)));
    Ok(())
}
