//! All cells of one facet at once.
//!
//! Purpose: the integrals of a facet's pieces for a fraction of what a walk over its cells costs.
//! A seed that is farther than another one from all three corners is farther from the whole facet,
//! as their bisector is linear on it; so the seeds around the one nearest to the centroid, compared at the
//! corners, leave hardly more than the facet meets cells. Between any two of these lies at most one
//! segment, what the others leave of their bisector; and a polynomial's integral over a piece is a
//! sum over the segments around it (Green's theorem), so that no polygon is ever made, and a
//! segment serves the pieces on both of its sides.
//! Invariant: the cells that meet the facet, exactly: what rounding could get wrong is not decided
//! here, but left to the walk. The bits depend on the facet and the seeds alone, not on the seed
//! from which the search began. The pieces of a facet add up to it.
//! Must not know: other facets, threads, how integrals are added.

use glam::DVec3;

use super::gather::{CELLS, Gathered, Gatherer, Members};
use crate::rvd::clip::Integrals;
use crate::rvd::incident::Diagram;

/// A segment's end may be off by this share of the farthest corner's distance, in the worst case, and the facet is
/// left to the walk beyond: two bisectors are nearly parallel there, one facet in some thousand.
const MAX_SLIP: f64 = 1e-10;

/// A facet with a piece of less than this share is left to the walk: the piece's integrals, sums of terms as large as
/// the facet's, would keep nine digits at most, and some cell may have nothing else.
const LEAST_SHARE: f64 = 1e-6;

/// One thread's scratch memory.
#[derive(Default)]
pub(super) struct FacetCells {
    gatherer: Gatherer,
    pieces: [Piece; CELLS],
}

/// What is known of a member's piece.
#[derive(Clone, Copy, Default)]
struct Piece {
    moments: Moments,
    /// The part of the edge from the second corner to the third that lies in the cell.
    low: f64,
    high: f64,
    /// The largest squared distance of a vertex from the seed.
    radius2: f64,
    there: bool,
}

/// ∫ uᵃvᵇ over a piece in barycentric coordinates, p = p₀ + u (p₁ - p₀) + v (p₂ - p₀), in order 1, u, v,
/// u², uv, v², u³, u²v, uv², v³, times the numbers that [`Moments::uniform`] and [`Moments::weighted`] divide by.
#[derive(Clone, Copy, Default)]
struct Moments([f64; 10]);

/// The facet in space.
struct Facet {
    corner: [DVec3; 3],
    /// From the first corner to the others.
    side: [DVec3; 2],
    twice_area: f64,
    weight: [f64; 3],
}

/// What rounding may do to the facet's numbers.
#[derive(Clone, Copy)]
struct Bounds {
    /// A bisector's value at a corner is off by at most this.
    value: f64,
    /// What a cut may be off by, as a share of the edge that it cuts.
    slip: f64,
}

impl FacetCells {
    /// Visits every cell that meets `facet`, with its piece's integrals about the seed. `start` is
    /// any seed; the nearer, the faster. Returns the seed nearest to the facet's centroid; or `None`,
    /// before anything was visited, where cells are too many, rows too short, or rounding could
    /// decide.
    pub(super) fn divide(
        &mut self,
        diagram: Diagram<'_>,
        facet: u32,
        start: u32,
        mut visit: impl FnMut(u32, Integrals),
    ) -> Option<u32> {
        let surface = diagram.surface;
        let vertex = surface.facets()[facet as usize];
        let corner = vertex.map(|v| surface.positions()[v as usize]);
        let gathered = self.gatherer.gather(diagram, &corner, surface.centroid(facet), start)?;
        let side = [corner[1] - corner[0], corner[2] - corner[0]];
        let space = Facet {
            corner,
            side,
            twice_area: side[0].cross(side[1]).length(),
            weight: vertex.map(|v| surface.weights()[v as usize]),
        };
        let cubic = !surface.is_uniform();
        let members = self.gatherer.members();
        let pieces = &mut self.pieces[..members.len];
        pieces.fill(Piece { high: 1.0, ..Piece::default() });
        if members.len == 1 {
            pieces[0].moments.add([1.0, 0.0], [0.0, 1.0], 1.0, cubic);
            pieces[0].there = true;
        } else {
            let bounds = Bounds::new(members, &gathered, &side);
            let look = gathered.unproved.then_some((diagram.seeds, &space));
            if !divide(members, pieces, bounds, cubic, look) {
                return None;
            }
        }
        if gathered.unproved {
            for (corner, farther) in space.corner.iter().zip(&members.farther) {
                let nearest = (0..pieces.len()).fold(0, |best, k| if farther[k] < farther[best] { k } else { best });
                let squared = corner.distance_squared(diagram.seeds[members.seed[nearest] as usize]);
                pieces[nearest].radius2 = pieces[nearest].radius2.max(squared);
            }
            // A little more than it is, for roundings that matter to the smallest pieces alone.
            let least = 16.0 * f64::EPSILON * gathered.radius2;
            let reaches = |k: usize| !pieces[k].there || self.gatherer.reaches(k, pieces[k].radius2 + least);
            if !(0..pieces.len()).all(reaches) {
                return None;
            }
        }
        if pieces.iter().any(|piece| piece.there && piece.moments.0[0] < LEAST_SHARE) {
            return None;
        }
        for (piece, &i) in pieces.iter().zip(&members.seed).filter(|(piece, _)| piece.there) {
            let origin = corner[0] - diagram.seeds[i as usize];
            visit(
                i,
                if cubic { piece.moments.weighted(&space, origin) } else { piece.moments.uniform(&space, origin) },
            );
        }
        Some(gathered.nearest)
    }
}

