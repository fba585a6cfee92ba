//! Polygons that are not convex.
//!
//! Purpose: readers make a fan of every polygon, which is right for convex ones. [`recut`] finds those of which it is not,
//! as some of its triangles would lie outside, turned over, and cuts them by clipping ears (`earcut`).
//! Invariant: a polygon of n corners stays n - 2 facets with each of its corners, so that neighbours keep their edges; one
//! that crosses itself, of which nothing would be right, keeps its fan. What stands for the corners beside the facets can be
//! cut in the same way ([`Cut::apply`]). Must not know: formats.

use earcut::Earcut;
use earcut::utils3d::project3d_to_2d;
use glam::DVec3;

use crate::mesh::normal;

/// The facets of a polygon with more than three corners: the first of them and how many there are.
pub(super) type Fan = (u32, u32);

/// One with more corners keeps its fan: the time that ears take may go by the square of the corners.
const MOST: u32 = 1 << 14;
/// A fan's triangle is turned over if it is so by more than rounding: this share of the polygon's area.
const TURNED: f64 = 1e-9;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cut {
    first: u32,
    /// Numbers of the polygon's corners, from 0.
    triangles: Vec<[u32; 3]>,
}

impl Cut {
    pub(super) fn apply(&self, facets: &mut [[u32; 3]]) {
        let fan = facets.get_mut(self.first as usize..).and_then(|f| f.get_mut(..self.triangles.len()));
        let Some(fan) = fan else { return };
        let ring = ring(fan);
        fan.iter_mut().zip(&self.triangles).for_each(|(facet, cut)| *facet = cut.map(|corner| ring[corner as usize]));
    }
}

/// The corners of a fan in order.
fn ring(fan: &[[u32; 3]]) -> Vec<u32> {
    let first = fan.iter().take(1).flat_map(|t| [t[0], t[1]]);
    first.chain(fan.iter().map(|t| t[2])).collect()
}

pub(super) fn recut(positions: &[DVec3], facets: &[[u32; 3]], fans: &[Fan]) -> Vec<Cut> {
    let mut scratch = Scratch::default();
    let mut cuts = Vec::new();
    for &(first, count) in fans.iter().filter(|fan| fan.1 < MOST) {
        let fan = facets.get(first as usize..).and_then(|f| f.get(..count as usize)).unwrap_or_default();
        let place = |v: u32| positions.get(v as usize).copied().unwrap_or(DVec3::NAN);
        if is_right(fan, place) {
            continue;
        }
        cuts.extend(scratch.cut(&ring(fan), place).map(|triangles| Cut { first, triangles }));
    }
    cuts
}

/// Whether no triangle of a fan is turned over.
fn is_right(fan: &[[u32; 3]], place: impl Fn(u32) -> DVec3) -> bool {
    let twice = |t: &[u32; 3]| normal(t.map(&place));
    let whole: DVec3 = fan.iter().map(twice).sum();
    let least = -TURNED * whole.length_squared();
    // Positions that are not finite are refused later.
    !fan.iter().any(|t| twice(t).dot(whole) < least)
}

#[derive(Default)]
struct Scratch {
    corners: Vec<[f64; 3]>,
    flat: Vec<[f64; 2]>,
    ears: Vec<u32>,
    earcut: Earcut<f64>,
}

impl Scratch {
    /// `None` if the polygon cannot be cut, or if the cut is no better than the fan.
    fn cut(&mut self, ring: &[u32], place: impl Fn(u32) -> DVec3) -> Option<Vec<[u32; 3]>> {
        let corners: Vec<DVec3> = ring.iter().map(|&v| place(v)).collect();
        let low = corners.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let extent = (corners.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max) - low).max_element();
        if !(extent.is_finite() && extent > 0.0) {
            return None;
        }
        // So that no square leaves the range.
        self.corners.clear();
        self.corners.extend(corners.iter().map(|&p| ((p - low) / extent).to_array()));
        if !project3d_to_2d(&self.corners, self.corners.len(), &mut self.flat) {
            return None;
        }
        self.earcut.earcut_slice::<u32>(&self.flat, &[], &mut self.ears);
        let mut triangles = self.ears.as_chunks::<3>().0.to_vec();
        let twice = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|k| self.flat[k as usize]);
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        let whole: f64 = (2..ring.len() as u32).map(|k| twice(&[0, k - 1, k])).sum();
        // Both ways around are possible; a facet is oriented as its polygon.
        let turned = triangles.iter().map(twice).sum::<f64>() * whole < 0.0;
        if turned {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        put_back(&mut triangles, ring.len() as u32);
        let area = |t: &[u32; 3]| twice(t).abs();
        let is_whole = (triangles.iter().map(area).sum::<f64>() - whole.abs()).abs() <= 1e-6 * whole.abs();
        (triangles.len() + 2 == ring.len() && is_whole).then_some(triangles)
    }
}

