//! Regions of a surface: facets with one label, such as a material or a physical group.
//!
//! Purpose: [`Regions`] has the region of each facet, and what the file calls it; [`Regions::borders`] are the edges between two.
//! Invariant: every facet has a region that is there; no two regions have one number. Must not know: files, what borders are for.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use super::edges::{sides, undirected};

/// What a file calls a region.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Region {
    /// Its number, as a physical group or a reference has one.
    pub number: i64,
    /// Its name; empty if it has none. At most [`MAX_REGION_NAME`].
    pub name: String,
}

/// The most regions of a surface.
pub const MAX_REGIONS: usize = 1 << 16;
/// The longest name of a region, bytes.
pub const MAX_REGION_NAME: usize = 128;

/// Why regions were refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RegionsError {
    /// More than can be told apart.
    #[error("there are {count} regions; {MAX_REGIONS} are possible")]
    TooMany {
        /// How many were given.
        count: usize,
    },
    /// A facet names a region that is not there.
    #[error("regions: facet {facet} is of region {index}, but there are {regions}")]
    IndexOutOfRange {
        /// Index of the facet, from 0.
        facet: usize,
        /// The index as given.
        index: u32,
        /// Number of regions.
        regions: usize,
    },
    /// Two regions cannot be told apart.
    #[error("two regions have the number {number}; number them differently")]
    SameNumber {
        /// Their number.
        number: i64,
    },
    /// A name will not do.
    #[error("the region with the number {number} cannot have its name: {reason}")]
    Name {
        /// Its number.
        number: i64,
        /// The defect.
        reason: &'static str,
    },
}

/// The region of each facet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Regions {
    of_facet: Vec<u32>,
    all: Vec<Region>,
}

impl Regions {
    /// `of_facet` has an index into `all` for each facet. A region may be without facets.
    pub fn new(of_facet: Vec<u32>, all: Vec<Region>) -> Result<Self, RegionsError> {
        if all.len() > MAX_REGIONS {
            return Err(RegionsError::TooMany { count: all.len() });
        }
        if let Some(facet) = of_facet.iter().position(|&region| region as usize >= all.len()) {
            return Err(RegionsError::IndexOutOfRange { facet, index: of_facet[facet], regions: all.len() });
        }
        let mut numbers = HashSet::new();
        for &Region { number, ref name } in &all {
            if !numbers.insert(number) {
                return Err(RegionsError::SameNumber { number });
            }
            let wrong = |reason| Err(RegionsError::Name { number, reason });
            if name.len() > MAX_REGION_NAME {
                return wrong("a name has at most 128 bytes");
            }
            if name.contains(char::is_control) || name.trim() != name {
                return wrong("leave out control characters, and spaces at its ends");
            }
        }
        Ok(Self { of_facet, all })
    }

    /// A region for each number, in the order of the numbers, without names.
    pub fn of_numbers(numbers: &[i64]) -> Result<Self, RegionsError> {
        Self::of_named(numbers, Vec::new())
    }

    /// The `named` regions, and after them one without a name for each other number.
    pub fn of_named(numbers: &[i64], named: Vec<Region>) -> Result<Self, RegionsError> {
        let known: BTreeMap<i64, u32> = named.iter().map(|region| region.number).zip(0..).collect();
        let others: BTreeSet<i64> = numbers.iter().copied().filter(|number| !known.contains_key(number)).collect();
        let first = named.len() as u32;
        let mut index = known;
        index.extend(others.iter().copied().zip(first..));
        let of_facet = numbers.iter().map(|number| index[number]).collect();
        let others = others.into_iter().map(|number| Region { number, name: String::new() });
        Self::new(of_facet, named.into_iter().chain(others).collect())
    }

    /// For each facet its region: an index into [`Regions::all`].
    pub fn of_facet(&self) -> &[u32] {
        &self.of_facet
    }

    /// All regions.
    pub fn all(&self) -> &[Region] {
        &self.all
    }

    /// The facets of each region, in order.
    pub(crate) fn facets_by_region(&self) -> Vec<Vec<u32>> {
        let mut facets = vec![Vec::new(); self.all.len()];
        self.of_facet.iter().zip(0..).for_each(|(&region, facet)| facets[region as usize].push(facet));
        facets
    }

