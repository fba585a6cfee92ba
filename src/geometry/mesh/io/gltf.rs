//! The format glTF 2.0: `.glb`, and `.gltf` with its data inside or beside it ([`beside`]). Writes single precision.
//!
//! Purpose: the triangles, strips and fans of all nodes of the scene, in their places, with normals, texture coordinates and
//! colours of vertices. A glTF has a vertex once for each normal and each place in the texture: vertices of a primitive with the
//! same bits of position and colour become one, and corners keep the rest. The second texture coordinate goes up here, and down
//! in a glTF. A mesh with a skin is where its joints place it. Materials are regions; images, morph targets and animations are left aside.
//! Why the reading is our own, over `serde_json`: in the crate `gltf` (1.4.1, of 2024) an accessor with a stride below its
//! elements' size, or with indices that are fractions, panics in release builds, a count of 0 or 2⁶² in debug builds; and its
//! documents hold the places of nodes in single precision, which tears scenes far from the origin.
//! Invariant: what is made of the file's bytes is bounded ([`super::UNPACKED_RATIO`]), however often nodes name a mesh; the JSON
//! becomes lists of numbers that are bounded by its length ([`document`]). Must not know: other formats.

pub(super) mod beside;
mod document;
mod numbers;

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DVec2, DVec3};

use self::document::{Document, Names, Primitive, Skin, Text};
use self::numbers::{Numbers, Source};
use super::held::{By, Held, Holds, Labelled, centred, check_single, eight_bit, firsts, numbered};
use super::numbers::{Cursor, Encoding, Kind, Order, cut};
use super::packed::Room;
use super::regions::{self, Labels};
use super::{Codec, Counts, DataError, Soup, VertexNumbers, unpacked_limit};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner};
use crate::mesh::regions::Region;

const HOLDS: Holds = Holds {
    normals: By::Corner,
    texture: By::Corner,
    colours: true,
    opacity: true,
    scalars: false,
    regions: Labelled::Name,
};

pub(super) const BINARY: Codec = Codec {
    extension: "glb",
    media_types: &["model/gltf-binary"],
    // Half a vertex of three floats, and three indices.
    facet_bytes: 18,
    signature: super::packed::Signature::Start(|head| head.bytes.starts_with(MAGIC)),
    decode: |bytes, wanted| {
        parts(bytes).and_then(|(json, binary)| surface(json, binary, bytes.len(), wanted.is_some()))
    },
    encode: encode_binary,
    counts: |bytes| parts(bytes).ok().and_then(|(json, binary)| counts(json, binary, bytes.len())),
    holds: HOLDS,
    vertices: VertexNumbers::Absent,
};

pub(super) const TEXT: Codec = Codec {
    extension: "gltf",
    media_types: &["model/gltf+json"],
    // Half a vertex of three floats, and three indices, in base64.
    facet_bytes: 24,
    signature: super::packed::Signature::Start(|head| head.is_document(b'{', b"\"asset\"")),
    decode: |bytes, wanted| surface(bytes, None, bytes.len(), wanted.is_some()),
    encode: encode_text,
    counts: |bytes| counts(bytes, None, bytes.len()),
    holds: HOLDS,
    vertices: VertexNumbers::Absent,
};

const MAGIC: &[u8] = b"glTF";
const JSON: u32 = 0x4e4f_534a;
const BIN: u32 = 0x004e_4942;

