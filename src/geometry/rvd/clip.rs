//! Clipping one facet to one Voronoi cell in f64 (\[HYWZ17\], Algorithm 2; re-entrant clipping after \[SH74\]).
//!
//! Purpose: the polygon in which facet and cell meet, and its integrals.
//! Invariant: coordinates are relative to the seed, so nothing cancels; a point on a bisector belongs to the lower seed index
//! (two-way sign); a side that rounding could get wrong is decided exactly from the vertex's identity (`rvd::exact`); where a
//! bisector meets a mesh edge the point is computed from the edge's own ends, from the lower vertex index to the higher, so that
//! both facets of the edge get the same bits. Must not know: which pairs there are, where neighbours come from.

use super::cells::{FACET_EDGE, facet_edge};
use super::{PairStatus, Surface, exact::Sides};
use crate::knn::Point;
use crate::token::{Pace, Token};

/// A polygon vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex<P = glam::DVec3> {
    /// The point relative to the seed, `p - x_i`, unit frame.
    pub p: P,
    /// Density weight at p.
    pub w: f64,
    /// What lies across the edge to the next vertex: the opposite seed, or a facet edge ([`facet_edge`]).
    pub edge: u32,
}

/// Integrals over one piece, about the seed, unit frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Integrals<P = glam::DVec3> {
    /// ∫ w.
    pub mass: f64,
    /// ∫ w (p - x_i).
    pub moment: P,
    /// ∫ w |p - x_i|².
    pub energy: f64,
    /// ∫ 1.
    pub area: f64,
}

/// Four times the squared radius bounds the squared distance of a seed that can cut; a little more covers rounding.
pub(super) const SECURITY: f64 = 4.0 * (1.0 + 1e-9);

/// A cut that rounding may move by more than this share of the radius is placed exactly: lines nearly parallel, one in 10⁴.
const MAX_SLIP: f64 = 1e-11;

/// Corners of one facet relative to one seed.
struct Corners<P> {
    p: [P; 3],
    w: [f64; 3],
    vertex: [u32; 3],
}

/// Scratch memory for clipping, and the last polygon.
#[derive(Debug, Default)]
pub struct Clipper<P = glam::DVec3> {
    pub(super) polygon: Vec<Vertex<P>>,
    next: Vec<Vertex<P>>,
    /// Value of the bisector at each vertex, and the exact side.
    side: Vec<(f64, bool)>,
    /// The seed whose bisector cut last. After an empty result it is nearer to the facet than the seed that was clipped.
    pub(super) cutter: u32,
    /// Bound on the distance of each vertex from the seed.
    radius: f64,
    /// Bound on the error of each vertex's position.
    error: f64,
    steps: usize,
    /// Where it is stopped clips end early, without a polygon.
    pub(super) token: Token,
    pace: Pace,
}

/// Floating-point sides that take as long as an exact one.
const EXACT: usize = 64;

impl<P: Point> Clipper<P> {
    pub(super) fn is_stopped_after(&mut self, steps: usize) -> bool {
        self.token.is_stopped_after(steps, &mut self.pace)
    }

    /// The last polygon; empty if the cell does not meet the facet.
    pub fn polygon(&self) -> &[Vertex<P>] {
        &self.polygon
    }

    /// Clips `facet` to the cell of seed `i` by the bisectors with `row`, nearest first, until the security radius closes
    /// (\[LB12\]: no seed beyond twice the polygon's radius cuts). With `complete` no other matters; `slots` bounds the polygon.
    pub fn clip(
        &mut self,
        surface: &Surface<P>,
        facet: u32,
        seeds: &[P],
        i: u32,
        (row, complete): (&[u32], bool),
        slots: usize,
    ) -> PairStatus {
        let origin = seeds[i as usize];
        let corners = Corners::new(surface, facet, origin);
        self.polygon.clear();
        self.cutter = i;
        for e in 0..3 {
            self.polygon.push(Vertex { p: corners.p[e], w: corners.w[e], edge: FACET_EDGE - e as u32 });
        }
        let mut radius2 = self.radius2();
        if !radius2.is_finite() {
            return PairStatus::NonFinite;
        }
        self.radius = radius2.sqrt();
        // Differences of grid points are exact inside the box and off by one rounding outside.
        self.error = f64::EPSILON * self.radius;
        let sides = Sides { surface, facet, seeds, i };
        for &j in row {
            let b = seeds[j as usize] - origin;
            let b2 = b.length_squared();
            if b2 > SECURITY * radius2 {
                return PairStatus::Done;
            }
            let changed = self.cut(Bisector { j, b, half: 0.5 * b2, length: b2.sqrt() }, &corners, sides);
            // A cell among thousands has as many sides, and each bisector is compared with each.
            if self.is_stopped_after(self.steps) {
                self.polygon.clear();
                return PairStatus::NonFinite;
            }
            if !changed {
                continue;
            }
            self.cutter = j;
            if self.polygon.len() > slots {
                return PairStatus::PolygonOverflow;
            }
            if self.polygon.len() < 3 {
                self.polygon.clear();
                return PairStatus::Done;
            }
            radius2 = self.radius2();
        }
        if complete { PairStatus::Done } else { PairStatus::NeighboursExhausted }
    }

