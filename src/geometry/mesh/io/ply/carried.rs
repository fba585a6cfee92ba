//! Attributes of a PLY file: normals, texture, colours and other scalars of its vertices, and `texcoord` of its faces.
//!
//! Purpose: [`Carried`] takes numbers as they are read, and makes attributes of them at the end.
//! Invariant: an attribute has all its properties or stays a number of scalars. Must not know: how numbers are written.

use glam::{DVec2, DVec3};

use super::header::{Element, FACES, Header, Property};
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner, Scalar};
use crate::mesh::io::held::{Raw, firsts, numbered};
use crate::mesh::io::numbers::{Kind, plain};

/// Names of what is no scalar; a scalar of such a name is written with [`PREFIX`].
pub(super) const TAKEN: [&str; 16] =
    ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha", "s", "t", "u", "v", "texture_u", "texture_v"];
pub(super) const PREFIX: &str = "scalar_";

#[derive(Clone, Copy, Debug)]
pub(super) enum Role {
    Axis(usize),
    Corners,
    Column(usize),
    /// Texture coordinates of a face's corners.
    Wedges,
    Skipped,
}

struct Column {
    name: String,
    kind: Kind,
    values: Vec<f64>,
}

/// Attributes read so far. The default wants none.
#[derive(Default)]
pub(super) struct Carried {
    /// All scalar properties but the position.
    columns: Vec<Column>,
    wedges: Option<Wedges>,
}

impl Carried {
    pub(super) fn of(header: &Header<'_>) -> Self {
        let column = |p: &Property| Column { name: p.name.clone(), kind: p.item, values: Vec::new() };
        let is_column =
            |p: &&Property| p.length.is_none() && p.odd.is_none() && !matches!(p.name.as_str(), "x" | "y" | "z");
        let columns = header.element("vertex").map(|vertex| vertex.properties.iter().filter(is_column).map(column));
        let has_wedges = header.element("face").is_some_and(|face| face.properties.iter().any(is_wedges));
        Self { columns: columns.into_iter().flatten().collect(), wedges: has_wedges.then(Wedges::default) }
    }

    pub(super) fn role(&self, element: &Element, property: &Property) -> Role {
        let name = property.name.as_str();
        match (element.name.as_str(), property.length) {
            ("vertex", None) => match ["x", "y", "z"].iter().position(|&axis| axis == name) {
                Some(axis) => Role::Axis(axis),
                None => self.find(name).map_or(Role::Skipped, Role::Column),
            },
            (name, Some(_)) if FACES.contains(&name) && property.is_corners() => Role::Corners,
            ("face", Some(_)) if self.wedges.is_some() && is_wedges(property) => Role::Wedges,
            _ => Role::Skipped,
        }
    }

    pub(super) fn push(&mut self, to: Role, value: f64) {
        match (to, &mut self.wedges) {
            (Role::Column(column), _) => self.columns[column].values.push(value),
            (Role::Wedges, Some(wedges)) => wedges.face.push(value),
            _ => {}
        }
    }

    pub(super) fn end_face(&mut self, corners: usize) {
        if let Some(wedges) = &mut self.wedges {
            wedges.push_face(corners);
        }
    }

    pub(super) fn columns(&self) -> impl Iterator<Item = &str> {
        self.columns.iter().map(|column| column.name.as_str())
    }

    pub(super) fn take_columns(&mut self, values: Vec<Vec<f64>>) {
        self.columns.iter_mut().zip(values).for_each(|(column, values)| column.values = values);
    }

    fn find(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column.name == name)
    }

    /// Takes columns out if they are all there.
    fn take<const N: usize>(&mut self, names: [&str; N]) -> Option<[Column; N]> {
        if !names.iter().all(|name| self.find(name).is_some()) {
            return None;
        }
        let empty = || Column { name: String::new(), kind: Kind::F64, values: Vec::new() };
        Some(names.map(|name| self.find(name).map_or_else(empty, |i| self.columns.remove(i))))
    }

    pub(super) fn finish(mut self, facets: &[[u32; 3]]) -> Raw {
        let mut raw = Raw::default();
        if let Some([x, y, z]) = self.take(["nx", "ny", "nz"]) {
            let triples = x.values.iter().zip(&y.values).zip(&z.values);
            raw.normals = Some(Normals::PerVertex(triples.map(|((&x, &y), &z)| DVec3::new(x, y, z)).collect()));
        }
        if let Some(colour) = self.take(["red", "green", "blue"]) {
            let alpha = self.take(["alpha"]).map(|[a]| a);
            raw.colours = Some(colours(&colour, alpha.as_ref()));
        }
        let names = [["s", "t"], ["u", "v"], ["texture_u", "texture_v"]];
        let per_vertex = names.into_iter().find_map(|names| self.take(names)).map(|[u, v]| {
            let values = u.values.iter().zip(&v.values).map(|(&u, &v)| DVec2::new(u, v));
            PerCorner { values: values.collect(), corners: facets.to_vec() }
        });
        let wedges = self.wedges.filter(|w| w.any).map(|w| PerCorner { values: w.values, corners: w.corners });
        raw.texture = wedges.map(|wedges| shared(facets, wedges)).or(per_vertex);
        let plain = |name: String| match name.strip_prefix(PREFIX) {
            Some(rest) if TAKEN.contains(&rest) => rest.to_owned(),
            _ => name,
        };
        let scalar = |c: Column| Scalar { number: c.kind, ..Scalar::new(plain(c.name), c.values) };
        raw.scalars = self.columns.into_iter().map(scalar).collect();
        raw
    }
}

