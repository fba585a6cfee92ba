//! Medit: `.mesh`, text, and `.meshb`, binary, versions 1 to 4. Writes version 2, with doubles; 3 where 32 bits are too few.
//!
//! Purpose: vertices, triangles and quadrilaterals, in either byte order. Edges that are ridges or required are creases; vertices that are
//! required stay. All other keywords are passed over. A vertex without a third coordinate, as of dimension 2, lies at 0. Our own reader:
//! it is small.
//! Invariant: edges never refuse a file. Must not know: other formats.

use std::collections::HashSet;
use std::fmt::Write as _;
use std::ops::RangeInclusive;

use glam::DVec3;

use super::held::{By, Held, Holds, Labelled, note};
use super::numbers::{Cursor, Encoding, Kind, Order, shown};
use super::regions::{Labels, numbers};
use super::{Codec, Counts, DataError, Others, Soup, VertexNumbers};
use crate::mesh::TriMesh;

const NOTHING: Holds = Holds {
    normals: By::None,
    texture: By::None,
    colours: false,
    opacity: false,
    scalars: false,
    regions: Labelled::Number,
};

pub(super) const TEXT: Codec = Codec {
    extension: "mesh",
    media_types: &["application/x-medit", "model/medit", "model/x-medit"],
    // Half a vertex of three short numbers, and a face of three indices.
    facet_bytes: 30,
    signature: super::packed::Signature::Start(|head| head.word().eq_ignore_ascii_case(VERSION)),
    decode: |bytes, wanted| surface(read_text(bytes, Mode { wanted: wanted.is_some(), counted: false })?),
    encode: encode_text,
    counts: |bytes| read_text(bytes, Mode { wanted: false, counted: true }).ok().map(|reader| reader.counts),
    holds: NOTHING,
    vertices: VertexNumbers::Kept,
};

pub(super) const BINARY: Codec = Codec {
    extension: "meshb",
    media_types: &["application/x-medit-binary", "model/x-medit-binary"],
    // Half a vertex of three floats, and a face of four numbers.
    facet_bytes: 22,
    signature: super::packed::Signature::Start(is_binary),
    decode: |bytes, wanted| surface(read_binary(bytes, Mode { wanted: wanted.is_some(), counted: false })?),
    encode: encode_binary,
    counts: |bytes| read_binary(bytes, Mode { wanted: false, counted: true }).ok().map(|reader| reader.counts),
    holds: NOTHING,
    vertices: VertexNumbers::Kept,
};

/// Whether a file begins with a 1 in either byte order and a version from 1 to 4.
fn is_binary(head: &super::packed::Head<'_>) -> bool {
    matches!(head.bytes.first_chunk(), Some([1, 0, 0, 0, 1..=4, 0, 0, 0] | [0, 0, 0, 1, 0, 0, 0, 1..=4]))
}

const VERSION: &[u8] = b"MeshVersionFormatted";

/// Numbers of keywords in binary files, and their names in text.
const KEYWORDS: [(i64, &[u8]); 13] = [
    (DIMENSION, b"dimension"),
    (VERTICES, b"vertices"),
    (EDGES, b"edges"),
    (RIDGES, b"ridges"),
    (REQUIRED_VERTICES, b"requiredvertices"),
    (REQUIRED_EDGES, b"requirededges"),
    (TRIANGLES, b"triangles"),
    (QUADRILATERALS, b"quadrilaterals"),
    (8, b"tetrahedra"),
    (9, b"prisms"),
    (10, b"hexahedra"),
    (49, b"pyramids"),
    (END, b"end"),
];
/// Numbers and names of some others.
const PASSED: [(i64, &str); 7] = [
    (13, "Corners"),
    (17, "RequiredTriangles"),
    (18, "RequiredQuadrilaterals"),
    (20, "NormalAtVertices"),
    (59, "Tangents"),
    (60, "Normals"),
    (62, "SolAtVertices"),
];
/// The most keywords that are named.
const MOST_PASSED: usize = 16;
const DIMENSION: i64 = 3;
const VERTICES: i64 = 4;
const EDGES: i64 = 5;
const TRIANGLES: i64 = 6;
const QUADRILATERALS: i64 = 7;
const RIDGES: i64 = 14;
const REQUIRED_VERTICES: i64 = 15;
const REQUIRED_EDGES: i64 = 16;
const END: i64 = 54;

