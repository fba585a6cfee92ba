//! VTK's XML for polygonal data, `.vtp`, and for unstructured grids, `.vtu`: text, base64, appended data, plain or by zlib.
//! Writes base64 in place, doubles.
//!
//! Purpose: finds the arrays first (`quick-xml`) and reads those that matter then, since appended data come last. Several
//! pieces are one surface. Invariant: arrays together are no longer than the file, or, where they are packed, than
//! [`super::super::UNPACKED_RATIO`] times the file: any number of arrays may name the same bytes. Records of pieces and
//! arrays are bounded by the file too ([`Room`]). Must not know: legacy files.

use std::collections::HashMap;
use std::io::Read as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::read::ZlibDecoder;
use glam::DVec3;
use quick_xml::Reader;
use quick_xml::escape::{escape, unescape};
use quick_xml::events::{BytesStart, Event};

use super::{
    Array, Cell, KINDS, ON_POINTS, Role, SURFACE_FIRST, carried, label, labels, names, push_cells, put_label, written,
};
use crate::mesh::TriMesh;
use crate::mesh::io::held::{By, Held, Holds, Labelled};
use crate::mesh::io::numbers::{Cursor, Encoding, Kind, Order, plain};
use crate::mesh::io::packed::{Head, Room, Signature};
use crate::mesh::io::regions::{ARRAY, Labels, whole_numbers};
use crate::mesh::io::{
    Codec, Counts, DataError, Others, RegionChoice, Soup, VertexNumbers, Wanted, syntax, unpacked_limit,
};

const HOLDS: Holds = Holds {
    normals: By::Vertex,
    texture: By::Vertex,
    colours: true,
    opacity: true,
    scalars: true,
    regions: Labelled::Number,
};

pub(in crate::mesh::io) const POLYGONS: Codec = Codec {
    extension: "vtp",
    media_types: &["application/x-vtp", "model/vtp", "model/x-vtp"],
    // Half a vertex of three floats, and a face of four numbers, packed by zlib.
    facet_bytes: 7,
    // Other types are refused by their names.
    signature: Signature::Start(|head| is_vtk(head) && !is_grid(head)),
    decode: |bytes, wanted| decode(bytes, wanted, Type::PolyData),
    encode: |mesh, held| encode(mesh, held, Type::PolyData),
    counts: |bytes| counts(bytes, Type::PolyData),
    holds: HOLDS,
    vertices: VertexNumbers::Kept,
};

pub(in crate::mesh::io) const GRID: Codec = Codec {
    extension: "vtu",
    media_types: &["application/x-vtu", "model/vtu", "model/x-vtu"],
    facet_bytes: 7,
    signature: Signature::Start(|head| is_vtk(head) && is_grid(head)),
    decode: |bytes, wanted| decode(bytes, wanted, Type::UnstructuredGrid),
    encode: |mesh, held| encode(mesh, held, Type::UnstructuredGrid),
    counts: |bytes| counts(bytes, Type::UnstructuredGrid),
    holds: HOLDS,
    vertices: VertexNumbers::Kept,
};

/// What a file holds, as its first element names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Type {
    #[default]
    PolyData,
    UnstructuredGrid,
}

impl Type {
    fn name(self) -> &'static str {
        match self {
            Self::PolyData => "PolyData",
            Self::UnstructuredGrid => "UnstructuredGrid",
        }
    }
}

fn is_vtk(head: &Head<'_>) -> bool {
    head.is_document(b'<', b"<VTKFile")
}

fn is_grid(head: &Head<'_>) -> bool {
    let name = Type::UnstructuredGrid.name().as_bytes();
    let tag = head.text().split(|&byte| byte == b'>').find(|tag| tag.windows(8).any(|window| window == b"<VTKFile"));
    tag.is_some_and(|tag| tag.windows(name.len()).any(|window| window == name))
}

