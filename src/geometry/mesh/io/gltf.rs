//! The format glTF 2.0: `.glb`, and `.gltf` with its data inside. Writes single precision.
//!
//! Purpose: the triangles, strips and fans of all nodes of the scene, in their places, with normals, texture coordinates and
//! colours of vertices. A glTF has a vertex once for each normal and each place in the texture: vertices of a primitive with the
//! same bits of position and colour become one, and corners keep the rest. The second texture coordinate goes up here, and down
//! in a glTF. Materials, images, skins and animations are left aside.
//! Why the reading is our own, over `serde_json`: in the crate `gltf` (1.4.1, of 2024) an accessor with a stride below its
//! elements' size, or with indices that are fractions, panics in release builds, a count of 0 or 2⁶² in debug builds; and its
//! documents hold the places of nodes in single precision, which tears scenes far from the origin.
//! Invariant: what is made of the file's bytes is bounded ([`super::UNPACKED_RATIO`]), however often nodes name a mesh; the JSON
//! becomes lists of numbers that are bounded by its length ([`document`]). Must not know: other formats.

mod document;

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DVec2, DVec3};

use self::document::{Accessor, Document, Primitive, Text};
use super::held::{By, Held, Holds, centred, check_single, eight_bit, firsts, numbered};
use super::numbers::{Cursor, Encoding, Kind, Order, cut};
use super::{Codec, Counts, DataError, Soup, VertexNumbers, unpacked_limit};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner};

const HOLDS: Holds = Holds { normals: By::Corner, texture: By::Corner, colours: true, opacity: true, scalars: false };

pub(super) const BINARY: Codec = Codec {
    extension: "glb",
    media_types: &["model/gltf-binary"],
    // Half a vertex of three floats, and three indices.
    facet_bytes: 18,
    signature: super::packed::Signature::Start(|head| head.bytes.starts_with(MAGIC)),
    decode: |bytes, wanted| parts(bytes).and_then(|(json, binary)| surface(json, binary, bytes.len(), wanted)),
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
    decode: |bytes, wanted| surface(bytes, None, bytes.len(), wanted),
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
    nodes(&document, length, |primitive, _| {
        let Some((mode, position)) = primitive.triangles() else { return Ok(()) };
        let vertices = count(position).ok_or(DataError::Empty)?;
        let corners = primitive.indices.map_or(Some(vertices), count).ok_or(DataError::Empty)?;
        let facets = if mode == 4 { corners / 3 } else { corners.saturating_sub(2) };
        counts.vertices += vertices;
        counts.facets += facets;
        // Numbers of vertices, as they are read and as they are kept, and of corners, and what corners carry.
        let names = &primitive.attributes;
        let numbers = [(names.normal, 3), (names.texture, 2), (names.colour, 4)];
        let numbers = 3 + numbers.iter().filter(|(name, _)| name.is_some()).map(|(_, n)| n).sum::<u64>();
        counts.made_bytes += (16 * numbers + 8) * vertices + 12 * corners + 48 * facets;
        // Reading refuses such files.
        if counts.made_bytes > most.saturating_mul(2) { Err(DataError::Empty) } else { Ok(()) }
    })
    .ok()?;
    counts.made_bytes = counts.made_bytes.saturating_add(read as u64);
    Some(counts)
}

