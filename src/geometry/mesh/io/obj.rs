//! Wavefront OBJ.
//!
//! Purpose: bytes to triangles with what they carry, in one pass over the statements, and back. Vertices are numbered by their
//! first use in a facet; those that no facet uses are left out. How: statements as nearly all files have them ([`common`]) are
//! read in place, on all threads. A file with any other statement is read as one piece ([`dialects`]): the `tobj` crate reads
//! its vertices. Invariant: both give the same to the bit, whatever the number of threads. Must not know: other formats.

mod common;
mod dialects;

use std::collections::HashSet;
use std::fmt::Write as _;

use glam::{DVec2, DVec3};

use super::held::{By, Held, Holds, Labelled, Raw};
use super::polygons::Fan;
use super::regions::{Labels, RegionChoice, by_name, missing, names};
use super::{Codec, Counts, DataError, Soup, VertexNumbers, VertexOrder, Wanted};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner};
use crate::tasks;

pub(super) const CODEC: Codec = Codec {
    extension: "obj",
    media_types: &["model/obj", "application/x-obj", "model/x-obj"],
    // Half a vertex of three short numbers, and a face of three indices.
    facet_bytes: 30,
    signature: super::packed::Signature::Words(&["v", "vn", "vt", "f", "o", "g", "s", "usemtl", "mtllib"]),
    decode,
    encode,
    counts,
    holds: Holds {
        normals: By::Corner,
        texture: By::Corner,
        colours: true,
        opacity: false,
        scalars: false,
        regions: Labelled::Name,
    },
    vertices: VertexNumbers::Reordered(vertex_order),
};

/// An index that names nothing.
const NONE: u32 = u32::MAX;
const WHITE: [f64; 4] = [1.0; 4];
const NORMALS: &str = "normals";
const TEXTURE: &str = "texture coordinates";
const COLOURS: &str = "colours";

/// Reads a surface; what it carries only if it is `wanted`.
fn decode(bytes: &[u8], wanted: Wanted<'_>) -> Result<Soup, DataError> {
    let surface = common::read(bytes, wanted.is_some()).and_then(|all| all.surface(Raw::default()));
    let mut soup = surface.map_or_else(|| dialects::decode(bytes, wanted.is_some()), Ok)?;
    if let Some(choice) = wanted {
        regions(bytes, choice, soup.facets.len(), &mut soup.raw)?;
        others(bytes, &mut soup.raw);
    }
    Ok(soup)
}

/// Statements that label the faces after them.
const LABELS: [&str; 3] = ["usemtl", "g", "o"];

/// Finds the labels that become regions, and names the others.
fn regions(bytes: &[u8], choice: &RegionChoice, facets: usize, raw: &mut Raw) -> Result<(), DataError> {
    let [materials, groups] = labels(bytes);
    let of_materials = match choice {
        RegionChoice::Ignore => {
            raw.labels("materials", materials);
            raw.labels("groups", groups);
            return Ok(());
        }
        RegionChoice::Named => materials > 1,
        RegionChoice::Array(name) => name == LABELS[0],
    };
    // Without another choice groups and objects label alike.
    let statements = match choice.array() {
        Some(name) => {
            let found = |label: &&str| {
                dialects::statements(bytes).any(|(_, text)| dialects::Words(text).next() == Some(label.as_bytes()))
            };
            let there: Vec<&str> = LABELS.into_iter().filter(found).collect();
            let chosen: Vec<&str> = there.iter().copied().filter(|label| *label == name).collect();
            if chosen.is_empty() {
                return Err(missing(name, &there.into_iter().map(str::to_owned).collect::<Vec<_>>()));
            }
            chosen
        }
        None if of_materials => LABELS[..1].to_vec(),
        None => LABELS[1..].to_vec(),
    };
    let others = if of_materials { groups } else { materials };
    let mut are_others_lost = others > 1;
    if choice.array().is_some() || materials > 1 || groups > 1 {
        let labels = labels_of(bytes, &statements, facets);
        if of_materials && are_others_lost {
            are_others_lost = !labels.are_alike(&labels_of(bytes, &LABELS[1..], facets));
        }
        let kinds = if of_materials { "materials" } else { "groups" };
        raw.regions = Some(labels.finish(kinds, by_name));
    }
    match of_materials {
        _ if !are_others_lost => {}
        true => raw.labels_beside("groups", others, "the regions are those of the materials; --regions g takes these"),
        false => raw.labels_beside("materials", others, "the regions are the groups; --regions usemtl takes these"),
    }
    Ok(())
}