impl Bounds {
    fn new(members: &Members, gathered: &Gathered, side: &[DVec3; 2]) -> Self {
        let error = members.error[..members.len].iter().copied().fold(0.0, f64::max);
        let mut most: f64 = 0.0;
        for values in &members.farther {
            most = values[..members.len].iter().fold(most, |most, v| if v.abs() > most { v.abs() } else { most });
        }
        let longest2 = side[0].length_squared().max(side[1].length_squared());
        // A third side is at most the other two together.
        let slip = MAX_SLIP * (0.25 * gathered.radius2 / longest2).max(1.0).sqrt();
        Self { value: 2.0 * error + 8.0 * f64::EPSILON * most, slip }
    }
}

/// The corners (u, v).
const CORNER: [[f64; 2]; 3] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];

/// Finds all segments and adds them to their pieces. Returns whether rounding decided nothing.
fn divide(
    members: &Members,
    pieces: &mut [Piece],
    bounds: Bounds,
    cubic: bool,
    look: Option<(&[DVec3], &Facet)>,
) -> bool {
    let n = pieces.len();
    let mut sure = true;
    for i in 0..n {
        for j in i + 1..n {
            let d = [0, 1, 2].map(|c| members.farther[c][j] - members.farther[c][i]);
            let inside = d.map(|d| d > 0.0);
            sure &= d[0].abs() > bounds.value && d[1].abs() > bounds.value && d[2].abs() > bounds.value;
            along_edge(pieces, (i, j), d[1], d[2], bounds, &mut sure);
            // The corner that is alone on its side.
            let c = if inside[1] == inside[2] {
                if inside[0] == inside[1] {
                    continue;
                }
                0
            } else if inside[0] == inside[2] {
                1
            } else {
                2
            };
            let (a, b) = ((c + 1) % 3, (c + 2) % 3);
            let (to_a, to_b) = (1.0 / (d[c] - d[a]), 1.0 / (d[c] - d[b]));
            let (xa, xb) = (d[c] * to_a, d[c] * to_b);
            let (slip_a, slip_b) = (2.0 * bounds.value * to_a.abs(), 2.0 * bounds.value * to_b.abs());
            sure &= slip_a <= bounds.slip && slip_b <= bounds.slip;
            let [fc, fa, fb] = [c, a, b].map(|c| &members.farther[c]);
            let (mut low, mut high) = (0.0f64, 1.0f64);
            for k in (0..n).filter(|&k| k != i && k != j) {
                let (g, to_ga, to_gb) = (fc[k] - fc[i], fa[k] - fa[i], fb[k] - fb[i]);
                let (run_a, run_b) = (to_ga - g, to_gb - g);
                let (ga, gb) = (g + xa * run_a, g + xb * run_b);
                let (out_a, out_b) = (ga <= 0.0, gb <= 0.0);
                let unsure_a = bounds.value + slip_a * run_a.abs();
                let unsure_b = bounds.value + slip_b * run_b.abs();
                sure &= ga.abs() > unsure_a && gb.abs() > unsure_b;
                if out_a != out_b {
                    let inverse = 1.0 / (ga - gb);
                    sure &= (unsure_a + unsure_b) * inverse.abs() <= bounds.slip;
                    let t = ga * inverse;
                    if out_a {
                        low = if t > low { t } else { low };
                    } else {
                        high = if t < high { t } else { high };
                    }
                } else if out_a {
                    high = -1.0;
                    break;
                }
            }
            sure &= (high - low).abs() > 4.0 * bounds.slip;
            if low < high {
                let [p, q] = [CORNER[c], CORNER[a]];
                let r = CORNER[b];
                let from = [p[0] + xa * (q[0] - p[0]), p[1] + xa * (q[1] - p[1])];
                let to = [p[0] + xb * (r[0] - p[0]), p[1] + xb * (r[1] - p[1])];
                let (du, dv) = (to[0] - from[0], to[1] - from[1]);
                let start = [from[0] + low * du, from[1] + low * dv];
                let end = [from[0] + high * du, from[1] + high * dv];
                // Around corner c, and so around its piece, the segment runs from a's side to b's.
                let sign = if inside[c] { 1.0 } else { -1.0 };
                pieces[i].moments.add(start, end, sign, cubic);
                pieces[j].moments.add(start, end, -sign, cubic);
                (pieces[i].there, pieces[j].there) = (true, true);
                if let Some((seeds, facet)) = look {
                    let origin = facet.corner[0] - seeds[members.seed[i] as usize];
                    let squared = |[u, v]: [f64; 2]| (origin + u * facet.side[0] + v * facet.side[1]).length_squared();
                    let radius2 = squared(start).max(squared(end));
                    for k in [i, j] {
                        pieces[k].radius2 = pieces[k].radius2.max(radius2);
                    }
                }
            }
        }
    }
    // The first corner is the origin, so that of the facet's own edges only the one across counts.
    for piece in pieces {
        sure &= (piece.high - piece.low).abs() > 4.0 * bounds.slip;
        if piece.low < piece.high {
            let at = |t: f64| [1.0 - t, t];
            piece.moments.add(at(piece.low), at(piece.high), 1.0, cubic);
            piece.there = true;
        }
    }
    sure
}