fn decode(bytes: &[u8], wanted: Wanted<'_>, expected: Type) -> Result<Soup, DataError> {
    let chosen = wanted.and_then(RegionChoice::of_cells);
    let wanted = wanted.is_some();
    let mut file = File::walk(bytes, expected, chosen)?;
    let has_regions = file.pieces.iter().any(|piece| piece.labels.is_some());
    let mut soup = Soup { cells: has_regions.then(Vec::new), ..Soup::default() };
    let mut labels = Labels::default();
    let (mut arrays, mut names, mut others) = (Vec::new(), HashMap::new(), Others::default());
    for (index, piece) in std::mem::take(&mut file.pieces).into_iter().enumerate() {
        let first = soup.positions.len();
        others.thin = others.thin.saturating_add(piece.thin);
        let missing = |what: &str| DataError::Header(format!("piece {index} has no {what}"));
        if piece.points == 0 {
            continue;
        }
        let points = piece.coordinates.as_ref().ok_or_else(|| missing("Points"))?;
        let numbers = file.values(points, piece.points.checked_mul(3), |c, n, k| c.floats(n, k, "points"))?;
        soup.positions.extend(numbers.as_chunks::<3>().0.iter().map(|&p| DVec3::from_array(p)));
        drop(numbers);
        for (cells, kind) in piece.lists() {
            if cells.count == 0 {
                continue;
            }
            let kinds = match kind {
                Some(_) => Vec::new(),
                None => {
                    let types = cells.types.as_ref().ok_or_else(|| missing("types"))?;
                    file.integers(types, Some(cells.count))?
                }
            };
            let offsets = cells.offsets.as_ref().ok_or_else(|| missing("offsets"))?;
            let list = cells.points.as_ref().ok_or_else(|| missing("connectivity"))?;
            let ends = file.integers(offsets, Some(cells.count))?;
            let mut points = file.indices(list, ends.last().and_then(|&end| usize::try_from(end).ok()))?;
            // Numbers that are out of range stay so.
            let first = u32::try_from(first).unwrap_or(u32::MAX);
            let placed = |p: u32| ((p as usize) < piece.points).then(|| p.checked_add(first)).flatten();
            points.iter_mut().for_each(|p| *p = placed(*p).unwrap_or(u32::MAX));
            let cell = |index: usize| Cell::of(kind.or(kinds.get(index).copied()).unwrap_or(0));
            others += push_cells(&mut soup, cell, &ends, &points)?;
        }
        if let (Some(cells), true) = (soup.cells.as_mut().map(std::mem::take), has_regions) {
            file.labels(&mut labels, &piece, &cells);
        }
        if wanted {
            file.data(&mut arrays, &mut names, &piece, first, &mut soup);
        }
    }
    carried(arrays, &mut soup);
    if let Some(name) = chosen.filter(|_| has_regions) {
        soup.raw.regions = Some(labels.numbered(format!("values of the array {:?}", plain(name, 40))));
    }
    if chosen.is_some() {
        soup.raw.arrays.clone_from(&file.cell_arrays);
    }
    for name in file.cell_arrays.iter().filter(|_| wanted) {
        soup.raw.unreadable(&format!("cell array {:?}", plain(name, 40)), ON_POINTS.to_owned());
    }
    for name in file.texts.iter().filter(|_| wanted) {
        soup.raw.unreadable(&format!("array {:?}", plain(name, 40)), "it holds no numbers".to_owned());
    }
    others.leave(&mut soup, SURFACE_FIRST)?;
    Ok(soup)
}

/// Counts by the lengths before arrays: nothing is unpacked, but the ends and types of a grid's cells.
fn counts(bytes: &[u8], expected: Type) -> Option<Counts> {
    let mut file = File::walk(bytes, expected, None).ok()?;
    let mut counts = Counts::default();
    for piece in std::mem::take(&mut file.pieces).iter().filter(|piece| piece.points > 0) {
        let grid = &piece.grid;
        if grid.count > 0 {
            let (ends, kinds) = (grid.offsets.as_ref()?, grid.types.as_ref()?);
            let ends = file.integers(ends, Some(grid.count)).ok()?;
            let kinds = file.integers(kinds, Some(grid.count)).ok()?;
            let facets = super::facets(|index| Cell::of(kinds[index]), &ends);
            counts.facets = counts.facets.saturating_add(facets);
        }
        let mut numbers = |array: &DataArray<'_>| -> Option<usize> {
            let (numbers, is_made) = file.numbers(array)?;
            if is_made {
                counts.made_bytes = counts.made_bytes.saturating_add(8 * numbers as u64);
            }
            Some(numbers)
        };
        if numbers(piece.coordinates.as_ref()?)? / 3 < piece.points {
            return None;
        }
        counts.vertices = counts.vertices.saturating_add(piece.points as u64);
        for (cells, kind) in piece.lists().into_iter().filter(|(cells, _)| cells.count > 0) {
            if numbers(cells.offsets.as_ref()?)? < cells.count {
                return None;
            }
            let corners = numbers(cells.points.as_ref()?)?;
            if kind.is_some() {
                counts.facets = counts.facets.saturating_add(corners.saturating_sub(2 * cells.count) as u64);
            }
        }
        for array in &piece.arrays {
            numbers(array);
        }
    }
    // Reading ends there.
    counts.made_bytes = counts.made_bytes.min(8 * file.left as u64);
    Some(counts)
}