#[derive(Clone, Copy, Default)]
struct Mode {
    /// Whether edges are read.
    wanted: bool,
    /// Whether lists are passed over and their lengths added up.
    counted: bool,
}

/// Reads all lists, or their lengths alone if they are counted.
fn read_text(bytes: &[u8], mode: Mode) -> Result<Reader<'_>, DataError> {
    let mut reader = Reader::new(bytes, mode);
    reader.cursor.has_comments = true;
    let cursor = &mut reader.cursor;
    let word = cursor.word().ok_or(DataError::Empty)?;
    if !word.eq_ignore_ascii_case(VERSION) {
        let message = format!("\"{}\" is not MeshVersionFormatted; name a binary file .meshb", shown(word));
        return Err(cursor.syntax(message));
    }
    cursor.integer(Kind::I32, "a version")?;
    while let Some(word) = reader.cursor.word() {
        // Other keywords and the numbers after them are passed over.
        let Some(&(keyword, _)) = KEYWORDS.iter().find(|(_, name)| word.eq_ignore_ascii_case(name)) else {
            let is_empty = reader.cursor.peek().is_some_and(|count| count == b"0");
            if word[0].is_ascii_alphabetic() && !is_empty {
                reader.pass_over(shown(word));
            }
            continue;
        };
        if keyword == END {
            break;
        }
        reader.keyword(keyword)?;
    }
    Ok(reader)
}

/// As [`read_text`]. Each keyword has the place of the next one; after the last one this is 0.
fn read_binary(bytes: &[u8], mode: Mode) -> Result<Reader<'_>, DataError> {
    let mut reader = Reader::new(bytes, mode);
    reader.cursor.encoding = Encoding::Binary(match bytes.first_chunk::<4>() {
        Some([1, 0, 0, 0]) => Order::Little,
        Some([0, 0, 0, 1]) => Order::Big,
        _ => return Err(DataError::Header("it does not begin with a 1 of four bytes; name text .mesh".to_owned())),
    });
    reader.cursor.take(4);
    let version = reader.cursor.integer(Kind::I32, "keywords")?;
    let place = match version {
        1 | 2 => Kind::I32,
        3 | 4 => Kind::I64,
        _ => return Err(DataError::Header(format!("version {version} is not 1, 2, 3 or 4"))),
    };
    reader.float = if version == 1 { Kind::F32 } else { Kind::F64 };
    reader.int = if version == 4 { Kind::I64 } else { Kind::I32 };
    loop {
        let keyword = reader.cursor.integer(Kind::I32, "keywords")?;
        let next = reader.cursor.integer(place, "keywords")?;
        if keyword == END {
            return Ok(reader);
        }
        if !KEYWORDS.iter().any(|(known, _)| *known == keyword) {
            let name = PASSED.iter().find(|(number, _)| *number == keyword).map(|(_, name)| (*name).to_owned());
            reader.pass_over(name.unwrap_or_else(|| format!("keyword {keyword}")));
        }
        reader.keyword(keyword)?;
        // Places only grow, so that this ends, and no byte is read twice.
        let next = usize::try_from(next).unwrap_or(0);
        if next == 0 {
            return Ok(reader);
        }
        if next < bytes.len() - reader.cursor.rest.len() {
            return Err(DataError::Header(format!("keyword {keyword} leads back to byte {next}")));
        }
        let beyond = || DataError::Truncated(format!("keyword {keyword} leads to byte {next} of {}", bytes.len()));
        reader.cursor.rest = bytes.get(next..).ok_or_else(beyond)?;
    }
}

