//! Clipping one facet to one Voronoi cell in f64 (\[HYWZ17\], Algorithm 2; re-entrant clipping after \[SH74\]).
//!
//! Purpose: the polygon in which facet and cell meet, and its integrals.
//! Invariant: coordinates are relative to the seed, so nothing cancels; a point on a bisector
//! belongs to the lower seed index (two-way sign); where a bisector meets a mesh edge the point is
//! computed from the edge's own ends, from the lower vertex index to the higher, so that both
//! facets of the edge get the same bits.
//! Must not know: which pairs there are, where neighbours come from.

use glam::DVec3;

use super::cells::{FACET_EDGE, facet_edge};
use super::{PairStatus, Surface};

/// A polygon vertex: position relative to the seed, density weight, and the label of the edge
/// from here to the next vertex (opposite seed, or a facet edge; see [`facet_edge`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// p - x_i, unit frame.
    pub p: DVec3,
    /// Density weight at p.
    pub w: f64,
    /// What lies across the edge to the next vertex.
    pub edge: u32,
}

/// Integrals over one piece, about the seed, unit frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Integrals {
    /// ∫ w.
    pub mass: f64,
    /// ∫ w (p - x_i).
    pub moment: DVec3,
    /// ∫ w |p - x_i|².
    pub energy: f64,
    /// ∫ 1.
    pub area: f64,
}

/// Corners of one facet relative to one seed.
struct Corners {
    p: [DVec3; 3],
    w: [f64; 3],
    vertex: [u32; 3],
}

/// Scratch memory for clipping, and the last polygon.
#[derive(Debug, Default)]
pub struct Clipper {
    polygon: Vec<Vertex>,
    next: Vec<Vertex>,
    side: Vec<f64>,
    cutter: u32,
}

impl Clipper {
    /// The last polygon; empty if the cell does not meet the facet.
    pub fn polygon(&self) -> &[Vertex] {
        &self.polygon
    }

    /// The seed whose bisector cut last. After an empty result it is nearer to the facet than
    /// the seed that was clipped.
    pub fn cutter(&self) -> u32 {
        self.cutter
    }

    /// Clips `facet` to the cell of seed `i` by the bisectors with `row`, nearest first, until
    /// the security radius closes (\[LB12\]: no seed farther than twice the polygon's radius can
    /// cut it). `complete` says that no other seed can matter; `slots` bounds the polygon.
    pub fn clip(
        &mut self,
        surface: &Surface,
        facet: u32,
        seeds: &[DVec3],
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
        for &j in row {
            let b = seeds[j as usize] - origin;
            let b2 = b.length_squared();
            if b2 > 4.0 * radius2 {
                return PairStatus::Done;
            }
            if !self.cut(b, 0.5 * b2, j, i < j, &corners) {
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
    fn cut(&mut self, b: DVec3, half: f64, j: u32, tie_inside: bool, corners: &Corners) -> bool {
        let inside = |d: f64| d > 0.0 || (d == 0.0 && tie_inside);
        self.side.clear();
        let mut kept = 0;
        for v in &self.polygon {
            let d = half - v.p.dot(b);
            kept += usize::from(inside(d));
            self.side.push(d);
        }
        let n = self.polygon.len();
        if kept == n {
            return false;
        }
        self.next.clear();
        if kept > 0 {
            for k in 0..n {
                let m = if k + 1 == n { 0 } else { k + 1 };
                let (v, u) = (self.polygon[k], self.polygon[m]);
                let (dv, du) = (self.side[k], self.side[m]);
                let (v_in, u_in) = (inside(dv), inside(du));
                if v_in {
                    self.next.push(v);
                }
                if v_in != u_in {
                    let (p, w) = match facet_edge(v.edge) {
                        Some(e) => corners.meet(e, b, half).unwrap_or_else(|| meet(&v, dv, &u, du)),
                        None => meet(&v, dv, &u, du),
                    };
                    self.next.push(Vertex { p, w, edge: if v_in { j } else { v.edge } });
                }
            }
        }
        std::mem::swap(&mut self.polygon, &mut self.next);
        true
    }

    /// Integrals of the last polygon, fanned from its first vertex (design, section 3, "Density").
    pub fn integrals(&self) -> Integrals {
        let mut sum = Integrals::default();
        let Some((a, rest)) = self.polygon.split_first() else { return sum };
        for pair in rest.windows(2) {
            let (b, c) = (&pair[0], &pair[1]);
            let area = 0.5 * (b.p - a.p).cross(c.p - a.p).length();
            let total = a.w + b.w + c.w;
            let (wa, wb, wc) = (total + a.w, total + b.w, total + c.w);
            sum.area += area;
            sum.mass += area * total / 3.0;
            sum.moment += area / 12.0 * (wa * a.p + wb * b.p + wc * c.p);
            let squares = (wa + a.w) * a.p.length_squared()
                + (wb + b.w) * b.p.length_squared()
                + (wc + c.w) * c.p.length_squared();
            let products = (wa + b.w) * a.p.dot(b.p) + (wb + c.w) * b.p.dot(c.p) + (wc + a.w) * c.p.dot(a.p);
            sum.energy += area / 30.0 * (squares + products);
        }
        sum
    }
}

/// Where the edge between two vertices meets the bisector with values `dv`, `du` at its ends.
fn meet(v: &Vertex, dv: f64, u: &Vertex, du: f64) -> (DVec3, f64) {
    // In a direction that does not depend on which of the two facets asks.
    let ((v, dv), (u, du)) = if dv > du { ((v, dv), (u, du)) } else { ((u, du), (v, dv)) };
    let t = dv / (dv - du);
    (v.p + t * (u.p - v.p), v.w + t * (u.w - v.w))
}

impl Corners {
    fn new(surface: &Surface, facet: u32, origin: DVec3) -> Self {
        let vertex = surface.facets()[facet as usize];
        Self {
            p: vertex.map(|v| surface.positions()[v as usize] - origin),
            w: vertex.map(|v| surface.weights()[v as usize]),
            vertex: surface.welded()[facet as usize],
        }
    }

    /// Where edge `e` meets a bisector, from its own ends; `None` where rounding has both ends
    /// on one side.
    fn meet(&self, e: usize, b: DVec3, half: f64) -> Option<(DVec3, f64)> {
        let (mut lo, mut hi) = (e, (e + 1) % 3);
        if self.vertex[lo] > self.vertex[hi] {
            std::mem::swap(&mut lo, &mut hi);
        }
        let (dl, dh) = (half - self.p[lo].dot(b), half - self.p[hi].dot(b));
        let t = dl / (dl - dh);
        ((0.0..=1.0).contains(&t))
            .then(|| (self.p[lo] + t * (self.p[hi] - self.p[lo]), self.w[lo] + t * (self.w[hi] - self.w[lo])))
    }
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
