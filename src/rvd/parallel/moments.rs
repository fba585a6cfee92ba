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
    for m in 0..N {
        (Number::load(simd, &sum[m]) + more[m]).store(&mut sum[m]);
    }
}

/// Takes from a piece's moments.
#[inline(always)]
pub(super) fn take<S: Simd, const N: usize>(simd: S, sum: &mut Moments, less: [Number<S>; N]) {
    for m in 0..N {
        (Number::load(simd, &sum[m]) - less[m]).store(&mut sum[m]);
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
    let (one, u, v) = (part(simd, moments, 0, 2.0), part(simd, moments, 1, 6.0), part(simd, moments, 2, 6.0));
    let (uu, uv, vv) = (part(simd, moments, 3, 12.0), part(simd, moments, 4, 12.0), part(simd, moments, 5, 12.0));
    let area = shape.twice_area * one;
    if N == UNIFORM {
        let (moment, energy) = about(simd, shape, origin, [one, u, v, uu, uv, vv]);
        return PieceIntegrals { mass: area, moment, energy, area };
    }
    let (uuu, uuv) = (part(simd, moments, 6, 20.0), part(simd, moments, 7, 60.0));
    let (uvv, vvv) = (part(simd, moments, 8, 60.0), part(simd, moments, 9, 20.0));
    let w = shape.weight;
    let (mass, mu, mv) = (weighted(w, one, u, v), weighted(w, u, uu, uv), weighted(w, v, uv, vv));
    let (muu, muv, mvv) = (weighted(w, uu, uuu, uuv), weighted(w, uv, uuv, uvv), weighted(w, vv, uvv, vvv));
    let (moment, energy) = about(simd, shape, origin, [mass, mu, mv, muu, muv, mvv]);
    PieceIntegrals { mass: shape.twice_area * mass, moment, energy, area }
}

#[inline(always)]
fn part<S: Simd>(simd: S, moments: &Moments, k: usize, by: f64) -> Number<S> {
    Number::load(simd, &moments[k]) / Number::all(simd, by)
}

/// From the integral of a function, and of it times u and v, that of the function times a weight.
#[inline(always)]
fn weighted<S: Simd>(w: [Number<S>; 3], one: Number<S>, u: Number<S>, v: Number<S>) -> Number<S> {
    w[0] * one + (w[1] - w[0]) * u + (w[2] - w[0]) * v
}

/// ∫ (p - x) and ∫ |p - x|² from the integrals of 1, u, v, u², uv, v².
#[inline(always)]
fn about<S: Simd>(
    simd: S,
    shape: &Shape<S>,
    origin: [Number<S>; 3],
    [one, u, v, uu, uv, vv]: [Number<S>; 6],
) -> ([Number<S>; 3], Number<S>) {
    let [e, f] = shape.side;
    let two = Number::all(simd, 2.0);
    let squares = dot(origin, origin) * one
        + two * (dot(origin, e) * u + dot(origin, f) * v + dot(e, f) * uv)
        + dot(e, e) * uu
        + dot(f, f) * vv;
    let moment = [
        shape.twice_area * (one * origin[0] + u * e[0] + v * f[0]),
        shape.twice_area * (one * origin[1] + u * e[1] + v * f[1]),
        shape.twice_area * (one * origin[2] + u * e[2] + v * f[2]),
    ];
    (moment, shape.twice_area * squares)
}
