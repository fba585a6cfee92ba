//! Labels of facets in files: materials, groups, solids, physical groups, references, arrays of cells.
//!
//! Purpose: [`RegionChoice`] says which of them become regions. [`Labels`] collects those of a reader's facets, in order, and
//! [`Found`] is what it found; [`names`] and [`numbers`] are what a writer calls the regions. Invariant: labels that cannot be
//! regions are left aside with the reason; memory is in proportion to the facets. Must not know: the syntax of a format.

use std::collections::{HashMap, HashSet};
use std::hash::Hash;
use std::ops::RangeInclusive;

use super::DataError;
use super::numbers::{Cursor, Encoding, Kind, plain};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::weld;
use crate::mesh::attributes::AttributeError;
use crate::mesh::regions::{MAX_REGION_NAME, MAX_REGIONS, Region, Regions};

/// Which labels of facets become regions.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum RegionChoice {
    /// Those that the format has for this: materials, groups, solids, physical groups, references, and an array of cells or a property
    /// of faces called `regions`, as is written here.
    #[default]
    Named,
    /// None. Labels are reported as left aside.
    Ignore,
    /// The array of cells (VTK) or the property of faces (PLY) of this name; in OBJ the labels of `usemtl`, `g` or `o`.
    Array(String),
}

impl RegionChoice {
    /// The array of cells or property of faces that is read.
    pub(super) fn of_cells(&self) -> Option<&str> {
        match self {
            Self::Array(name) => Some(name),
            Self::Named => Some(ARRAY),
            Self::Ignore => None,
        }
    }

    /// The name of an array that has to be there.
    pub(super) fn array(&self) -> Option<&str> {
        match self {
            Self::Array(name) => Some(name),
            Self::Named | Self::Ignore => None,
        }
    }
}

/// What the array or property of a written file is called.
pub(super) const ARRAY: &str = "regions";

/// Arrays are named by a message, at most.
const MOST_NAMES: usize = 32;

/// The array is not among those that are there.
pub(super) fn missing(name: &str, there: &[String]) -> DataError {
    let there = there.iter().take(MOST_NAMES).map(|name| plain(name, 40)).collect();
    DataError::NoRegions { name: plain(name, 40), there }
}

/// What a message says of the arrays that are there.
pub(super) fn listed(there: &[String]) -> String {
    let names: Vec<String> = there.iter().map(|name| format!("{name:?}")).collect();
    if names.is_empty() { "there is none".to_owned() } else { format!("there is {}", names.join(", ")) }
}

/// Labels of facets as they are read.
#[derive(Debug)]
pub(super) struct Labels<K> {
    known: HashMap<K, u32>,
    last: Option<(K, u32)>,
    of_facet: Vec<u32>,
    wrong: Option<String>,
}

impl<K> Default for Labels<K> {
    fn default() -> Self {
        Self { known: HashMap::new(), last: None, of_facet: Vec::new(), wrong: None }
    }
}

impl<K: Copy + Eq + Hash> Labels<K> {
    /// No labels, with room for those of so many facets.
    pub(super) fn with_room(facets: usize) -> Self {
        Self { of_facet: Vec::with_capacity(facets), ..Self::default() }
    }

    /// The label of the next facets.
    pub(super) fn push(&mut self, label: K, facets: usize) {
        if facets == 0 || self.wrong.is_some() {
            return;
        }
        let index = match self.last {
            Some((last, index)) if last == label => index,
            _ => {
                let next = self.known.len();
                if next == MAX_REGIONS && !self.known.contains_key(&label) {
                    return self.give_up(format!("there are more than {MAX_REGIONS}, as of data"));
                }
                *self.known.entry(label).or_insert(next as u32)
            }
        };
        self.last = Some((label, index));
        self.of_facet.extend(std::iter::repeat_n(index, facets));
    }

    /// Leaves the labels aside.
    pub(super) fn give_up(&mut self, reason: String) {
        self.of_facet = Vec::new();
        self.wrong.get_or_insert(reason);
    }

    /// How many there are.
    pub(super) fn count(&self) -> usize {
        self.known.len()
    }

    /// Whether others tell apart the same facets.
    pub(super) fn are_alike(&self, others: &Self) -> bool {
        // Labels are numbered by their first use.
        self.of_facet == others.of_facet
    }

    /// The labels with what their regions are called; `region` also gets the rank of a label by its first use, from 0.
    /// `kinds` is the labels' plural.
    pub(super) fn finish(self, kinds: impl Into<String>, region: impl Fn(K, u32) -> Region) -> Found {
        let Self { known, mut of_facet, wrong, .. } = self;
        let mut all: Vec<(u32, Region)> = known.into_iter().map(|(label, k)| (k, region(label, k))).collect();
        all.sort_unstable_by_key(|(k, region)| (region.number, *k));
        let mut place = vec![0; all.len()];
        all.iter().zip(0..).for_each(|((k, _), at)| place[*k as usize] = at);
        of_facet.iter_mut().for_each(|label| *label = place[*label as usize]);
        Found { kinds: kinds.into(), of_facet, all: all.into_iter().map(|(_, region)| region).collect(), wrong }
    }
}

impl Labels<i64> {
    /// As [`Labels::push`], for a number that may have a fraction.
    pub(super) fn push_number(&mut self, number: f64, facets: usize) {
        match whole(number) {
            Some(label) => self.push(label, facets),
            None => self.give_up(no_label(number)),
        }
    }