    /// The number of the region of each facet.
    pub fn numbers(&self) -> impl ExactSizeIterator<Item = i64> + '_ {
        self.of_facet.iter().map(|&region| self.all[region as usize].number)
    }

    /// What the region is called: by its name, or by its number.
    pub fn label(&self, region: usize) -> String {
        match &self.all[region] {
            Region { number, name } if name.is_empty() => number.to_string(),
            Region { name, .. } => name.clone(),
        }
    }

    /// The region of this name; if there is none, that of this number.
    pub(crate) fn named(&self, name: &str) -> Option<u32> {
        let number = || name.parse::<i64>().ok().and_then(|number| self.all.iter().position(|r| r.number == number));
        self.all.iter().position(|region| region.name == name && !name.is_empty()).or_else(number).map(|k| k as u32)
    }

    /// The regions of a mesh whose facets are of these of the present one; the same if `None`.
    pub(crate) fn of(&self, origin: Option<&[u32]>) -> Cow<'_, Self> {
        let Some(origin) = origin else { return Cow::Borrowed(self) };
        let of_facet = origin.iter().map(|&f| self.of_facet[f as usize]).collect();
        Cow::Owned(Self { of_facet, all: self.all.clone() })
    }

    /// The same regions of other facets.
    pub(crate) fn with_facets(&self, of_facet: Vec<u32>) -> Self {
        Self { of_facet, all: self.all.clone() }
    }

    /// The edges at which facets of several regions meet. `class` has the lowest vertex in the place of each vertex.
    pub(crate) fn borders(&self, facets: &[[u32; 3]], class: &[u32]) -> Vec<[u32; 2]> {
        let welded = |edge: [u32; 2]| undirected(edge.map(|v| class[v as usize]));
        let of = |(t, &region): (&[u32; 3], &u32)| sides(*t).map(|edge| (welded(edge), region));
        let mut all: Vec<([u32; 2], u32)> = facets.iter().zip(&self.of_facet).flat_map(of).collect();
        all.sort_unstable();
        let edges = all.chunk_by(|a, b| a.0 == b.0).filter(|edge| edge[0].0[0] != edge[0].0[1]);
        edges.filter(|edge| edge[0].1 != edge[edge.len() - 1].1).map(|edge| edge[0].0).collect()
    }

    /// How many edges [`Self::borders`] has, and at how many any two facets meet. Takes less memory than these edges.
    pub(crate) fn count_borders(&self, facets: &[[u32; 3]], class: &[u32]) -> (usize, usize) {
        let (mut borders, mut meet) = (0, 0);
        for part in 0..PARTS {
            // The first region at each edge, whether there is another facet, and another region.
            let mut known: HashMap<[u32; 2], (u32, bool, bool), foldhash::fast::RandomState> = HashMap::default();
            for (t, &region) in facets.iter().zip(&self.of_facet) {
                for edge in sides(*t) {
                    let [a, b] = undirected(edge.map(|v| class[v as usize]));
                    if a != b && a.wrapping_add(b) % PARTS == part {
                        let known =
                            known.entry([a, b]).and_modify(|edge| *edge = (edge.0, true, edge.2 || edge.0 != region));
                        known.or_insert((region, false, false));
                    }
                }
            }
            meet += known.values().filter(|edge| edge.1).count();
            borders += known.values().filter(|edge| edge.2).count();
        }
        (borders, meet)
    }
}

/// Edges are counted in so many parts.
const PARTS: u32 = 8;

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn borders_are_between_regions() {
        // A strip of four facets.
        let facets = [[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]];
        let class: Vec<u32> = (0..6).collect();
        let regions = Regions::of_numbers(&[7, 7, -2, -2]).unwrap();
        assert_eq!((regions.of_facet(), regions.label(0)), (&[1, 1, 0, 0][..], "-2".to_owned()));
        assert_eq!(regions.borders(&facets, &class), [[2, 3]]);
        assert_eq!(regions.count_borders(&facets, &class), (1, 3));
        assert_eq!(regions.count_borders(&facets, &[0, 1, 2, 1, 4, 5]), (1, 2));
        assert_eq!(regions.borders(&facets, &[0, 1, 2, 1, 4, 5]), [[1, 2]]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let region = |number| Region { number, name: String::new() };
        assert!(matches!(Regions::new(vec![1], vec![region(1)]), Err(RegionsError::IndexOutOfRange { .. })));
        assert!(matches!(Regions::new(vec![0], vec![region(1), region(1)]), Err(RegionsError::SameNumber { .. })));
        let many: Vec<i64> = (0..=MAX_REGIONS as i64).collect();
        assert!(matches!(Regions::of_numbers(&many), Err(RegionsError::TooMany { .. })));
    }
}
