//! What a PLY file carries: normals, texture coordinates, colours and all other scalar properties of its vertices,
//! and `texcoord`, six numbers for a triangle, of its faces, which is how seams are stored.
//!
//! The data are walked through here, apart from the crate: it was seen that they are whole when the surface was read.

use glam::{DVec2, DVec3};
use ply_rs_bw::ply::{ElementDef, Encoding, Header, PropertyType, ScalarType};

use super::super::held::{Held, Raw, eight_bit};
use super::header::{self, Parted};
use super::{is_index_name, records};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner, Scalar};

/// Names of what is no scalar; a scalar of such a name is written with [`PREFIX`].
const TAKEN: [&str; 16] =
    ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha", "s", "t", "u", "v", "texture_u", "texture_v"];
const PREFIX: &str = "scalar_";

/// `bytes` are those that `mesh` was read from.
pub(in super::super) fn attributes(bytes: &[u8], mesh: &TriMesh) -> Raw {
    let Ok(Parted { header, data, .. }) = header::read(bytes) else { return Raw::default() };
    let mut columns = header.elements.get("vertex").map(Columns::of).unwrap_or_default();
    let has_wedges = header.elements.get("face").is_some_and(|face| {
        face.properties.iter().any(|(name, p)| name == "texcoord" && matches!(p.data_type, PropertyType::List(..)))
    });
    if columns.0.is_empty() && !has_wedges {
        return Raw::default();
    }
    if !has_wedges {
        let names: Vec<&str> = columns.0.iter().map(|column| column.name.as_str()).collect();
        if let Some(values) = records::columns(data, &header, &names) {
            columns.0.iter_mut().zip(values).for_each(|(column, values)| column.values = values);
            return columns.sort(mesh, None);
        }
    }
    let mut wedges = Wedges::default();
    if walk(data, &header, &mut columns, &mut wedges).is_none() {
        let mut raw = Raw::default();
        raw.unreadable("all attributes", "the data could not be read again".to_owned());
        return raw;
    }
    columns.sort(mesh, has_wedges.then(|| wedges.finish(mesh)).flatten())
}

/// Reads all elements up to the last that matters.
fn walk(data: &[u8], header: &Header, columns: &mut Columns, wedges: &mut Wedges) -> Option<()> {
    let mut source = Source { rest: data, encoding: header.encoding };
    for (name, element) in &header.elements {
        let (is_vertex, is_face) = (name == "vertex", name == "face");
        let plan: Vec<(&PropertyType, Role)> = element
            .properties
            .iter()
            .map(|(property, p)| {
                let role = match &p.data_type {
                    PropertyType::Scalar(_) if is_vertex => columns.find(property).map_or(Role::Skip, Role::Column),
                    PropertyType::List(..) if is_face && is_index_name(property) => Role::Corners,
                    PropertyType::List(..) if is_face && property == "texcoord" => Role::Wedges,
                    _ => Role::Skip,
                };
                (&p.data_type, role)
            })
            .collect();
        for _ in 0..element.count {
            let mut corners = 0;
            wedges.face.clear();
            for (data_type, role) in &plan {
                match data_type {
                    PropertyType::Scalar(scalar) => {
                        let value = source.number(scalar)?;
                        if let Role::Column(column) = role {
                            columns.0[*column].values.push(value);
                        }
                    }
                    PropertyType::List(length, item) => {
                        let length = source.number(length)? as usize;
                        for _ in 0..length {
                            let value = source.number(item)?;
                            if matches!(role, Role::Wedges) {
                                wedges.face.push(value);
                            }
                        }
                        // A face may have both of the names; the plain reader takes them together.
                        corners += if matches!(role, Role::Corners) { length } else { 0 };
                    }
                }
            }
            if is_face {
                wedges.push_face(corners);
            }
        }
    }
    Some(())
}

/// What becomes of a property.
enum Role {
    Skip,
    Column(usize),
    Corners,
    Wedges,
}

/// Numbers one by one.
struct Source<'a> {
    rest: &'a [u8],
    encoding: Encoding,
}

