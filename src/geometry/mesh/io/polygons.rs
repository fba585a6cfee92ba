//! Polygons that are not convex.
//!
//! Purpose: readers make a fan of every polygon, which is right for convex ones. [`recut`] finds those of which it is not,
//! as some of its triangles would lie outside, turned over, and cuts them by clipping ears (`earcut`).
//! Invariant: a polygon of n corners stays n - 2 facets with each of its corners, so that neighbours keep their edges; one
//! that crosses itself, of which nothing would be right, keeps its fan, after work that is bounded for all of a file. What
//! stands for the corners beside the facets is cut in the same way, in place. Must not know: formats.

use earcut::Earcut;
use earcut::utils3d::project3d_to_2d;
use glam::DVec3;

use crate::mesh::normal;

/// The facets of a polygon with more than three corners: the first of them and how many there are.
pub(super) type Fan = (u32, u32);

/// One with more corners keeps its fan: the time that ears take may go by the square of the corners.
const MOST: u32 = 1 << 14;
/// Ears of one that crosses itself take 0.03 s for so many corners, and 5 s for eight times as many. Of longer ones it is
/// found out first.
const LONG: usize = 2048;
/// What may be spent on polygons that cross themselves: the squares of their corners. Ears take about 1 s for it.
const MOST_IN_VAIN: u64 = 1 << 26;
/// Pairs of edges that are compared in the time of ears for a square of one corner.
const PAIRS: u64 = 16;
/// A fan's triangle is turned over if it is so by more than rounding: this share of the polygon's area.
const TURNED: f64 = 1e-9;
/// Bytes that cutting takes for a corner: of `earcut` 76 and as many again as its list of nodes may grow by.
const CORNER_BYTES: usize = 120;
/// Bytes that cutting may take in any case.
const LEAST_ROOM: usize = 128 << 10;

/// Cuts polygons, of which `lists` has the facets and then what stands beside them. One that would take more than `room`
/// bytes keeps its fan. Returns how many keep a fan with facets that are turned over because cutting would take too long.
pub(super) fn recut(positions: &[DVec3], lists: &mut [&mut [[u32; 3]]], fans: &[Fan], room: usize) -> usize {
    let mut scratch = Scratch::default();
    let (mut left, mut spent) = (0, 0u64);
    let most = (room.max(LEAST_ROOM) / CORNER_BYTES).min(MOST as usize);
    let place = |v: u32| positions.get(v as usize).copied().unwrap_or(DVec3::NAN);
    for &(first, count) in fans {
        let range = first as usize..first as usize + count as usize;
        let fan = lists.first().and_then(|facets| facets.get(range.clone())).unwrap_or_default();
        if is_right(fan, place) {
            continue;
        }
        if count as usize >= most || spent >= MOST_IN_VAIN {
            left += 1;
        } else if scratch.may_be_simple(fan, place) && scratch.cut(fan, place, &mut spent) {
            lists.iter_mut().filter_map(|list| list.get_mut(range.clone())).for_each(|fan| scratch.apply(fan));
        }
    }
    left
}

/// The corners of a fan in order.
fn ring(fan: &[[u32; 3]]) -> impl Iterator<Item = u32> {
    let first = fan.iter().take(1).flat_map(|t| [t[0], t[1]]);
    first.chain(fan.iter().map(|t| t[2]))
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
    ring: Vec<u32>,
    flat: Vec<[f64; 2]>,
    /// Numbers of the polygon's corners, from 0, three a triangle.
    ears: Vec<u32>,
    earcut: Earcut<f64>,
}