/// What the nodes declare: no number of an accessor is read.
fn counts(json: &[u8], binary: Option<&[u8]>, length: usize) -> Option<Counts> {
    let document = Document::read(json).ok()?;
    // Buffers are decoded from base64.
    let decoded = document.buffers.iter().filter_map(|buffer| buffer.uri.as_ref()).map(|Text(uri)| uri.len() / 4 * 3);
    let read = document.bytes().saturating_add(decoded.sum());
    let mut counts = Counts::default();
    let most = unpacked_limit(length) as u64;
    // An element has a byte at the least.
    let there = (json.len() + binary.map_or(0, <[u8]>::len)) as u64;
    let count = |accessor: u32| {
        document.accessors.get(accessor as usize).map(|a| a.count as u64).filter(|count| (1..=there).contains(count))
    };
    let mut last = None;
    nodes(&document, length, |primitive, At { node, .. }| {
        let Some((mode, position)) = primitive.triangles() else { return Ok(()) };
        let vertices = count(position).ok_or(DataError::Empty)?;
        let corners = primitive.indices.map_or(Some(vertices), count).ok_or(DataError::Empty)?;
        let facets = if mode == 4 { corners / 3 } else { corners.saturating_sub(2) };
        counts.facets += facets;
        counts.made_bytes += 12 * corners + 48 * facets;
        if counts.made_bytes > most.saturating_mul(2) {
            return Err(DataError::Empty);
        }
        // Primitives of a mesh that name the same vertices share them.
        if last.replace((node, primitive.attributes)) == Some((node, primitive.attributes)) {
            return Ok(());
        }
        counts.vertices += vertices;
        // Numbers of vertices, as they are read and as they are kept, and of corners, and what corners carry.
        let names = &primitive.attributes;
        let numbers = [(names.normal, 3), (names.texture, 2), (names.colour, 4)];
        let of_joints = if names.joints_0.is_some() { 8 } else { 0 };
        let numbers = 3 + of_joints + numbers.iter().filter(|(name, _)| name.is_some()).map(|(_, n)| n).sum::<u64>();
        counts.made_bytes += (16 * numbers + 8) * vertices;
        // Reading refuses such files.
        if counts.made_bytes > most.saturating_mul(2) { Err(DataError::Empty) } else { Ok(()) }
    })
    .ok()?;
    counts.made_bytes = counts.made_bytes.saturating_add(read as u64);
    Some(counts)
}

fn surface(json: &[u8], binary: Option<&[u8]>, length: usize, wanted: bool) -> Result<Soup, DataError> {
    let document = Document::read(json)?;
    let source = Source::of(&document, binary, unpacked_limit(length));
    let mut reader = Reader {
        source: &source,
        parents: None,
        skin: None,
        room: Room::of(length),
        steps: length.saturating_mul(8).saturating_add(1 << 20),
        wanted,
        soup: Soup::default(),
        normals: None,
        texture: None,
        colours: None,
        last: None,
        labels: Labels::default(),
        eight: true,
        is_morphed: false,
        thin: 0,
        has_more: false,
        reported: HashSet::new(),
    };
    nodes(&document, length, |primitive, at| reader.primitive(primitive, at))?;
    let Reader { mut soup, normals, texture, colours, labels, eight, is_morphed, thin, has_more, .. } = reader;
    soup.raw.normals = normals.map(Normals::PerCorner);
    soup.raw.texture = texture;
    let depth = if eight { ColourDepth::Eight } else { ColourDepth::Float };
    soup.raw.colours = colours.map(|values| Colours { values, depth });
    if wanted {
        // Facets without a material are of region 0.
        let number = |material: Option<u32>| material.map_or(0, |index| i64::from(index) + 1);
        soup.raw.regions = Some(labels.finish("materials", |material, _| {
            let name = material.and_then(|index| document.material(index)).unwrap_or_default();
            Region { number: number(material), name: regions::name(name.as_bytes()) }
        }));
        soup.raw.elements("primitives of points and lines", thin);
    }
    if let Some(name) = document.used.as_ref().filter(|_| wanted) {
        soup.raw.unreadable(&format!("the extension {name}"), "the surface is read without it".to_owned());
    }
    if has_more {
        let text = "a surface carries normals, colours and one set of texture coordinates".to_owned();
        soup.raw.unreadable("other attributes of vertices", text);
    }
    if is_morphed {
        soup.raw.unreadable("morph targets", "the surface is read without them".to_owned());
    }
    Ok(soup)
}

