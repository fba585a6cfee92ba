//! Seeds on curves: corners, creases and boundaries.
//!
//! Purpose: a seed at every corner, and on every curve as many as its length asks for, at the centroids of their stretches:
//! a centroidal Voronoi tessellation of one dimension. They are held while the others move, and the others are kept clear
//! of them, so that the dual has every curve as a chain of edges (\[YLL*09\], section 5, has seeds of curves move with the
//! rest; on a curve of its own density the tessellation of one dimension is known at once and needs no other seed).
//! Invariant: with edge length h, density h⁻³ on a curve has the spacing that density h⁻⁴ has on the
//! surface: the weight w of a surface is w^(3/4) on its curves. Lengths are those of the unit frame.
//! Must not know: how curves were found, backends.

mod beside;
mod chords;
mod path;
mod shared;

use std::collections::{BTreeSet, HashMap};

use glam::DVec3;

use beside::Placed;
use path::Path;
pub(crate) use shared::Twin;

use crate::knn::{NeighbourRow, SeedIndex};
use crate::mesh::features::{Curve, Features};
use crate::rvd::Surface;
use crate::tasks;
use crate::token::{Stopped, Token};

/// Seeds of curves, the first of all seeds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CurveSeeds {
    /// Unit frame: corners first, then curve by curve.
    pub seeds: Vec<DVec3>,
    pub corners: usize,
    pub segments: Vec<Segment>,
    /// Curves between two corners that are much shorter than an edge.
    short: Vec<u32>,
    /// Curves that others are copies of, or that are copies; ascending. Their seeds stay as they are.
    shared: Vec<u32>,
}

/// Two neighbouring seeds of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    pub ends: [u32; 2],
    /// Points of the curve between them, in order and about evenly spaced, unit frame.
    pub between: [DVec3; INNER_POINTS],
    pub curve: u32,
    /// The target edge length there, unit frame.
    pub edge: f64,
}

/// Points between two neighbours on a curve; odd, so that one is in the middle.
pub(crate) const INNER_POINTS: usize = 7;

impl Segment {
    /// The point of the curve half-way between its seeds, unit frame.
    pub fn middle(&self) -> DVec3 {
        self.between[INNER_POINTS / 2]
    }
}

const SEGMENTS_PER_CHECK: usize = 8;
/// Least distance of seeds of two curves, and beside a common corner, share of their spacing.
const MIN_SEPARATION: f64 = 0.45;
const MIN_CORNER_SEPARATION: f64 = 0.3;
/// A seed comes between the ends of a segment if its distance to a point there is below this share of theirs.
const BETWEEN_MARGIN: f64 = 0.98;
/// The same for edges that stay, which have to be in the result.
const HELD_BETWEEN_MARGIN: f64 = 1.0;
/// Rounds of splitting segments that a seed of another curve comes between, at most, and the shortest part, a share of h.
const MAX_SPLIT_ROUNDS: usize = 4;
const MIN_SPLIT_PART: f64 = 0.3;
/// How far from a corner both sides of a facet that stay get a seed, share of the shorter segment.
const TIP_SHARE: f64 = 0.4;
/// The shortest part of edges that stay, share of the segment: it may be much shorter than h, and seeds within are taken out again.
const MIN_HELD_PART: f64 = 0.1;
/// A corner is acute if two of its curves enclose less than this, degrees.
const ACUTE_CORNER_DEG: f64 = 40.0;
/// Two creases that enclose less than this at a corner, degrees, both stay only if their dihedral angles exceed the second.
const MIN_CORNER_DEG: f64 = 32.0;
const DISTINCT_CREASE_DEG: f64 = 55.0;
/// Shortest curve between two corners, a share of h.
const MIN_CURVE: f64 = 0.65;
/// Largest distance of a curve from its chord, share of an edge. A curve that is farther off is cut.
const MAX_DEVIATION: f64 = 0.15;
/// Shortest part of a curve that is cut for its distance from the chord, share of an edge.
const MIN_PART: f64 = 0.5;
/// Longest segment, in h: on a longer one, a seed beside its middle would take a part of the curve.
const MAX_SEGMENT: f64 = 1.2;

