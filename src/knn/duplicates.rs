//! Points that lie exactly on one another.
//!
//! Purpose: the earliest twin of every later one, in linear time.
//! Must not know: trees.

use glam::DVec3;

/// `(later, earliest)` for every point that lies exactly on an earlier one, in order of `later`.
pub(super) fn find(seeds: &[DVec3]) -> Vec<(u32, u32)> {
    const EMPTY: u32 = u32::MAX;
    let mask = (seeds.len() * 2).next_power_of_two() - 1;
    let mut slots = vec![EMPTY; mask + 1];
    let mut pairs = Vec::new();
    for (i, seed) in seeds.iter().enumerate() {
        let mut slot = hash(*seed) & mask;
        loop {
            match slots[slot] {
                EMPTY => {
                    slots[slot] = i as u32;
                    break;
                }
                j if seeds[j as usize] == *seed => {
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
fn hash(p: DVec3) -> usize {
    let mut h = 0u64;
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
