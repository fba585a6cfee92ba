//! Parts of a surface: a region, a box, a sphere, a list of facets, single vertices.
//!
//! Purpose: [`Part`] names facets of a surface; [`Part::facets`] finds them. Invariant: depends on the surface and its regions alone.
//! Must not know: files, what a part is for.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use super::TriMesh;
use super::facet_set::squared_distance;
use super::regions::Regions;

/// A part of a surface. As text: `box:X0,Y0,Z0,X1,Y1,Z1`, `sphere:X,Y,Z,R`, `facets:0-99,205`, `vertices:7,12`, `region:NAME`, or the name or
/// number of a region alone.
///
/// ```
/// use tessera::mesh::parts::{Part, PartError};
/// let sphere: Part = "sphere:0,0,1,0.25".parse()?;
/// assert_eq!(sphere.to_string(), "sphere:0,0,1,0.25");
/// assert_eq!("bolt holes".parse::<Part>()?, Part::Region("bolt holes".into()));
/// assert!("box:0,0,0,1".parse::<Part>().is_err());
/// # Ok::<(), PartError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum Part {
    /// The region with this name, or else with this number.
    Region(String),
    /// A box along the axes, caller's coordinates.
    Box {
        /// The corner with the least coordinates.
        low: DVec3,
        /// The corner with the largest.
        high: DVec3,
    },
    /// A ball, caller's coordinates.
    Sphere {
        /// Its centre.
        centre: DVec3,
        /// Its radius, above 0.
        radius: f64,
    },
    /// Facets by number, from 0.
    Facets(Indices),
    /// Vertices by number, from 0, without facets.
    Vertices(Indices),
}

/// Which facets belong to a box or a ball. Regions and lists have facets of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Inclusion {
    /// Those that have a point in it.
    Touching,
    /// Those that are in it wholly.
    Within,
}

/// Why a part was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PartError {
    /// A text is none of a part.
    #[error(
        "{text:?} is no part of a surface: give box:X0,Y0,Z0,X1,Y1,Z1 with X0 up to X1, sphere:X,Y,Z,R with R above 0, facets:0-99,205 or \
         vertices:7,12 with numbers from 0, or a region"
    )]
    Unreadable {
        /// The beginning of the text.
        text: String,
    },
    /// A text is none of a zone.
    #[error("{text:?} is no zone: give PART=LENGTH with a finite length above 0")]
    NoZone {
        /// The beginning of the text.
        text: String,
    },
    /// The surface has no such region.
    #[error("there is no region {name:?}; there are {known}")]
    NoSuchRegion {
        /// The name that was given.
        name: String,
        /// Those that there are, the first ones of many.
        known: String,
    },
    /// The surface has no regions at all.
    #[error("there is no region {name:?}: the input has none, or they are left aside; give a box or a sphere")]
    NoRegions {
        /// The name that was given.
        name: String,
    },
    /// A facet is not there.
    #[error("facet {facet} is not there; the input has {facets}, numbered from 0")]
    NoSuchFacet {
        /// The number that was given.
        facet: u32,
        /// How many there are.
        facets: usize,
    },
    /// A vertex is not there, or no facet has it.
    #[error("vertex {vertex} is not there, or no facet has it; the input has {vertices} vertices, numbered from 0")]
    NoSuchVertex {
        /// The number that was given.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// Vertices where facets are needed.
    #[error("a list of vertices has no facets; it may stay as it is, and be no other part")]
    VerticesAlone,
}

/// Numbers from 0. As text: numbers and ranges with commas between them, as `0-99,205`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Indices(Vec<[u32; 2]>);

impl Indices {
    /// From ranges with their first and last numbers.
    fn of_ranges(mut ranges: Vec<[u32; 2]>) -> Self {
        ranges.sort_unstable();
        let mut all: Vec<[u32; 2]> = Vec::with_capacity(ranges.len());
        for range in ranges {
            match all.last_mut() {
                Some(last) if range[0] <= last[1].saturating_add(1) => last[1] = last[1].max(range[1]),
                _ => all.push(range),
            }
        }
        Self(all)
    }

    /// Whether a number is there.
    pub fn contains(&self, number: u32) -> bool {
        let behind = self.0.partition_point(|range| range[0] <= number);
        behind > 0 && number <= self.0[behind - 1][1]
    }

    /// All of them, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.0.iter().flat_map(|&[first, last]| first..=last)
    }

    /// The largest one.
    pub fn last(&self) -> Option<u32> {
        self.0.last().map(|range| range[1])
    }
}

impl FromIterator<u32> for Indices {
    fn from_iter<I: IntoIterator<Item = u32>>(numbers: I) -> Self {
        Self::of_ranges(numbers.into_iter().map(|number| [number; 2]).collect())
    }
}