/// The edge length in the unit frame that `seeds` seeds have where the weight is 1: 1/u of (4/√3) u² ∫√w + u ∫_boundary
/// w^(1/4) = 2n, since a triangulation of n vertices, b of them on the boundary, has 2n - b - 2χ triangles of area √3/4 h².
/// `root_mass` is that of the surface, lifted or not, and `stretch` as in [`Path::new`].
pub(crate) fn edge_length(
    surface: &Surface,
    (features, stretch): (&Features, &[f64]),
    root_mass: f64,
    seeds: usize,
    token: &Token,
) -> Result<f64, Stopped> {
    use crate::mesh::features::CurveKind::Boundary;
    let mut one = 0.0;
    for curve in features.curves.iter().filter(|c| c.kind == Boundary) {
        token.check()?;
        one += Path::new(surface, curve, stretch, 1.0).total();
    }
    let two = 4.0 / 3f64.sqrt() * root_mass;
    let u = 0.5 * ((one * one + 8.0 * two * seeds as f64).sqrt() - one) / two;
    Ok(1.0 / u)
}

impl CurveSeeds {
    /// Seeds for all curves, about `edge` (where the weight is 1) apart; `None` if these are more than `most`.
    pub fn place(
        surface: &Surface,
        curves: (&Features, &[f64]),
        edge: f64,
        most: usize,
        token: &Token,
    ) -> Result<Option<Self>, Stopped> {
        Self::place_each(surface, curves, edge, most, |places, _, _, _| places, token)
    }

    /// The same with the seeds of bent curves beside those of curves near them. Parts of the surface were moved, each curve by what `moved`
    /// says, unit frame.
    pub fn place_beside(
        surface: &Surface,
        features: &Features,
        edge: f64,
        (most, moved): (usize, &[DVec3]),
        token: &Token,
    ) -> Result<Option<Self>, Stopped> {
        let mut placed = Placed::new(edge);
        let beside = |places, path: &Path, number: u32, least| {
            placed.beside(places, path, (number, moved[number as usize], least))
        };
        Self::place_each(surface, (features, &[]), edge, most, beside, token)
    }

    /// `change` returns other arc lengths for a curve's seeds: the path, its number, and the fewest edges it may have.
    fn place_each(
        surface: &Surface,
        (features, stretch): (&Features, &[f64]),
        edge: f64,
        most: usize,
        mut change: impl FnMut(Vec<f64>, &Path, u32, usize) -> Vec<f64>,
        token: &Token,
    ) -> Result<Option<Self>, Stopped> {
        let at = |v: u32| surface.positions()[v as usize];
        let mut all = Self { corners: features.corners.len(), ..Self::default() };
        all.seeds.extend(features.corners.iter().map(|&v| at(v)));
        let corner = |v: u32| features.corners.binary_search(&v).ok().map(|k| k as u32);
        let ends = |c: &Curve| {
            let (a, b) = (c.vertices[0], c.vertices[c.vertices.len() - 1]);
            (a.min(b), a.max(b))
        };
        let mut pairs: Vec<(u32, u32)> = features.curves.iter().filter(|c| !c.closed).map(ends).collect();
        pairs.sort_unstable();
        token.check()?;
        for (number, curve) in features.curves.iter().enumerate() {
            token.check()?;
            let path = Path::new(surface, curve, stretch, edge);
            let total = path.total();
            if !curve.closed && !curve.is_rim && total < MIN_CURVE {
                all.short.push(number as u32);
            }
            // Fewer would give two edges the same ends.
            let least = match curve.closed {
                _ if curve.is_rim => 1,
                true => 3,
                false if ends(curve).0 == ends(curve).1 => 3,
                false if pairs.get(pairs.partition_point(|&p| p < ends(curve)) + 1) == Some(&ends(curve)) => 2,
                false => 1,
            };
            let count = (total.round() as usize).max((total / MAX_SEGMENT).ceil() as usize).max(least);
            // Before anything of that size is made.
            if count > most.saturating_sub(all.seeds.len()) {
                return Ok(None);
            }
            let places = change(path.tessellate(count, least, token)?, &path, number as u32, least);
            let first = all.seeds.len() as u32;
            all.seeds.extend(places.iter().map(|&s| path.at(s)));
            let inner = (0..places.len() as u32).map(|k| first + k);
            let last = curve.vertices[curve.vertices.len() - 1];
            let mut chain: Vec<(u32, f64)> = inner.zip(places.iter().copied()).collect();
            if curve.closed {
                chain.extend(chain.first().map(|&(seed, s)| (seed, s + path.length())));
            } else if let (Some(a), Some(b)) = (corner(curve.vertices[0]), corner(last)) {
                chain.insert(0, (a, 0.0));
                chain.push((b, path.length()));
            }
            all.segments.extend(chain.windows(2).map(|w| Segment {
                ends: [w[0].0, w[1].0],
                between: path.between(w[0].1, w[1].1),
                curve: number as u32,
                edge: path.edge_at(0.5 * (w[0].1 + w[1].1)),
            }));
        }
        Ok(Some(all))
    }