fn surface(reader: Reader<'_>) -> Result<Soup, DataError> {
    let Reader { mut soup, mode, volumes, lists, edges, mut named, required, passed, parts, .. } = reader;
    if mode.wanted {
        if !passed.is_empty() {
            let reason = "a surface has facets, creases and vertices that stay alone";
            soup.raw.unreadable(&passed.join(", "), reason.to_owned());
        }
        soup.raw.labels("references of vertices", parts.len());
    }
    let mut labels = Labels::default();
    // Faces may stand before the vertices that they name.
    for (list, corners) in lists {
        for (index, face) in list.chunks_exact(corners + 1).enumerate() {
            let wrong = |message: String| DataError::Element { element: "face", index, message };
            let mut from_0 = [0; 4];
            for (from_0, &v) in from_0.iter_mut().zip(&face[..corners]) {
                let last = soup.positions.len();
                *from_0 = v.checked_sub(1).filter(|v| (0..last as i64).contains(v)).ok_or_else(|| {
                    wrong(format!("vertex {v} is named, but there are {last} vertices, counted from 1"))
                })?;
            }
            soup.push_polygon(&from_0[..corners]).map_err(wrong)?;
            labels.push(face[corners], if mode.wanted { corners - 2 } else { 0 });
        }
    }
    soup.raw.regions = Some(labels.numbered("references of facets"));
    named.sort_unstable();
    named.dedup();
    let thin = if mode.wanted { (edges.len() / 3).saturating_sub(named.len()) } else { 0 };
    Others { volumes, ..Others::default() }.leave(&mut soup, "write the triangles of its surface too")?;
    if thin > 0 {
        let text = format!("{thin} are neither ridges nor required, and are no creases");
        soup.raw.unreadable("edges", text);
    }
    // Edges are counted from 1, as vertices are.
    let from_1 = |n: i64| n.checked_sub(1).and_then(|n| usize::try_from(n).ok());
    let vertex = |v: i64| from_1(v).and_then(|v| u32::try_from(v).ok()).unwrap_or(u32::MAX);
    let edge = |n: i64| {
        from_1(n).and_then(|n| edges.as_chunks::<3>().0.get(n)).map_or([u32::MAX; 2], |&[a, b, _]| [a, b].map(vertex))
    };
    soup.raw.creases = named.into_iter().map(edge).collect();
    soup.raw.vertices = required.into_iter().map(vertex).collect();
    Ok(soup)
}

#[derive(Default)]
struct Reader<'a> {
    cursor: Cursor<'a>,
    dimension: usize,
    float: Kind,
    int: Kind,
    mode: Mode,
    counts: Counts,
    soup: Soup,
    /// Corners of faces with the number of their part, and how many corners a face has.
    lists: Vec<(Vec<i64>, usize)>,
    /// Two vertices and the number of a part for each edge.
    edges: Vec<i64>,
    /// Numbers of edges that are ridges or required.
    named: Vec<i64>,
    /// Numbers of vertices that are required.
    required: Vec<i64>,
    volumes: usize,
    /// Keywords that are passed over.
    passed: Vec<String>,
    /// References of vertices, as they are written.
    parts: HashSet<&'a [u8]>,
}

impl<'a> Reader<'a> {
    fn new(bytes: &'a [u8], mode: Mode) -> Self {
        Self { cursor: Cursor::new(bytes), dimension: 3, int: Kind::I32, mode, ..Self::default() }
    }

    fn pass_over(&mut self, keyword: String) {
        if self.mode.wanted && self.passed.len() < MOST_PASSED && !self.passed.contains(&keyword) {
            self.passed.push(keyword);
        }
    }

    /// Reads edges, or numbers of edges or vertices, ahead of the words or bytes that are passed over next.
    fn named(&mut self, keyword: i64) {
        let (mut ahead, int) = (self.cursor.clone(), self.int);
        let each = if keyword == EDGES { 3 } else { 1 };
        let what = if keyword == REQUIRED_VERTICES { "required vertices" } else { "edges" };
        let count = ahead.count(int, &format!("a number of {what}"));
        match count.and_then(|count| ahead.integers(count.saturating_mul(each), int, what)) {
            Ok(numbers) if keyword == EDGES => self.edges.extend(numbers),
            Ok(numbers) if keyword == REQUIRED_VERTICES => self.required.extend(numbers),
            Ok(numbers) => self.named.extend(numbers),
            Err(error) => self.soup.raw.unreadable(what, error.to_string()),
        }
    }

