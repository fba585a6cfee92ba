//! Facets divided among their cells.
//!
//! Purpose: the integrals of all pieces of several facets at once ([`facets`]), without polygons. [`Lanes`] are vectors of one
//! number a facet, as wide as the processor's registers, with the usual operators. A polynomial's integral over a piece is a sum
//! over the segments around it (Green's theorem), in barycentric coordinates.
//! Invariant: each lane is computed as it would be alone: the same bits on every processor. Nothing depends on what a comparison or
//! an extremum does with what is no number. A segment gives the pieces on both of its sides the same numbers but for their sign.
//! Must not know: where lists of seeds come from, how segments are found.

pub(super) mod facets;

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Not, Sub};

use glam::DVec3;
use pulp::Simd;

use crate::knn::Point;

/// The most lanes that there may be.
pub(crate) const WIDEST: usize = 8;

/// Memory of one vector, however wide.
#[derive(Clone, Copy, Default)]
#[repr(align(64))]
pub(crate) struct Row(pub [f64; WIDEST]);

/// A number for each lane.
#[derive(Clone, Copy)]
pub(crate) struct Number<S: Simd> {
    simd: S,
    value: S::f64s,
}

/// Yes or no for each lane.
#[derive(Clone, Copy)]
pub(crate) struct Mask<S: Simd> {
    simd: S,
    value: S::m64s,
}

macro_rules! methods {
    ($($name:ident($($other:ident)?) -> $of:ident = $simd:ident;)*) => {$(
        #[inline(always)]
        pub(crate) fn $name(self $(, $other: Self)?) -> $of<S> {
            $of { simd: self.simd, value: self.simd.$simd(self.value $(, $other.value)?) }
        }
    )*};
}

impl<S: Simd> Number<S> {
    pub(crate) const LANES: usize = if S::F64_LANES < WIDEST { S::F64_LANES } else { WIDEST };

    #[inline(always)]
    pub(crate) fn all(simd: S, value: f64) -> Self {
        Self { simd, value: simd.splat_f64s(value) }
    }

    #[inline(always)]
    pub(crate) fn load(simd: S, row: &Row) -> Self {
        Self { simd, value: S::as_simd_f64s(&row.0).0[0] }
    }

    #[inline(always)]
    pub(crate) fn store(self, row: &mut Row) {
        S::as_mut_simd_f64s(&mut row.0).0[0] = self.value;
    }

    /// As `abs_f64s`, which calls what is not always inlined, and has no vector instructions then.
    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        let all_but_sign = self.simd.splat_f64s(f64::from_bits(u64::MAX >> 1));
        Self { value: self.simd.and_f64s(self.value, all_but_sign), ..self }
    }

    methods! {
        sqrt() -> Number = sqrt_f64s;
        larger(other) -> Number = max_f64s;
        smaller(other) -> Number = min_f64s;
        below(other) -> Mask = less_than_f64s;
        at_most(other) -> Mask = less_than_or_equal_f64s;
    }
}

impl<S: Simd> Mask<S> {
    #[inline(always)]
    pub(crate) fn none(simd: S) -> Self {
        let zero = Number::all(simd, 0.0);
        zero.below(zero)
    }

    #[inline(always)]
    pub(crate) fn choose(self, yes: Number<S>, no: Number<S>) -> Number<S> {
        Number { simd: self.simd, value: self.simd.select_f64s(self.value, yes.value, no.value) }
    }

    #[inline(always)]
    pub(crate) fn any(self) -> bool {
        self.simd.first_true_m64s(self.value) < S::F64_LANES
    }
}

macro_rules! operator {
    ($trait:ident, $name:ident, $simd:ident, $of:ident) => {
        impl<S: Simd> $trait for $of<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self { value: self.simd.$simd(self.value, other.value), ..self }
            }
        }
    };
}

operator!(Add, add, add_f64s, Number);
operator!(Sub, sub, sub_f64s, Number);
operator!(Mul, mul, mul_f64s, Number);
operator!(Div, div, div_f64s, Number);
operator!(BitAnd, bitand, and_m64s, Mask);
operator!(BitOr, bitor, or_m64s, Mask);
operator!(BitXor, bitxor, xor_m64s, Mask);

impl<S: Simd> Not for Mask<S> {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        let zero = Number::all(self.simd, 0.0);
        self ^ zero.at_most(zero)
    }
}

/// Integrals over a piece in barycentric coordinates, p = p₀ + u (p₁ - p₀) + v (p₂ - p₀): of 1, wu, wv, wu², wuv, wv²
/// and w, where w is the weight; times the numbers that [`integrals`] divides by.
pub(crate) type Moments = [Row; WEIGHTED];

/// Number of moments where the weight is 1; the first moment then also stands for the last.
pub(crate) const UNIFORM: usize = 6;
pub(crate) const WEIGHTED: usize = 7;

/// The weight at the first corner, and how much more it is at the others.
#[derive(Clone, Copy)]
pub(crate) struct Weight<S: Simd>([Number<S>; 3]);

impl<S: Simd> Weight<S> {
    #[inline(always)]
    pub(crate) fn new([first, second, third]: [Number<S>; 3]) -> Self {
        Self([first, second - first, third - first])
    }

    #[inline(always)]
    fn at(&self, [u, v]: Place<S>) -> Number<S> {
        let [first, du, dv] = self.0;
        first + du * u + dv * v
    }
}

/// A place (u, v).
pub(crate) type Place<S> = [Number<S>; 2];