fn parts(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), DataError> {
    let Some(rest) = bytes.strip_prefix(MAGIC) else {
        return Err(DataError::Header("it does not begin with \"glTF\"; name text .gltf".to_owned()));
    };
    let mut cursor = Cursor { encoding: Encoding::Binary(Order::Little), ..Cursor::new(rest) };
    let word = |cursor: &mut Cursor<'_>| cursor.count(Kind::U32, "the header");
    let (version, length) = (word(&mut cursor)?, word(&mut cursor)?);
    if version != 2 {
        return Err(DataError::Header(format!("version {version} of glTF is not read; export it as 2")));
    }
    let there = bytes.len();
    if length > there {
        return Err(DataError::Truncated(format!("{length} bytes are declared and {there} are there")));
    }
    let (mut json, mut binary) = (None, None);
    while cursor.rest.len() >= 8 {
        let (length, kind) = (word(&mut cursor)?, word(&mut cursor)? as u32);
        let chunk = cursor.take(length).ok_or_else(|| cut("the header"))?;
        match kind {
            JSON if json.is_none() => json = Some(chunk),
            BIN if binary.is_none() => binary = Some(chunk),
            _ => {}
        }
    }
    Ok((json.ok_or_else(|| cut("the header"))?, binary))
}

/// Ancestors of a node with further children to visit, at most. A place takes 128 bytes.
const DEEPEST: usize = 10_000;

/// Where a primitive is: its node, the place of this, and a skin.
#[derive(Clone, Copy)]
struct At {
    node: usize,
    place: DMat4,
    skin: Option<u32>,
}

/// All primitives of the scene, in their places, with their skins; the file has `length` bytes.
fn nodes(
    document: &Document<'_>,
    length: usize,
    mut visit: impl FnMut(&Primitive, At) -> Result<(), DataError>,
) -> Result<(), DataError> {
    // Counts primitives without triangles too, which take time and no memory.
    let mut left = length.saturating_mul(8).saturating_add(1 << 20);
    let roots = document.roots();
    let mut open = vec![(roots.as_slice(), DMat4::IDENTITY)];
    let mut seen = vec![false; document.nodes.len()];
    while let Some((rest, parent)) = open.pop() {
        let Some((&index, rest)) = rest.split_first() else { continue };
        if !rest.is_empty() {
            open.push((rest, parent));
        }
        let index = index as usize;
        let wrong = |message: &str| DataError::Element { element: "node", index, message: message.to_owned() };
        let seen = seen.get_mut(index).ok_or_else(|| wrong("it is named, and there is none"))?;
        if std::mem::replace(seen, true) {
            return Err(wrong("it has two parents"));
        }
        let place = parent * document.place(index);
        if let Some(mesh) = document.mesh(index) {
            let primitives = document.primitives(mesh).ok_or_else(|| wrong("its mesh is not there"))?;
            left = left.checked_sub(primitives.len()).ok_or_else(repeated)?;
            let at = At { node: index, place, skin: document.skin(index) };
            primitives.iter().try_for_each(|primitive| visit(primitive, at))?;
        }
        if open.len() > DEEPEST {
            return Err(wrong("nodes are nested too deep; export the scene flat"));
        }
        open.push((document.children(index), place));
    }
    Ok(())
}

fn repeated() -> DataError {
    DataError::Header("its nodes repeat more than a file of this size may; write .ply or .obj".to_owned())
}

struct Reader<'a> {
    source: &'a Source<'a>,
    /// Of each node, found for the first skin.
    parents: Option<Vec<Option<u32>>>,
    /// The skin of the last primitive that has one, with the moves by its joints.
    skin: Option<(u32, Arc<[DMat4]>)>,
    /// For these moves.
    room: Room,
    /// Nodes that may still be passed on the way from joints to roots.
    steps: usize,
    wanted: bool,
    soup: Soup,
    /// Nothing until a primitive has some.
    normals: Option<PerCorner<DVec3>>,
    texture: Option<PerCorner<DVec2>>,
    colours: Option<Vec<[f64; 4]>>,
    /// Those of the last primitive.
    last: Option<Vertices>,
    /// Materials.
    labels: Labels<Option<u32>>,
    /// Whether all colours came in bytes.
    eight: bool,
    is_morphed: bool,
    /// Primitives of points and lines.
    thin: usize,
    /// Whether vertices carry more than a surface does.
    has_more: bool,
    /// Accessors and skins that were left aside.
    reported: HashSet<(&'static str, u32)>,
}

