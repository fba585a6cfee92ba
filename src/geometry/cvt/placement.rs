//! Where free seeds may be: on the surface, and clear of the curves.
//!
//! Purpose: [`Cvt::put_on_surface`] projects them; [`Cvt::keep_curves`] and what follows keep them from coming between two
//! neighbours of a curve.
//! Invariant: seeds that are held stay. Must not know: steps, how curves were found.

use std::collections::HashSet;

use glam::DVec3;

use super::Cvt;
use super::curves::{CurveSeeds, INNER_POINTS};
use crate::mesh::closest_point::ClosestPoint;
use crate::rvd::{RvdError, Surface};
use crate::token::Token;

/// Intruders that become seeds of a curve; more of them are a curve that the seeds cannot resolve.
const MOST_ADOPTED: usize = 64;

/// Times that seeds are pushed off curves after they were put on the surface: a moved seed may intrude elsewhere.
const PUSHES: usize = 4;

impl Cvt {
    /// Holds the first seeds, which are those of `curves`, and keeps the others clear of them in every Lloyd
    /// step.
    pub fn keep_curves(&mut self, curves: CurveSeeds, token: &Token) -> Result<(), RvdError> {
        self.hold((0..self.seeds.len()).map(|i| i < curves.len()).collect())?;
        self.curves = curves;
        self.clear_curves(token)?;
        Ok(())
    }

    /// Pushes seeds off the curves. Returns how many there were.
    pub fn clear_curves(&mut self, token: &Token) -> Result<usize, RvdError> {
        if self.curves.is_empty() {
            return Ok(0);
        }
        self.download()?;
        let mut seeds = self.seeds.clone();
        let pushed = self.curves.push_out(&mut seeds, token)?;
        if pushed > 0 {
            self.seeds = seeds;
            self.seeds_changed();
        }
        Ok(pushed)
    }

    /// Makes seeds that come between two neighbours on a curve, and could not be pushed off, seeds of that curve.
    /// Returns how many there were.
    pub fn adopt_intruders(&mut self, token: &Token) -> Result<usize, RvdError> {
        self.download()?;
        let mut adopted = 0;
        while adopted < MOST_ADOPTED {
            // One for each segment: another seed between the same two may be none once these have a new one between them. Seeds ascend, so
            // that none of those to come changes its number.
            let mut split = HashSet::new();
            let mut intruders = self.curves.intruders(&self.seeds, token)?;
            intruders.retain(|&(_, segment)| split.insert(segment));
            intruders.truncate(MOST_ADOPTED - adopted);
            if intruders.is_empty() {
                break;
            }
            for &(seed, segment) in &intruders {
                let place = self.curves.len();
                self.seeds.swap(place, seed as usize);
                self.held.swap(place, seed as usize);
                self.seeds[place] = self.curves.split(segment, INNER_POINTS / 2);
                self.held[place] = true;
            }
            adopted += intruders.len();
        }
        if adopted > 0 {
            self.seeds_changed();
        }
        Ok(adopted)
    }

    /// The curves' seeds, which are the first ones.
    pub fn curves(&self) -> &CurveSeeds {
        &self.curves
    }

    /// Moves every seed that is not held to the closest point of the surface.
    ///
    /// # Errors
    /// `Stopped`, with the seeds where they were; or `Internal`.
    pub fn project_seeds(&mut self, token: &Token) -> Result<(), RvdError> {
        self.download()?;
        let mut seeds = std::mem::take(&mut self.seeds);
        let done = self.project(&mut seeds, token);
        self.seeds = seeds;
        self.seeds_changed();
        done
    }

    /// Moves every seed that is not held to the closest point of the surface that is clear of the curves: along a sharp crease
    /// seeds lie inside, between its two sides, and the point that is closest to one may be between two seeds of the curve.
    ///
    /// # Errors
    /// `Stopped`, with the seeds somewhere between; or `Internal`.
    pub fn put_on_surface(&mut self, token: &Token) -> Result<(), RvdError> {
        self.project_seeds(token)?;
        for _ in 0..PUSHES {
            let held = &self.held;
            let stays = |i: u32| held.get(i as usize).is_some_and(|&held| held);
            if self.curves.is_empty() || self.curves.push_out_unless(&mut self.seeds, stays, token)? == 0 {
                break;
            }
            self.project_seeds(token)?;
        }
        Ok(())
    }

    fn project(&mut self, seeds: &mut [DVec3], token: &Token) -> Result<(), RvdError> {
        let closest = closest(&mut self.closest, &self.surface)?;
        let held = &self.held;
        let free = |i: usize| !held.get(i).is_some_and(|&held| held);
        let placed = closest.project_all(seeds, token)?;
        let moved = seeds.iter_mut().zip(placed).enumerate().filter(|(i, _)| free(*i));
        moved.for_each(|(_, (seed, place))| *seed = place.position);
        Ok(())
    }
}

/// What answers for closest points of a surface, made on first use.
pub(super) fn closest<'a>(slot: &'a mut Option<ClosestPoint>, surface: &Surface) -> Result<&'a ClosestPoint, RvdError> {
    match slot {
        Some(tree) => Ok(tree),
        None => Ok(slot.insert(surface.closest_points()?)),
    }
}
