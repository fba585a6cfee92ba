//! Points between which distances are measured.
//!
//! Purpose: [`Point`] is what the diagram needs of its points, so that one kernel serves the surface in R^3 and the surface
//! lifted to R^6 by its normals (\[LB12\]).
//! Invariant: a distance is at least that of the [`Point::place`]s, so that a search among places finds everything; sums of
//! coordinates are in one order. Must not know: what lifts a surface, facets.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub};

use glam::DVec3;

use super::tree::{SearchTree, Tree};
use crate::mesh::coincident;

/// A vector of R^3, or of the space to which a surface is lifted.
pub trait Point:
    Copy
    + Debug
    + Default
    + PartialEq
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Neg<Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
    + AddAssign
    + MulAssign<f64>
{
    /// One item a coordinate.
    type Each<T: Copy + Send + Sync>: AsRef<[T]> + AsMut<[T]> + Copy + Send + Sync;
    /// Finds the nearest of many.
    type Tree: SearchTree<Self::Each<f64>>;

    /// The origin.
    const ZERO: Self;
    /// Whether the place is all there is.
    const IS_PLACE: bool;
    /// Pairs of coordinates: the minors of two vectors, whose squares add up to the square of twice the area between them.
    const MINORS: &'static [(usize, usize)];

    /// One item a coordinate, each from its number. `of` is called where it stands: a call of `array::map` that is not inlined
    /// would have no vector instructions.
    fn each<T: Copy + Send + Sync>(of: impl FnMut(usize) -> T) -> Self::Each<T>;

    /// The coordinates.
    fn coordinates(self) -> Self::Each<f64>;

    /// The point with these coordinates.
    fn from_coordinates(coordinates: Self::Each<f64>) -> Self;

    /// Where it is in R^3.
    fn place(self) -> DVec3;

    /// The point that was found at a place, `whole` if that is not all there is.
    fn found_at(place: DVec3, whole: impl FnOnce() -> Self) -> Self;

    /// The same point at another place.
    fn at(self, place: DVec3) -> Self;

    /// The scalar product.
    fn dot(self, other: Self) -> f64;

    /// Coordinate by coordinate.
    fn times(self, other: Self) -> Self;

    /// The sum of the coordinates.
    fn element_sum(self) -> f64;

    /// The area of the parallelogram between two vectors.
    fn parallelogram(self, other: Self) -> f64;

    /// Whether all coordinates are.
    fn is_finite(self) -> bool;

    /// `(later, earliest)` for every point that lies exactly on an earlier one, in order of `later`.
    fn coincident(points: &[Self]) -> Vec<(u32, u32)>;

    /// |p|².
    fn length_squared(self) -> f64 {
        self.dot(self)
    }

    /// |p|.
    fn length(self) -> f64 {
        self.length_squared().sqrt()
    }

    /// |p - q|².
    fn distance_squared(self, other: Self) -> f64 {
        (self - other).length_squared()
    }

    /// |p - q|.
    fn distance(self, other: Self) -> f64 {
        (self - other).length()
    }
}

impl Point for DVec3 {
    type Each<T: Copy + Send + Sync> = [T; 3];
    type Tree = Tree<3>;

    const ZERO: Self = Self::ZERO;
    const IS_PLACE: bool = true;
    const MINORS: &'static [(usize, usize)] = &[(1, 2), (2, 0), (0, 1)];

    #[inline(always)]
    fn each<T: Copy + Send + Sync>(mut of: impl FnMut(usize) -> T) -> [T; 3] {
        [of(0), of(1), of(2)]
    }

    #[inline(always)]
    fn coordinates(self) -> [f64; 3] {
        self.to_array()
    }

    #[inline(always)]
    fn from_coordinates(coordinates: [f64; 3]) -> Self {
        Self::from_array(coordinates)
    }

    #[inline(always)]
    fn place(self) -> DVec3 {
        self
    }

    #[inline(always)]
    fn found_at(place: DVec3, _: impl FnOnce() -> Self) -> Self {
        place
    }

    #[inline(always)]
    fn at(self, place: DVec3) -> Self {
        place
    }

    #[inline(always)]
    fn dot(self, other: Self) -> f64 {
        self.dot(other)
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self * other
    }

    #[inline(always)]
    fn element_sum(self) -> f64 {
        self.element_sum()
    }

    #[inline(always)]
    fn parallelogram(self, other: Self) -> f64 {
        self.cross(other).length()
    }

    #[inline(always)]
    fn is_finite(self) -> bool {
        self.is_finite()
    }