    /// For each seed, whether it is next to a corner that another segment leaves at an acute angle with its own.
    pub fn beside_acute(&self) -> Vec<bool> {
        let limit = ACUTE_CORNER_DEG.to_radians().cos();
        let mut beside = vec![false; self.seeds.len()];
        for list in self.leaving() {
            for (k, &(direction, s, end)) in list.iter().enumerate() {
                let seed = s.ends[1 - end];
                let is_acute = |other: &(DVec3, &Segment, usize)| other.0.dot(direction) > limit;
                // Of many that leave a corner most have such a one among the next: the first of each bundle comes soon.
                let others = || list[k + 1..].iter().chain(&list[..k]);
                beside[seed as usize] |= seed as usize >= self.corners && others().any(is_acute);
            }
        }
        beside
    }

    /// For each corner the directions in which segments leave it, with the segment and which of its ends the corner is.
    fn leaving(&self) -> Vec<Vec<(DVec3, &Segment, usize)>> {
        let mut leaving = vec![Vec::new(); self.corners];
        for s in &self.segments {
            for end in 0..2 {
                let [a, b] = [s.ends[end], s.ends[1 - end]].map(|e| e as usize);
                if let Some(list) = leaving.get_mut(a) {
                    list.push(((self.seeds[b] - self.seeds[a]).normalize_or_zero(), s, end));
                }
            }
        }
        leaving
    }

    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// Puts a seed at a point between the ends of a segment, after all others; the segment becomes two. Returns the point.
    pub fn split(&mut self, segment: u32, at: usize) -> DVec3 {
        let new = self.seeds.len() as u32;
        let Segment { ends: [a, b], between, curve, edge } = self.segments[segment as usize];
        let middle = between[at];
        self.seeds.push(middle);
        // Points evenly along what is known of each part.
        let half = |from: DVec3, to: DVec3, inner: &[DVec3]| {
            let mut known = vec![from];
            known.extend_from_slice(inner);
            known.push(to);
            std::array::from_fn(|k| {
                let t = (k + 1) as f64 / (INNER_POINTS + 1) as f64 * (known.len() - 1) as f64;
                let before = (t as usize).min(known.len() - 2);
                known[before].lerp(known[before + 1], t - before as f64)
            })
        };
        let (start, end) = (self.seeds[a as usize], self.seeds[b as usize]);
        let first = half(start, middle, &between[..at]);
        let second = half(middle, end, &between[at + 1..]);
        self.segments[segment as usize] = Segment { ends: [a, new], between: first, curve, edge };
        self.segments.push(Segment { ends: [new, b], between: second, curve, edge });
        middle
    }

    /// Splits the straight segments of each group at their corners, all in one distance: (the seed of a corner, curve). Both sides of a
    /// facet's corner then have a seed as near to it as the other, so that the three are a facet with acute angles.
    pub fn split_alike(&mut self, groups: &[Vec<(u32, u32)>]) {
        let mut at: HashMap<(u32, u32), u32> = HashMap::new();
        let ends = |number: u32, segment: &Segment| segment.ends.map(|end| ((end, segment.curve), number));
        at.extend((0..).zip(&self.segments).flat_map(|(number, segment)| ends(number, segment)));
        for group in groups {
            let length = |all: &Self, segment: u32| {
                let [a, b] = all.segments[segment as usize].ends.map(|end| all.seeds[end as usize]);
                a.distance(b)
            };
            let own: Vec<(u32, u32)> = group.iter().filter_map(|key| Some((key.0, *at.get(key)?))).collect();
            let lengths = own.iter().map(|&(_, segment)| length(self, segment));
            let reach = TIP_SHARE * lengths.fold(f64::INFINITY, f64::min);
            // Ends that rounding brought to one place have no room.
            if reach <= 0.0 {
                continue;
            }
            for (corner, segment) in own {
                let share = reach / length(self, segment);
                let from_first = self.segments[segment as usize].ends[0] == corner;
                self.split_straight(segment, if from_first { share } else { 1.0 - share });
                let last = self.segments.len() as u32 - 1;
                at.extend([segment, last].into_iter().flat_map(|k| ends(k, &self.segments[k as usize])));
            }
        }
    }

