//! Several facets at once.
//!
//! Purpose: vectors of one number a facet, as wide as the processor's registers, with the usual operators.
//! Invariant: each lane is computed as it would be alone: the same bits on every processor. Nothing depends on what
//! a comparison or an extremum does with what is no number.
//! Must not know: what the numbers mean.

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Not, Sub};

use pulp::Simd;

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

impl<S: Simd> Number<S> {
    /// How many lanes there are.
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

    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        Self { value: self.simd.abs_f64s(self.value), ..self }
    }

    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self { value: self.simd.sqrt_f64s(self.value), ..self }
    }

    #[inline(always)]
    pub(crate) fn below(self, other: Self) -> Mask<S> {
        Mask { simd: self.simd, value: self.simd.less_than_f64s(self.value, other.value) }
    }

    #[inline(always)]
    pub(crate) fn at_most(self, other: Self) -> Mask<S> {
        Mask { simd: self.simd, value: self.simd.less_than_or_equal_f64s(self.value, other.value) }
    }

    #[inline(always)]
    pub(crate) fn larger(self, other: Self) -> Self {
        Self { value: self.simd.max_f64s(self.value, other.value), ..self }
    }

    #[inline(always)]
    pub(crate) fn smaller(self, other: Self) -> Self {
        Self { value: self.simd.min_f64s(self.value, other.value), ..self }
    }
}

impl<S: Simd> Mask<S> {
    #[inline(always)]
    pub(crate) fn none(simd: S) -> Self {
        let zero = Number::all(simd, 0.0);
        zero.below(zero)
    }

    /// `yes` where it is so, `no` elsewhere.
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