    fn keyword(&mut self, keyword: i64) -> Result<(), DataError> {
        let (float, int, n) = (self.float, self.int, self.dimension);
        let cursor = &mut self.cursor;
        match keyword {
            DIMENSION => {
                self.dimension = cursor.count(Kind::I32, "a dimension")?;
                if !(2..=3).contains(&self.dimension) {
                    return Err(DataError::Header(format!("the dimension is {}, not 2 or 3", self.dimension)));
                }
            }
            VERTICES => {
                let count = cursor.count(int, "a number of vertices")?;
                let is_text = cursor.encoding == Encoding::Text;
                let (each, kind) =
                    if is_text { (n + 1, Kind::F64) } else { (n * float.bytes() + int.bytes(), Kind::U8) };
                let all = count.saturating_mul(each);
                if self.mode.counted {
                    self.counts.vertices += count as u64;
                    return cursor.pass(all, kind, "vertices");
                }
                cursor.check(all, kind, "vertices")?;
                for _ in 0..count {
                    let mut p = [0.0; 3];
                    for x in &mut p[..n] {
                        *x = cursor.float(float, "a coordinate")?;
                    }
                    let part = if is_text { cursor.peek() } else { cursor.rest.get(..int.bytes()) };
                    note(&mut self.parts, part.filter(|_| self.mode.wanted));
                    cursor.pass(1, int, "the number of a part")?;
                    self.soup.positions.push(DVec3::from_array(p));
                }
            }
            TRIANGLES | QUADRILATERALS => {
                let corners = if keyword == TRIANGLES { 3 } else { 4 };
                let count = cursor.count(int, "a number of faces")?;
                let all = count.saturating_mul(corners + 1);
                if self.mode.counted {
                    cursor.pass(all, int, "faces")?;
                    self.counts.facets += count as u64 * (corners as u64 - 2);
                } else {
                    self.lists.push((cursor.integers(all, int, "faces")?, corners));
                }
            }
            EDGES | RIDGES | REQUIRED_EDGES | REQUIRED_VERTICES if self.mode.wanted => self.named(keyword),
            // Volumes.
            8 | 9 | 10 | 49 => {
                let count = cursor.count(int, "a number of elements")?;
                self.volumes = self.volumes.saturating_add(count);
            }
            _ => {}
        }
        Ok(())
    }
}

/// References of facets are whole numbers of 32 bits.
pub(super) const REFERENCES: RangeInclusive<i64> = i32::MIN as i64..=i32::MAX as i64;

/// The reference of each facet.
fn references(held: &Held<'_>) -> impl Fn(usize) -> i32 {
    let found = held.regions.map(|regions| (regions, numbers(regions, &REFERENCES)));
    move |facet| found.as_ref().map_or(0, |(regions, numbers)| numbers[regions.of_facet()[facet] as usize] as i32)
}

fn encode_text(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let mut text = String::with_capacity(64 + 70 * vertices + 26 * facets);
    let _ = writeln!(text, "MeshVersionFormatted 2\nDimension 3\nVertices\n{vertices}");
    // Debug formatting is the shortest text that reads back as the same bits.
    for p in mesh.positions() {
        let _ = writeln!(text, "{:?} {:?} {:?} 0", p.x, p.y, p.z);
    }
    let _ = writeln!(text, "Triangles\n{facets}");
    let reference = references(held);
    for (index, facet) in mesh.facets().iter().enumerate() {
        let [a, b, c] = facet.map(|v| v + 1);
        let _ = writeln!(text, "{a} {b} {c} {}", reference(index));
    }
    text.push_str("End\n");
    Ok(text.into_bytes())
}

fn encode_binary(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let most = 64 + 28 * vertices + 16 * facets;
    let is_long = i32::try_from(most).is_err();
    let mut out = Vec::with_capacity(most);
    let int = |out: &mut Vec<u8>, n: u32| out.extend_from_slice(&n.to_le_bytes());
    let size = if is_long { 8 } else { 4 };
    // Keyword, place of the next one, count or value; `bytes` follow.
    let keyword = |out: &mut Vec<u8>, number: i64, value: usize, bytes: usize| {
        int(out, number as u32);
        let next = (out.len() + size + 4 + bytes) as u64;
        out.extend_from_slice(&next.to_le_bytes()[..size]);
        int(out, value as u32);
    };
    int(&mut out, 1);
    int(&mut out, if is_long { 3 } else { 2 });
    keyword(&mut out, DIMENSION, 3, 0);
    keyword(&mut out, VERTICES, vertices, 28 * vertices);
    for p in mesh.positions() {
        p.to_array().iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
        int(&mut out, 0);
    }
    keyword(&mut out, TRIANGLES, facets, 16 * facets);
    let reference = references(held);
    for (index, facet) in mesh.facets().iter().enumerate() {
        facet.iter().for_each(|v| int(&mut out, v + 1));
        int(&mut out, reference(index).cast_unsigned());
    }
    int(&mut out, END as u32);
    out.extend_from_slice(&[0; 8][..size]);
    Ok(out)
}