    /// Regions with these numbers.
    pub(super) fn numbered(self, kinds: impl Into<String>) -> Found {
        self.finish(kinds, |number, _| Region { number, name: String::new() })
    }
}

/// Labels of a file.
#[derive(Debug)]
pub(super) struct Found {
    kinds: String,
    of_facet: Vec<u32>,
    all: Vec<Region>,
    wrong: Option<String>,
}

/// Labels that change at more than half of the edges are data, if they do so at this many.
const LEAST_BORDERS: usize = 64;

impl Found {
    /// What they are, and how many.
    pub(super) fn kinds(&self) -> (&str, usize) {
        (&self.kinds, self.all.len())
    }

    /// The regions; none if all facets have one label. The error says why labels are left aside.
    pub(super) fn regions(self, mesh: &TriMesh) -> Result<Option<Regions>, AttributeError> {
        let Self { kinds, of_facet, all, wrong } = self;
        let count = all.len();
        let aside = |attribute: String, message: String| Err(AttributeError::Unreadable { attribute, message });
        if let Some(wrong) = wrong {
            return aside(kinds, wrong);
        }
        if count <= 1 {
            return Ok(None);
        }
        let (labelled, facets) = (of_facet.len(), mesh.facets().len());
        if labelled != facets {
            return aside(kinds, format!("{labelled} of {facets} facets have one"));
        }
        let regions = Regions::new(of_facet, all)?;
        let (borders, edges) = regions.count_borders(mesh.facets(), &weld(mesh));
        if borders >= LEAST_BORDERS && 2 * borders > edges {
            let text = format!("they change at {borders} of {edges} edges, as data do; regions are patches");
            return aside(format!("{count} {kinds}"), text);
        }
        Ok(Some(regions))
    }
}

/// Doubles hold all whole numbers up to this one.
const LARGEST: f64 = 9_007_199_254_740_992.0;

fn whole(number: f64) -> Option<i64> {
    (number.fract() == 0.0 && number.abs() < LARGEST).then_some(number as i64)
}

fn no_label(number: f64) -> String {
    format!("{number:?} is no whole number below 2^53, as a label is")
}

/// Reads labels, or says why an array holds others.
pub(super) fn whole_numbers(
    cursor: &mut Cursor<'_>,
    count: usize,
    kind: Kind,
    what: &str,
) -> Result<Result<Vec<i64>, String>, DataError> {
    if cursor.encoding != Encoding::Text && !kind.is_float() {
        return cursor.integers(count, kind, what).map(Ok);
    }
    let numbers = cursor.lenient(count, kind, what)?;
    Ok(numbers.into_iter().map(|number| whole(number).ok_or_else(|| no_label(number))).collect())
}

/// A name as regions have it: text of at most [`MAX_REGION_NAME`] bytes, without control characters and spaces at its ends.
pub(super) fn name(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(4 * MAX_REGION_NAME)]);
    let mut name = String::new();
    for c in text.trim().chars().map(|c| if c.is_control() { ' ' } else { c }) {
        if name.len() + c.len_utf8() > MAX_REGION_NAME {
            break;
        }
        name.push(c);
    }
    name.trim().to_owned()
}

/// A region that a file has by its name alone: numbers go by first use, from 1.
pub(super) fn by_name(bytes: &[u8], rank: u32) -> Region {
    Region { number: i64::from(rank) + 1, name: name(bytes) }
}

/// What a file that has names alone calls each region: as `written` makes it of the name, or of the number if it has none. No
/// two are the same.
pub(super) fn names(regions: &Regions, written: impl Fn(&str) -> String) -> Vec<String> {
    let mut taken = HashSet::new();
    let name = |(index, region): (usize, &Region)| {
        let plain = written(&regions.label(index));
        let others = (2..).map(|k| format!("{plain}_{}_{k}", region.number));
        let mut all = [plain.clone(), format!("{plain}_{}", region.number)].into_iter().chain(others);
        all.find(|name| taken.insert(name.clone())).unwrap_or_default()
    };
    regions.all().iter().enumerate().map(name).collect()
}

/// What to say of regions that get other names in a file.
pub(super) fn renamed(regions: Option<&Regions>, written: impl Fn(&str) -> String) -> Option<String> {
    let regions = regions?;
    let names = names(regions, written).into_iter().enumerate().map(|(index, name)| (regions.label(index), name));
    let others: Vec<_> = names.filter(|(label, name)| label != name).collect();
    let shown = others.iter().take(MOST_NAMES).map(|(label, name)| format!("{label:?} (it is {name})"));
    (!others.is_empty()).then(|| format!("the name of region {}", shown.collect::<Vec<_>>().join(", ")))
}

/// The number of each region in a file that has numbers of a range: its own if all are in it, else 1, 2, ...
pub(super) fn numbers(regions: &Regions, range: &RangeInclusive<i64>) -> Vec<i64> {
    let own = || regions.all().iter().map(|region| region.number);
    if own().all(|number| range.contains(&number)) { own().collect() } else { (1..=own().len() as i64).collect() }
}

/// What to say of regions that get other numbers in a file.
pub(super) fn renumbered(regions: Option<&Regions>, range: &RangeInclusive<i64>) -> Option<String> {
    let kept = |regions: &&Regions| regions.all().iter().all(|region| range.contains(&region.number));
    regions.filter(|regions| !kept(regions)).map(|_| "numbers of regions (they are 1, 2, ...)".to_owned())
}

#[cfg(test)]
mod tests;