    /// Splits a straight segment at this share of it.
    fn split_straight(&mut self, segment: u32, share: f64) {
        let new = self.seeds.len() as u32;
        let Segment { ends: [a, b], curve, edge, .. } = self.segments[segment as usize];
        let [p, q] = [a, b].map(|end| self.seeds[end as usize]);
        let place = p.lerp(q, share);
        self.seeds.push(place);
        let between =
            |from: DVec3, to: DVec3| std::array::from_fn(|k| from.lerp(to, (k + 1) as f64 / (INNER_POINTS + 1) as f64));
        self.segments[segment as usize] = Segment { ends: [a, new], between: between(p, place), curve, edge };
        self.segments.push(Segment { ends: [new, b], between: between(place, q), curve, edge });
    }

    /// Splits segments whose chord leaves the curve by over a seventh of an edge, at the farthest point that may be. No edge counts as
    /// longer than `longest`.
    pub fn split_by_deviation(&mut self, longest: f64, token: &Token) -> Result<(), Stopped> {
        let mut next = 0;
        while let Some(&segment) = self.segments.get(next) {
            token.check_at(self.segments.len() + next)?;
            let [a, b] = segment.ends.map(|e| self.seeds[e as usize]);
            let edge = segment.edge.min(longest);
            let direction = (b - a).normalize_or_zero();
            let off = |p: DVec3| (p - a - direction * direction.dot(p - a)).length();
            let long = |p: DVec3| p.distance(a).min(p.distance(b)) > MIN_PART * edge;
            let far = (0..INNER_POINTS)
                .filter(|&k| long(segment.between[k]) && off(segment.between[k]) > MAX_DEVIATION * edge)
                .max_by(|&j, &k| off(segment.between[j]).total_cmp(&off(segment.between[k])));
            match far {
                Some(at) => _ = self.split(next as u32, at),
                None => next += 1,
            }
        }
        Ok(())
    }

