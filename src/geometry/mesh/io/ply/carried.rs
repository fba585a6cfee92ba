//! Attributes of a PLY file: normals, texture, colours and other scalars of its vertices, and `texcoord` of its faces.
//!
//! Purpose: [`Carried`] takes numbers as they are read, and makes attributes of them at the end.
//! Invariant: an attribute has all its properties or stays a number of scalars. Must not know: how numbers are written.

use glam::{DVec2, DVec3};

use super::header::{Element, FACES, Header, Property};
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner, Scalar};
use crate::mesh::io::held::{Raw, firsts, numbered};
use crate::mesh::io::numbers::{Encoding, Kind, Order, numbers, plain};
use crate::mesh::io::regions::Labels;

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
    /// The label of a face.
    Label,
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
    labels: Option<FaceLabels>,
}

/// Labels of faces, by the property of this name.
struct FaceLabels {
    name: String,
    /// That of the current face.
    next: Option<f64>,
    of_facets: Labels<i64>,
}

/// Scalar properties of faces, which may be labels.
fn of_faces<'a>(header: &'a Header<'_>) -> impl Iterator<Item = &'a Property> {
    let properties = header.element("face").into_iter().flat_map(|face| &face.properties);
    properties.filter(|p| p.length.is_none() && p.odd.is_none())
}

impl Carried {
    pub(super) fn of(header: &Header<'_>, chosen: Option<&str>) -> Self {
        let column = |p: &Property| Column { name: p.name.clone(), kind: p.item, values: Vec::new() };
        let is_column =
            |p: &&Property| p.length.is_none() && p.odd.is_none() && !matches!(p.name.as_str(), "x" | "y" | "z");
        let columns = header.element("vertex").map(|vertex| vertex.properties.iter().filter(is_column).map(column));
        let wedges = header.element("face").and_then(|face| face.properties.iter().find(|p| is_wedges(p)));
        // A text may have more digits than its type holds.
        let kind = |p: &Property| if header.encoding == Encoding::Text { Kind::F64 } else { p.item };
        let wedges = wedges.map(|p| Wedges { kind: kind(p), ..Wedges::default() });
        let label = of_faces(header).find(|p| Some(p.name.as_str()) == chosen);
        let labels = label.map(|p| FaceLabels { name: p.name.clone(), next: None, of_facets: Labels::default() });
        Self { columns: columns.into_iter().flatten().collect(), wedges, labels }
    }

    pub(super) fn role(&self, element: &Element, property: &Property) -> Role {
        let name = property.name.as_str();
        match (element.name.as_str(), property.length) {
            ("vertex", None) => match ["x", "y", "z"].iter().position(|&axis| axis == name) {
                Some(axis) => Role::Axis(axis),
                None => self.find(name).map_or(Role::Skipped, Role::Column),
            },
            (name, Some(_)) if FACES.contains(&name) && property.is_corners() => Role::Corners,
            ("face", None) if self.label() == Some(name) => Role::Label,
            ("face", Some(_)) if self.wedges.is_some() && is_wedges(property) => Role::Wedges,
            _ => Role::Skipped,
        }
    }

    /// Makes room for the scalars of so many vertices.
    pub(super) fn reserve(&mut self, vertices: usize) {
        self.columns.iter_mut().for_each(|column| column.values.reserve_exact(vertices));
    }

    pub(super) fn push(&mut self, column: usize, value: f64) {
        self.columns[column].values.push(value);
    }

    /// Takes so many numbers of the corners of a face.
    pub(super) fn wedges<E>(&mut self, count: usize, mut next: impl FnMut() -> Result<f64, E>) -> Result<(), E> {
        self.wedges.as_mut().map_or(Ok(()), |wedges| {
            wedges.reserve(count);
            (0..count)
                .try_for_each(|_| next().map(|number| wedges.kind.put(number, Order::Little, &mut wedges.numbers)))
        })
    }

    /// The name of the property that labels faces.
    pub(super) fn label(&self) -> Option<&str> {
        self.labels.as_ref().map(|labels| labels.name.as_str())
    }

    /// Takes the label of the current face.
    pub(super) fn label_face(&mut self, label: f64) {
        self.labels.iter_mut().for_each(|labels| labels.next = Some(label));
    }