/// The label of each of so many facets: what the last of these statements before its face says.
fn labels_of<'a>(bytes: &'a [u8], statements: &[&str], facets: usize) -> Labels<&'a [u8]> {
    let mut labels = Labels::with_room(facets);
    let mut last: &[u8] = b"";
    for (_, text) in dialects::statements(bytes) {
        let mut words = dialects::Words(text);
        match words.next() {
            Some(b"f") => labels.push(last, words.count().saturating_sub(2)),
            Some(word) if statements.iter().any(|name| name.as_bytes() == word) => last = words.0.trim_ascii(),
            _ => {}
        }
    }
    labels
}

/// A name as a statement has it: a word.
pub(super) fn word(name: &str) -> String {
    name.chars().map(|c| if c.is_whitespace() || c == '\\' { '_' } else { c }).collect()
}

/// How many materials, and how many groups and objects, facets have.
fn labels(bytes: &[u8]) -> [usize; 2] {
    let mut found = [(); 2].map(|()| HashSet::<&[u8]>::new());
    let mut last: [&[u8]; 2] = [b""; 2];
    for line in bytes.split(|&byte| byte == b'\n') {
        let line = line.trim_ascii_start();
        let kind = match line.first() {
            Some(b'f') => {
                found.iter_mut().zip(last).for_each(|(found, last)| _ = found.insert(last));
                continue;
            }
            Some(b'u') if line.starts_with(b"usemtl ") => 0,
            Some(b'g' | b'o') if line.get(1).is_none_or(u8::is_ascii_whitespace) => 1,
            _ => continue,
        };
        last[kind] = line.trim_ascii_end();
    }
    found.map(|found| found.len())
}

/// Names what else a file has.
fn others(bytes: &[u8], raw: &mut Raw) {
    let is_coloured = raw.colours.is_some();
    let [mut elements, mut free, mut plain, mut depths] = [0; 4];
    for line in bytes.split(|&byte| byte == b'\n') {
        let line = line.trim_ascii_start();
        let first = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
        match first {
            b"l" | b"p" => elements += 1,
            b"curv" | b"curv2" | b"surf" => free += 1,
            b"v" if is_coloured => plain += usize::from(dialects::Words(line).count() < 7),
            // Points of a texture in space.
            b"vt" if raw.texture.is_some() => {
                let depth = dialects::Words(line).nth(3).and_then(dialects::number::<f64>);
                depths += usize::from(depth.is_some_and(|depth| depth != 0.0));
            }
            _ => {}
        }
    }
    raw.elements("points and lines", elements);
    raw.elements("free-form curves and surfaces", free);
    if plain > 0 {
        raw.unreadable("colours of some vertices", format!("{plain} have none, and are white"));
    }
    if depths > 0 {
        raw.unreadable("the third texture coordinate", "a surface carries two".to_owned());
    }
}

fn vertex_order(bytes: &[u8]) -> Result<VertexOrder, DataError> {
    let all = || dialects::read(bytes, false).map(|read| read.0);
    let mut statements = common::read(bytes, false).map_or_else(all, Ok)?;
    Ok((statements.vertices, statements.number_by_use().unwrap_or_default()))
}

/// Vertices, used or not, and facets.
fn counts(bytes: &[u8]) -> Option<Counts> {
    let (mut vertices, mut facets) = (0, 0);
    for (_, statement) in dialects::statements(bytes) {
        let mut words = dialects::Words(statement);
        match words.next() {
            Some(b"v") => vertices += 1,
            Some(b"f") => facets += words.count().saturating_sub(2) as u64,
            _ => {}
        }
    }
    Some(Counts { vertices, facets, made_bytes: 0 })
}

/// What the statements of a file say. Indices are from 0 and count over the whole file.
#[derive(Debug, Default)]
struct Statements {
    /// Bytes of the text, and how many of them were left at the first face.
    bytes: usize,
    left: usize,
    vertices: usize,
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    fans: Vec<Fan>,
    /// As many as vertices up to the last one with a colour; empty if there is none.
    colours: Vec<[f64; 4]>,
    texture: Vec<DVec2>,
    normals: Vec<DVec3>,
    /// As many as facets up to the last one with texture coordinates, or normals.
    texture_corners: Vec<[u32; 3]>,
    normal_corners: Vec<[u32; 3]>,
}