    fn coincident(points: &[Self]) -> Vec<(u32, u32)> {
        coincident::find(points)
    }
}

/// A point of R^6: a place, and a normal of the surface there times a length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lifted {
    /// Where it is in R^3.
    pub place: DVec3,
    /// The normal times the length, in the same unit.
    pub lift: DVec3,
}

macro_rules! by_parts {
    ($($trait:ident $name:ident;)*) => {$(
        impl $trait for Lifted {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self { place: self.place.$name(other.place), lift: self.lift.$name(other.lift) }
            }
        }
    )*};
}

macro_rules! by_number {
    ($($trait:ident $name:ident;)*) => {$(
        impl $trait<f64> for Lifted {
            type Output = Self;

            #[inline(always)]
            fn $name(self, by: f64) -> Self {
                Self { place: self.place.$name(by), lift: self.lift.$name(by) }
            }
        }
    )*};
}

by_parts! { Add add; Sub sub; }
by_number! { Mul mul; Div div; }

impl Neg for Lifted {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self { place: -self.place, lift: -self.lift }
    }
}

impl AddAssign for Lifted {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl MulAssign<f64> for Lifted {
    #[inline(always)]
    fn mul_assign(&mut self, by: f64) {
        *self = *self * by;
    }
}

impl Point for Lifted {
    type Each<T: Copy + Send + Sync> = [T; 6];
    type Tree = Tree<6>;

    const ZERO: Self = Self { place: DVec3::ZERO, lift: DVec3::ZERO };
    const IS_PLACE: bool = false;
    const MINORS: &'static [(usize, usize)] = &[
        (1, 2),
        (2, 0),
        (0, 1),
        (4, 5),
        (5, 3),
        (3, 4),
        (0, 3),
        (0, 4),
        (0, 5),
        (1, 3),
        (1, 4),
        (1, 5),
        (2, 3),
        (2, 4),
        (2, 5),
    ];

    #[inline(always)]
    fn each<T: Copy + Send + Sync>(mut of: impl FnMut(usize) -> T) -> [T; 6] {
        [of(0), of(1), of(2), of(3), of(4), of(5)]
    }

    #[inline(always)]
    fn coordinates(self) -> [f64; 6] {
        let ([x, y, z], [u, v, w]) = (self.place.to_array(), self.lift.to_array());
        [x, y, z, u, v, w]
    }

    #[inline(always)]
    fn from_coordinates([x, y, z, u, v, w]: [f64; 6]) -> Self {
        Self { place: DVec3::new(x, y, z), lift: DVec3::new(u, v, w) }
    }

    #[inline(always)]
    fn place(self) -> DVec3 {
        self.place
    }

    #[inline(always)]
    fn found_at(_: DVec3, whole: impl FnOnce() -> Self) -> Self {
        whole()
    }

    #[inline(always)]
    fn at(self, place: DVec3) -> Self {
        Self { place, lift: self.lift }
    }

    #[inline(always)]
    fn dot(self, other: Self) -> f64 {
        // One after the other, as the search tree adds squares: rows are then in one order, whatever made them.
        let (a, b) = (self.lift, other.lift);
        self.place.dot(other.place) + a.x * b.x + a.y * b.y + a.z * b.z
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self { place: self.place * other.place, lift: self.lift * other.lift }
    }

    #[inline(always)]
    fn element_sum(self) -> f64 {
        self.place.element_sum() + self.lift.element_sum()
    }

    #[inline(always)]
    fn parallelogram(self, other: Self) -> f64 {
        // By minors, as the difference |a|²|b|² - (a·b)² cancels.
        let (a, b) = (self.coordinates(), other.coordinates());
        let squares = Self::MINORS.iter().map(|&(i, j)| (a[i] * b[j] - a[j] * b[i]).powi(2));
        squares.sum::<f64>().sqrt()
    }

    #[inline(always)]
    fn is_finite(self) -> bool {
        self.place.is_finite() && self.lift.is_finite()
    }

    fn coincident(points: &[Self]) -> Vec<(u32, u32)> {
        // Points in one place are few, but for those of creases: each is compared with the others there.
        let places: Vec<DVec3> = points.iter().map(|p| p.place).collect();
        let mut at_place: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        let mut pairs = Vec::new();
        for (later, first) in coincident::find(&places) {
            let others = at_place.entry(first).or_insert_with(|| vec![first]);
            match others.iter().find(|&&other| points[other as usize] == points[later as usize]) {
                Some(&earliest) => pairs.push((later, earliest)),
                None => others.push(later),
            }
        }
        pairs
    }
}
