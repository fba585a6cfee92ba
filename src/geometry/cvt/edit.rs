//! Changes of the seeds between two steps.
//!
//! Purpose: [`Cvt::edit`] moves, adds and removes seeds; [`Cvt::hold`] and [`Cvt::pin`] keep some where they are.
//! Invariant: nothing is changed if one edit is wrong. Must not know: curves, steps.

use glam::DVec3;

use super::Cvt;
use crate::rvd::{RvdError, check_seeds};

/// A change of the seeds between two steps. Positions in the caller's coordinates.
#[derive(Clone, Debug, PartialEq)]
pub enum SeedEdit {
    /// Seed `index` goes to `to`.
    Move {
        /// Which seed.
        index: u32,
        /// Where it goes.
        to: DVec3,
    },
    /// A new seed, with the next index.
    Add {
        /// Where it is.
        at: DVec3,
    },
    /// Seed `index` goes away; the last seed takes its index.
    Remove {
        /// Which seed.
        index: u32,
    },
}

impl Cvt {
    /// Applies edits in order; nothing is changed if one of them is wrong.
    ///
    /// # Errors
    /// `TooManySeeds` beyond the room reserved, `NonFiniteSeed`, `NoSeeds` if none would be
    /// left, `NoSuchSeed`.
    pub fn edit(&mut self, edits: &[SeedEdit]) -> Result<(), RvdError> {
        self.download()?;
        let frame = self.surface.frame();
        let mut seeds = self.seeds.clone();
        let mut held = self.held.clone();
        held.resize(seeds.len(), false);
        for edit in edits {
            match *edit {
                SeedEdit::Move { index, to } => {
                    let count = seeds.len();
                    let seed = seeds
                        .get_mut(index as usize)
                        .ok_or(RvdError::NoSuchSeed { seed: index as usize, seeds: count })?;
                    *seed = frame.to_unit(to);
                }
                SeedEdit::Add { at } => {
                    if seeds.len() == self.options.max_seeds {
                        return Err(RvdError::TooManySeeds { given: seeds.len() + 1, limit: self.options.max_seeds });
                    }
                    seeds.push(frame.to_unit(at));
                    held.push(false);
                }
                SeedEdit::Remove { index } => {
                    if index as usize >= seeds.len() {
                        return Err(RvdError::NoSuchSeed { seed: index as usize, seeds: seeds.len() });
                    }
                    seeds.swap_remove(index as usize);
                    held.swap_remove(index as usize);
                }
            }
        }
        check_seeds(&seeds, self.options.max_seeds)?;
        self.seeds = seeds;
        if held.contains(&true) {
            self.held = held;
        }
        self.seeds_changed();
        Ok(())
    }

    /// Which seeds never move, one entry a seed.
    pub fn hold(&mut self, held: Vec<bool>) -> Result<(), RvdError> {
        if held.len() != self.seeds.len() {
            return Err(RvdError::Internal(format!("{} marks for {} seeds", held.len(), self.seeds.len())));
        }
        self.download()?;
        self.held = held;
        self.seeds_changed();
        Ok(())
    }

    /// Puts seeds at places (unit frame), where they stay, and adds and holds new ones as far as there is room.
    /// Returns how many could be added.
    pub fn pin(&mut self, pins: &[(u32, DVec3)], new: &[DVec3]) -> Result<usize, RvdError> {
        self.download()?;
        self.held.resize(self.seeds.len(), false);
        for &(seed, to) in pins {
            let seeds = self.seeds.len();
            let place = self.seeds.get_mut(seed as usize).ok_or(RvdError::NoSuchSeed { seed: seed as usize, seeds })?;
            (*place, self.held[seed as usize]) = (to, true);
        }
        let room = self.options.max_seeds - self.seeds.len().min(self.options.max_seeds);
        let added = new.len().min(room);
        self.seeds.extend(&new[..added]);
        self.held.resize(self.seeds.len(), true);
        self.seeds_changed();
        Ok(added)
    }

    /// Whether a seed never moves.
    pub fn is_held(&self, seed: u32) -> bool {
        self.held.get(seed as usize).is_some_and(|&held| held)
    }
}