impl Source<'_> {
    /// NaN for a word that is no number: the plain reader does not look at it either.
    fn number(&mut self, scalar: &ScalarType) -> Option<f64> {
        if self.encoding == Encoding::Ascii {
            let start = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
            let rest = &self.rest[start..];
            let (word, rest) = rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
            self.rest = rest;
            return Some(std::str::from_utf8(word).ok().and_then(|text| text.parse().ok()).unwrap_or(f64::NAN));
        }
        let big = self.encoding == Encoding::BinaryBigEndian;
        Some(match scalar {
            ScalarType::Char => f64::from(i8::from_le_bytes(self.take(big)?)),
            ScalarType::UChar => f64::from(u8::from_le_bytes(self.take(big)?)),
            ScalarType::Short => f64::from(i16::from_le_bytes(self.take(big)?)),
            ScalarType::UShort => f64::from(u16::from_le_bytes(self.take(big)?)),
            ScalarType::Int => f64::from(i32::from_le_bytes(self.take(big)?)),
            ScalarType::UInt => f64::from(u32::from_le_bytes(self.take(big)?)),
            ScalarType::Float => f64::from(f32::from_le_bytes(self.take(big)?)),
            ScalarType::Double => f64::from_le_bytes(self.take(big)?),
        })
    }

    /// Bytes of a number, the lowest first.
    fn take<const N: usize>(&mut self, big: bool) -> Option<[u8; N]> {
        let (bytes, rest) = self.rest.split_first_chunk::<N>()?;
        self.rest = rest;
        let mut bytes = *bytes;
        if big {
            bytes.reverse();
        }
        Some(bytes)
    }
}

/// One scalar property of the vertices.
struct Column {
    name: String,
    kind: ScalarType,
    values: Vec<f64>,
}

/// All scalar properties but the position.
#[derive(Default)]
struct Columns(Vec<Column>);

impl Columns {
    fn of(vertex: &ElementDef) -> Self {
        let scalars = vertex.properties.iter().filter_map(|(name, p)| match &p.data_type {
            PropertyType::Scalar(kind) if !matches!(name.as_str(), "x" | "y" | "z") => {
                Some(Column { name: name.clone(), kind: kind.clone(), values: Vec::new() })
            }
            _ => None,
        });
        Self(scalars.collect())
    }

    fn find(&self, name: &str) -> Option<usize> {
        self.0.iter().position(|column| column.name == name)
    }

    /// Takes columns out if they are all there.
    fn take<const N: usize>(&mut self, names: [&str; N]) -> Option<[Column; N]> {
        if !names.iter().all(|name| self.find(name).is_some()) {
            return None;
        }
        let empty = || Column { name: String::new(), kind: ScalarType::Double, values: Vec::new() };
        Some(names.map(|name| self.find(name).map_or_else(empty, |i| self.0.remove(i))))
    }

    /// What each column is.
    fn sort(mut self, mesh: &TriMesh, wedges: Option<PerCorner<DVec2>>) -> Raw {
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
            let values = u.values.iter().zip(&v.values).map(|(&u, &v)| DVec2::new(u, v)).collect();
            PerCorner { values, corners: mesh.facets().to_vec() }
        });
        raw.texture = wedges.or(per_vertex);
        let plain = |name: String| match name.strip_prefix(PREFIX) {
            Some(rest) if TAKEN.contains(&rest) => rest.to_owned(),
            _ => name,
        };
        raw.scalars = self.0.into_iter().map(|c| Scalar { name: plain(c.name), values: c.values }).collect();
        raw
    }
}

fn colours(rgb: &[Column; 3], alpha: Option<&Column>) -> Colours {
    // Whole numbers are 255ths, two bytes of them 65535ths.
    let most = |column: &Column| match column.kind {
        ScalarType::Float | ScalarType::Double => 1.0,
        ScalarType::UShort | ScalarType::Short => 65535.0,
        _ => 255.0,
    };
    let [r, g, b] = rgb;
    let value = |column: &Column, i: usize| column.values.get(i).copied().unwrap_or(f64::NAN) / most(column);
    let values = (0..r.values.len()).map(|i| {
        let opacity = alpha.map_or(1.0, |a| value(a, i));
        [value(r, i), value(g, i), value(b, i), opacity]
    });
    let eight = rgb.iter().chain(alpha).all(|column| column.kind == ScalarType::UChar);
    Colours { values: values.collect(), depth: if eight { ColourDepth::Eight } else { ColourDepth::Float } }
}

/// Texture coordinates of the faces' corners.
#[derive(Default)]
struct Wedges {
    /// Of the face at hand.
    face: Vec<f64>,
    values: Vec<DVec2>,
    corners: Vec<[u32; 3]>,
    any: bool,
}

impl Wedges {
    /// A fan, as the plain reader makes it. A face without texture has (0, 0) everywhere.
    fn push_face(&mut self, corners: usize) {
        let whole = corners > 0 && self.face.len() == 2 * corners;
        self.any |= whole;
        let first = u32::try_from(self.values.len()).unwrap_or(u32::MAX);
        let pairs = self.face.as_chunks::<2>().0;
        if whole {
            self.values.extend(pairs.iter().map(|&[u, v]| DVec2::new(u, v)));
        } else {
            self.values.push(DVec2::ZERO);
        }
        for k in 1..corners.saturating_sub(1) {
            // Corners beyond 32 bits are refused as too many values.
            let k = if whole { u32::try_from(k).unwrap_or(u32::MAX) } else { 0 };
            let next = if whole { k.saturating_add(1) } else { 0 };
            self.corners.push([first, first.saturating_add(k), first.saturating_add(next)]);
        }
    }