impl fmt::Display for Indices {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, [first, last]) in self.0.iter().enumerate() {
            let comma = if k == 0 { "" } else { "," };
            match first == last {
                true => write!(f, "{comma}{first}")?,
                false => write!(f, "{comma}{first}-{last}")?,
            }
        }
        Ok(())
    }
}

/// A part of a surface, and how long its edges are to be. As text: `PART=LENGTH`.
#[derive(Clone, Debug, PartialEq)]
pub struct Zone {
    /// The part.
    pub part: Part,
    /// The length, caller's units, finite and above 0.
    pub length: f64,
}

impl FromStr for Zone {
    type Err = PartError;

    fn from_str(text: &str) -> Result<Self, PartError> {
        let read = || {
            let (part, length) = text.rsplit_once('=')?;
            let length = length.trim().parse().ok().filter(|length: &f64| length.is_finite() && *length > 0.0)?;
            Some((part, length))
        };
        let (part, length) =
            read().ok_or_else(|| PartError::NoZone { text: text.chars().take(MOST_SHOWN).collect() })?;
        Ok(Self { part: part.parse()?, length })
    }
}

impl fmt::Display for Zone {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.part, self.length)
    }
}

/// The most regions that an error names.
const MOST_NAMED: usize = 20;
/// The most characters of a text that an error shows.
const MOST_SHOWN: usize = 80;

impl Part {
    /// Whether `mesh` has all facets of a list. Other parts may be anywhere.
    pub(crate) fn check(&self, mesh: &TriMesh) -> Result<(), PartError> {
        let (Self::Facets(list), facets) = (self, mesh.facets().len()) else { return Ok(()) };
        match list.last().filter(|&last| last as usize >= facets) {
            Some(facet) => Err(PartError::NoSuchFacet { facet, facets }),
            None => Ok(()),
        }
    }

    /// For each facet of `mesh` whether it is of the part.
    pub(crate) fn facets(
        &self,
        (mesh, regions): (&TriMesh, Option<&Regions>),
        inclusion: Inclusion,
    ) -> Result<Vec<bool>, PartError> {
        let count = mesh.facets().len();
        let by_corners = |of: &dyn Fn([DVec3; 3]) -> bool| (0..count).map(|f| of(mesh.corners(f))).collect();
        Ok(match self {
            Self::Region(name) => {
                let regions = regions.ok_or_else(|| PartError::NoRegions { name: name.clone() })?;
                let found = regions.named(name).ok_or_else(|| {
                    let labels: Vec<String> =
                        (0..regions.all().len()).take(MOST_NAMED).map(|k| format!("{:?}", regions.label(k))).collect();
                    let more = if regions.all().len() > MOST_NAMED { ", ..." } else { "" };
                    PartError::NoSuchRegion { name: name.clone(), known: labels.join(", ") + more }
                })?;
                regions.of_facet().iter().map(|&region| region == found).collect()
            }
            Self::Facets(facets) => {
                self.check(mesh)?;
                let mut all = vec![false; count];
                facets.iter().for_each(|facet| all[facet as usize] = true);
                all
            }
            Self::Vertices(_) => return Err(PartError::VerticesAlone),
            &Self::Box { low, high } => match inclusion {
                Inclusion::Within => by_corners(&|t| t.iter().all(|p| p.cmpge(low).all() && p.cmple(high).all())),
                Inclusion::Touching => by_corners(&|t| touches_box(t, low, high)),
            },
            &Self::Sphere { centre, radius } => match inclusion {
                Inclusion::Within => by_corners(&|t| t.iter().all(|p| p.distance(centre) <= radius)),
                // In radii, so that nothing vanishes.
                Inclusion::Touching => {
                    by_corners(&|t| squared_distance(DVec3::ZERO, t.map(|p| (p - centre) / radius)) <= 1.0)
                }
            },
        })
    }
}

impl Part {
    /// How far a place is from a box or a ball, 0 inside; infinite for other parts.
    pub(crate) fn distance(&self, p: DVec3) -> f64 {
        match *self {
            Self::Box { low, high } => (low - p).max(p - high).max(DVec3::ZERO).length(),
            Self::Sphere { centre, radius } => (p.distance(centre) - radius).max(0.0),
            Self::Region(_) | Self::Facets(_) | Self::Vertices(_) => f64::INFINITY,
        }
    }

    /// The area that a box or a ball has of a plane at most; infinite for other parts.
    pub(crate) fn most_area(&self) -> f64 {
        match *self {
            Self::Box { low, high } => std::f64::consts::PI * 0.25 * (high - low).length_squared(),
            Self::Sphere { radius, .. } => std::f64::consts::PI * radius * radius,
            Self::Region(_) | Self::Facets(_) | Self::Vertices(_) => f64::INFINITY,
        }
    }
}