    fn radius2(&self) -> f64 {
        self.polygon.iter().map(|v| v.p.length_squared()).fold(0.0, f64::max)
    }

    /// Cuts by the bisector of b = x_j - x_i. Returns whether anything changed.
    fn cut(&mut self, bisector: Bisector<P>, corners: &Corners<P>, sides: Sides<'_, P>) -> bool {
        let n = self.polygon.len();
        let inherited = self.error;
        // By how much d = |b|²/2 - p·b may be off: three roundings in p·b, one of |b|²/2, and the vertex's own error along b.
        let unsure = bisector.length * (self.error + 4.0 * f64::EPSILON * (bisector.length + self.radius));
        self.side.clear();
        self.steps = n;
        let mut kept = 0;
        for k in 0..n {
            let v = &self.polygon[k];
            let mut d = bisector.half - v.p.dot(bisector.b);
            let mut inside = d > 0.0;
            if d.abs() <= unsure {
                self.steps += EXACT;
                let before = self.polygon[if k == 0 { n - 1 } else { k - 1 }].edge;
                inside = sides.inside(before, v.edge, bisector.j);
                if inside != (d > 0.0) {
                    d = 0.0;
                }
            }
            kept += usize::from(inside);
            self.side.push((d, inside));
        }
        if kept == n {
            return false;
        }
        self.next.clear();
        if kept > 0 {
            for k in 0..n {
                let m = if k + 1 == n { 0 } else { k + 1 };
                let (v, u) = (self.polygon[k], self.polygon[m]);
                let ((dv, v_in), (du, u_in)) = (self.side[k], self.side[m]);
                if v_in {
                    self.next.push(v);
                }
                if v_in != u_in {
                    let (p, w, slip) = match facet_edge(v.edge) {
                        Some(e) => corners.meet(e, &bisector),
                        None => between((v.p, v.w, dv), (u.p, u.w, du), unsure),
                    };
                    let (p, w) = if slip <= MAX_SLIP * self.radius {
                        self.error = self.error.max(inherited) + slip + 4.0 * f64::EPSILON * self.radius;
                        (p, w)
                    } else {
                        corners.at(sides.place(v.edge, bisector.j)).unwrap_or((p, w))
                    };
                    self.next.push(Vertex { p, w, edge: if v_in { bisector.j } else { v.edge } });
                }
            }
        }
        std::mem::swap(&mut self.polygon, &mut self.next);
        true
    }

    /// Integrals of the last polygon, fanned from its first vertex (design, section 3, "Density").
    pub fn integrals(&self) -> Integrals<P> {
        let mut sum = Integrals::default();
        let Some((a, rest)) = self.polygon.split_first() else { return sum };
        for pair in rest.windows(2) {
            let (b, c) = (&pair[0], &pair[1]);
            let area = 0.5 * (b.p - a.p).parallelogram(c.p - a.p);
            let total = a.w + b.w + c.w;
            let (wa, wb, wc) = (total + a.w, total + b.w, total + c.w);
            sum.area += area;
            sum.mass += area * total / 3.0;
            sum.moment += (a.p * wa + b.p * wb + c.p * wc) * (area / 12.0);
            let squares = (wa + a.w) * a.p.length_squared()
                + (wb + b.w) * b.p.length_squared()
                + (wc + c.w) * c.p.length_squared();
            let products = (wa + b.w) * a.p.dot(b.p) + (wb + c.w) * b.p.dot(c.p) + (wc + a.w) * c.p.dot(a.p);
            sum.energy += area / 30.0 * (squares + products);
        }
        sum
    }
}

/// Where the segment between two points (position, weight, bisector's value off by at most `unsure`) meets the bisector, in
/// a direction that does not depend on which of the two facets asks; and how far along the segment that may be wrong.
fn between<P: Point>(v: (P, f64, f64), u: (P, f64, f64), unsure: f64) -> (P, f64, f64) {
    let ((p, wp, dp), (q, wq, dq)) = if v.2 > u.2 { (v, u) } else { (u, v) };
    let t = parameter(dp, dq);
    (p + (q - p) * t, wp + t * (wq - wp), 2.0 * unsure / (dp - dq) * p.distance(q))
}

