//! Files of the Visualization Toolkit: legacy `.vtk` ([`legacy`]) and XML, `.vtp` and `.vtu` ([`xml`]).
//!
//! Purpose: what they have in common: types of cells and of numbers, and what arrays of points are as attributes. An
//! array of three or four bytes is a colour, and so is one of numbers that is named like one; others of points are scalars.
//! An array of cells gives regions if it is chosen; others are left aside. Must not know: how arrays are written.

pub(super) mod legacy;
pub(super) mod xml;

use glam::{DVec2, DVec3};

use super::held::{Held, eight_bit};
use super::numbers::Kind;
use super::regions::Labels;
use super::{DataError, Others, Soup};
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner, Scalar};
use crate::mesh::regions::Regions;

/// Names of numbers' types: legacy, in lower case, the first of which is written, and XML. In binary legacy files a `vtkIdType` has 4 bytes.
const KINDS: [(&[&str], &str, Kind); 10] = [
    (&["char", "signed_char", "vtktypeint8"], "Int8", Kind::I8),
    (&["unsigned_char", "vtktypeuint8"], "UInt8", Kind::U8),
    (&["short", "vtktypeint16"], "Int16", Kind::I16),
    (&["unsigned_short", "vtktypeuint16"], "UInt16", Kind::U16),
    (&["int", "vtktypeint32", "vtkidtype"], "Int32", Kind::I32),
    (&["unsigned_int", "vtktypeuint32"], "UInt32", Kind::U32),
    (&["vtktypeint64", "long", "long_long", "__int64"], "Int64", Kind::I64),
    (&["vtktypeuint64", "unsigned_long", "unsigned_long_long", "unsigned___int64"], "UInt64", Kind::U64),
    (&["float", "vtktypefloat32"], "Float32", Kind::F32),
    (&["double", "vtktypefloat64"], "Float64", Kind::F64),
];

/// The names of a type: legacy, XML.
fn names(kind: Kind) -> (&'static str, &'static str) {
    let known = KINDS.iter().find(|(.., known)| *known == kind);
    known.map_or(("double", "Float64"), |(legacy, xml, _)| (legacy[0], *xml))
}

/// Why arrays of cells are left aside.
const ON_POINTS: &str = "a surface carries numbers of points; --regions NAME makes regions of an array of cells";

/// The numbers of the facets' regions, and their type.
fn labels(regions: &Regions) -> (Kind, Vec<i64>) {
    let fit = regions.all().iter().all(|region| i32::try_from(region.number).is_ok());
    (if fit { Kind::I32 } else { Kind::I64 }, regions.numbers().collect())
}

/// A number's bytes.
fn put_label(kind: Kind, number: i64, is_big: bool, out: &mut Vec<u8>) {
    // The lowest bytes of a number of 64 bits are one of 32 bits, if it fits.
    match is_big {
        true => out.extend_from_slice(&number.to_be_bytes()[8 - kind.bytes()..]),
        false => out.extend_from_slice(&number.to_le_bytes()[..kind.bytes()]),
    }
}

/// Labels facets by the values of their cells, which have so many facets each.
fn label(labels: &mut Labels<i64>, values: &[i64], cells: &[u32]) {
    values.iter().zip(cells).for_each(|(&value, &facets)| labels.push(value, facets as usize));
}

/// What to do with a file of volume elements alone.
const SURFACE_FIRST: &str = "extract the surface first, as ParaView's filter \"Extract Surface\" does";

const COLOURS: [&str; 6] = ["rgb", "rgba", "color", "colors", "colour", "colours"];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Normals,
    Texture,
    Colours,
    /// Its name and its numbers decide.
    Any,
    None,
}

#[derive(Debug)]
struct Array {
    name: String,
    role: Role,
    components: usize,
    /// Type in the file. Bytes of a colour stand for numbers of 0 to 1.
    kind: Kind,
    values: Vec<f64>,
}

impl Array {
    fn role(&self) -> Role {
        let named = |names: &[&str]| names.iter().any(|name| name.eq_ignore_ascii_case(&self.name));
        match (self.role, self.components) {
            (Role::Any, 3 | 4) if self.kind == Kind::U8 || named(&COLOURS) => Role::Colours,
            (Role::Any, 3) if named(&["normals", "normal"]) => Role::Normals,
            (Role::Any, 2 | 3) if named(&["texture coordinates", "tcoords", "uv", "texcoords"]) => Role::Texture,
            (role, _) => role,
        }
    }
}

/// Makes attributes of arrays, for a surface. The first array of a role has it.
fn carried(arrays: Vec<Array>, soup: &mut Soup) {
    let facets = &soup.facets;
    let raw = &mut soup.raw;
    let aside = std::mem::take(&mut raw.unreadable);
    for array in arrays {
        let (role, values, n) = (array.role(), &array.values, array.components);
        match role {
            Role::Normals if raw.normals.is_none() && n == 3 => {
                let triples = values.as_chunks::<3>().0;
                raw.normals = Some(Normals::PerVertex(triples.iter().map(|&t| DVec3::from_array(t)).collect()));
            }
            Role::Texture if raw.texture.is_none() && (1..=3).contains(&n) => {
                let uv = |t: &[f64]| DVec2::new(t[0], t.get(1).copied().unwrap_or(0.0));
                let values = values.chunks_exact(n).map(uv).collect();
                raw.texture = Some(PerCorner { values, corners: facets.to_vec() });
            }
            Role::Colours if raw.colours.is_none() && (3..=4).contains(&n) => {
                let eight = array.kind == Kind::U8;
                let (one, depth) = if eight { (255.0, ColourDepth::Eight) } else { (1.0, ColourDepth::Float) };
                let colour = |t: &[f64]| [t[0] / one, t[1] / one, t[2] / one, t.get(3).map_or(1.0, |a| a / one)];
                raw.colours = Some(Colours { values: values.chunks_exact(n).map(colour).collect(), depth });
            }
            Role::None => {}
            _ => {
                let Array { name, kind: number, components, values, .. } = array;
                raw.scalars.push(Scalar { name, number, components, values });
            }
        }
    }
    raw.unreadable.extend(aside);
}