/// Vertices of a primitive, as the surface has them. The next one of its mesh may share them.
struct Vertices {
    of: (usize, Names),
    /// The number of each.
    numbers: Vec<u32>,
    is_mirrored: bool,
    /// The value of each, if they have some.
    normals: Option<Vec<u32>>,
    texture: Option<Vec<u32>>,
}

impl<'a> Reader<'a> {
    fn primitive(&mut self, primitive: &Primitive, at: At) -> Result<(), DataError> {
        let Some((mode, position)) = primitive.triangles() else {
            self.thin += usize::from(primitive.attributes.position.is_some());
            return Ok(());
        };
        self.has_more |= primitive.attributes.has_more;
        self.is_morphed |= primitive.is_morphed;
        let source = self.source;
        let of = (at.node, primitive.attributes);
        let vertices = match self.last.take().filter(|last| last.of == of) {
            Some(vertices) => vertices,
            None => self.vertices(primitive, position, at)?,
        };
        let count = vertices.numbers.len();
        let indices = primitive.indices.map(|indices| source.numbers(indices, 1)).transpose()?;
        let corners = indices.as_ref().map_or(count, Numbers::count);
        if let Some(wrong) = &indices
            && !(0..corners).all(|k| (0.0..count as f64).contains(&wrong.at(k, 0)))
        {
            return Err(DataError::Element {
                element: "accessor",
                index: primitive.indices.unwrap_or(position) as usize,
                message: format!("a vertex is named, but there are {count} vertices, counted from 0"),
            });
        }
        let corner = |k: usize| indices.as_ref().map_or(k as u32, |indices| indices.at(k, 0) as u32);
        let all = if mode == 4 { corners / 3 } else { corners.saturating_sub(2) };
        // The corners of a facet.
        let facet = |f: usize| {
            let corners = match mode {
                4 => [3 * f, 3 * f + 1, 3 * f + 2],
                5 if f % 2 == 1 => [f + 1, f, f + 2],
                5 => [f, f + 1, f + 2],
                _ => [0, f + 1, f + 2],
            };
            corners.map(corner)
        };
        // Each facet has three arrays of corners.
        source.spend(all.saturating_mul(36))?;
        let turned = |t: [u32; 3]| if vertices.is_mirrored { [t[0], t[2], t[1]] } else { t };
        let first = self.soup.facets.len();
        self.soup.facets.extend((0..all).map(|f| turned(facet(f)).map(|i| vertices.numbers[i as usize])));
        if self.wanted {
            self.labels.push(primitive.material, all);
            let facets = (first, all, |f: usize| turned(facet(f)));
            add(&mut self.normals, vertices.normals.as_deref(), facets);
            add(&mut self.texture, vertices.texture.as_deref(), facets);
        }
        self.last = Some(vertices);
        Ok(())
    }