impl Scratch {
    /// Whether no more than half of the corners are where another one is. A hole that is joined to the outer ring has two such
    /// corners and three of its own. Ears of a polygon that is in few places take very long.
    fn may_be_simple(&mut self, fan: &[[u32; 3]], place: impl Fn(u32) -> DVec3) -> bool {
        self.ring.clear();
        self.ring.extend(ring(fan));
        let corners = self.ring.len();
        let order = |a: DVec3, b: DVec3| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z));
        self.ring.sort_unstable_by(|&a, &b| order(place(a), place(b)));
        self.ring.dedup_by(|a, b| place(*a) == place(*b));
        2 * self.ring.len() >= corners
    }

    /// Finds the triangles of a polygon. Returns whether there are any that are better than the fan; if not, that is `spent`.
    fn cut(&mut self, fan: &[[u32; 3]], place: impl Fn(u32) -> DVec3, spent: &mut u64) -> bool {
        let places = || ring(fan).map(&place);
        let low = places().fold(DVec3::INFINITY, DVec3::min);
        let extent = (places().fold(DVec3::NEG_INFINITY, DVec3::max) - low).max_element();
        if !(extent.is_finite() && extent > 0.0) {
            return false;
        }
        // So that no square leaves the range. The list is freed before the ears need theirs.
        let mut corners = Vec::with_capacity(fan.len() + 2);
        corners.extend(places().map(|p| ((p - low) / extent).to_array()));
        if !project3d_to_2d(&corners, corners.len(), &mut self.flat) {
            return false;
        }
        drop(corners);
        if self.flat.len() > LONG {
            let (crosses, pairs) = crosses(&self.flat);
            *spent += pairs / PAIRS;
            if crosses {
                return false;
            }
        }
        self.earcut.earcut_slice::<u32>(&self.flat, &[], &mut self.ears);
        let twice = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|k| self.flat[k as usize]);
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        let count = self.flat.len() as u32;
        let whole: f64 = (2..count).map(|k| twice(&[0, k - 1, k])).sum();
        // Both ways around are possible; a facet is oriented as its polygon.
        if self.ears.as_chunks().0.iter().map(twice).sum::<f64>() * whole < 0.0 {
            self.ears.as_chunks_mut::<3>().0.iter_mut().for_each(|t| t.swap(1, 2));
        }
        put_back(&mut self.ears, count);
        let triangles = self.ears.as_chunks::<3>().0;
        let area = |t: &[u32; 3]| twice(t).abs();
        let is_whole = (triangles.iter().map(area).sum::<f64>() - whole.abs()).abs() <= 1e-6 * whole.abs();
        let is_cut = triangles.len() == fan.len() && is_whole;
        *spent += if is_cut { 0 } else { (self.flat.len() as u64).pow(2) };
        is_cut
    }

    /// Makes the triangles that were found of a fan.
    fn apply(&mut self, fan: &mut [[u32; 3]]) {
        self.ring.clear();
        self.ring.extend(ring(fan));
        let triangles = self.ears.as_chunks::<3>().0;
        fan.iter_mut().zip(triangles).for_each(|(facet, cut)| *facet = cut.map(|corner| self.ring[corner as usize]));
    }
}