fn written(held: &Held<'_>) -> Vec<Array> {
    let mut arrays = Vec::new();
    let mut add = |name: &str, role, components, kind, values| {
        arrays.push(Array { name: name.to_owned(), role, components, kind, values });
    };
    if let Some(normals) = &held.normals {
        add("Normals", Role::Normals, 3, Kind::F64, normals.iter().flat_map(|n| n.to_array()).collect());
    }
    if let Some(uv) = &held.uv {
        add("TCoords", Role::Texture, 2, Kind::F64, uv.iter().flat_map(|t| t.to_array()).collect());
    }
    if let Some(colours) = held.colours {
        let opaque = colours.values.iter().all(|c| c[3] == 1.0);
        let (name, n) = if opaque { ("RGB", 3) } else { ("RGBA", 4) };
        let eight = colours.depth == ColourDepth::Eight;
        let number = |&x: &f64| if eight { f64::from(eight_bit(x)) } else { x };
        let values = colours.values.iter().flat_map(|c| c[..n].iter().map(number)).collect();
        add(name, Role::Colours, n, if eight { Kind::U8 } else { Kind::F64 }, values);
    }
    for Scalar { name, number, components, values } in held.scalars {
        // Three or four bytes would be a colour.
        let kind = if *number == Kind::U8 && matches!(components, 3 | 4) { Kind::I16 } else { *number };
        add(name, Role::Any, *components, kind, values.clone());
    }
    arrays
}

enum Cell {
    Polygon,
    /// A polygon of its first points; the others lie on its edges.
    Corners(usize),
    Strip,
    Pixel,
    /// Points and lines.
    Less,
    Volume,
}

impl Cell {
    fn of(kind: i64) -> Self {
        match kind {
            0..=4 | 21 | 35 | 68 | 75 => Self::Less,
            6 => Self::Strip,
            8 => Self::Pixel,
            5 | 22 | 34 | 69 | 76 => Self::Corners(3),
            9 | 23 | 28 | 30 | 70 | 77 => Self::Corners(4),
            7 => Self::Polygon,
            _ => Self::Volume,
        }
    }

    fn facets(&self, points: usize) -> usize {
        match self {
            Self::Polygon | Self::Pixel | Self::Strip => points.saturating_sub(2),
            Self::Corners(n) => points.min(*n).saturating_sub(2),
            Self::Less | Self::Volume => 0,
        }
    }

    /// Adds its facets. Returns what it is if it has none.
    fn push(&self, soup: &mut Soup, points: &[u32], scratch: &mut Vec<u32>) -> Result<Others, String> {
        match self {
            Self::Polygon => soup.push_polygon(points)?,
            Self::Corners(n) => soup.push_polygon(points.get(..*n).unwrap_or(points))?,
            Self::Pixel => {
                scratch.clear();
                scratch.extend_from_slice(points);
                if let [_, _, c, d] = &mut scratch[..] {
                    std::mem::swap(c, d);
                }
                soup.push_polygon(scratch)?;
            }
            Self::Strip => {
                for (k, t) in points.windows(3).enumerate() {
                    let turned = if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
                    soup.push_polygon(&turned)?;
                }
            }
            // An empty cell is nothing.
            Self::Less => return Ok(Others { thin: usize::from(!points.is_empty()), ..Others::default() }),
            Self::Volume => return Ok(Others { volumes: 1, ..Others::default() }),
        }
        Ok(Others::default())
    }
}

/// Adds cells, each from the end of the one before to its own end in `points`. Returns how many are no facets.
fn push_cells(
    soup: &mut Soup,
    cell: impl Fn(usize) -> Cell,
    ends: &[i64],
    points: &[u32],
) -> Result<Others, DataError> {
    let (mut start, mut others, mut scratch) = (0usize, Others::default(), Vec::new());
    // All at once: the list would take more than the file while it grows.
    let most = usize::try_from(facets(&cell, ends)).unwrap_or(usize::MAX).min(points.len());
    soup.facets.reserve_exact(most);
    for (index, &end) in ends.iter().enumerate() {
        let wrong = |message: String| DataError::Element { element: "cell", index, message };
        let corners = usize::try_from(end).ok().and_then(|end| points.get(start..end));
        let Some(corners) = corners else {
            let there = points.len();
            return Err(wrong(format!("it goes from point {start} to {end} of a list of {there}")));
        };
        let before = soup.facets.len();
        others += cell(index).push(soup, corners, &mut scratch).map_err(wrong)?;
        let facets = (soup.facets.len() - before) as u32;
        soup.cells.iter_mut().for_each(|cells| cells.push(facets));
        start += corners.len();
    }
    Ok(others)
}

/// The most facets that cells have, which end there.
fn facets(cell: impl Fn(usize) -> Cell, ends: &[i64]) -> u64 {
    let begins = [0].into_iter().chain(ends.iter().copied());
    let lengths = begins.zip(ends).map(|(begin, end)| usize::try_from(end.saturating_sub(begin)).unwrap_or(0));
    lengths.enumerate().map(|(index, length)| cell(index).facets(length) as u64).fold(0, u64::saturating_add)
}