    fn finish(self, mesh: &TriMesh) -> Option<PerCorner<DVec2>> {
        self.any.then(|| shared(mesh, PerCorner { values: self.values, corners: self.corners }))
    }
}

/// Corners of one vertex with the same bits name the same value.
fn shared(mesh: &TriMesh, given: PerCorner<DVec2>) -> PerCorner<DVec2> {
    if given.corners.len() != mesh.facets().len() {
        return given;
    }
    let bits = |i: u32| given.values.get(i as usize).map(|uv| uv.to_array().map(f64::to_bits));
    let mut named: Vec<(u32, Option<[u64; 2]>, usize)> = mesh
        .facets()
        .iter()
        .flatten()
        .zip(given.corners.iter().flatten())
        .zip(0usize..)
        .map(|((&vertex, &i), corner)| (vertex, bits(i), corner))
        .collect();
    named.sort_unstable();
    // Each group is known by its first corner; values are numbered in the order of those.
    let mut group = vec![0usize; named.len()];
    for same in named.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        same.iter().for_each(|corner| group[corner.2] = same[0].2);
    }
    let mut number = vec![0u32; group.len()];
    let mut values = Vec::new();
    for (corner, &first) in group.iter().enumerate() {
        if corner == first {
            number[corner] = values.len() as u32;
            let index = given.corners[corner / 3][corner % 3];
            values.push(given.values.get(index as usize).copied().unwrap_or(DVec2::NAN));
        }
    }
    let corners = group.as_chunks::<3>().0.iter().map(|f| f.map(|first| number[first])).collect();
    PerCorner { values, corners }
}

pub(in super::super) fn encode_with(mesh: &TriMesh, held: &Held<'_>) -> Vec<u8> {
    let (vertices, faces) = (mesh.positions().len(), mesh.facets().len());
    let opaque = held.colours.is_none_or(|c| c.values.iter().all(|c| c[3] == 1.0));
    let mut out = head(mesh, held, opaque).into_bytes();
    out.reserve((24 + 8 * held.scalars.len()) * vertices + 13 * faces);
    let number = |out: &mut Vec<u8>, x: f64| out.extend_from_slice(&x.to_le_bytes());
    for (vertex, p) in mesh.positions().iter().enumerate() {
        p.to_array().into_iter().for_each(|x| number(&mut out, x));
        if let Some(normals) = &held.normals {
            normals[vertex].to_array().into_iter().for_each(|x| number(&mut out, x));
        }
        if let Some(colours) = held.colours {
            let colour = &colours.values[vertex][..if opaque { 3 } else { 4 }];
            match colours.depth {
                ColourDepth::Eight => out.extend(colour.iter().map(|&x| eight_bit(x))),
                ColourDepth::Float => colour.iter().for_each(|&x| number(&mut out, x)),
            }
        }
        if let Some(uv) = &held.uv {
            uv[vertex].to_array().into_iter().for_each(|x| number(&mut out, x));
        }
        held.scalars.iter().for_each(|s| number(&mut out, s.values[vertex]));
    }
    for (index, facet) in mesh.facets().iter().enumerate() {
        out.push(3);
        facet.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
        if let Some(texture) = held.corner_uv {
            out.push(6);
            for corner in texture.corners[index] {
                texture.values[corner as usize].to_array().into_iter().for_each(|x| number(&mut out, x));
            }
        }
    }
    out
}

fn head(mesh: &TriMesh, held: &Held<'_>, opaque: bool) -> String {
    let (vertices, faces) = (mesh.positions().len(), mesh.facets().len());
    let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\n");
    let mut properties = |names: &[&str], kind: &str| {
        names.iter().for_each(|name| text.push_str(&format!("property {kind} {name}\n")));
    };
    properties(&["x", "y", "z"], "double");
    if held.normals.is_some() {
        properties(&["nx", "ny", "nz"], "double");
    }
    if let Some(colours) = held.colours {
        let kind = if colours.depth == ColourDepth::Eight { "uchar" } else { "double" };
        properties(&["red", "green", "blue", "alpha"][..if opaque { 3 } else { 4 }], kind);
    }
    if held.uv.is_some() {
        properties(&["s", "t"], "double");
    }
    for scalar in held.scalars {
        let taken = TAKEN.contains(&scalar.name.as_str());
        properties(&[&format!("{}{}", if taken { PREFIX } else { "" }, scalar.name)], "double");
    }
    text.push_str(&format!("element face {faces}\nproperty list uchar int vertex_indices\n"));
    if held.corner_uv.is_some() {
        text.push_str("property list uchar double texcoord\n");
    }
    text.push_str("end_header\n");
    text
}
