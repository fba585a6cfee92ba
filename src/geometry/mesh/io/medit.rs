//! Medit: `.mesh`, text, and `.meshb`, binary, of versions 1 to 4. Writes version 2, with doubles, or 3 if a file is longer than
//! 32 bits can say.
//!
//! Purpose: vertices, triangles and quadrilaterals, in either byte order; all other keywords are passed over. A vertex without a
//! third coordinate, as of dimension 2, lies at 0. Our own reader: it is small.
//! Must not know: other formats.

use std::fmt::Write as _;

use glam::DVec3;

use super::held::{By, Held, Holds};
use super::numbers::{Cursor, Encoding, Kind, Order, cut, parse, shown};
use super::{Codec, Counts, DataError, Soup, VertexNumbers, volumes};
use crate::mesh::TriMesh;

const NOTHING: Holds = Holds { normals: By::None, texture: By::None, colours: false, opacity: false, scalars: false };

/// See [`Codec`].
pub(super) const TEXT: Codec = Codec {
    extension: "mesh",
    decode: decode_text,
    encode: encode_text,
    counts: |bytes| read_text(bytes, true).ok().map(|reader| reader.counts),
    holds: NOTHING,
    vertices: VertexNumbers::Kept,
};

/// See [`Codec`].
pub(super) const BINARY: Codec = Codec {
    extension: "meshb",
    decode: decode_binary,
    encode: encode_binary,
    counts: |bytes| read_binary(bytes, true).ok().map(|reader| reader.counts),
    holds: NOTHING,
    vertices: VertexNumbers::Kept,
};

/// Numbers of keywords in binary files.
const DIMENSION: i64 = 3;
const VERTICES: i64 = 4;
const TRIANGLES: i64 = 6;
const QUADRILATERALS: i64 = 7;
const TETRAHEDRA: i64 = 8;
const PRISMS: i64 = 9;
const HEXAHEDRA: i64 = 10;
const PYRAMIDS: i64 = 49;
const END: i64 = 54;

fn decode_text(bytes: &[u8], _wanted: bool) -> Result<Soup, DataError> {
    surface(read_text(bytes, false)?)
}

fn decode_binary(bytes: &[u8], _wanted: bool) -> Result<Soup, DataError> {
    surface(read_binary(bytes, false)?)
}

/// Reads all lists, or their lengths alone if they are counted.
fn read_text(bytes: &[u8], counted: bool) -> Result<Reader<'_>, DataError> {
    let mut reader = Reader { cursor: Cursor::new(bytes), counted, ..Reader::default() };
    reader.text()?;
    Ok(reader)
}

/// As [`read_text`].
fn read_binary(bytes: &[u8], counted: bool) -> Result<Reader<'_>, DataError> {
    let mut reader = Reader { cursor: Cursor::new(bytes), counted, ..Reader::default() };
    match bytes.first_chunk::<4>() {
        Some([1, 0, 0, 0]) => reader.binary(Order::Little)?,
        Some([0, 0, 0, 1]) => reader.binary(Order::Big)?,
        _ => return Err(DataError::Header("it does not begin with a 1 of four bytes; name text .mesh".to_owned())),
    }
    Ok(reader)
}

fn surface(reader: Reader<'_>) -> Result<Soup, DataError> {
    let Reader { mut soup, volumes: count, lists, .. } = reader;
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
        }
    }
    volumes(&mut soup, count, "write the triangles of its surface too")?;
    Ok(soup)
}

struct Reader<'a> {
    cursor: Cursor<'a>,
    encoding: Encoding,
    dimension: usize,
    float: Kind,
    int: Kind,
    /// Whether lists are passed over and their lengths added up in `counts`.
    counted: bool,
    counts: Counts,
    soup: Soup,
    /// Corners of faces with the number of their part, and how many corners a face has.
    lists: Vec<(Vec<i64>, usize)>,
    volumes: usize,
}