/// Whether a triangle has a point in a box, by separating axes: those of the box, the normal, and products of edges and axes.
fn touches_box(corners: [DVec3; 3], low: DVec3, high: DVec3) -> bool {
    // Halves first, so that nothing overflows; the whole is scaled to the order of 1.
    let half = 0.5 * high - 0.5 * low;
    let around = corners.map(|p| p - (low + half));
    let size = around.iter().fold(half.abs().max_element(), |size, p| size.max(p.abs().max_element()));
    let scale = if size > 0.0 && size.is_finite() { size.recip() } else { 1.0 };
    let (half, around) = (half * scale, around.map(|p| p * scale));
    let edges = [around[1] - around[0], around[2] - around[1], around[0] - around[2]];
    let axes = DVec3::AXES.into_iter().chain([edges[0].cross(edges[1])]);
    let products = edges.iter().flat_map(|edge| DVec3::AXES.map(|axis| edge.cross(axis)));
    axes.chain(products).all(|axis| {
        let reach = half.dot(axis.abs()) * (1.0 + 1e-15);
        let along = around.map(|p| p.dot(axis));
        let (least, most) = along.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |m, &x| (m.0.min(x), m.1.max(x)));
        least <= reach && most >= -reach
    })
}

impl FromStr for Part {
    type Err = PartError;