/// The moments of the triangle from the origin to a segment. The integral of a product of linear functions over a triangle
/// is a sum of products of their values at its corners, where u and v are 0 at the origin.
#[inline(always)]
pub(crate) fn segment_moments<S: Simd, const N: usize>(
    simd: S,
    weight: Weight<S>,
    [from, to]: [Place<S>; 2],
) -> [Number<S>; N] {
    let ([a, b], [c, d]) = (from, to);
    let cross = a * d - c * b;
    let mut m = [cross; N];
    if N == UNIFORM {
        let half = Number::all(simd, 0.5);
        m[1] = cross * (a + c);
        m[2] = cross * (b + d);
        m[3] = cross * (a * a + a * c + c * c);
        m[4] = cross * ((a * b + c * d) + half * (a * d + c * b));
        m[5] = cross * (b * b + b * d + d * d);
        return m;
    }
    let (w_from, w_to) = (weight.at(from), weight.at(to));
    let all = cross * (weight.0[0] + w_from + w_to);
    m[6] = all;
    let (f, t) = (cross * w_from, cross * w_to);
    let (x, y) = (all + f, all + t);
    m[1] = a * x + c * y;
    m[2] = b * x + d * y;
    let (x, y, z) = (x + f, y + t, all - cross * (Number::all(simd, 0.5) * weight.0[0]));
    let (ax, cy, two_z) = (a * x, c * y, z + z);
    m[3] = a * ax + c * cy + a * c * two_z;
    m[4] = b * ax + d * cy + (a * d + c * b) * z;
    m[5] = b * b * x + d * d * y + b * d * two_z;
    m
}

#[inline(always)]
pub(crate) fn add_moments<S: Simd, const N: usize>(simd: S, sum: &mut Moments, more: [Number<S>; N]) {
    for m in 0..N {
        (Number::load(simd, &sum[m]) + more[m]).store(&mut sum[m]);
    }
}

#[inline(always)]
pub(crate) fn take_moments<S: Simd, const N: usize>(simd: S, sum: &mut Moments, less: [Number<S>; N]) {
    for m in 0..N {
        (Number::load(simd, &sum[m]) - less[m]).store(&mut sum[m]);
    }
}

/// Facets in space, as their pieces' integrals need them.
pub(crate) struct Shape<S: Simd, P: Point> {
    /// From the first corner to the others.
    pub side: [P::Each<Number<S>>; 2],
    pub twice_area: Number<S>,
}

pub(crate) struct PieceIntegrals<S: Simd, P: Point> {
    pub mass: Number<S>,
    pub moment: P::Each<Number<S>>,
    pub energy: Number<S>,
    pub area: Number<S>,
}

/// Coordinate after coordinate.
#[inline(always)]
fn dot<S: Simd, P: Point>(a: &P::Each<Number<S>>, b: &P::Each<Number<S>>) -> Number<S> {
    let (a, b) = (a.as_ref(), b.as_ref());
    let mut sum = a[0] * b[0];
    for k in 1..a.len() {
        sum = sum + a[k] * b[k];
    }
    sum
}

#[inline(always)]
pub(crate) fn minus<S: Simd, P: Point>(a: &P::Each<Number<S>>, b: &P::Each<Number<S>>) -> P::Each<Number<S>> {
    P::each(|k| a.as_ref()[k] - b.as_ref()[k])
}

#[inline(always)]
pub(crate) fn distance_squared<S: Simd, P: Point>(a: &P::Each<Number<S>>, b: &P::Each<Number<S>>) -> Number<S> {
    let between = minus::<S, P>(a, b);
    dot::<S, P>(&between, &between)
}

/// The integrals about a seed from which the first corner is at `origin`.
#[inline(always)]
pub(crate) fn integrals<S: Simd, P: Point, const N: usize>(
    simd: S,
    moments: &Moments,
    shape: &Shape<S, P>,
    origin: &P::Each<Number<S>>,
) -> PieceIntegrals<S, P> {
    let area = shape.twice_area * part(simd, moments, 0, 2.0);
    let ([one, first, second], [mass, linear, quadratic]) = match N {
        UNIFORM => ([0, 1, 3], [2.0, 6.0, 12.0]),
        _ => ([6, 1, 3], [6.0, 24.0, 60.0]),
    };
    let mass = part(simd, moments, one, mass);
    let (u, v) = (part(simd, moments, first, linear), part(simd, moments, first + 1, linear));
    let [uu, uv, vv] = DVec3::each(|k| part(simd, moments, second + k, quadratic));
    // ∫ (p - x) and ∫ |p - x|² from the integrals of 1, u, v, u², uv, v².
    let [e, f] = &shape.side;
    let two = Number::all(simd, 2.0);
    let squares = dot::<S, P>(origin, origin) * mass
        + two * (dot::<S, P>(origin, e) * u + dot::<S, P>(origin, f) * v + dot::<S, P>(e, f) * uv)
        + dot::<S, P>(e, e) * uu
        + dot::<S, P>(f, f) * vv;
    let at = |k: usize| mass * origin.as_ref()[k] + u * e.as_ref()[k] + v * f.as_ref()[k];
    let moment = P::each(|k| shape.twice_area * at(k));
    PieceIntegrals { mass: shape.twice_area * mass, moment, energy: shape.twice_area * squares, area }
}

#[inline(always)]
fn part<S: Simd>(simd: S, moments: &Moments, k: usize, by: f64) -> Number<S> {
    Number::load(simd, &moments[k]) * Number::all(simd, 1.0 / by)
}