/// Puts corners that lie on a line with their neighbours, and were left out, into the edges that pass them by.
fn put_back(triangles: &mut Vec<[u32; 3]>, corners: u32) {
    let mut there = vec![false; corners as usize];
    triangles.iter().flatten().for_each(|&c| there[c as usize] = true);
    let Some(first) = (0..corners).find(|&c| there[c as usize]) else { return };
    let mut from = first;
    for k in 1..=corners {
        let corner = (first + k) % corners;
        if !there[corner as usize] {
            // The next one that is there.
            let to = (1..=corners).map(|k| (corner + k) % corners).find(|&c| there[c as usize]).unwrap_or(first);
            let edge = triangles.iter().position(|t| (0..3).any(|s| t[s] == from && t[(s + 1) % 3] == to));
            let Some(at) = edge else { return };
            let t = triangles[at];
            let across = t.into_iter().find(|&c| c != from && c != to).unwrap_or(from);
            triangles[at] = [from, corner, across];
            triangles.push([corner, to, across]);
            there[corner as usize] = true;
        }
        from = corner;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// The facets that a polygon becomes.
    fn cut(places: &[DVec3]) -> Vec<[u32; 3]> {
        let n = places.len() as u32;
        let mut facets: Vec<[u32; 3]> = (2..n).map(|k| [0, k - 1, k]).collect();
        recut(places, &facets.clone(), &[(0, n - 2)]).iter().for_each(|cut| cut.apply(&mut facets));
        facets
    }

    fn area(places: &[DVec3], facets: &[[u32; 3]]) -> (f64, f64) {
        let cross = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| places[v as usize]);
            0.5 * (b - a).cross(c - a)
        };
        (facets.iter().map(|t| cross(t).length()).sum(), facets.iter().map(cross).sum::<DVec3>().length())
    }

    /// On a slanted plane.
    fn slanted(flat: &[[f64; 2]]) -> Vec<DVec3> {
        flat.iter().map(|p| DVec3::new(p[0], p[1], 0.5 * p[0] - 0.25 * p[1] + 3.0) * 1e150).collect()
    }

    #[test]
    fn an_arrow_is_cut_from_its_notch() {
        for start in 0..4 {
            let mut arrow = [[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [1.0, 1.0]];
            arrow.rotate_left(start);
            for turned in [false, true] {
                if turned {
                    arrow.reverse();
                }
                let places: Vec<DVec3> = slanted(&arrow).iter().map(|&p| p / 1e150).collect();
                let facets = cut(&places);
                let (all, net) = area(&places, &facets);
                assert!((all - net).abs() < 1e-12 * all, "{start} {facets:?}");
                let ring: DVec3 = (0..4).map(|k| places[k].cross(places[(k + 1) % 4])).sum();
                let [a, b, c] = facets[0].map(|v| places[v as usize]);
                assert!((b - a).cross(c - a).dot(ring) > 0.0, "oriented as the polygon");
            }
        }
    }

    #[test]
    fn corners_on_straight_edges_stay() {
        // A U with a corner in the middle of each edge.
        let u = [[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [2.0, 3.0], [2.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]];
        let middle = |k: usize| [0, 1].map(|x| 0.5 * (u[k][x] + u[(k + 1) % u.len()][x]));
        let ring: Vec<[f64; 2]> = (0..u.len()).flat_map(|k| [u[k], middle(k)]).collect();
        for start in 0..ring.len() {
            let mut ring = ring.clone();
            ring.rotate_left(start);
            let places: Vec<DVec3> = slanted(&ring).iter().map(|&p| p / 1e150).collect();
            let facets = cut(&places);
            assert_eq!(facets.len(), ring.len() - 2);
            let (all, net) = area(&places, &facets);
            assert!((all - net).abs() < 1e-12 * all);
            // Every edge of the polygon is one facet's.
            let n = ring.len() as u32;
            for k in 0..n {
                let edge = |t: &&[u32; 3]| (0..3).any(|s| t[s] == k && t[(s + 1) % 3] == (k + 1) % n);
                assert_eq!(facets.iter().filter(edge).count(), 1, "{start} {k}");
            }
        }
    }

    #[test]
    fn what_is_convex_or_crosses_itself_keeps_its_fan() {
        let fan = |n: u32| (2..n).map(|k| [0, k - 1, k]).collect::<Vec<_>>();
        let square = slanted(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 1.0], [0.0, 1.0]]);
        assert_eq!(cut(&square), fan(5));
        let bow = slanted(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]);
        assert_eq!(cut(&bow), fan(4));
        let mut broken = slanted(&[[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [1.0, 1.0]]);
        broken[1].x = f64::NAN;
        assert_eq!(cut(&broken), fan(4));
    }

    #[test]
    fn fans_that_are_not_there_do_no_harm() {
        assert!(recut(&[], &[], &[(5, 3)]).is_empty());
        Cut { first: 1, triangles: vec![[0, 1, 2], [0, 2, 3]] }.apply(&mut [[0, 1, 2]]);
    }
}