    /// Adds the vertices of a primitive, and what they carry.
    fn vertices(&mut self, primitive: &Primitive, position: u32, at: At) -> Result<Vertices, DataError> {
        let At { node, place, skin } = at;
        let source = self.source;
        let positions = source.numbers(position, 3)?;
        let count = positions.count();
        source.spend(count.saturating_mul(32))?;
        // Read even if they are not wanted: colours part vertices, and all count against the bound.
        let [normals, texture, colours] = [
            self.carried(primitive.attributes.normal, count, 3, 3),
            self.carried(primitive.attributes.texture, count, 2, 2),
            self.carried(primitive.attributes.colour, count, 3, 4),
        ];
        let colour_of = |i: usize| match &colours {
            Some(colours) => {
                let alpha = if colours.components() == 4 { colours.at(i, 3) } else { 1.0 };
                [colours.at(i, 0), colours.at(i, 1), colours.at(i, 2), alpha]
            }
            None => [1.0; 4],
        };
        let moves = skin.and_then(|skin| self.moves(skin, primitive, count));
        let is_still = place == DMat4::IDENTITY && moves.is_none();
        // The place of a mesh with a skin does not count.
        let place_of = |i: usize| moves.as_ref().map_or(place, |moves| moves.of(i));
        let position = |i: usize| {
            let p = DVec3::new(positions.at(i, 0), positions.at(i, 1), positions.at(i, 2));
            if moves.is_some() { place_of(i).transform_point3(p) } else { p }
        };
        let points: Vec<DVec3> = (0..count).map(position).collect();
        let firsts = firsts(count, |i| {
            let mut key = [0; 7];
            let numbers = points[i].to_array().into_iter().chain(colour_of(i));
            // Adding 0 makes -0 the same as 0.
            key.iter_mut().zip(numbers).for_each(|(k, x)| *k = (x + 0.0).to_bits());
            key
        });
        let soup = &mut self.soup;
        let before = soup.positions.len();
        if self.wanted && colours.is_some() && self.colours.is_none() {
            self.colours = Some(vec![[1.0; 4]; before]);
        }
        let numbers = numbered(firsts, before, |i| {
            let is_placed = is_still || moves.is_some();
            soup.positions.push(if is_placed { points[i] } else { place.transform_point3(points[i]) });
            self.colours.iter_mut().for_each(|colours| colours.push(colour_of(i)));
        });
        drop(points);
        let facets = soup.facets.len();
        let normal = |i: usize| {
            let n = normals.as_ref().map_or(DVec3::ZERO, |n| DVec3::new(n.at(i, 0), n.at(i, 1), n.at(i, 2)));
            let map = || place_of(i).inverse().transpose();
            if is_still { n } else { map().transform_vector3(n).normalize_or_zero() }
        };
        let uv = |i: usize| texture.as_ref().map_or(DVec2::ZERO, |uv| DVec2::new(uv.at(i, 0), 1.0 - uv.at(i, 1)));
        let mut vertices = Vertices {
            of: (node, primitive.attributes),
            numbers,
            is_mirrored: count > 0 && place_of(0).determinant() < 0.0,
            normals: None,
            texture: None,
        };
        if self.wanted && normals.is_some() {
            let key = |n: DVec3| n.to_array().map(f64::to_bits);
            vertices.normals = Some(values(&mut self.normals, count, normal, facets, key));
        }
        if self.wanted && texture.is_some() {
            let key = |uv: DVec2| uv.to_array().map(f64::to_bits);
            vertices.texture = Some(values(&mut self.texture, count, uv, facets, key));
        }
        Ok(vertices)
    }