/// What a bisector leaves to either of its pieces of the edge from the second corner to the third, where
/// its values are `d` and `e`.
fn along_edge(pieces: &mut [Piece], (i, j): (usize, usize), d: f64, e: f64, bounds: Bounds, sure: &mut bool) {
    let (i_first, i_last) = (d > 0.0, e > 0.0);
    if i_first == i_last {
        pieces[if i_first { j } else { i }].high = -1.0;
        return;
    }
    let inverse = 1.0 / (d - e);
    *sure &= 2.0 * bounds.value * inverse.abs() <= bounds.slip;
    let t = d * inverse;
    let (before, after) = if i_first { (i, j) } else { (j, i) };
    let (high, low) = (&mut pieces[before].high, t);
    *high = if low < *high { low } else { *high };
    let low = &mut pieces[after].low;
    *low = if t > *low { t } else { *low };
}

impl Moments {
    /// Adds `sign` times the triangle from the origin to a segment, whose integral of a homogeneous
    /// polynomial of degree n is that along the segment, times the cross product over n + 2.
    #[inline]
    fn add(&mut self, [a, b]: [f64; 2], [c, d]: [f64; 2], sign: f64, cubic: bool) {
        let cross = sign * (a * d - c * b);
        let m = &mut self.0;
        m[0] += cross;
        m[1] += cross * (a + c);
        m[2] += cross * (b + d);
        m[3] += cross * (a * a + a * c + c * c);
        m[4] += cross * ((a * b + c * d) + 0.5 * (a * d + c * b));
        m[5] += cross * (b * b + b * d + d * d);
        if cubic {
            m[6] += cross * (a + c) * (a * a + c * c);
            m[7] += cross * (a * a * (3.0 * b + d) + 2.0 * a * c * (b + d) + c * c * (b + 3.0 * d));
            m[8] += cross * (b * b * (3.0 * a + c) + 2.0 * b * d * (a + c) + d * d * (a + 3.0 * c));
            m[9] += cross * (b + d) * (b * b + d * d);
        }
    }

    /// Integrals for weight 1 about a seed from which the first corner is at `origin`.
    fn uniform(&self, facet: &Facet, origin: DVec3) -> Integrals {
        let [one, u, v, uu, uv, vv, ..] = self.0;
        let [e, f] = facet.side;
        let (one, u, v, uu, uv, vv) = (one / 2.0, u / 6.0, v / 6.0, uu / 12.0, uv / 12.0, vv / 12.0);
        let area = facet.twice_area * one;
        let moment = facet.twice_area * (one * origin + u * e + v * f);
        let squares = origin.length_squared() * one
            + 2.0 * (origin.dot(e) * u + origin.dot(f) * v + e.dot(f) * uv)
            + e.length_squared() * uu
            + f.length_squared() * vv;
        Integrals { mass: area, moment, energy: facet.twice_area * squares, area }
    }

    /// The same for weights linear in the facet.
    fn weighted(&self, facet: &Facet, origin: DVec3) -> Integrals {
        let [one, u, v, uu, uv, vv, uuu, uuv, uvv, vvv] = self.0;
        let [e, f] = facet.side;
        let (one, u, v, uu, uv, vv) = (one / 2.0, u / 6.0, v / 6.0, uu / 12.0, uv / 12.0, vv / 12.0);
        let (uuu, uuv, uvv, vvv) = (uuu / 20.0, uuv / 60.0, uvv / 60.0, vvv / 20.0);
        let w = facet.weight;
        let (wu, wv) = (w[1] - w[0], w[2] - w[0]);
        let by = |one: f64, u: f64, v: f64| w[0] * one + wu * u + wv * v;
        let (mass, mu, mv) = (by(one, u, v), by(u, uu, uv), by(v, uv, vv));
        let (muu, muv, mvv) = (by(uu, uuu, uuv), by(uv, uuv, uvv), by(vv, uvv, vvv));
        let squares = origin.length_squared() * mass
            + 2.0 * (origin.dot(e) * mu + origin.dot(f) * mv + e.dot(f) * muv)
            + e.length_squared() * muu
            + f.length_squared() * mvv;
        let moment = facet.twice_area * (mass * origin + mu * e + mv * f);
        Integrals {
            mass: facet.twice_area * mass,
            moment,
            energy: facet.twice_area * squares,
            area: facet.twice_area * one,
        }
    }
}