    /// Ends the current face, or a triangle of a strip.
    pub(super) fn end_face(&mut self, corners: usize) {
        if let Some(FaceLabels { next, of_facets, .. }) = &mut self.labels
            && let Some(label) = next.take()
        {
            of_facets.push_number(label, corners.saturating_sub(2));
        }
        if let Some(wedges) = &mut self.wedges {
            wedges.end_face(corners);
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
        raw.texture = self.wedges.and_then(|wedges| wedges.finish(facets)).or(per_vertex);
        let unprefixed = |name: String| match name.strip_prefix(PREFIX) {
            Some(rest) if TAKEN.contains(&rest) => rest.to_owned(),
            _ => name,
        };
        if let Some(FaceLabels { name, of_facets, .. }) = self.labels {
            raw.regions = Some(of_facets.numbered(format!("values of the property {:?}", plain(&name, 40))));
        }
        let scalar = |c: Column| Scalar { number: c.kind, ..Scalar::new(unprefixed(c.name), c.values) };
        raw.scalars = self.columns.into_iter().map(scalar).collect();
        raw
    }
}

fn is_wedges(property: &Property) -> bool {
    property.name == "texcoord" && property.length.is_some() && property.odd.is_none()
}

/// Says what no surface carries.
pub(super) fn left_aside(header: &Header<'_>, chosen: Option<&str>, raw: &mut Raw) {
    if chosen.is_some() {
        raw.arrays = of_faces(header).map(|p| p.name.clone()).collect();
    }
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
            let is_label = element.name == "face" && p.length.is_none() && Some(p.name.as_str()) == chosen;
            let is_read = if is_vertex { p.length.is_none() } else { p.is_corners() || is_wedges(p) || is_label };
            !is_read && p.odd.is_none()
        };
        let names: Vec<&str> = element.properties.iter().filter(is_left).map(|p| p.name.as_str()).collect();
        if !names.is_empty() {
            let may_label =
                element.name == "face" && element.properties.iter().any(|p| p.length.is_none() && is_left(&p));
            let more = if may_label { "; --regions NAME makes regions of a number of faces" } else { "" };
            let text = format!("a surface carries a number for each vertex, and texture coordinates of faces{more}");
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

/// Texture coordinates of faces' corners. Lists of them and of vertices may be bytes: nothing here takes many times as much.
#[derive(Default)]
struct Wedges {
    /// The type of the numbers.
    kind: Kind,
    /// Two for each corner of the faces that have a pair for each corner, and those of the current face.
    numbers: Vec<u8>,
    /// Bytes of the faces before the current one.
    before: usize,
    /// The first facet of each of these faces, and its corners.
    faces: Vec<(u32, u32)>,
    facets: usize,
}

impl Wedges {
    /// The list grows by half, and for a large face by no more than that needs.
    fn reserve(&mut self, count: usize) {
        let more = count.saturating_mul(self.kind.bytes());
        if self.numbers.capacity() - self.numbers.len() < more {
            self.numbers.reserve_exact(more.max(self.numbers.len() / 2));
        }
    }

    fn end_face(&mut self, corners: usize) {
        let count = (self.numbers.len() - self.before) / self.kind.bytes();
        let facets = corners.saturating_sub(2);
        // Facets beyond 32 bits are refused later.
        match (u32::try_from(self.facets), u32::try_from(corners)) {
            (Ok(first), Ok(corners)) if facets > 0 && count == 2 * corners as usize => {
                self.faces.push((first, corners))
            }
            _ => self.numbers.truncate(self.before),
        }
        self.before = self.numbers.len();
        self.facets += facets;
    }

    /// Fans, as the surface has them. Corners of one vertex with the same bits name the same value, and those of faces without
    /// texture (0, 0).
    fn finish(self, facets: &[[u32; 3]]) -> Option<PerCorner<DVec2>> {
        if self.faces.is_empty() || self.facets != facets.len() {
            return None;
        }
        let Self { kind, numbers, faces, .. } = self;
        let of_face = |&(first, corners): &(u32, u32)| &facets[first as usize..][..corners as usize - 2];
        let ring = |face| {
            let fan: &[[u32; 3]] = of_face(face);
            fan[0][..2].iter().copied().chain(fan.iter().map(|facet| facet[2]))
        };
        let total = faces.iter().map(|(_, corners)| *corners as usize).sum();
        let mut vertices = Vec::with_capacity(total);
        vertices.extend(faces.iter().flat_map(ring));
        let pair = 2 * kind.bytes();
        let firsts = firsts(total, |wedge| (vertices[wedge], &numbers[wedge * pair..][..pair]));
        drop(vertices);
        let is_bare = faces.iter().map(|(_, corners)| *corners as usize - 2).sum::<usize>() < facets.len();
        let count = firsts.iter().zip(0..).filter(|(first, wedge)| *first == wedge).count();
        let mut values = Vec::with_capacity(count + usize::from(is_bare));
        values.extend(is_bare.then_some(DVec2::ZERO));
        let number = |at: usize| numbers!(kind, f64, number(&numbers, at));
        let named = numbered(firsts, values.len(), |wedge| {
            values.push(DVec2::new(number(wedge * pair), number(wedge * pair + kind.bytes())));
        });
        let mut corners = vec![[0; 3]; facets.len()];
        let mut rest = named.as_slice();
        for &(first, count) in &faces {
            let (ring, after) = rest.split_at(count as usize);
            rest = after;
            let fan = corners[first as usize..].iter_mut().zip(ring[1..].windows(2));
            fan.for_each(|(facet, next)| *facet = [ring[0], next[0], next[1]]);
        }
        Some(PerCorner { values, corners })
    }
}

/// The number at a byte, which is there.
fn number<const N: usize>(bytes: &[u8], at: usize, of: impl Fn([u8; N]) -> f64) -> f64 {
    bytes[at..].first_chunk().map_or(f64::NAN, |bytes| of(*bytes))
}