/// Whether edges of a polygon cross, and how many pairs were compared: by their places along the axis on which edges are short.
fn crosses(flat: &[[f64; 2]]) -> (bool, u64) {
    let edge = |k: u32| [flat[k as usize], flat[(k as usize + 1) % flat.len()]];
    let extent =
        |axis: usize| -> f64 { (0..flat.len() as u32).map(|k| (edge(k)[0][axis] - edge(k)[1][axis]).abs()).sum() };
    let axis = usize::from(extent(1) < extent(0));
    let low = |k: u32| edge(k)[0][axis].min(edge(k)[1][axis]);
    let mut order: Vec<u32> = (0..flat.len() as u32).collect();
    order.sort_unstable_by(|&a, &b| low(a).total_cmp(&low(b)));
    // Only from side to side: edges of a joined hole lie on one another.
    let side = |[a, b]: [[f64; 2]; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let parts = |a: [[f64; 2]; 2], b: [[f64; 2]; 2]| side(a, b[0]) * side(a, b[1]) < 0.0;
    let mut pairs = 0;
    for (k, &a) in order.iter().enumerate() {
        let high = edge(a)[0][axis].max(edge(a)[1][axis]);
        for &b in order[k + 1..].iter().take_while(|&&b| low(b) < high) {
            pairs += 1;
            if parts(edge(a), edge(b)) && parts(edge(b), edge(a)) {
                return (true, pairs);
            }
        }
    }
    (false, pairs)
}

/// Puts corners that lie on a line with their neighbours, and were left out, into the edges that pass them by.
fn put_back(ears: &mut Vec<u32>, corners: u32) {
    let mut there = vec![false; corners as usize];
    ears.iter().for_each(|&c| there[c as usize] = true);
    let Some(first) = (0..corners).find(|&c| there[c as usize]) else { return };
    let mut from = first;
    for k in 1..=corners {
        let corner = (first + k) % corners;
        if !there[corner as usize] {
            // The next one that is there.
            let to = (1..=corners).map(|k| (corner + k) % corners).find(|&c| there[c as usize]).unwrap_or(first);
            let has_edge = |t: &&mut [u32; 3]| (0..3).any(|s| t[s] == from && t[(s + 1) % 3] == to);
            let Some(t) = ears.as_chunks_mut::<3>().0.iter_mut().find(has_edge) else { return };
            let across = t.iter().copied().find(|&c| c != from && c != to).unwrap_or(from);
            *t = [from, corner, across];
            ears.extend([corner, to, across]);
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
        recut(places, &mut [&mut facets], &[(0, n - 2)], 0);
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

    /// A polygon of any length may cross itself anywhere, and a file may have many of them.
    #[test]
    fn work_on_what_crosses_itself_is_bounded() {
        let hash = |n: usize| -> Vec<[f64; 2]> {
            (0..n).map(|k| [(k * 7919 % 30_011) as f64, (k * 104_729 % 251) as f64]).collect()
        };
        // Spikes that all overlap along both axes, and one crossing at the end.
        let spikes = |n: usize| -> Vec<[f64; 2]> {
            let spike = |k: usize| {
                let angle = std::f64::consts::TAU * k as f64 / n as f64;
                let r = if k.is_multiple_of(2) { 1.0 } else { 0.5 };
                [r * angle.cos(), r * angle.sin()]
            };
            (0..n).map(spike).collect()
        };
        let mut bow = spikes(16_000);
        bow.swap(1000, 1002);
        let cut = |flat: &[[f64; 2]], copies: u32| {
            let (n, places) = (flat.len() as u32, slanted(flat).iter().map(|&p| p / 1e150).collect::<Vec<_>>());
            let mut facets: Vec<[u32; 3]> = (0..copies).flat_map(|_| (2..n).map(|k| [0, k - 1, k])).collect();
            let before = facets.clone();
            let fans: Vec<Fan> = (0..copies).map(|copy| (copy * (n - 2), n - 2)).collect();
            let left = recut(&places, &mut [&mut facets], &fans, usize::MAX);
            (left, facets != before)
        };
        assert_eq!(cut(&spikes(16_000), 2), (0, true), "it is simple");
        assert_eq!(cut(&bow, 1), (0, false));
        assert_eq!(cut(&hash(16_000), 4), (0, false), "crossings are soon found");
        assert_eq!(cut(&hash(20_000), 3), (3, false), "too long");
        let (left, _) = cut(&hash(2000), 100);
        assert_eq!(left, 100 - (MOST_IN_VAIN / 2000 / 2000 + 1) as usize, "the rest is not tried");
        assert_eq!(cut(&hash(100), 1000), (0, false), "of short ones there may be many");
    }

    #[test]
    fn fans_that_are_not_there_do_no_harm() {
        let mut facets = [[0, 1, 2]];
        recut(&[], &mut [], &[(5, 3)], 0);
        recut(&[], &mut [&mut facets], &[(0, 3)], 0);
        recut(&[], &mut [&mut facets], &[(u32::MAX, u32::MAX)], usize::MAX);
        assert_eq!(facets, [[0, 1, 2]]);
    }
}