impl Default for Reader<'_> {
    fn default() -> Self {
        Self {
            cursor: Cursor::new(&[]),
            encoding: Encoding::Text,
            dimension: 3,
            float: Kind::F64,
            int: Kind::I32,
            counted: false,
            counts: Counts::default(),
            soup: Soup::default(),
            lists: Vec::new(),
            volumes: 0,
        }
    }
}

impl<'a> Reader<'a> {
    fn text(&mut self) -> Result<(), DataError> {
        let mut first = true;
        while let Some(word) = self.word() {
            match word.to_ascii_lowercase().as_slice() {
                b"meshversionformatted" => drop(self.number::<i64>("a version")?),
                _ if first => {
                    return Err(self.cursor.syntax(format!(
                        "\"{}\" is not MeshVersionFormatted; name a binary file .meshb",
                        shown(word)
                    )));
                }
                b"dimension" => {
                    self.dimension = self.number("a dimension")?;
                    self.check_dimension()?;
                }
                b"vertices" => {
                    let count = self.count(2 * self.dimension + 2)?;
                    if self.counted {
                        self.counts.vertices += count as u64;
                        continue;
                    }
                    for _ in 0..count {
                        let mut p = [0.0; 3];
                        for x in &mut p[..self.dimension] {
                            *x = self.number("a coordinate")?;
                        }
                        self.number::<i64>("the number of a part")?;
                        self.soup.positions.push(DVec3::from_array(p));
                    }
                }
                b"triangles" => self.faces(3)?,
                b"quadrilaterals" => self.faces(4)?,
                b"tetrahedra" | b"hexahedra" | b"prisms" | b"pyramids" => {
                    self.volumes = self.volumes.saturating_add(self.number("a number of elements")?);
                }
                b"end" => return Ok(()),
                // Of other keywords and the numbers after them.
                _ => {}
            }
            first = false;
        }
        if first { Err(DataError::Empty) } else { Ok(()) }
    }

