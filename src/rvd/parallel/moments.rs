//! Integrals over the pieces of facets.
//!
//! Purpose: a polynomial's integral over a piece is a sum over the segments around it (Green's theorem), in
//! barycentric coordinates.
//! Invariant: a segment gives the pieces on both of its sides the same numbers but for their sign.
//! Must not know: how segments are found.

use pulp::Simd;

use super::lanes::{Number, Row};

/// ∫ uᵃvᵇ over a piece in barycentric coordinates, p = p₀ + u (p₁ - p₀) + v (p₂ - p₀), in order 1, u, v,
/// u², uv, v², u³, u²v, uv², v³, times the numbers that [`integrals`] divides by.
pub(super) type Moments = [Row; WEIGHTED];

/// How many of them weight 1 takes, which leaves the third powers out,
pub(super) const UNIFORM: usize = 6;
/// and weights linear in the facet.
pub(super) const WEIGHTED: usize = 10;

/// A place (u, v).
pub(super) type Place<S> = [Number<S>; 2];

/// The moments of the triangle from the origin to a segment, whose integral of a homogeneous polynomial of degree
/// n is that along the segment, times the cross product over n + 2.
#[inline(always)]
pub(super) fn of<S: Simd, const N: usize>(simd: S, [a, b]: Place<S>, [c, d]: Place<S>) -> [Number<S>; N] {
    let (half, two, three) = (Number::all(simd, 0.5), Number::all(simd, 2.0), Number::all(simd, 3.0));
    let cross = a * d - c * b;
    let mut m = [cross; N];
    m[1] = cross * (a + c);
    m[2] = cross * (b + d);
    m[3] = cross * (a * a + a * c + c * c);
    m[4] = cross * ((a * b + c * d) + half * (a * d + c * b));
    m[5] = cross * (b * b + b * d + d * d);
    if N == WEIGHTED {
        m[6] = cross * (a + c) * (a * a + c * c);
        m[7] = cross * (a * a * (three * b + d) + two * a * c * (b + d) + c * c * (b + three * d));
        m[8] = cross * (b * b * (three * a + c) + two * b * d * (a + c) + d * d * (a + three * c));
        m[9] = cross * (b + d) * (b * b + d * d);
    }
    m
}

/// Adds to a piece's moments.
#[inline(always)]
pub(super) fn add<S: Simd, const N: usize>(simd: S, sum: &mut Moments, more: [Number<S>; N]) {
    for (sum, more) in sum.iter_mut().zip(more) {
        (Number::load(simd, sum) + more).store(sum);
    }
}

/// Takes from a piece's moments.
#[inline(always)]
pub(super) fn take<S: Simd, const N: usize>(simd: S, sum: &mut Moments, less: [Number<S>; N]) {
    for (sum, less) in sum.iter_mut().zip(less) {
        (Number::load(simd, sum) - less).store(sum);
    }
}

/// Facets in space, as their pieces' integrals need them.
pub(super) struct Shape<S: Simd> {
    /// From the first corner to the others.
    pub side: [[Number<S>; 3]; 2],
    pub twice_area: Number<S>,
    /// At the corners.
    pub weight: [Number<S>; 3],
}

/// Integrals over pieces about their seeds.
pub(super) struct PieceIntegrals<S: Simd> {
    pub mass: Number<S>,
    pub moment: [Number<S>; 3],
    pub energy: Number<S>,
    pub area: Number<S>,
}

#[inline(always)]
fn dot<S: Simd>(a: [Number<S>; 3], b: [Number<S>; 3]) -> Number<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The integrals about a seed from which the first corner is at `origin`.
#[inline(always)]
pub(super) fn integrals<S: Simd, const N: usize>(
    simd: S,
    moments: &Moments,
    shape: &Shape<S>,
    origin: [Number<S>; 3],
) -> PieceIntegrals<S> {
    let m = |k: usize, by: f64| Number::load(simd, &moments[k]) * Number::all(simd, 1.0 / by);
    let (one, u, v) = (m(0, 2.0), m(1, 6.0), m(2, 6.0));
    let (uu, uv, vv) = (m(3, 12.0), m(4, 12.0), m(5, 12.0));
    let [e, f] = shape.side;
    let two = Number::all(simd, 2.0);
    let squares = |one, u, v, uu, uv, vv| {
        dot(origin, origin) * one
            + two * (dot(origin, e) * u + dot(origin, f) * v + dot(e, f) * uv)
            + dot(e, e) * uu
            + dot(f, f) * vv
    };
    let area = shape.twice_area * one;
    let first = |one, u, v| {
        let along = |c: usize| shape.twice_area * (one * origin[c] + u * e[c] + v * f[c]);
        [along(0), along(1), along(2)]
    };
    if N == UNIFORM {
        let energy = shape.twice_area * squares(one, u, v, uu, uv, vv);
        return PieceIntegrals { mass: area, moment: first(one, u, v), energy, area };
    }
    let (uuu, uuv, uvv, vvv) = (m(6, 20.0), m(7, 60.0), m(8, 60.0), m(9, 20.0));
    let w = shape.weight;
    let (wu, wv) = (w[1] - w[0], w[2] - w[0]);
    let by = |one, u, v| w[0] * one + wu * u + wv * v;
    let (mass, mu, mv) = (by(one, u, v), by(u, uu, uv), by(v, uv, vv));
    let (muu, muv, mvv) = (by(uu, uuu, uuv), by(uv, uuv, uvv), by(vv, uvv, vvv));
    PieceIntegrals {
        mass: shape.twice_area * mass,
        moment: first(mass, mu, mv),
        energy: shape.twice_area * squares(mass, mu, mv, muu, muv, mvv),
        area,
    }
}