    fn from_str(text: &str) -> Result<Self, PartError> {
        let unreadable = || PartError::Unreadable { text: text.chars().take(MOST_SHOWN).collect() };
        fn numbers<const N: usize>(list: &str) -> Option<[f64; N]> {
            let all: Vec<f64> = list.split(',').map(|x| x.trim().parse().ok()).collect::<Option<_>>()?;
            all.try_into().ok().filter(|all: &[f64; N]| all.iter().all(|x| x.is_finite()))
        }
        let indices = |list: &str| {
            let range = |text: &str| {
                let (first, last) = text.split_once('-').unwrap_or((text, text));
                let range = [first.trim().parse().ok()?, last.trim().parse().ok()?];
                Some(range).filter(|[first, last]: &[u32; 2]| first <= last)
            };
            list.split(',').map(range).collect::<Option<_>>().map(Indices::of_ranges).ok_or_else(unreadable)
        };
        match text.split_once(':') {
            Some(("box", list)) => {
                let [x, y, z, right, back, top] = numbers(list).ok_or_else(unreadable)?;
                let (low, high) = (DVec3::new(x, y, z), DVec3::new(right, back, top));
                if low.cmple(high).all() { Ok(Self::Box { low, high }) } else { Err(unreadable()) }
            }
            Some(("sphere", list)) => match numbers(list) {
                Some([x, y, z, radius]) if radius > 0.0 => Ok(Self::Sphere { centre: DVec3::new(x, y, z), radius }),
                _ => Err(unreadable()),
            },
            Some(("facets", list)) => indices(list).map(Self::Facets),
            Some(("vertices", list)) => indices(list).map(Self::Vertices),
            Some(("region", name)) => Ok(Self::Region(name.to_owned())),
            _ if text.trim().is_empty() => Err(unreadable()),
            _ => Ok(Self::Region(text.to_owned())),
        }
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Region(name) if name.contains(':') => write!(f, "region:{name}"),
            Self::Region(name) => write!(f, "{name}"),
            Self::Box { low: a, high: b } => write!(f, "box:{},{},{},{},{},{}", a.x, a.y, a.z, b.x, b.y, b.z),
            Self::Sphere { centre: c, radius } => write!(f, "sphere:{},{},{},{radius}", c.x, c.y, c.z),
            Self::Facets(facets) => write!(f, "facets:{facets}"),
            Self::Vertices(vertices) => write!(f, "vertices:{vertices}"),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::regions::Region;
    use crate::mesh::shapes::Shape;

    #[test]
    fn texts_are_read_and_written() {
        let lists = ["facets:0-99,205", "vertices:7,12-4294967295"];
        for text in ["box:-1,-2,0,1,2,0.5", "sphere:1e-3,0,0,2", "steel", "7", "region:a:b", "region:box:1"]
            .into_iter()
            .chain(lists)
        {
            let part: Part = text.parse().unwrap();
            assert_eq!(part.to_string().parse::<Part>().unwrap(), part, "{text}");
        }
        let list: Part = "facets: 4, 2-3,9,0-2 ".parse().unwrap();
        assert_eq!(list.to_string(), "facets:0-4,9");
        let Part::Facets(facets) = list else { panic!("facets are a list") };
        assert_eq!(facets.iter().collect::<Vec<_>>(), [0, 1, 2, 3, 4, 9]);
        assert!((0..12).all(|f| facets.contains(f) == (f < 5 || f == 9)));
        for text in [
            "",
            " ",
            "box:",
            "box:0,0,0,1,1",
            "box:0,0,0,-1,1,1",
            "sphere:0,0,0,0",
            "sphere:0,0,nan,1",
            "sphere:0,0,0,inf",
            "facets:",
            "facets:3-2",
            "facets:-1",
            "vertices:1.5",
            "vertices:4294967296",
        ] {
            assert!(matches!(text.parse::<Part>(), Err(PartError::Unreadable { .. })), "{text}");
        }
    }

    #[test]
    fn zones_are_read_and_written() {
        for text in ["box:-1,-2,0,1,2,0.5=0.25", "steel=1e-3", "region:a=b:c=7"] {
            let zone: Zone = text.parse().unwrap();
            assert_eq!(zone.to_string().parse::<Zone>().unwrap(), zone, "{text}");
        }
        for text in ["", "steel", "steel=", "steel=0", "steel=-1", "steel=inf", "=1"] {
            assert!(text.parse::<Zone>().is_err(), "{text}");
        }
    }

    /// Points of a facet, close together.
    fn points([a, b, c]: [DVec3; 3]) -> impl Iterator<Item = DVec3> {
        (0..=60)
            .flat_map(move |i| (0..=60 - i).map(move |j| a + (b - a) * (i as f64 / 60.0) + (c - a) * (j as f64 / 60.0)))
    }

    #[test]
    fn facets_are_those_with_points_inside() {
        let mesh = Shape::Torus.build(300);
        let (low, high) = mesh.bounds();
        let number = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65_536.0;
        for k in 0..60 {
            let centre = low + (high - low) * DVec3::new(number(4 * k), number(4 * k + 1), number(4 * k + 2));
            let size = (high - low).length() * (0.05 + 0.3 * number(4 * k + 3));
            let parts = [
                Part::Sphere { centre, radius: size },
                Part::Box { low: centre - size * DVec3::new(0.4, 1.0, 0.7), high: centre + size },
            ];
            for part in parts {
                let holds = |p: &DVec3| match part {
                    Part::Sphere { centre, radius } => p.distance(centre) <= radius,
                    Part::Box { low, high } => p.cmpge(low).all() && p.cmple(high).all(),
                    _ => false,
                };
                let touching = part.facets((&mesh, None), Inclusion::Touching).unwrap();
                let within = part.facets((&mesh, None), Inclusion::Within).unwrap();
                for f in 0..mesh.facets().len() {
                    let corners = mesh.corners(f);
                    assert_eq!(within[f], corners.iter().all(holds));
                    assert!(touching[f] || !points(corners).any(|p| holds(&p)), "{part}: facet {f}");
                    // What touches has points that are nearly inside.
                    let near = |p: DVec3| match part {
                        Part::Sphere { centre, radius } => p.distance(centre) < radius + 0.02 * size,
                        Part::Box { low, high } => {
                            p.cmpge(low - 0.03 * size).all() && p.cmple(high + 0.03 * size).all()
                        }
                        _ => false,
                    };
                    assert!(!touching[f] || points(corners).any(near), "{part}: facet {f}");
                }
            }
        }
    }

    #[test]
    fn regions_are_found_by_name_and_then_by_number() {
        let mesh = Shape::Square.build(2);
        let of = |name: &str, regions: Option<&Regions>| {
            Part::Region(name.into()).facets((&mesh, regions), Inclusion::Touching)
        };
        assert_eq!(of("5", Some(&Regions::of_numbers(&[4, 5]).unwrap())), Ok(vec![false, true]));
        let named = |(number, name): (i64, &str)| Region { number, name: name.to_owned() };
        let regions = Regions::new(vec![0, 1], [(4, "5"), (5, "b")].map(named).to_vec()).unwrap();
        assert_eq!(of("5", Some(&regions)), Ok(vec![true, false]), "a name goes before a number");
        assert_eq!(of("b", Some(&regions)), Ok(vec![false, true]));
        assert!(
            matches!(of("c", Some(&regions)), Err(PartError::NoSuchRegion { known, .. }) if known == "\"5\", \"b\"")
        );
        assert!(matches!(of("c", None), Err(PartError::NoRegions { .. })));
        let lists = Part::Facets([1, 1].into_iter().collect()).facets((&mesh, None), Inclusion::Within);
        assert_eq!(lists, Ok(vec![false, true]));
        let wrong = Part::Facets([2].into_iter().collect()).facets((&mesh, None), Inclusion::Within);
        assert_eq!(wrong, Err(PartError::NoSuchFacet { facet: 2, facets: 2 }));
        let vertices = Part::Vertices(Indices::default()).facets((&mesh, None), Inclusion::Within);
        assert_eq!(vertices, Err(PartError::VerticesAlone));
    }
}