fn surface(json: &[u8], binary: Option<&[u8]>, length: usize, wanted: bool) -> Result<Soup, DataError> {
    let document = Document::read(json)?;
    let buffers = buffers(&document, binary)?;
    let mut reader = Reader {
        document: &document,
        buffers,
        left: unpacked_limit(length),
        wanted,
        soup: Soup::default(),
        normals: PerCorner { values: Vec::new(), corners: Vec::new() },
        texture: PerCorner { values: Vec::new(), corners: Vec::new() },
        colours: Vec::new(),
        eight: true,
        found: [false; 3],
        reported: HashSet::new(),
    };
    nodes(&document, length, |primitive, place| reader.primitive(primitive, place))?;
    let mut soup = reader.soup;
    let [normals, texture, colours] = reader.found;
    soup.raw.normals = normals.then_some(Normals::PerCorner(reader.normals));
    soup.raw.texture = texture.then_some(reader.texture);
    let depth = if reader.eight { ColourDepth::Eight } else { ColourDepth::Float };
    soup.raw.colours = colours.then_some(Colours { values: reader.colours, depth });
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

fn buffers<'a>(document: &Document<'_>, binary: Option<&'a [u8]>) -> Result<Vec<Cow<'a, [u8]>>, DataError> {
    let buffer = |(index, buffer): (usize, &document::Buffer<'_>)| {
        let wrong = |message: String| DataError::Element { element: "buffer", index, message };
        match &buffer.uri {
            None if index == 0 => Ok(binary.unwrap_or_default().into()),
            None => Err(wrong("it has no data".to_owned())),
            Some(Text(uri)) if uri.starts_with("data:") => {
                let text = uri.split_once(";base64,").map(|(_, text)| text);
                let text = text.ok_or_else(|| wrong("its data are not in base64".to_owned()))?;
                Ok(STANDARD.decode(text).map_err(|error| wrong(error.to_string()))?.into())
            }
            Some(_) => Err(wrong("its data are in another file; export it as .glb".to_owned())),
        }
    };
    document.buffers.iter().enumerate().map(buffer).collect()
}

/// Ancestors of a node with further children to visit, at most. A place takes 128 bytes.
const DEEPEST: usize = 10_000;

/// All primitives of the scene, in their places; the file has `length` bytes.
fn nodes(
    document: &Document<'_>,
    length: usize,
    mut visit: impl FnMut(&Primitive, DMat4) -> Result<(), DataError>,
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
            primitives.iter().try_for_each(|primitive| visit(primitive, place))?;
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
    document: &'a Document<'a>,
    buffers: Vec<Cow<'a, [u8]>>,
    /// Bytes that may still be made.
    left: usize,
    wanted: bool,
    soup: Soup,
    normals: PerCorner<DVec3>,
    texture: PerCorner<DVec2>,
    colours: Vec<[f64; 4]>,
    /// Whether all colours came in bytes.
    eight: bool,
    /// Whether there are normals, texture coordinates, colours at all.
    found: [bool; 3],
    /// Accessors that were left aside.
    reported: HashSet<u32>,
}

impl Reader<'_> {
    fn primitive(&mut self, primitive: &Primitive, place: DMat4) -> Result<(), DataError> {
        let Some((mode, position)) = primitive.triangles() else { return Ok(()) };
        let positions = self.numbers(position, 3)?;
        let count = positions.len() / 3;
        let order: Option<Vec<u32>> = match primitive.indices {
            Some(indices) => {
                let corner = |x: f64| (0.0..count as f64).contains(&x).then_some(x as u32);
                self.numbers(indices, 1)?.into_iter().map(corner).collect()
            }
            None => {
                self.spend(count.saturating_mul(8))?;
                Some((0..count as u32).collect())
            }
        };
        let order = order.ok_or_else(|| DataError::Element {
            element: "accessor",
            index: primitive.indices.unwrap_or(position) as usize,
            message: format!("a vertex is named, but there are {count} vertices, counted from 0"),
        })?;
        let mirrored = place.determinant() < 0.0;
        let in_strip = |(k, t): (usize, &[u32])| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
        let facets: Vec<[u32; 3]> = match mode {
            4 => order.as_chunks::<3>().0.to_vec(),
            5 => order.windows(3).enumerate().map(in_strip).collect(),
            _ => order.get(1..).unwrap_or_default().windows(2).map(|t| [order[0], t[0], t[1]]).collect(),
        };
        // Each facet has three arrays of corners.
        self.spend(facets.len().saturating_mul(36).saturating_add(count.saturating_mul(24)))?;

        // Read even if they are not wanted: colours part vertices, and all count against the bound.
        let [normals, texture, colours] = [
            self.carried(primitive.attributes.normal, count, 3, 3),
            self.carried(primitive.attributes.texture, count, 2, 2),
            self.carried(primitive.attributes.colour, count, 3, 4),
        ];
        let colour_of = |colours: &Option<(Vec<f64>, usize)>, i: usize| match colours {
            Some((values, n)) => {
                let c = &values[i * n..(i + 1) * n];
                [c[0], c[1], c[2], c.get(3).copied().unwrap_or(1.0)]
            }
            None => [1.0; 4],
        };
        let is_still = place == DMat4::IDENTITY;
        let position = |i: usize| DVec3::from_slice(&positions[3 * i..]);
        let firsts = firsts(count, |i| {
            let mut key = [0; 7];
            let numbers = position(i).to_array().into_iter().chain(colour_of(&colours, i));
            // Adding 0 makes -0 the same as 0.
            key.iter_mut().zip(numbers).for_each(|(k, x)| *k = (x + 0.0).to_bits());
            key
        });
        let soup = &mut self.soup;
        let vertices = numbered(firsts, soup.positions.len(), |i| {
            soup.positions.push(if is_still { position(i) } else { place.transform_point3(position(i)) });
            if self.wanted {
                self.colours.push(colour_of(&colours, i));
            }
        });
        let turned = |t: [u32; 3]| if mirrored { [t[0], t[2], t[1]] } else { t };
        self.soup.facets.extend(facets.iter().map(|&t| turned(t).map(|i| vertices[i as usize])));
        if !self.wanted {
            return Ok(());
        }
        self.found[2] |= colours.is_some();
        // An attribute that a primitive lacks is one value: a normal of length 0, the corner of the texture.
        let map = place.inverse().transpose();
        let normal = |n: &[f64; 3]| {
            let n = DVec3::from_array(*n);
            if is_still { n } else { map.transform_vector3(n).normalize_or_zero() }
        };
        let values = normals.as_ref().map(|(values, _)| values.as_chunks::<3>().0.iter().map(normal).collect());
        self.found[0] |= values.is_some();
        add(&mut self.normals, values, &facets, turned, |n| n.to_array().map(f64::to_bits));
        let uv = |uv: &[f64; 2]| DVec2::new(uv[0], 1.0 - uv[1]);
        let values = texture.as_ref().map(|(values, _)| values.as_chunks::<2>().0.iter().map(uv).collect());
        self.found[1] |= values.is_some();
        add(&mut self.texture, values, &facets, turned, |uv| uv.to_array().map(f64::to_bits));
        Ok(())
    }

    /// Numbers that vertices carry, and how many each has, `few` to `most`; what is wrong is left aside.
    fn carried(&mut self, accessor: Option<u32>, count: usize, few: usize, most: usize) -> Option<(Vec<f64>, usize)> {
        let index = accessor?;
        let found = self.document.accessors.get(index as usize);
        let n = found.map_or(0, Accessor::components);
        let read = if (few..=most).contains(&n) { self.numbers(index, n).ok() } else { None };
        let Some(values) = read.filter(|values| values.len() == n * count) else {
            // Once, however often nodes name its mesh.
            if self.reported.insert(index) {
                let message = format!("it has not {most} numbers for each of {count} vertices");
                self.soup.raw.unreadable(&format!("accessor {index}"), message);
            }
            return None;
        };
        if (few, most) == (3, 4) {
            self.eight &= found.is_some_and(|a| a.component_type == 5121 && a.normalized);
        }
        Some((values, n))
    }

    fn spend(&mut self, bytes: usize) -> Result<(), DataError> {
        let left = self.left.checked_sub(bytes);
        self.left = left.ok_or_else(repeated)?;
        Ok(())
    }

    fn numbers(&mut self, index: u32, components: usize) -> Result<Vec<f64>, DataError> {
        let index = index as usize;
        let wrong = |message: &str| DataError::Element { element: "accessor", index, message: message.to_owned() };
        let document = self.document;
        let accessor = document.accessors.get(index).ok_or_else(|| wrong("it is named, and there is none"))?;
        if accessor.components() != components {
            return Err(wrong("it is of another type than what it is used for"));
        }
        if accessor.sparse.is_some() {
            return Err(wrong("it is sparse, which is not read; export it without"));
        }
        // A type, and its number that stands for 1 where numbers are normalized.
        let (kind, most) = match accessor.component_type {
            5120 => (Kind::I8, 127.0),
            5121 => (Kind::U8, 255.0),
            5122 => (Kind::I16, 32767.0),
            5123 => (Kind::U16, 65535.0),
            5125 => (Kind::U32, 1.0),
            5126 => (Kind::F32, 1.0),
            _ => return Err(wrong("its type of numbers is not known")),
        };
        let view = accessor.buffer_view.and_then(|view| document.views.get(view as usize));
        let view = view.ok_or_else(|| wrong("its buffer view is not there"))?;
        let size = kind.bytes() * components;
        let stride = view.byte_stride.unwrap_or(size);
        if stride < size || accessor.count == 0 {
            return Err(wrong("its stride is less than its elements' size, or it has no elements"));
        }
        let length = stride.saturating_mul(accessor.count - 1).saturating_add(size);
        self.spend(accessor.count.saturating_mul(8 * components))?;
        let buffer = self.buffers.get(view.buffer as usize).ok_or_else(|| wrong("its buffer is not there"))?;
        let slice = |from: &'_ [u8]| -> Option<Vec<f64>> {
            let view = from.get(view.byte_offset..)?.get(..view.byte_length)?;
            let data = view.get(accessor.byte_offset..)?.get(..length)?;
            if stride == size {
                return Some(kind.floats(data, Order::Little));
            }
            let elements = data.chunks(stride).flat_map(|element| element[..size].iter().copied());
            Some(kind.floats(&elements.collect::<Vec<_>>(), Order::Little))
        };
        let beyond = || DataError::Truncated(format!("accessor {index} has {length} bytes that its buffer has not"));
        let mut values = slice(buffer).ok_or_else(beyond)?;
        if accessor.normalized {
            values.iter_mut().for_each(|x| *x = (*x / most).max(-1.0));
        }
        Ok(values)
    }
}

