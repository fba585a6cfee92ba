//! Points that lie exactly or nearly on one another.
//!
//! Purpose: [`find`] returns for each later duplicate the earliest one, [`near`] an earlier point nearby; both in linear time.
//! Invariant: 0 and -0 are the same place. Must not know: whether points are vertices or seeds.

use std::cmp::Ordering::Equal;
use std::collections::HashMap;
use std::hash::{BuildHasher, RandomState};
use std::iter::successors;

use glam::DVec3;

use crate::token::{Stopped, Token};

/// No point.
const NONE: u32 = u32::MAX;

/// `(later, earliest)` for every point that lies exactly on an earlier one, in order of `later`.
pub fn find(points: &[DVec3]) -> Vec<(u32, u32)> {
    find_unless(points, &Token::default()).unwrap_or_default()
}

/// As [`find`], unless it is stopped.
pub fn find_unless(points: &[DVec3], token: &Token) -> Result<Vec<(u32, u32)>, Stopped> {
    const EMPTY: u32 = u32::MAX;
    let mask = (points.len() * 2).next_power_of_two() - 1;
    let mut slots = vec![EMPTY; mask + 1];
    let mut pairs = Vec::new();
    // A random key, so that no input can make all points collide. The result does not depend on it.
    let key = RandomState::new().hash_one(points.len());
    for (i, point) in points.iter().enumerate() {
        token.check_at(i)?;
        let mut slot = hash(*point, key) & mask;
        while slots[slot] != EMPTY && points[slots[slot] as usize] != *point {
            slot = (slot + 1) & mask;
        }
        match slots[slot] {
            EMPTY => slots[slot] = i as u32,
            j => pairs.push((i as u32, j)),
        }
    }
    Ok(pairs)
}

/// Returns `(later, earlier, distance)` for each of the points `numbers` within `reach` of an earlier one: the nearest of
/// the points that have no earlier neighbour themselves. `origin` is a corner of the points' box.
pub fn near(
    points: &[DVec3],
    numbers: impl IntoIterator<Item = u32>,
    (origin, reach): (DVec3, f64),
    token: &Token,
) -> Result<Vec<(u32, u32, f64)>, Stopped> {
    let place = |v: u32| points[v as usize];
    // The first point stands for those near it. Others are farther away, so that a cell has few. Counted from the box's
    // corner, so that numbers stay small far from the origin.
    let cell = |p: DVec3| ((p - origin) / (4.0 * reach)).floor().to_array().map(|x| x as i64);
    // The first and the last point of each cell. All are in one list, with the place of the next of their cell: a list for each
    // cell would be freed for a long time.
    let mut cells: HashMap<[i64; 3], (u32, u32)> = HashMap::new();
    let mut list: Vec<(u32, u32)> = Vec::new();
    let mut found = Vec::new();
    for (k, v) in numbers.into_iter().enumerate() {
        // Each looks at up to eight cells.
        token.check_at(8 * k)?;
        let (low, high) = (cell(place(v) - reach), cell(place(v) + reach));
        let along = |axis: usize| low[axis]..=high[axis];
        let around = along(0).flat_map(|x| along(1).flat_map(move |y| along(2).map(move |z| [x, y, z])));
        let next = |at: &u32| Some(list[*at as usize].1).filter(|&next| next != NONE);
        let there = around.filter_map(|cell| cells.get(&cell)).flat_map(|&(first, _)| successors(Some(first), next));
        let there = there.map(|at| list[at as usize].0);
        let nearest = there.map(|u| (place(u).distance(place(v)), u)).min_by(|a, b| a.partial_cmp(b).unwrap_or(Equal));
        match nearest.filter(|(distance, _)| *distance <= reach) {
            Some((distance, u)) => found.push((v, u, distance)),
            None => {
                let at = list.len() as u32;
                list.push((v, NONE));
                let (_, last) = cells.entry(cell(place(v))).or_insert((at, at));
                if *last != at {
                    list[*last as usize].1 = at;
                    *last = at;
                }
            }
        }
    }
    Ok(found)
}

/// Equal points hash alike: -0 is +0 after adding +0.
fn hash(p: DVec3, key: u64) -> usize {
    let mut h = key;
    for x in p.to_array() {
        h = (h ^ (x + 0.0).to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h ^= h >> 29;
    }
    h as usize
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use glam::dvec3;

    #[test]
    fn later_twins_name_the_earliest() {
        let p = dvec3(0.25, 0.0, -1.0);
        let q = dvec3(0.25, -0.0, -1.0);
        let seeds = [p, dvec3(1., 2., 3.), q, p];
        assert_eq!(find(&seeds), vec![(2, 0), (3, 0)]);
        assert!(find(&seeds[..2]).is_empty());
    }

    #[test]
    fn near_ones_name_an_earlier_one_across_cells_too() {
        let at = |x: f64| dvec3(x, 2.0 * x, 5.0);
        let points = [at(0.39), at(0.41), at(0.395), at(3.0), at(0.0)];
        let found = near(&points, 0..5, (at(0.0), 0.1), &Token::default()).unwrap();
        assert_eq!(found.iter().map(|f| (f.0, f.1)).collect::<Vec<_>>(), [(1, 0), (2, 0)]);
        assert!((found[0].2 - 0.02 * 5f64.sqrt()).abs() < 1e-12);
    }
}
