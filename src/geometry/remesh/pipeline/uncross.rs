//! Results whose facets cross each other.
//!
//! Purpose: chords leave a bent sheet by more than another sheet is away, and their facets cross. [`Job::uncross`] remeshes again with
//! shorter edges there, as long as fewer cross.
//! Invariant: of the results that lose no more curves, the one with the fewest crossing facets comes back. Where the input itself has some,
//! nothing changes.
//! Must not know: how a result is made.

use super::crossing::shorten_near;
use super::job::Job;
use super::prepare::with_source;
use super::tolerance::Attempt;
use crate::cvt::density::DensitySource;
use crate::mesh::crossings::crossing_facets;
use crate::remesh::constants::{MAX_CROSSING_ROUNDS, THIN_LONGEST};
use crate::remesh::{RemeshOptions, Result};

impl<'a> Job<'a, '_> {
    /// A result in place of `best` with fewer crossing facets, if there is one, and how many it has. `None` if some cross and the surface
    /// is `divisible`: divided, it has room for its cells.
    pub(super) fn uncross(
        &mut self,
        mut best: Attempt<'a>,
        (divisible, is_divided): (bool, bool),
        options: &RemeshOptions,
    ) -> Result<Option<(Attempt<'a>, usize)>> {
        let mut crossing = self.crossing(&best.built.mesh)?;
        if crossing.is_empty() || !crossing_facets(self.clean, self.token)?.is_empty() {
            return Ok(Some((best, crossing.len())));
        }
        if divisible {
            return Ok(None);
        }
        self.may_divide = false;
        let mut fewest = crossing.len();
        let mut lengths = best.plan.lengths(self.separated, self.token)?;
        shorten_near(&mut lengths, self.separated, (&best.built.mesh, &crossing), self.token)?;
        for _ in 0..MAX_CROSSING_ROUNDS {
            let options = with_source(options, DensitySource::Sizes(lengths));
            let Some(prepared) = self.prepare_again(&options, None)? else { break };
            let median = best.plan.figures.edge_median.zip(prepared.plan.figures.edge_median);
            if median.is_some_and(|(before, now)| now > THIN_LONGEST * before) {
                break;
            }
            let Ok(mut next) = self.attempt(prepared, &options, None) else { break };
            crossing = self.crossing(&next.built.mesh)?;
            lengths = next.plan.lengths(self.separated, self.token)?;
            shorten_near(&mut lengths, self.separated, (&next.built.mesh, &crossing), self.token)?;
            if !next.is_whole || crossing.len() >= fewest || next.lost_curves() > best.lost_curves() {
                best.figures.refine.evaluations += next.figures.passes();
                // Of a bent wall, edges may have to be shorter still.
                if is_divided && next.is_whole {
                    continue;
                }
                break;
            }
            fewest = crossing.len();
            next.plan.figures.source = best.plan.figures.source;
            next.figures.refine.evaluations += best.figures.passes();
            best = next;
            if fewest == 0 {
                break;
            }
        }
        self.token.check()?;
        if fewest > 0 {
            crossing = self.crossing(&best.built.mesh)?;
            fewest = self.divide_crossing(&mut best.built, crossing)?;
        }
        Ok(Some((best, fewest)))
    }
}