/// Adds the values of a primitive's vertices to the corners of its facets, each value once.
fn add<T: Copy + Default + Sync, K: Ord>(
    to: &mut PerCorner<T>,
    values: Option<Vec<T>>,
    facets: &[[u32; 3]],
    turned: impl Fn([u32; 3]) -> [u32; 3],
    key: impl Fn(T) -> K + Sync,
) {
    let first = to.values.len();
    let Some(values) = values else {
        to.values.push(T::default());
        to.corners.extend(facets.iter().map(|_| [first as u32; 3]));
        return;
    };
    let index = numbered(firsts(values.len(), |i| key(values[i])), first, |i| to.values.push(values[i]));
    to.corners.extend(facets.iter().map(|&t| turned(t).map(|i| index[i as usize])));
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
    let number = add(34963, "5125", indices.len(), "\"SCALAR\"", &index);
    let json = format!(
        "{{\"asset\":{{\"version\":\"2.0\",\"generator\":\"tessera\"}},\"scene\":0,\"scenes\":[{{\"nodes\":[0]}}],\
         \"nodes\":[{{\"mesh\":0{node}}}],\"meshes\":[{{\"primitives\":[{{\"attributes\":{{{}}},\"indices\":{number},\
         \"mode\":4}}]}}],\"accessors\":[{}],\"bufferViews\":[{}],\"buffers\":[{{\"byteLength\":{}",
        names.join(","),
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