struct DataArray<'a> {
    name: String,
    role: Role,
    kind: Option<Kind>,
    components: usize,
    place: Place<'a>,
    line: usize,
}

enum Place<'a> {
    Text(&'a [u8]),
    Base64(&'a [u8]),
    Appended(usize),
    /// Of a format that is not known.
    Unknown,
}

#[derive(Default)]
struct Cells<'a> {
    count: usize,
    points: Option<Box<DataArray<'a>>>,
    offsets: Option<Box<DataArray<'a>>>,
    types: Option<Box<DataArray<'a>>>,
}

#[derive(Default)]
struct Piece<'a> {
    points: usize,
    /// Points and lines.
    thin: usize,
    coordinates: Option<Box<DataArray<'a>>>,
    polygons: Cells<'a>,
    strips: Cells<'a>,
    grid: Cells<'a>,
    arrays: Vec<DataArray<'a>>,
    /// The array of cells that gives regions.
    labels: Option<Box<DataArray<'a>>>,
    normals: String,
    texture: String,
}

impl<'a> Piece<'a> {
    /// Its cells, with the number of their type if all have one.
    fn lists(&self) -> [(&Cells<'a>, Option<i64>); 3] {
        [(&self.polygons, Some(7)), (&self.strips, Some(6)), (&self.grid, None)]
    }
}

#[derive(Default)]
struct File<'a> {
    expected: Type,
    /// The name of the array of cells that gives regions.
    chosen: Option<&'a str>,
    order: Order,
    /// Type of the lengths before data.
    length: Kind,
    packed: bool,
    pieces: Vec<Piece<'a>>,
    /// Names of the first piece's arrays of cells, and of its arrays of points that hold text.
    cell_arrays: Vec<String>,
    texts: Vec<String>,
    appended: &'a [u8],
    appended_raw: bool,
    /// Bytes that may still be made of arrays.
    left: usize,
    /// For pieces and what is noted of arrays.
    room: Room,
}

/// The number of a triangle among types of cells.
const TRIANGLE: u8 = 5;

/// Elements within each other. Files in use have six.
const DEEPEST: usize = 64;

fn attribute(tag: &BytesStart<'_>, name: &str) -> Option<String> {
    let found = tag.attributes().with_checks(false).flatten().find(|a| a.key.as_ref() == name.as_bytes())?;
    let text = String::from_utf8_lossy(&found.value);
    Some(unescape(&text).map_or_else(|_| text.to_string(), |plain| plain.into_owned()))
}

fn number(tag: &BytesStart<'_>, name: &str) -> usize {
    attribute(tag, name).and_then(|text| text.trim().parse().ok()).unwrap_or(0)
}