    /// Numbers that vertices carry, `few` to `most` each; what is wrong is left aside.
    fn carried(&mut self, accessor: Option<u32>, count: usize, few: usize, most: usize) -> Option<Numbers<'a>> {
        let index = accessor?;
        let n = self.source.components(index);
        let read = if (few..=most).contains(&n) { self.source.numbers(index, n).ok() } else { None };
        let Some(values) = read.filter(|values| values.count() == count) else {
            // Once, however often nodes name its mesh.
            let message = || format!("it has not {most} numbers for each of {count} vertices");
            self.report("accessor", index, message);
            return None;
        };
        if (few, most) == (3, 4) {
            self.eight &= values.is_of_bytes();
        }
        Some(values)
    }

    fn report(&mut self, what: &'static str, index: u32, message: impl Fn() -> String) {
        if self.reported.insert((what, index)) {
            self.soup.raw.unreadable(&format!("{what} {index}"), message());
        }
    }

    /// The moves of a primitive's vertices by a skin. What is wrong is left aside.
    fn moves(&mut self, skin: u32, primitive: &Primitive, count: usize) -> Option<Moves<'a>> {
        let names = &primitive.attributes;
        let sets = [(names.joints_0, names.weights_0), (names.joints_1, names.weights_1)];
        let numbers = |accessor: u32| self.source.numbers(accessor, 4).ok().filter(|found| found.count() == count);
        let sets = sets.into_iter().filter_map(|(joints, weights)| joints.zip(weights));
        let sets: Option<Vec<_>> = sets.map(|(joints, weights)| numbers(joints).zip(numbers(weights))).collect();
        let moves = self.joints(skin).zip(sets.filter(|sets| !sets.is_empty()));
        let moves = moves.map(|(joints, sets)| Moves { joints, sets });
        if moves.is_none() {
            self.report("skin", skin, || "its joints cannot be read; the mesh stands at its node".to_owned());
        }
        moves
    }

    /// The moves by the joints of a skin: from where the surface was bound to where they are.
    fn joints(&mut self, skin: u32) -> Option<Arc<[DMat4]>> {
        if let Some((_, moves)) = self.skin.as_ref().filter(|(last, _)| *last == skin) {
            return Some(moves.clone());
        }
        let document = self.source.document;
        let (Skin { inverses, .. }, joints) = document.joints(skin)?;
        let inverses = inverses.map(|inverses| self.source.numbers(inverses, 16)).transpose().ok()?;
        if inverses.as_ref().is_some_and(|inverses| inverses.count() < joints.len()) {
            return None;
        }
        self.room.take(2 * joints.len() * size_of::<DMat4>()).ok()?;
        let parents = self.parents.get_or_insert_with(|| document.parents());
        let mut moves = Vec::with_capacity(joints.len());
        for (k, &joint) in joints.iter().enumerate() {
            let mut place = match &inverses {
                Some(inverses) => DMat4::from_cols_array(&std::array::from_fn(|n| inverses.at(k, n))),
                None => DMat4::IDENTITY,
            };
            let mut next = Some(joint);
            while let Some(node) = next {
                self.steps = self.steps.checked_sub(1)?;
                let parent = parents.get(node as usize)?;
                place = document.place(node as usize) * place;
                next = *parent;
            }
            moves.push(place);
        }
        let moves: Arc<[DMat4]> = moves.into();
        self.skin = Some((skin, moves.clone()));
        Some(moves)
    }
}

/// Moves of vertices by joints, each with a weight.
struct Moves<'a> {
    joints: Arc<[DMat4]>,
    /// Four joints and their weights for each vertex.
    sets: Vec<(Numbers<'a>, Numbers<'a>)>,
}

impl Moves<'_> {
    fn of(&self, vertex: usize) -> DMat4 {
        let (mut sum, mut total) = (DMat4::ZERO, 0.0);
        for (joints, weights) in &self.sets {
            for k in 0..4 {
                let weight = weights.at(vertex, k);
                let joint = self.joints.get(joints.at(vertex, k) as usize);
                if let Some(&joint) = joint.filter(|_| weight > 0.0) {
                    sum += weight * joint;
                    total += weight;
                }
            }
        }
        if total > 0.0 { (1.0 / total) * sum } else { self.joints.first().copied().unwrap_or_default() }
    }
}

/// Adds the values of so many vertices, each once, after facets without values. Returns which value each vertex has.
fn values<T: Copy + Default + Sync, K: Ord>(
    to: &mut Option<PerCorner<T>>,
    vertices: usize,
    value: impl Fn(usize) -> T + Sync,
    facets: usize,
    key: impl Fn(T) -> K + Sync,
) -> Vec<u32> {
    // The first value is the default.
    let to = to.get_or_insert_with(|| PerCorner { values: vec![T::default()], corners: vec![[0; 3]; facets] });
    let first = to.values.len();
    let firsts = firsts(vertices, |i| key(value(i)));
    numbered(firsts, first, |i| to.values.push(value(i)))
}

/// Adds the corners of facets, whose vertices have these values: the first facet, how many and which. Without values all corners
/// have the default, once any primitive has values.
fn add<T>(
    to: &mut Option<PerCorner<T>>,
    values: Option<&[u32]>,
    (first_facet, count, facet): (usize, usize, impl Fn(usize) -> [u32; 3]),
) {
    let Some(to) = to else { return };
    match values {
        None => to.corners.resize(first_facet + count, [0; 3]),
        Some(values) => to.corners.extend((0..count).map(|f| facet(f).map(|i| values[i as usize]))),
    }
}