/// Where a linear function with values `a` and `b` at 0 and 1 is zero, kept in [0, 1], where exact signs put it.
fn parameter(a: f64, b: f64) -> f64 {
    let t = a / (a - b);
    if t.is_nan() { 0.5 } else { t.clamp(0.0, 1.0) }
}

impl<P: Point> Corners<P> {
    fn new(surface: &Surface<P>, facet: u32, origin: P) -> Self {
        let vertex = surface.facets()[facet as usize];
        Self {
            p: vertex.map(|v| surface.positions()[v as usize] - origin),
            w: vertex.map(|v| surface.weights()[v as usize]),
            vertex: surface.welded()[facet as usize],
        }
    }

    /// Where edge `e` meets a bisector, from its own ends, the lower mesh vertex first; and how far along it that may be wrong.
    fn meet(&self, e: usize, bisector: &Bisector<P>) -> (P, f64, f64) {
        let (mut lo, mut hi) = (e, (e + 1) % 3);
        if self.vertex[lo] > self.vertex[hi] {
            std::mem::swap(&mut lo, &mut hi);
        }
        let value = |c: usize| bisector.half - self.p[c].dot(bisector.b);
        let (dl, dh) = (value(lo), value(hi));
        let t = parameter(dl, dh);
        let radius = self.p[lo].length().max(self.p[hi].length());
        let unsure = 4.0 * f64::EPSILON * bisector.length * (bisector.length + radius);
        let slip = 2.0 * unsure / (dl - dh).abs() * self.p[lo].distance(self.p[hi]);
        (self.p[lo] + (self.p[hi] - self.p[lo]) * t, self.w[lo] + t * (self.w[hi] - self.w[lo]), slip)
    }

    /// Position and weight at barycentric coordinates.
    fn at(&self, bary: Option<[f64; 3]>) -> Option<(P, f64)> {
        let [x, y, z] = bary?;
        Some((self.p[0] * x + self.p[1] * y + self.p[2] * z, x * self.w[0] + y * self.w[1] + z * self.w[2]))
    }
}

/// The bisector with seed j: points where half - p·b = 0.
struct Bisector<P> {
    j: u32,
    b: P,
    half: f64,
    length: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriMesh;
    use glam::dvec3;

    fn square() -> Surface {
        let corners = vec![dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 0.)];
        let mesh = TriMesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        Surface::new(&mesh, None).unwrap()
    }

    #[test]
    fn half_a_triangle() {
        let surface = square();
        // The unit frame puts the square at [-1/2, 1/2]²; the bisector is x = 0.
        let seeds = [dvec3(-0.25, 0., 0.), dvec3(0.25, 0., 0.)];
        let mut clipper = Clipper::default();
        let status = clipper.clip(&surface, 0, &seeds, 0, (&[1], true), 10);
        assert_eq!(status, PairStatus::Done);
        let sums = clipper.integrals();
        assert!((sums.area - 0.125).abs() < 1e-15 && (sums.mass - 0.125).abs() < 1e-15);
        assert!(clipper.polygon().iter().any(|v| v.edge == 1));
        assert_eq!(clipper.polygon().iter().filter(|v| facet_edge(v.edge).is_some()).count(), 2);
    }

    #[test]
    fn statuses() {
        let surface = square();
        let seeds = [dvec3(-0.25, 0., 0.), dvec3(0.25, 0., 0.), dvec3(9., 0., 0.)];
        let mut clipper = Clipper::default();
        let mut clip = |row: &[u32], complete, slots| clipper.clip(&surface, 1, &seeds, 0, (row, complete), slots);
        assert_eq!(clip(&[1], false, 10), PairStatus::NeighboursExhausted);
        assert_eq!(clip(&[1, 2], false, 10), PairStatus::Done);
        assert_eq!(clip(&[1], true, 3), PairStatus::PolygonOverflow);
    }

    #[test]
    fn energy_of_a_weighted_triangle() {
        // ∫ (1 + x) |p|² over the triangle (0,0), (1,0), (0,1): 1/6 + (1/20 + 1/60).
        let mut clipper = Clipper::default();
        for (x, y, w) in [(0., 0., 1.), (1., 0., 2.), (0., 1., 1.)] {
            clipper.polygon.push(Vertex { p: dvec3(x, y, 0.), w, edge: 0 });
        }
        let sums = clipper.integrals();
        assert!((sums.energy - (1. / 6. + 1. / 20. + 1. / 60.)).abs() < 1e-15);
        assert!((sums.mass - (0.5 + 1. / 6.)).abs() < 1e-15);
        assert!((sums.moment.x - (1. / 6. + 1. / 12.)).abs() < 1e-15);
    }
}