impl<'a> File<'a> {
    fn walk(bytes: &'a [u8], expected: Type, chosen: Option<&'a str>) -> Result<Self, DataError> {
        let (left, room) = (bytes.len(), Room::of(bytes.len()));
        let mut file = File { expected, chosen, length: Kind::U32, left, room, ..File::default() };
        if !bytes.trim_ascii_end().ends_with(b"</VTKFile>") {
            let begins = bytes.trim_ascii_start().starts_with(b"<");
            let text = "it does not end with \"</VTKFile>\"".to_owned();
            return Err(if begins { DataError::Truncated(text) } else { DataError::Header(text) });
        }
        let mut reader = Reader::from_reader(bytes);
        let (mut line, mut passed) = (1, 0);
        let mut section = Vec::new();
        let mut array: Option<(DataArray<'a>, usize)> = None;
        loop {
            let event = reader.read_event();
            let at = usize::try_from(reader.buffer_position()).unwrap_or(usize::MAX).min(bytes.len());
            line += bytes.get(passed..at).unwrap_or_default().iter().filter(|&&b| b == b'\n').count();
            passed = passed.max(at);
            let event = event.map_err(|error| syntax(line, plain(&error.to_string(), 200)))?;
            match &event {
                Event::Start(tag) | Event::Empty(tag) => {
                    let name = tag.name().as_ref().to_vec();
                    let empty = matches!(event, Event::Empty(_));
                    match name.as_slice() {
                        b"VTKFile" => file.head(tag)?,
                        b"Piece" => {
                            let cells = |of: Type, name: &str| Cells {
                                count: if of == expected { number(tag, name) } else { 0 },
                                ..Cells::default()
                            };
                            let piece = Piece {
                                points: number(tag, "NumberOfPoints"),
                                thin: number(tag, "NumberOfVerts").saturating_add(number(tag, "NumberOfLines")),
                                polygons: cells(Type::PolyData, "NumberOfPolys"),
                                strips: cells(Type::PolyData, "NumberOfStrips"),
                                grid: cells(Type::UnstructuredGrid, "NumberOfCells"),
                                ..Piece::default()
                            };
                            file.room.push(&mut file.pieces, piece)?;
                        }
                        b"PointData" => {
                            if let Some(piece) = file.pieces.last_mut() {
                                piece.normals = attribute(tag, "Normals").unwrap_or_default();
                                piece.texture = attribute(tag, "TCoords").unwrap_or_default();
                            }
                        }
                        b"DataArray" => {
                            let found = data_array(tag, line);
                            if empty { file.put(&section, found)? } else { array = Some((found, section.len())) }
                        }
                        b"Array" if file.pieces.len() == 1 => {
                            let name = attribute(tag, "Name").unwrap_or_default();
                            file.room.take(name.len())?;
                            match section.last().map(Vec::as_slice) {
                                Some(b"PointData") => file.room.push(&mut file.texts, name)?,
                                Some(b"CellData") => file.room.push(&mut file.cell_arrays, name)?,
                                _ => {}
                            }
                        }
                        b"AppendedData" if !empty => {
                            file.append(tag, &bytes[at..])?;
                            break;
                        }
                        _ => {}
                    }
                    if !empty {
                        if section.len() == DEEPEST {
                            return Err(syntax(line, format!("more than {DEEPEST} elements are open")));
                        }
                        section.push(name);
                    }
                }
                Event::End(_) => {
                    section.pop();
                    if let Some((found, _)) = array.take_if(|(_, depth)| *depth == section.len()) {
                        file.put(&section, found)?;
                    }
                }
                Event::Text(text) => {
                    if let Some((found, depth)) = &mut array
                        && *depth + 1 == section.len()
                        && let Place::Text(content) | Place::Base64(content) = &mut found.place
                        && content.trim_ascii().is_empty()
                    {
                        // A slice of the file, which outlives the event.
                        *content = &bytes[at.saturating_sub(text.len())..at];
                        found.line = line - content.iter().filter(|&&b| b == b'\n').count();
                    }
                }
                Event::Eof if !section.is_empty() => {
                    return Err(DataError::Truncated("an element is not closed".to_owned()));
                }
                Event::Eof => break,
                _ => {}
            }
        }
        if file.pieces.is_empty() {
            return Err(DataError::Header(format!("there is no element Piece of {}", expected.name())));
        }
        Ok(file)
    }

    fn head(&mut self, tag: &BytesStart<'_>) -> Result<(), DataError> {
        let is = |name: &str, value: &str| attribute(tag, name).is_some_and(|text| text == value);
        if !is("type", self.expected.name()) {
            let kind = attribute(tag, "type").unwrap_or_default();
            let other = [Type::PolyData, Type::UnstructuredGrid].into_iter().any(|known| known.name() == kind);
            let advice = match (other, self.expected) {
                (false, _) => "extract the surface first",
                (true, Type::PolyData) => "name it .vtu",
                (true, Type::UnstructuredGrid) => "name it .vtp",
            };
            let (kind, expected) = (plain(&kind, 40), self.expected.name());
            return Err(DataError::Header(format!("VTKFile is of type \"{kind}\", not {expected}; {advice}")));
        }
        if is("byte_order", "BigEndian") {
            self.order = Order::Big;
        }
        if is("header_type", "UInt64") {
            self.length = Kind::U64;
        }
        match attribute(tag, "compressor").as_deref() {
            None | Some("") => {}
            Some("vtkZLibDataCompressor") => {
                self.packed = true;
                self.left = unpacked_limit(self.left);
            }
            Some(other) => {
                let text = format!("the compressor {} is not known; write it with zlib or without", plain(other, 40));
                return Err(DataError::Header(text));
            }
        }
        Ok(())
    }

    /// Appended data: from an underscore to the end of the element.
    fn append(&mut self, tag: &BytesStart<'_>, rest: &'a [u8]) -> Result<(), DataError> {
        self.appended_raw = attribute(tag, "encoding").is_some_and(|text| text == "raw");
        let end = rest.windows(15).rposition(|window| window == b"</AppendedData>");
        let begin = rest.iter().position(|b| !b.is_ascii_whitespace()).filter(|&at| rest[at] == b'_');
        match (begin, end) {
            (Some(begin), Some(end)) if begin < end => {
                self.appended = &rest[begin + 1..end];
                Ok(())
            }
            _ => Err(DataError::Header("appended data stand between \"_\" and \"</AppendedData>\"".to_owned())),
        }
    }

    fn put(&mut self, section: &[Vec<u8>], mut found: DataArray<'a>) -> Result<(), DataError> {
        let is_first = self.pieces.len() == 1;
        let (Some(piece), Some(section)) = (self.pieces.last_mut(), section.last()) else { return Ok(()) };
        let room = &mut self.room;
        let mut boxed = |found: DataArray<'a>| room.take(size_of::<DataArray<'_>>()).map(|()| Some(Box::new(found)));
        match section.as_slice() {
            b"Points" => piece.coordinates = boxed(found)?,
            b"PointData" => {
                if !found.name.is_empty() && found.name == piece.normals {
                    found.role = Role::Normals;
                } else if !found.name.is_empty() && found.name == piece.texture {
                    found.role = Role::Texture;
                }
                self.room.take(found.name.len())?;
                self.room.push(&mut piece.arrays, found)?;
            }
            b"CellData" if self.chosen == Some(found.name.as_str()) && piece.labels.is_none() => {
                piece.labels = boxed(found)?;
            }
            b"CellData" if is_first => {
                self.room.take(found.name.len())?;
                self.room.push(&mut self.cell_arrays, found.name)?;
            }
            b"Polys" | b"Strips" | b"Cells" => {
                let cells = match section.as_slice() {
                    b"Polys" => &mut piece.polygons,
                    b"Strips" => &mut piece.strips,
                    _ => &mut piece.grid,
                };
                match found.name.as_str() {
                    "connectivity" => cells.points = boxed(found)?,
                    "offsets" => cells.offsets = boxed(found)?,
                    "types" => cells.types = boxed(found)?,
                    _ => {}
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// How many numbers an array declares, at most as many as a file of this size can hold; whether they are binary.
    fn numbers(&self, array: &DataArray<'_>) -> Option<(usize, bool)> {
        let kind = array.kind?;
        match self.source(array) {
            Ok(source) => {
                let length = self.length_of(&source).ok()?;
                (length <= self.left).then_some((length / kind.bytes(), true))
            }
            Err(text) => Some((text.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).count(), false)),
        }
    }

    /// The bytes of an array, with the length before them; its text, if it is text.
    fn source(&self, array: &DataArray<'a>) -> Result<Source<'a>, &'a [u8]> {
        match array.place {
            Place::Text(content) => Err(content),
            Place::Base64(content) => Ok(Source::base64(content)),
            Place::Unknown => Ok(Source::Raw(&[])),
            Place::Appended(offset) => {
                let data = self.appended.get(offset..).unwrap_or_default();
                Ok(if self.appended_raw { Source::Raw(data) } else { Source::Base64(data.into()) })
            }
        }
    }

    fn lengths(&self, data: &[u8]) -> Vec<usize> {
        let all = self.length.integers(data, self.order);
        all.into_iter().map(|n| usize::try_from(n).unwrap_or(usize::MAX)).collect()
    }

    fn length_of(&self, source: &Source<'_>) -> Result<usize, String> {
        let size = self.length.bytes();
        match (self.packed, self.lengths(&source.after(0, if self.packed { 3 * size } else { size })?).as_slice()) {
            (false, &[length]) => Ok(length),
            (true, &[count, block, last]) => Ok(blocks([count, block, last]).1),
            _ => Err("an array is cut off".to_owned()),
        }
    }

    fn integers(&mut self, array: &DataArray<'_>, count: Option<usize>) -> Result<Vec<i64>, DataError> {
        self.values(array, count, |c, n, k| c.integers(n, k, "cells"))
    }

    fn indices(&mut self, array: &DataArray<'_>, count: Option<usize>) -> Result<Vec<u32>, DataError> {
        self.values(array, count, |c, n, k| c.indices(n, k, "cells"))
    }

    fn values<T>(
        &mut self,
        array: &DataArray<'_>,
        count: Option<usize>,
        read: impl Fn(&mut Cursor<'_>, usize, Kind) -> Result<Vec<T>, DataError>,
    ) -> Result<Vec<T>, DataError> {
        let wrong = |message: String| syntax(array.line, message);
        let kind = array.kind.ok_or_else(|| wrong("a DataArray has no known type of numbers".to_owned()))?;
        let count = count.ok_or_else(|| wrong("there are too many numbers".to_owned()))?;
        if matches!(array.place, Place::Unknown) {
            return Err(wrong("the format of an array is not known".to_owned()));
        }
        let whole = match self.source(array) {
            Ok(source) => source,
            Err(content) => {
                return read(&mut Cursor { line: array.line, ..Cursor::new(content) }, count, kind);
            }
        };
        let bytes = count.saturating_mul(kind.bytes());
        self.spend(bytes).map_err(wrong)?;
        let data = self.data_of(whole, bytes).map_err(wrong)?;
        read(&mut Cursor { encoding: Encoding::Binary(self.order), ..Cursor::new(&data) }, count, kind)
    }

    /// Counts bytes that are made of the file's.
    fn spend(&mut self, bytes: usize) -> Result<(), String> {
        let left = self.left.checked_sub(bytes);
        self.left = left.ok_or_else(|| format!("{bytes} bytes more are more than a file of this size holds"))?;
        Ok(())
    }

    /// The data of an array that should have `bytes`, without the length before them.
    fn data_of(&mut self, source: Source<'_>, bytes: usize) -> Result<Vec<u8>, String> {
        let size = self.length.bytes();
        let differs = |n: usize| format!("an array has {n} bytes and should have {bytes}; write the file again");
        if !self.packed {
            let data = source.after(0, bytes.saturating_add(size))?;
            let (head, data) = data.split_at_checked(size).ok_or("an array is cut off")?;
            return match self.lengths(head).first() {
                Some(&n) if n == bytes && data.len() == n => Ok(data.to_vec()),
                Some(&n) => Err(differs(n)),
                None => Err("an array is cut off".to_owned()),
            };
        }
        // Packed sizes of all blocks follow.
        let head = self.lengths(&source.after(0, 3 * size)?);
        let &[count, block, last] = head.as_slice() else { return Err("an array is cut off".to_owned()) };
        let (full, whole) = blocks([count, block, last]);
        if whole != bytes {
            return Err(differs(whole));
        }
        let head_bytes = count.saturating_add(3).saturating_mul(size);
        self.spend(head_bytes)?;
        let sizes = self.lengths(source.after(0, head_bytes)?.get(3 * size..).unwrap_or_default());
        if sizes.len() != count {
            return Err("an array is cut off".to_owned());
        }
        let packed = sizes.iter().fold(0usize, |sum, &n| sum.saturating_add(n));
        self.spend(packed)?;
        let data = source.after(head_bytes, packed)?;
        let mut out = Vec::with_capacity(bytes.min(1 << 20));
        let mut rest = data.as_slice();
        for (index, &n) in sizes.iter().enumerate() {
            let (packed, after) = rest.split_at_checked(n).ok_or("an array is cut off")?;
            rest = after;
            let wanted = if index < full { block } else { last };
            let before = out.len();
            let read = ZlibDecoder::new(packed).take(wanted as u64).read_to_end(&mut out);
            if read.is_err() || out.len() - before != wanted {
                return Err(format!("block {index} of an array cannot be unpacked"));
            }
        }
        Ok(out)
    }

    /// Labels the facets of a piece, whose cells that may have some have so many each.
    fn labels(&mut self, labels: &mut Labels<i64>, piece: &Piece<'a>, cells: &[u32]) {
        let Some(array) = piece.labels.as_ref().filter(|array| array.components == 1) else {
            return labels.give_up("it has not one number for each cell".to_owned());
        };
        let count = piece.thin.checked_add(cells.len());
        let whole = |cursor: &mut Cursor<'_>, count, kind| {
            whole_numbers(cursor, count, kind, "labels").and_then(|numbers| numbers.map_err(DataError::List))
        };
        match self.values(array, count, whole) {
            // Points and lines come first.
            Ok(values) => label(labels, values.get(piece.thin..).unwrap_or_default(), cells),
            Err(error) => labels.give_up(error.to_string()),
        }
    }

    /// Reads what a piece's points carry, after `first` others; wrong arrays are left aside. Later pieces go by names.
    fn data(
        &mut self,
        arrays: &mut Vec<Array>,
        names: &mut HashMap<(String, usize), usize>,
        piece: &Piece<'a>,
        first: usize,
        soup: &mut Soup,
    ) {
        for array in &piece.arrays {
            let components = array.components;
            let key = (array.name.clone(), components);
            let known = names.get(&key).and_then(|&index| arrays.get_mut(index));
            if first > 0 && known.as_ref().is_none_or(|known| Some(known.values.len()) != first.checked_mul(components))
            {
                continue;
            }
            let count = piece.points.checked_mul(components);
            let values = self.values(array, count, |c, n, k| c.lenient(n, k, "an array"));
            match (values, known.filter(|_| first > 0)) {
                (Ok(values), Some(known)) => known.values.extend(values),
                (Err(_), Some(_)) => {}
                (Ok(values), None) => {
                    names.entry(key).or_insert(arrays.len());
                    let kind = array.kind.unwrap_or_default();
                    arrays.push(Array { name: array.name.clone(), role: array.role, components, kind, values });
                }
                (Err(error), None) => {
                    soup.raw.unreadable(&format!("array {:?}", plain(&array.name, 40)), error.to_string());
                }
            }
        }
    }
}

/// How many blocks of packed data are full, and all bytes, by the header: count, size of each but the last, of the last.
fn blocks([blocks, block, last]: [usize; 3]) -> (usize, usize) {
    let full = if last == 0 { blocks } else { blocks.saturating_sub(1) };
    (full, full.saturating_mul(block).saturating_add(if blocks > 0 { last } else { 0 }))
}

enum Source<'a> {
    Raw(&'a [u8]),
    Base64(std::borrow::Cow<'a, [u8]>),
}

impl<'a> Source<'a> {
    /// Text that may be broken into lines.
    fn base64(text: &'a [u8]) -> Self {
        if !text.iter().any(u8::is_ascii_whitespace) {
            return Self::Base64(text.into());
        }
        Self::Base64(text.iter().copied().filter(|b| !b.is_ascii_whitespace()).collect::<Vec<_>>().into())
    }

    /// Bytes after those passed, fewer where the source ends.
    fn after(&self, passed: usize, wanted: usize) -> Result<Vec<u8>, String> {
        let text = match self {
            Self::Raw(data) => {
                let data = data.get(passed..).unwrap_or_default();
                return Ok(data[..wanted.min(data.len())].to_vec());
            }
            Self::Base64(text) => text,
        };
        // Lengths are encoded by themselves or with the data after them: padding may stand inside.
        let total = passed.saturating_add(wanted);
        let (mut out, mut rest) = (Vec::new(), text.as_ref());
        while out.len() < total && !rest.is_empty() {
            let most = (total - out.len()).div_ceil(3).saturating_mul(4).min(rest.len());
            let padding = rest[..most].iter().position(|&b| b == b'=').unwrap_or(most);
            let run = padding + rest[padding..most].iter().take(2).take_while(|&&b| b == b'=').count();
            let (run, after) = rest.split_at(run);
            STANDARD.decode_vec(run, &mut out).map_err(|error| format!("base64: {error}"))?;
            rest = after;
        }
        out.truncate(total);
        out.drain(..passed.min(out.len()));
        Ok(out)
    }
}

fn data_array<'a>(tag: &BytesStart<'_>, line: usize) -> DataArray<'a> {
    let kind = attribute(tag, "type").unwrap_or_default();
    let place = match attribute(tag, "format").as_deref() {
        Some("ascii") | None => Place::Text(&[]),
        Some("binary") => Place::Base64(&[]),
        Some("appended") => Place::Appended(number(tag, "offset")),
        Some(_) => Place::Unknown,
    };
    DataArray {
        name: attribute(tag, "Name").unwrap_or_default(),
        role: Role::Any,
        kind: KINDS.iter().find(|(_, name, _)| *name == kind).map(|&(.., kind)| kind),
        components: number(tag, "NumberOfComponents").max(1),
        place,
        line,
    }
}

fn encode(mesh: &TriMesh, held: &Held<'_>, of: Type) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let arrays = written(held);
    let mut out = String::with_capacity(1024 + 32 * vertices + 44 * facets + 11 * vertices * arrays.len());
    let array = |out: &mut String, name: &str, kind: &str, components: usize, data: Vec<u8>| {
        out.push_str(&format!(
            "<DataArray type=\"{kind}\" Name=\"{}\" NumberOfComponents=\"{components}\" format=\"binary\">",
            escape(name)
        ));
        STANDARD.encode_string((data.len() as u64).to_le_bytes(), out);
        STANDARD.encode_string(data, out);
        out.push_str("</DataArray>\n");
    };
    let kind = of.name();
    let cells = match of {
        Type::PolyData => {
            format!("NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"{facets}\"")
        }
        Type::UnstructuredGrid => format!("NumberOfCells=\"{facets}\""),
    };
    out.push_str(&format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"{kind}\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n<{kind}>\n<Piece NumberOfPoints=\"{vertices}\" {cells}>\n<PointData"
    ));
    for (key, role) in [("Normals", Role::Normals), ("TCoords", Role::Texture)] {
        if let Some(array) = arrays.iter().find(|array| array.role == role) {
            out.push_str(&format!(" {key}=\"{}\"", array.name));
        }
    }
    out.push_str(">\n");
    let doubles = |numbers: &mut dyn Iterator<Item = f64>| -> Vec<u8> { numbers.flat_map(f64::to_le_bytes).collect() };
    for a in arrays {
        let mut data = Vec::with_capacity(a.kind.bytes() * a.values.len());
        a.values.iter().for_each(|&x| a.kind.put(x, Order::Little, &mut data));
        array(&mut out, &a.name, names(a.kind).1, a.components, data);
    }
    out.push_str("</PointData>\n");
    if let Some(regions) = held.regions {
        let (kind, numbers) = labels(regions);
        let mut data = Vec::with_capacity(kind.bytes() * facets);
        numbers.into_iter().for_each(|number| put_label(kind, number, false, &mut data));
        out.push_str("<CellData>\n");
        array(&mut out, ARRAY, names(kind).1, 1, data);
        out.push_str("</CellData>\n");
    }
    out.push_str("<Points>\n");
    let positions = doubles(&mut mesh.positions().iter().flat_map(|p| p.to_array()));
    array(&mut out, "Points", "Float64", 3, positions);
    let section = if of == Type::PolyData { "Polys" } else { "Cells" };
    out.push_str(&format!("</Points>\n<{section}>\n"));
    let corners = mesh.facets().as_flattened().iter().flat_map(|&v| i64::from(v).to_le_bytes()).collect();
    array(&mut out, "connectivity", "Int64", 1, corners);
    let ends = (1..=facets).flat_map(|f| (3 * f as u64).to_le_bytes()).collect();
    array(&mut out, "offsets", "Int64", 1, ends);
    if of == Type::UnstructuredGrid {
        array(&mut out, "types", "UInt8", 1, vec![TRIANGLE; facets]);
    }
    out.push_str(&format!("</{section}>\n</Piece>\n</{kind}>\n</VTKFile>"));
    Ok(out.into_bytes())
}