/// What a corner names.
#[derive(Clone, Copy)]
struct Corner {
    vertex: u32,
    texture: u32,
    normal: u32,
}

impl Statements {
    fn push_colour(&mut self, colour: [f64; 4]) {
        self.colours.resize(self.vertices, WHITE);
        self.colours.push(colour);
    }

    /// Adds a corner to a polygon, which becomes a fan around its first corner. So many bytes of the text are left.
    fn push_corner(&mut self, face: &mut Face, next: Corner, left: usize) {
        if let Some([first, last]) = face.first_and_last {
            if face.corners > 1 {
                let facet = [first, last, next];
                if self.facets.is_empty() {
                    self.left = left;
                }
                make_room(&mut self.facets, self.left - left, left);
                push_corners(&mut self.texture_corners, &self.facets, facet.map(|c| c.texture));
                push_corners(&mut self.normal_corners, &self.facets, facet.map(|c| c.normal));
                self.facets.push(facet.map(|c| c.vertex));
            }
            face.first_and_last = Some([first, next]);
        } else {
            face.first_and_last = Some([next; 2]);
        }
        face.corners += 1;
    }

    /// Ends a polygon; one of fewer than three corners is none.
    fn end_face(&mut self, face: &Face) {
        if face.corners > 3 {
            let count = face.corners - 2;
            // As many facets as numbers can tell apart are refused later.
            let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
            self.fans.push((number(self.facets.len() - count), number(count)));
        }
    }

    fn push_position(&mut self, position: DVec3, left: usize) {
        make_room(&mut self.positions, self.bytes - left, left);
        self.positions.push(position);
    }

    /// Numbers the vertices by first use. Returns which vertex of the file each is; nothing if a corner names none.
    fn number_by_use(&mut self) -> Option<Vec<u32>> {
        let mut number = vec![NONE; self.vertices];
        let mut order = Vec::with_capacity(self.vertices);
        for corner in self.facets.iter_mut().flatten() {
            let slot = number.get_mut(*corner as usize)?;
            if *slot == NONE {
                *slot = u32::try_from(order.len()).ok()?;
                order.push(*corner);
            }
            *corner = *slot;
        }
        Some(order)
    }

    /// The surface, if no corner names another vertex. What `raw` has given up is left out.
    fn surface(mut self, raw: Raw) -> Option<Soup> {
        let order = self.number_by_use()?;
        let positions = tasks::map(order.len(), |k| self.positions[order[k] as usize]);
        let colour = |&v: &u32| self.colours.get(v as usize).copied().unwrap_or(WHITE);
        let colours = (!self.colours.is_empty()).then(|| order.iter().map(colour).collect());
        let (facets, fans) = (std::mem::take(&mut self.facets), std::mem::take(&mut self.fans));
        let raw = self.carried(&facets, order.len(), colours, raw);
        Some(Soup { positions, facets, fans, cells: None, raw })
    }

    /// What a surface of these facets and so many vertices carries.
    fn carried(self, facets: &[[u32; 3]], vertices: usize, colours: Option<Vec<[f64; 4]>>, mut raw: Raw) -> Raw {
        if let Some(values) = colours.filter(|_| !raw.is_unreadable(COLOURS)) {
            let depth = depth(&values);
            raw.colours = Some(Colours { values, depth });
        }
        if !self.texture_corners.is_empty() && !raw.is_unreadable(TEXTURE) {
            let named = self.texture_corners.iter().filter(|corners| !corners.contains(&NONE)).count();
            let bare = facets.len().saturating_sub(named);
            if bare > 0 {
                raw.unreadable("texture coordinates of some facets", format!("{bare} name none, and have (0, 0)"));
            }
            raw.texture = Some(per_corner(self.texture, self.texture_corners, facets.len()));
        }
        if !self.normal_corners.is_empty() && !raw.is_unreadable(NORMALS) {
            let normals = per_corner(self.normals, self.normal_corners, facets.len());
            // Checked before they are looked up: an index may still be too large.
            let known = normals.corners.iter().flatten().all(|&i| (i as usize) < normals.values.len());
            let per_vertex = known.then(|| normals.per_vertex(facets, vertices)).flatten();
            raw.normals = Some(per_vertex.map_or(Normals::PerCorner(normals), Normals::PerVertex));
        }
        raw
    }
}

/// A face of which some corners are read.
#[derive(Default)]
struct Face {
    first_and_last: Option<[Corner; 2]>,
    corners: usize,
}