fn is_wedges(property: &Property) -> bool {
    property.name == "texcoord" && property.length.is_some() && property.odd.is_none()
}

/// Says what no surface carries.
pub(super) fn left_aside(header: &Header<'_>, raw: &mut Raw) {
    let is_surface = |element: &&Element| element.name == "vertex" || FACES.contains(&element.name.as_str());
    for element in header.elements.iter().chain(&header.unread).filter(|element| !is_surface(element)) {
        raw.elements(&plain(&format!("elements {:?}", element.name), 100), element.count);
    }
    for element in &header.elements {
        let is_vertex = element.name == "vertex";
        if !is_vertex && !FACES.contains(&element.name.as_str()) {
            continue;
        }
        for Property { name, odd, .. } in &element.properties {
            if let Some(odd) = odd {
                raw.unreadable(&format!("property {name:?}"), format!("{odd:?} is no type of a property"));
            }
        }
        let is_left = |p: &&Property| {
            let is_read = if is_vertex { p.length.is_none() } else { p.is_corners() || is_wedges(p) };
            !is_read && p.odd.is_none()
        };
        let names: Vec<&str> = element.properties.iter().filter(is_left).map(|p| p.name.as_str()).collect();
        if !names.is_empty() {
            let text = "a surface carries a number for each vertex, and texture coordinates of faces".to_owned();
            raw.unreadable(&plain(&format!("properties of {:?}: {}", element.name, names.join(", ")), 200), text);
        }
    }
}

fn colours(rgb: &[Column; 3], alpha: Option<&Column>) -> Colours {
    // Whole numbers are 255ths, two bytes of them 65535ths.
    let most = |column: &Column| match column.kind {
        Kind::F32 | Kind::F64 => 1.0,
        Kind::U16 | Kind::I16 => 65535.0,
        _ => 255.0,
    };
    let [r, g, b] = rgb;
    let value = |column: &Column, i: usize| column.values.get(i).copied().unwrap_or(f64::NAN) / most(column);
    let values = (0..r.values.len()).map(|i| {
        let opacity = alpha.map_or(1.0, |a| value(a, i));
        [value(r, i), value(g, i), value(b, i), opacity]
    });
    let eight = rgb.iter().chain(alpha).all(|column| column.kind == Kind::U8);
    Colours { values: values.collect(), depth: if eight { ColourDepth::Eight } else { ColourDepth::Float } }
}

#[derive(Default)]
struct Wedges {
    /// Numbers of the current face.
    face: Vec<f64>,
    values: Vec<DVec2>,
    corners: Vec<[u32; 3]>,
    any: bool,
}

impl Wedges {
    /// A fan, as the surface has it. A face without texture has (0, 0) everywhere.
    fn push_face(&mut self, corners: usize) {
        let is_whole = corners > 0 && self.face.len() == 2 * corners;
        self.any |= is_whole;
        let first = u32::try_from(self.values.len()).unwrap_or(u32::MAX);
        let pairs = self.face.as_chunks::<2>().0;
        if is_whole {
            self.values.extend(pairs.iter().map(|&[u, v]| DVec2::new(u, v)));
        } else {
            self.values.push(DVec2::ZERO);
        }
        for k in 1..corners.saturating_sub(1) {
            // Corners beyond 32 bits are refused as too many values.
            let k = if is_whole { u32::try_from(k).unwrap_or(u32::MAX) } else { 0 };
            let next = if is_whole { k.saturating_add(1) } else { 0 };
            self.corners.push([first, first.saturating_add(k), first.saturating_add(next)]);
        }
        self.face.clear();
    }
}

/// Corners of one vertex with the same bits name the same value.
fn shared(facets: &[[u32; 3]], given: PerCorner<DVec2>) -> PerCorner<DVec2> {
    if given.corners.len() != facets.len() {
        return given;
    }
    let index = |corner: usize| given.corners.as_flattened()[corner] as usize;
    let bits = |corner: usize| given.values.get(index(corner)).map(|uv| uv.to_array().map(f64::to_bits));
    let vertices = facets.as_flattened();
    let mut values = Vec::new();
    let corners = numbered(firsts(vertices.len(), |corner| (vertices[corner], bits(corner))), 0, |corner| {
        values.push(given.values.get(index(corner)).copied().unwrap_or(DVec2::NAN));
    });
    PerCorner { values, corners: corners.as_chunks::<3>().0.to_vec() }
}