    /// Splits segments of the curves that `may` allows if another curve's seed comes between their ends, as across a slit. Edges of the
    /// curves that are `held` have to be in the result, and are split sooner.
    pub fn split_between_others(
        &mut self,
        (may, held): (impl Fn(u32) -> bool, impl Fn(u32) -> bool),
        token: &Token,
    ) -> Result<(), Stopped> {
        for _ in 0..MAX_SPLIT_ROUNDS {
            token.check()?;
            let index = SeedIndex::new(&self.seeds);
            let mut found: Vec<(u32, usize)> = Vec::new();
            for (number, segment) in (0..).zip(&self.segments).filter(|(_, s)| may(s.curve)) {
                token.check_at(64 * number as usize)?;
                let ends = segment.ends.map(|e| self.seeds[e as usize]);
                let (margin, least) = match held(segment.curve) {
                    true => (HELD_BETWEEN_MARGIN, MIN_HELD_PART * ends[0].distance(ends[1])),
                    false => (BETWEEN_MARGIN, MIN_SPLIT_PART * segment.edge),
                };
                let between = |k: usize| {
                    let p = segment.between[k];
                    let (nearest, own) = (index.nearest(p), ends[0].distance(p).min(ends[1].distance(p)));
                    let apart = self.seeds[nearest as usize].distance(p);
                    let comes_between = !segment.ends.contains(&nearest) && apart < margin * own;
                    (comes_between && own > least).then_some((apart, k))
                };
                let places = (0..INNER_POINTS).filter_map(between);
                found.extend(places.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, k)| (number, k)));
            }
            if found.is_empty() {
                break;
            }
            for (segment, at) in found {
                self.split(segment, at);
            }
        }
        Ok(())
    }

    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// Seeds that come between two neighbours on a curve: (seed, segment), each seed once. Their cells hold a part of the
    /// curve, which the dual may then lack. On a straight curve it is nearer to the middle of the segment than the ends.
    pub fn intruders(&self, seeds: &[DVec3], token: &Token) -> Result<Vec<(u32, u32)>, Stopped> {
        let index = SeedIndex::new(seeds);
        let of = |k: usize| {
            let segment = &self.segments[k];
            if k.is_multiple_of(SEGMENTS_PER_CHECK) && token.is_stopped() {
                return Vec::new();
            }
            let ends = segment.ends.map(|e| seeds[e as usize]);
            let intruder = |p: DVec3| {
                let nearest = index.nearest(p);
                let own = ends[0].distance(p).min(ends[1].distance(p));
                let intrudes = nearest as usize >= self.seeds.len() && seeds[nearest as usize].distance(p) < own;
                intrudes.then_some((nearest, k as u32))
            };
            // Points between are where the curve has vertices, and none may be in the middle.
            let middle = ends[0].midpoint(ends[1]);
            segment.between.into_iter().chain([middle]).filter_map(intruder).collect::<Vec<_>>()
        };
        let mut found: Vec<(u32, u32)> = tasks::flat_map(self.segments.len(), of);
        token.check()?;
        found.sort_unstable();
        found.dedup_by_key(|f| f.0);
        Ok(found)
    }

    /// Creases to leave out, since a triangulation has no room between them and another curve: of two curves that come
    /// within half of their spacing and do not meet there, the flatter one; never a boundary or a crease the caller named.
    pub fn too_close(&self, features: &Features, token: &Token) -> Result<BTreeSet<u32>, Stopped> {
        let mut on = vec![Vec::new(); self.seeds.len()];
        let mut reach = vec![0.0f64; self.seeds.len()];
        for s in &self.segments {
            let spacing = self.seeds[s.ends[0] as usize].distance(self.seeds[s.ends[1] as usize]);
            for e in s.ends {
                on[e as usize].push(s.curve);
                reach[e as usize] = reach[e as usize].max(MIN_SEPARATION * spacing);
            }
        }
        let meet: BTreeSet<(u32, u32)> =
            self.segments.iter().map(|s| (s.ends[0].min(s.ends[1]), s.ends[0].max(s.ends[1]))).collect();
        // Seeds next to a common corner are close since their curves meet there: for each seed its corners, ascending.
        let mut beside = vec![Vec::new(); self.seeds.len()];
        for s in &self.segments {
            for (a, b) in [(s.ends[0], s.ends[1]), (s.ends[1], s.ends[0])] {
                if (a as usize) < self.corners {
                    beside[b as usize].push(a);
                }
            }
        }
        beside.iter_mut().for_each(|corners| corners.sort_unstable());
        let share_a_corner = |i: u32, j: u32| {
            let (few, many) = (&beside[i as usize], &beside[j as usize]);
            let (few, many) = if few.len() <= many.len() { (few, many) } else { (many, few) };
            few.iter().any(|corner| many.binary_search(corner).is_ok())
        };
        let index = SeedIndex::new(&self.seeds);
        let mut row = NeighbourRow::default();
        let mut out = self.acute_creases(features, token)?;
        out.extend(self.coming_between(features, &index, &on, token)?);
        out.extend(self.short.iter().copied().filter(|&c| features.curves[c as usize].angle_deg < 180.0));
        for i in 0..self.seeds.len() as u32 {
            token.check_at(16 * i as usize)?;
            index.row(i, 16, &mut row);
            let near = |&&j: &&u32| self.seeds[j as usize].distance(self.seeds[i as usize]) < reach[i as usize];
            for &j in row.seeds.iter().take_while(near) {
                let joined = meet.contains(&(i.min(j), i.max(j))) || share_a_corner(i, j);
                let apart = self.seeds[j as usize].distance(self.seeds[i as usize]);
                if joined && apart > MIN_CORNER_SEPARATION / MIN_SEPARATION * reach[i as usize] {
                    continue;
                }
                out.extend(flattest(features, on[i as usize].iter().chain(&on[j as usize]), 180.0));
            }
        }
        Ok(out)
    }

    /// Weak creases, as of a scan, with a seed between two neighbours of another curve: that edge would be lacking.
    fn coming_between(
        &self,
        features: &Features,
        index: &SeedIndex,
        on: &[Vec<u32>],
        token: &Token,
    ) -> Result<BTreeSet<u32>, Stopped> {
        let mut out = BTreeSet::new();
        for (k, segment) in self.segments.iter().enumerate() {
            token.check_at(64 * k)?;
            for p in segment.between {
                let nearest = index.nearest(p);
                let own = segment.ends.map(|e| self.seeds[e as usize].distance(p));
                let between = self.seeds[nearest as usize].distance(p) < BETWEEN_MARGIN * own[0].min(own[1]);
                if between && !segment.ends.contains(&nearest) {
                    let both = on[nearest as usize].iter().chain([&segment.curve]);
                    out.extend(flattest(features, both, DISTINCT_CREASE_DEG));
                }
            }
        }
        Ok(out)
    }

    /// Of two creases at an acute angle at a corner, the flatter, if weak: the triangle between them has no larger angle.
    fn acute_creases(&self, features: &Features, token: &Token) -> Result<BTreeSet<u32>, Stopped> {
        let bend = |s: &Segment, end: usize| features.curves[s.curve as usize].ends_deg[end];
        let mut out = BTreeSet::new();
        for list in self.leaving() {
            for (k, &(direction, s, end)) in list.iter().enumerate() {
                token.check_at(64 * k)?;
                for &(other, t, other_end) in &list[..k] {
                    let (own, others) = (bend(s, end), bend(t, other_end));
                    let (flatter, bend) = if own < others { (s.curve, own) } else { (t.curve, others) };
                    if direction.dot(other) > MIN_CORNER_DEG.to_radians().cos() && bend < DISTINCT_CREASE_DEG {
                        out.insert(flatter);
                    }
                }
            }
        }
        Ok(out)
    }

    /// Moves intruders away from their segments, to the distance that the next row of a regular triangulation has beside a chord
    /// of this length. One pass: a moved seed may intrude elsewhere.
    pub fn push_out(&self, seeds: &mut [DVec3], intruders: &[(u32, u32)], chord: impl Fn(&Segment) -> f64) {
        for &(seed, segment) in intruders {
            let segment = &self.segments[segment as usize];
            let (ends, middle) = (segment.ends, segment.middle());
            let along = seeds[ends[1] as usize] - seeds[ends[0] as usize];
            let away = seeds[seed as usize] - middle;
            // Across the curve, where there is such a direction.
            let across = away - along * (away.dot(along) / along.length_squared().max(f64::MIN_POSITIVE));
            let direction = across.try_normalize().or_else(|| away.try_normalize()).unwrap_or(DVec3::X);
            seeds[seed as usize] = middle + 0.75 * chord(segment) * direction;
        }
    }

    /// The points farther from every curve seed and every middle of a segment than this share of the spacing there.
    pub fn clearance(&self, share: f64) -> Clearance {
        let mut reach = vec![0.0f64; self.seeds.len()];
        let mut places = self.seeds.clone();
        let mut middles = Vec::new();
        for s in &self.segments {
            let d = self.seeds[s.ends[0] as usize].distance(self.seeds[s.ends[1] as usize]);
            s.ends.iter().for_each(|&e| reach[e as usize] = reach[e as usize].max(share * d));
            places.push(s.middle());
            middles.push(share * d);
        }
        reach.extend(middles);
        Clearance { index: SeedIndex::new(&places), places, reach }
    }
}

/// The flattest of some curves that bend by less than `limit`, degrees; of equals, the first.
fn flattest<'a>(features: &Features, curves: impl Iterator<Item = &'a u32>, limit: f64) -> Option<u32> {
    let bends = curves.map(|&c| (features.curves[c as usize].angle_deg, c)).filter(|b| b.0 < limit);
    bends.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).map(|(_, c)| c)
}

pub struct Clearance {
    index: SeedIndex,
    places: Vec<DVec3>,
    reach: Vec<f64>,
}

impl Clearance {
    /// Whether `p` is clear of the curves, unit frame.
    pub fn holds(&self, p: DVec3) -> bool {
        let k = self.index.nearest(p) as usize;
        p.distance(self.places[k]) >= self.reach[k]
    }
}