/// Makes room in a list that is full: for what the rest of a text has, if it goes on as it did. A list that doubles would take
/// more than the text.
fn make_room<T>(list: &mut Vec<T>, read: usize, left: usize) {
    if list.len() == list.capacity() {
        // A little more, so that it need not grow again for the last few.
        let expected = 1.05 * list.len() as f64 * (left as f64 / read.max(1) as f64) + 64.0;
        list.reserve_exact((expected as usize).min(left / 2).max(list.len() / 8 + 64));
    }
}

/// Notes what the corners of the next facet name, if they name anything.
fn push_corners(list: &mut Vec<[u32; 3]>, facets: &Vec<[u32; 3]>, corners: [u32; 3]) {
    if corners != [NONE; 3] {
        if list.len() == list.capacity() {
            list.reserve_exact(facets.capacity() - list.len());
        }
        list.resize(facets.len(), [NONE; 3]);
        list.push(corners);
    }
}

/// Values by corner; corners that name nothing get a default value of their own. OBJ has (0, 0) for texture coordinates, as
/// renderers take them, and no normal.
fn per_corner<T: Default>(mut values: Vec<T>, mut corners: Vec<[u32; 3]>, facets: usize) -> PerCorner<T> {
    corners.resize(facets, [NONE; 3]);
    let missing = u32::try_from(values.len()).unwrap_or(NONE);
    if corners.iter().flatten().any(|&i| i == NONE) {
        // An index that is too large must stay so, and not become the default's.
        corners.iter_mut().flatten().filter(|i| **i == missing).for_each(|i| *i = missing + 1);
        values.push(T::default());
        corners.iter_mut().flatten().filter(|i| **i == NONE).for_each(|i| *i = missing);
    }
    PerCorner { values, corners }
}

/// Eight bits if every component is a 255th, and one of them is between 0 and 1.
fn depth(values: &[[f64; 4]]) -> ColourDepth {
    let mut between = false;
    for &x in values.iter().flatten() {
        let k = (x * 255.0).round();
        if !(0.0..=255.0).contains(&k) || k / 255.0 != x {
            return ColourDepth::Float;
        }
        between |= k != 0.0 && k != 255.0;
    }
    if between { ColourDepth::Eight } else { ColourDepth::Float }
}

fn encode(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let mut text = String::with_capacity(128 * mesh.positions().len() + 32 * mesh.facets().len());
    for (vertex, p) in mesh.positions().iter().enumerate() {
        let _ = write!(text, "v {:?} {:?} {:?}", p.x, p.y, p.z);
        if let Some([r, g, b, _]) = held.colours.map(|c| c.values[vertex]) {
            let _ = write!(text, " {r:?} {g:?} {b:?}");
        }
        text.push('\n');
    }
    if let Some(texture) = held.corner_uv {
        for uv in &texture.values {
            let _ = writeln!(text, "vt {:?} {:?}", uv.x, uv.y);
        }
    }
    let normals = held.corner_normals.map(|n| &n.values).or(held.normals.as_ref());
    for n in normals.into_iter().flatten() {
        let _ = writeln!(text, "vn {:?} {:?} {:?}", n.x, n.y, n.z);
    }
    let names = held.regions.map_or_else(Vec::new, |regions| names(regions, word));
    let mut last = None;
    for (facet, vertices) in mesh.facets().iter().enumerate() {
        if let Some(&region) = held.regions.and_then(|regions| regions.of_facet().get(facet))
            && last.replace(region) != Some(region)
        {
            let name = &names[region as usize];
            let _ = writeln!(text, "g {name}\nusemtl {name}");
        }
        text.push('f');
        for (corner, &vertex) in vertices.iter().enumerate() {
            let texture = held.corner_uv.map(|t| u64::from(t.corners[facet][corner]) + 1);
            let normal = held.corner_normals.map(|n| n.corners[facet][corner]);
            let normal = normal.or(held.normals.as_ref().map(|_| vertex)).map(|n| u64::from(n) + 1);
            let vertex = u64::from(vertex) + 1;
            let _ = match (texture, normal) {
                (None, None) => write!(text, " {vertex}"),
                (Some(t), None) => write!(text, " {vertex}/{t}"),
                (None, Some(n)) => write!(text, " {vertex}//{n}"),
                (Some(t), Some(n)) => write!(text, " {vertex}/{t}/{n}"),
            };
        }
        text.push('\n');
    }
    Ok(text.into_bytes())
}
