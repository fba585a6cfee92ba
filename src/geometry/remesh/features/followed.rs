//! Curves that the edges of a result follow.
//!
//! Purpose: [`KeptCurves::lacking_shares`] tells how much of the curves a result lacks: what was dropped, and where chords are too long.
//! Invariant: a place of a curve is followed if any edge of any curve is near, as of a wall thinner than that. Must not know: how seeds
//! are placed.

use glam::DVec3;
use rstar::RTree;
use rstar::primitives::Line;

use super::KeptCurves;
use crate::mesh::TriMesh;
use crate::tasks;

impl KeptCurves {
    /// Shares of the length of curves: of what is dropped, and of what is farther than `most` from all of `edges` of `result`, caller's
    /// units. `place` of a point in the unit frame is where the input has it.
    pub(crate) fn lacking_shares(
        &self,
        place: impl Fn(DVec3) -> DVec3 + Sync,
        (result, edges): (&TriMesh, &[[u32; 2]]),
        most: f64,
    ) -> [f64; 2] {
        let at = |v: u32| result.positions()[v as usize].to_array();
        let tree = RTree::bulk_load(edges.iter().map(|&[a, b]| Line::new(at(a), at(b))).collect());
        let lengths = |k: usize| {
            let segment = &self.seeds.segments[k];
            if self.features.curves[segment.curve as usize].is_rim {
                return [0.0; 2];
            }
            let [from, to] = segment.ends.map(|end| self.seeds.seeds[end as usize]);
            let points = [from].into_iter().chain(segment.between).chain([to]).map(&place);
            let is_away = |p| tree.locate_within_distance(p, most * most).next().is_none();
            let places: Vec<_> = points.map(|p| (p, is_away(p.to_array()))).collect();
            places.windows(2).fold([0.0; 2], |[all, away], ends| {
                let length = ends[0].0.distance(ends[1].0);
                let share = 0.5 * ends.iter().filter(|(_, is_away)| *is_away).count() as f64;
                [all + length, away + share * length]
            })
        };
        let lengths = tasks::map(self.seeds.segments.len(), lengths);
        let dropped: f64 = self.dropped.iter().map(|curve| curve.length).sum();
        let [with_seeds, away] = lengths.iter().fold([0.0; 2], |sum, of| [sum[0] + of[0], sum[1] + of[1]]);
        let all = dropped + with_seeds;
        if all > 0.0 { [dropped / all, away / all] } else { [0.0; 2] }
    }
}