/// JSON without its end, and the bytes that it names.
fn scene(mesh: &TriMesh, held: &Held<'_>) -> Result<(String, Vec<u8>), DataError> {
    let moved = centred(mesh);
    let (mesh, node) = match &moved {
        Some((moved, DVec3 { x, y, z })) => (moved, format!(",\"translation\":[{x:?},{y:?},{z:?}]")),
        None => (mesh, String::new()),
    };
    check_single(mesh)?;
    // A vertex for each normal and place in the texture that its corners have; the first of each keeps its number.
    let corner = |f: usize, k: usize| {
        let normal = held.corner_normals.map_or(0, |n| n.corners[f][k]);
        (mesh.facets()[f][k], normal, held.corner_uv.map_or(0, |t| t.corners[f][k]))
    };
    let count = mesh.positions().len();
    let mut vertices: Vec<Option<(u32, u32)>> = vec![None; count];
    let mut owners: Vec<u32> = (0..count as u32).collect();
    let mut more: HashMap<(u32, u32, u32), u32> = HashMap::new();
    let mut indices = Vec::with_capacity(3 * mesh.facets().len());
    for (f, k) in (0..mesh.facets().len()).flat_map(|f| [(f, 0), (f, 1), (f, 2)]) {
        let (v, n, t) = corner(f, k);
        let number = if *vertices[v as usize].get_or_insert((n, t)) == (n, t) {
            v
        } else {
            *more.entry((v, n, t)).or_insert_with(|| {
                vertices.push(Some((n, t)));
                owners.push(v);
                vertices.len() as u32 - 1
            })
        };
        indices.push(number);
    }
    let mut data = Vec::new();
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    // Adds an array of elements, each written by `write`; returns its accessor.
    let mut add = |target: u32, kind: &str, n: usize, shape: &str, write: &dyn Fn(&mut Vec<u8>, usize)| {
        let (start, number) = (data.len(), accessors.len());
        (0..n).for_each(|i| write(&mut data, i));
        let length = data.len() - start;
        data.resize(data.len().next_multiple_of(4), 0);
        views.push(format!("{{\"buffer\":0,\"byteOffset\":{start},\"byteLength\":{length},\"target\":{target}}}"));
        accessors.push(format!("{{\"bufferView\":{number},\"componentType\":{kind},\"count\":{n},\"type\":{shape}}}"));
        number
    };
    let total = vertices.len();
    let floats = |out: &mut Vec<u8>, numbers: &[f64]| {
        numbers.iter().for_each(|&x| out.extend_from_slice(&(x as f32).to_le_bytes()));
    };
    let (low, high) = mesh.bounds();
    let three = |p: DVec3| {
        let [x, y, z] = p.to_array().map(|x| f64::from(x as f32));
        format!("[{x:?},{y:?},{z:?}]")
    };
    let shape = format!("\"VEC3\",\"min\":{},\"max\":{}", three(low), three(high));
    let position = |out: &mut Vec<u8>, i: usize| floats(out, &mesh.positions()[owners[i] as usize].to_array());
    let mut names = vec![format!("\"POSITION\":{}", add(34962, "5126", total, &shape, &position))];
    let at = |i: usize| vertices[i].unwrap_or_default();
    if held.normals.is_some() || held.corner_normals.is_some() {
        let normal = |out: &mut Vec<u8>, i: usize| {
            let own = held.normals.as_ref().map(|n| n[owners[i] as usize]);
            let normal = own.or_else(|| held.corner_normals.and_then(|n| n.values.get(at(i).0 as usize).copied()));
            floats(out, &normal.unwrap_or_default().to_array());
        };
        names.push(format!("\"NORMAL\":{}", add(34962, "5126", total, "\"VEC3\"", &normal)));
    }
    if let Some(texture) = held.corner_uv {
        let uv = |out: &mut Vec<u8>, i: usize| {
            let uv = texture.values.get(at(i).1 as usize).copied().unwrap_or_default();
            floats(out, &[uv.x, 1.0 - uv.y]);
        };
        names.push(format!("\"TEXCOORD_0\":{}", add(34962, "5126", total, "\"VEC2\"", &uv)));
    }
    if let Some(colours) = held.colours {
        let eight = colours.depth == ColourDepth::Eight;
        let colour = |out: &mut Vec<u8>, i: usize| match colours.values[owners[i] as usize] {
            colour if eight => out.extend(colour.map(eight_bit)),
            colour => floats(out, &colour),
        };
        let component = if eight { "5121,\"normalized\":true" } else { "5126" };
        names.push(format!("\"COLOR_0\":{}", add(34962, component, total, "\"VEC4\"", &colour)));
    }
    let index = |out: &mut Vec<u8>, i: usize| out.extend_from_slice(&u32::to_le_bytes(indices[i]));
    // Facets of each region follow one another.
    let regions =
        held.regions.map(|regions| regions.facets_by_region().into_iter().enumerate().filter(|(_, f)| !f.is_empty()));
    let (mut primitives, mut materials) = (Vec::new(), Vec::new());
    let attributes = names.join(",");
    let mut primitive = |number: usize, material: &str| {
        primitives.push(format!("{{\"attributes\":{{{attributes}}},\"indices\":{number},{material}\"mode\":4}}"));
    };
    if regions.is_none() {
        primitive(add(34963, "5125", indices.len(), "\"SCALAR\"", &index), "");
    }
    for (region, facets) in regions.into_iter().flatten() {
        let of_region = |out: &mut Vec<u8>, i: usize| index(out, 3 * facets[i / 3] as usize + i % 3);
        let number = add(34963, "5125", 3 * facets.len(), "\"SCALAR\"", &of_region);
        primitive(number, &format!("\"material\":{},", materials.len()));
        let label = held.regions.map_or_else(String::new, |regions| regions.label(region));
        materials.push(format!("{{\"name\":{}}}", serde_json::Value::from(label)));
    }
    let materials =
        if materials.is_empty() { String::new() } else { format!("\"materials\":[{}],", materials.join(",")) };
    let json = format!(
        "{{\"asset\":{{\"version\":\"2.0\",\"generator\":\"tessera\"}},\"scene\":0,\"scenes\":[{{\"nodes\":[0]}}],\
         \"nodes\":[{{\"mesh\":0{node}}}],\"meshes\":[{{\"primitives\":[{}]}}],{materials}\"accessors\":[{}],\
         \"bufferViews\":[{}],\"buffers\":[{{\"byteLength\":{}",
        primitives.join(","),
        accessors.join(","),
        views.join(","),
        data.len()
    );
    Ok((json, data))
}

fn encode_binary(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (mut json, data) = scene(mesh, held)?;
    json.push_str("}]}");
    while json.len() % 4 != 0 {
        json.push(' ');
    }
    let length = 28 + json.len() + data.len();
    let Ok(length) = u32::try_from(length) else {
        return Err(DataError::Header("it would be longer than the 4 GiB of a .glb file; write .ply".to_owned()));
    };
    let mut out = Vec::with_capacity(length as usize);
    out.extend_from_slice(MAGIC);
    let words = |out: &mut Vec<u8>, words: [u32; 2]| words.iter().for_each(|w| out.extend_from_slice(&w.to_le_bytes()));
    words(&mut out, [2, length]);
    words(&mut out, [json.len() as u32, JSON]);
    out.extend_from_slice(json.as_bytes());
    words(&mut out, [data.len() as u32, BIN]);
    out.extend_from_slice(&data);
    Ok(out)
}

fn encode_text(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (mut json, data) = scene(mesh, held)?;
    json.push_str(",\"uri\":\"data:application/octet-stream;base64,");
    STANDARD.encode_string(&data, &mut json);
    json.push_str("\"}]}");
    Ok(json.into_bytes())
}
