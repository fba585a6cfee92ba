//! Points that lie exactly on one another.
//!
//! Purpose: the earliest duplicate of every later one, in linear time.
//! Invariant: 0 and -0 are the same place. Must not know: whether points are vertices or seeds.

use std::hash::{BuildHasher, RandomState};

use glam::DVec3;

/// `(later, earliest)` for every point that lies exactly on an earlier one, in order of `later`.
pub(crate) fn find(points: &[DVec3]) -> Vec<(u32, u32)> {
    const EMPTY: u32 = u32::MAX;
    let mask = (points.len() * 2).next_power_of_two() - 1;
    let mut slots = vec![EMPTY; mask + 1];
    let mut pairs = Vec::new();
    // Another key each time, so that nobody can send points that all fall into one slot. The
    // answer does not depend on it.
    let key = RandomState::new().hash_one(points.len());
    for (i, point) in points.iter().enumerate() {
        let mut slot = hash(*point, key) & mask;
        loop {
            match slots[slot] {
                EMPTY => {
                    slots[slot] = i as u32;
                    break;
                }
                j if points[j as usize] == *point => {
                    pairs.push((i as u32, j));
                    break;
                }
                _ => slot = (slot + 1) & mask,
            }
        }
    }
    pairs
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
}