    /// A word that is no comment.
    fn word(&mut self) -> Option<&'a [u8]> {
        loop {
            let word = self.cursor.word()?;
            if !word.starts_with(b"#") {
                return Some(word);
            }
            self.cursor.end_line();
        }
    }

    fn number<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, DataError> {
        let word = self.word().ok_or_else(|| DataError::Truncated(format!("it ends where {what} should be")))?;
        parse(word).ok_or_else(|| self.cursor.syntax(format!("\"{}\" is not {what}", shown(word))))
    }

    /// How many of so many bytes each follow.
    fn count(&mut self, least: usize) -> Result<usize, DataError> {
        let count: usize = self.number("a number of elements")?;
        let left = self.cursor.rest.len();
        if count.saturating_mul(least) > left + 1 {
            return Err(DataError::Truncated(format!("{count} elements are declared and {left} bytes follow")));
        }
        Ok(count)
    }

    fn faces(&mut self, corners: usize) -> Result<(), DataError> {
        let count = self.count(2 * corners + 2)?;
        if self.counted {
            self.counts.facets += count as u64 * (corners as u64 - 2);
            return Ok(());
        }
        let list = (0..count * (corners + 1)).map(|_| self.number("a whole number"));
        let list = list.collect::<Result<_, _>>()?;
        self.lists.push((list, corners));
        Ok(())
    }

    fn check_dimension(&self) -> Result<(), DataError> {
        match self.dimension {
            2 | 3 => Ok(()),
            n => Err(DataError::Header(format!("the dimension is {n}, not 2 or 3"))),
        }
    }

    /// Each keyword says where the next one is; after the last one this is 0.
    fn binary(&mut self, order: Order) -> Result<(), DataError> {
        let bytes = self.cursor.rest;
        self.encoding = Encoding::Binary(order);
        self.cursor.take(4);
        let version = self.integer(Kind::I32)?;
        let place = match version {
            1 | 2 => Kind::I32,
            3 | 4 => Kind::I64,
            _ => return Err(DataError::Header(format!("version {version} is not 1, 2, 3 or 4"))),
        };
        self.float = if version == 1 { Kind::F32 } else { Kind::F64 };
        self.int = if version == 4 { Kind::I64 } else { Kind::I32 };
        loop {
            let keyword = self.integer(Kind::I32)?;
            if keyword == END {
                return self.integer(place).map(|_| ());
            }
            let next = self.integer(place)?;
            self.keyword(keyword)?;
            // Places only grow, so that this ends, and no byte is read twice.
            let next = usize::try_from(next).unwrap_or(0);
            if next == 0 {
                return Ok(());
            }
            let end = bytes.len() - self.cursor.rest.len();
            if next < end {
                return Err(DataError::Header(format!("keyword {keyword} leads back to byte {next}")));
            }
            let rest = bytes.get(next..).ok_or_else(|| {
                DataError::Truncated(format!("keyword {keyword} leads to byte {next} of {}", bytes.len()))
            })?;
            self.cursor.rest = rest;
        }
    }

    fn keyword(&mut self, keyword: i64) -> Result<(), DataError> {
        let (int, encoding) = (self.int, self.encoding);
        match keyword {
            DIMENSION => {
                self.dimension = self.cursor.count(Kind::I32, encoding, "a dimension")?;
                self.check_dimension()?;
            }
            VERTICES => {
                let count = self.cursor.count(int, encoding, "a number of vertices")?;
                let (size, n) = (self.float.bytes(), self.dimension);
                let each = n * size + int.bytes();
                let Encoding::Binary(order) = encoding else { return Ok(()) };
                let records = self.cursor.take(count.saturating_mul(each)).ok_or_else(|| cut("vertices"))?;
                if self.counted {
                    self.counts.vertices += count as u64;
                    return Ok(());
                }
                for record in records.chunks_exact(each) {
                    let numbers = self.float.floats(&record[..n * size], order);
                    self.soup.positions.push(DVec3::new(
                        numbers[0],
                        numbers[1],
                        numbers.get(2).copied().unwrap_or(0.0),
                    ));
                }
            }
            TRIANGLES | QUADRILATERALS => {
                let corners = if keyword == TRIANGLES { 3 } else { 4 };
                let count = self.cursor.count(int, encoding, "a number of faces")?;
                let all = count.saturating_mul(corners + 1);
                if self.counted {
                    self.cursor.lenient(all, int, encoding, "faces", false)?;
                    self.counts.facets += count as u64 * (corners as u64 - 2);
                    return Ok(());
                }
                let list = self.cursor.integers(all, int, encoding, "faces")?;
                self.lists.push((list, corners));
            }
            TETRAHEDRA | HEXAHEDRA | PRISMS | PYRAMIDS => {
                let count = self.cursor.count(int, encoding, "a number of elements")?;
                self.volumes = self.volumes.saturating_add(count);
            }
            _ => {}
        }
        Ok(())
    }

    fn integer(&mut self, kind: Kind) -> Result<i64, DataError> {
        self.cursor.integer(kind, self.encoding, "keywords")
    }
}

fn encode_text(mesh: &TriMesh, _held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let mut text = String::with_capacity(64 + 70 * vertices + 26 * facets);
    let _ = writeln!(text, "MeshVersionFormatted 2\nDimension 3\nVertices\n{vertices}");
    // Debug formatting is the shortest text that reads back as the same bits.
    for p in mesh.positions() {
        let _ = writeln!(text, "{:?} {:?} {:?} 0", p.x, p.y, p.z);
    }
    let _ = writeln!(text, "Triangles\n{facets}");
    for facet in mesh.facets() {
        let [a, b, c] = facet.map(|v| v + 1);
        let _ = writeln!(text, "{a} {b} {c} 0");
    }
    text.push_str("End\n");
    Ok(text.into_bytes())
}

fn encode_binary(mesh: &TriMesh, _held: &Held<'_>) -> Result<Vec<u8>, DataError> {
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
    for facet in mesh.facets() {
        facet.iter().for_each(|v| int(&mut out, v + 1));
        int(&mut out, 0);
    }
    int(&mut out, END as u32);
    out.extend_from_slice(&[0; 8][..size]);
    Ok(out)
}
