//! Legacy VTK, text and big-endian, versions 1 to 5.1: polygonal data, unstructured grids. Writes 4.2, binary, with doubles.
//!
//! Purpose: bytes to triangles with what the points carry, section by section, and back. Our own reader: the crate `vtkio`
//! (0.6) does not know the cells of version 5, which all VTK writes now. Must not know: XML.

use glam::DVec3;

use super::{
    Array, Cell, KINDS, ON_POINTS, Role, SURFACE_FIRST, carried, facets, label, labels, names, push_cells, put_label,
    written,
};
use crate::mesh::TriMesh;
use crate::mesh::io::held::{By, Held, Holds, Labelled, Raw};
use crate::mesh::io::numbers::{Cursor, Encoding, Kind, Order, cut, parse, plain, shown};
use crate::mesh::io::regions::{ARRAY, Labels, whole_numbers};
use crate::mesh::io::{Codec, Counts, DataError, RegionChoice, Soup, VertexNumbers, Wanted};

pub(in crate::mesh::io) const CODEC: Codec = Codec {
    extension: "vtk",
    media_types: &["application/x-vtk", "model/vtk", "model/x-vtk"],
    // Half a vertex of three floats, and a face of four numbers.
    facet_bytes: 22,
    signature: crate::mesh::io::packed::Signature::Start(|head| head.text().starts_with(b"# vtk DataFile")),
    decode: |bytes, wanted| read(bytes, wanted, false).map(|(soup, _)| soup),
    encode,
    counts: |bytes| read(bytes, None, true).ok().map(|(_, counts)| counts),
    holds: Holds {
        normals: By::Vertex,
        texture: By::Vertex,
        colours: true,
        opacity: true,
        scalars: true,
        regions: Labelled::Number,
    },
    vertices: VertexNumbers::Kept,
};

/// Reads all sections; if they are counted, how much is in them alone.
fn read(bytes: &[u8], wanted: Wanted<'_>, counted: bool) -> Result<(Soup, Counts), DataError> {
    let mut cursor = Cursor::new(bytes);
    if !cursor.end_line().starts_with(b"# vtk DataFile Version") {
        return Err(DataError::Header("it does not begin with \"# vtk DataFile Version\"".to_owned()));
    }
    // The title.
    cursor.end_line();
    cursor.encoding = match cursor.word().ok_or_else(|| cut("the header"))? {
        word if word.eq_ignore_ascii_case(b"ASCII") => Encoding::Text,
        word if word.eq_ignore_ascii_case(b"BINARY") => Encoding::Binary(Order::Big),
        word => return Err(cursor.syntax(format!("\"{}\" is not ASCII or BINARY", shown(word)))),
    };
    let chosen = wanted.and_then(RegionChoice::of_cells);
    let wanted = wanted.is_some();
    let mut reader = Reader { cursor, wanted, chosen, counted, ..Reader::default() };
    reader.soup.cells = chosen.map(|_| Vec::new());
    let mut counts = Counts::default();
    let (mut cells, mut thin) = (None, 0);
    let mut kinds = Vec::new();
    while let Some(word) = reader.cursor.word() {
        let keyword = word.to_ascii_uppercase();
        match keyword.as_slice() {
            b"DATASET" => {
                let kind = reader.cursor.word().ok_or_else(|| cut("the header"))?;
                if !(kind.eq_ignore_ascii_case(b"POLYDATA") || kind.eq_ignore_ascii_case(b"UNSTRUCTURED_GRID")) {
                    let text = "is not POLYDATA or UNSTRUCTURED_GRID; extract the surface first";
                    return Err(reader.cursor.syntax(format!("DATASET {} {text}", shown(kind))));
                }
            }
            b"POINTS" => counts.vertices = counts.vertices.max(reader.points()?),
            b"VERTICES" | b"LINES" => {
                let cells = reader.lists()?.0.len();
                thin += cells;
                reader.end_section(if keyword == b"VERTICES" { 0 } else { 1 }, cells);
            }
            b"POLYGONS" | b"TRIANGLE_STRIPS" => {
                let cell = |_: usize| if keyword == b"POLYGONS" { Cell::Polygon } else { Cell::Strip };
                let (ends, points) = reader.lists()?;
                match counted {
                    true => counts.facets += facets(cell, &ends),
                    false => _ = push_cells(&mut reader.soup, cell, &ends, &points)?,
                }
                reader.end_section(if keyword == b"POLYGONS" { 2 } else { 3 }, 0);
            }
            b"CELLS" => cells = Some(reader.lists()?),
            b"CELL_TYPES" => {
                let count = reader.count("a number of cells")?;
                reader.cursor.begin_data();
                kinds = reader.cursor.integers(count, Kind::I32, "types of cells")?;
            }
            b"FIELD" => reader.field(false)?,
            b"METADATA" => reader.metadata(),
            b"POINT_DATA" | b"CELL_DATA" => {
                match reader.data(&keyword) {
                    // The length of what follows is not known.
                    Err(error @ DataError::Syntax { .. }) => {
                        reader.left.unreadable("the rest of the data of points and cells", error.to_string());
                    }
                    read => read?,
                }
                break;
            }
            _ => return Err(reader.cursor.syntax(format!("\"{}\" is no section of a surface", shown(word)))),
        }
    }
    let Reader { mut soup, arrays, left, numbers, sections, labels, names, .. } = reader;
    counts.made_bytes = numbers.saturating_mul(16);
    if let (Some((ends, _)), true) = (&cells, counted) {
        counts.facets += facets(|index| kinds.get(index).map_or(Cell::Less, |&kind| Cell::of(kind)), ends);
    } else if let Some((ends, points)) = cells {
        grid(&mut soup, &ends, &points, &kinds)?;
    }
    if let Some((name, values)) = chosen.zip(labels) {
        let of_grid = soup.cells.take().unwrap_or_default();
        let sections = if of_grid.is_empty() { sections } else { vec![(0, of_grid)] };
        soup.raw.regions =
            Some(regions(&sections, values).numbered(format!("values of the array {:?}", plain(name, 40))));
    }
    carried(arrays, &mut soup);
    if wanted {
        soup.raw.elements("points and lines", thin);
    }
    soup.raw.arrays = names;
    soup.raw.unreadable.extend(left.unreadable);
    soup.raw.more += left.more;
    Ok((soup, counts))
}

/// Labels of facets, in their order, by the values of all cells.
fn regions(sections: &[(u8, Vec<u32>)], values: Result<Vec<i64>, String>) -> Labels<i64> {
    let mut all = Labels::default();
    let count: usize = sections.iter().map(|(_, cells)| cells.len()).sum();
    match values {
        Err(reason) => all.give_up(reason),
        Ok(values) if values.len() != count => {
            all.give_up(format!("there are {} for {count} cells", values.len()));
        }
        Ok(values) => {
            for (index, (rank, cells)) in sections.iter().enumerate() {
                let is_before = |(other, (of, _)): &(usize, &(u8, Vec<u32>))| (*of, *other) < (*rank, index);
                let before = sections.iter().enumerate().filter(is_before).map(|(_, (_, cells))| cells.len()).sum();
                label(&mut all, values.get(before..).unwrap_or_default(), cells);
            }
        }
    }
    all
}

fn grid(soup: &mut Soup, ends: &[i64], points: &[u32], kinds: &[i64]) -> Result<(), DataError> {
    if kinds.len() != ends.len() {
        return Err(DataError::Truncated(format!("there are {} cells and {} types of cells", ends.len(), kinds.len())));
    }
    push_cells(soup, |index| Cell::of(kinds[index]), ends, points)?.leave(soup, SURFACE_FIRST)
}

#[derive(Default)]
struct Reader<'a> {
    cursor: Cursor<'a>,
    wanted: bool,
    /// The array of cells that gives regions, its values or what is wrong with them, and the names of all.
    chosen: Option<&'a str>,
    labels: Option<Result<Vec<i64>, String>>,
    names: Vec<String>,
    /// How many facets the cells of each section have, if an array is chosen. Values of cells are in the order of the first
    /// numbers: points, lines, polygons, strips.
    sections: Vec<(u8, Vec<u32>)>,
    /// Whether points are passed over.
    counted: bool,
    soup: Soup,
    arrays: Vec<Array>,
    left: Raw,
    /// Whether data are those of cells.
    of_cells: bool,
    /// Numbers of all cells.
    numbers: u64,
}

/// A type of numbers, or one that is passed over.
#[derive(Clone, Copy)]
enum Type {
    Numbers(Kind),
    Bits,
    Strings,
    /// Two words each, in binary files too.
    Variants,
    /// A word each in files of text; of unknown length in others.
    Unknown,
}

impl Reader<'_> {
    /// Ends a section of cells, of which so many have no facets beside those that were pushed.
    fn end_section(&mut self, rank: u8, more: usize) {
        if let Some(cells) = &mut self.soup.cells {
            let mut cells = std::mem::take(cells);
            cells.resize(cells.len() + more, 0);
            self.sections.push((rank, cells));
        }
    }

    fn count(&mut self, what: &str) -> Result<usize, DataError> {
        self.cursor.parsed(what)
    }

    fn kind(&mut self) -> Result<Type, DataError> {
        let word = self.cursor.word().ok_or_else(|| cut("a header"))?.to_ascii_lowercase();
        Ok(match word.as_slice() {
            b"bit" => Type::Bits,
            b"string" | b"utf8_string" => Type::Strings,
            b"variant" => Type::Variants,
            other => match KINDS.iter().find(|(names, ..)| names.iter().any(|name| name.as_bytes() == other)) {
                Some(&(.., kind)) => Type::Numbers(kind),
                None if self.cursor.encoding == Encoding::Text => Type::Unknown,
                None => return Err(self.cursor.syntax(format!("\"{}\" is no type of numbers", shown(&word)))),
            },
        })
    }

    /// Reads the points, or passes over them; gives how many there are.
    fn points(&mut self) -> Result<u64, DataError> {
        let count = self.count("a number of points")?;
        let Type::Numbers(kind) = self.kind()? else {
            return Err(self.cursor.syntax("coordinates are numbers"));
        };
        self.cursor.begin_data();
        let all = count.saturating_mul(3);
        if self.counted {
            self.cursor.pass(all, kind, "points")?;
        } else {
            let numbers = self.cursor.floats(all, kind, "points")?;
            self.soup.positions = numbers.as_chunks::<3>().0.iter().map(|&p| DVec3::from_array(p)).collect();
        }
        Ok(count as u64)
    }

    /// Lists of points: where each of them ends, and the points of all, unless they are counted.
    fn lists(&mut self) -> Result<(Vec<i64>, Vec<u32>), DataError> {
        let (count, size) = (self.count("a number of cells")?, self.count("a size")?);
        self.numbers = self.numbers.saturating_add(size as u64);
        if !self.cursor.peek().is_some_and(|word| word.eq_ignore_ascii_case(b"OFFSETS")) {
            // The length of each list before it. A line's end may also be part of what follows, if this is binary.
            self.cursor.begin_data();
            if self.counted {
                return Ok((self.ends(count, size)?, Vec::new()));
            }
            let mut numbers = self.cursor.indices(size, Kind::I32, "cells")?;
            // Points move to the front, over the lengths.
            let (mut ends, mut passed, mut end) = (Vec::with_capacity(count.min(size)), 0, 0);
            for index in 0..count {
                let length = numbers.get(passed).and_then(|&length| usize::try_from(length).ok());
                let list = length.map(|length| passed + 1..(passed + 1).saturating_add(length));
                let message = || format!("it does not fit the {size} numbers that are declared for all cells");
                let list = list.filter(|list| list.end <= numbers.len()).ok_or_else(|| DataError::Element {
                    element: "cell",
                    index,
                    message: message(),
                })?;
                passed = list.end;
                let length = list.len();
                numbers.copy_within(list, end);
                end += length;
                ends.push(end as i64);
            }
            numbers.truncate(end);
            return Ok((ends, numbers));
        }
        let begin = |reader: &mut Self, name: &[u8]| -> Result<Kind, DataError> {
            let word = reader.cursor.word().ok_or_else(|| cut("cells"))?;
            if !word.eq_ignore_ascii_case(name) {
                return Err(reader.cursor.syntax(format!("\"{}\" is not {}", shown(word), shown(name))));
            }
            let Type::Numbers(kind) = reader.kind()? else {
                return Err(reader.cursor.syntax("points of cells are whole numbers"));
            };
            reader.cursor.begin_data();
            Ok(kind)
        };
        let kind = begin(self, b"OFFSETS")?;
        let mut offsets = self.cursor.integers(count, kind, "cells")?;
        let kind = begin(self, b"CONNECTIVITY")?;
        let points = match self.counted {
            true => self.cursor.pass(size, kind, "cells").map(|()| Vec::new()),
            false => self.cursor.indices(size, kind, "cells"),
        }?;
        // The first is where the first list begins.
        offsets.drain(..offsets.len().min(1));
        Ok((offsets, points))
    }

    /// Where lists end that have their lengths before them: `count` lists, `size` numbers in all.
    fn ends(&mut self, count: usize, size: usize) -> Result<Vec<i64>, DataError> {
        // A list has two bytes at least.
        let mut ends = Vec::with_capacity(count.min(self.cursor.rest.len() / 2 + 1));
        let (mut end, mut left) = (0i64, size);
        for _ in 0..count {
            let length = self.cursor.count(Kind::I32, "a number of points")?;
            let rest = left.checked_sub(1).and_then(|left| left.checked_sub(length));
            left = rest.ok_or_else(|| cut("cells"))?;
            self.cursor.pass(length, Kind::I32, "cells")?;
            end += length as i64;
            ends.push(end);
        }
        // Numbers that belong to no list.
        self.cursor.pass(left, Kind::I32, "cells")?;
        Ok(ends)
    }

    /// Passes over lines to an empty one.
    fn metadata(&mut self) {
        self.cursor.end_line();
        while !self.cursor.end_line().is_empty() {}
    }

    /// Reads the data after the word `POINT_DATA` or `CELL_DATA`, which is given. An unknown word ends them.
    fn data(&mut self, first: &[u8]) -> Result<(), DataError> {
        let mut keyword = first.to_vec();
        let (mut tuples, mut keep) = (0, false);
        loop {
            match keyword.as_slice() {
                b"POINT_DATA" | b"CELL_DATA" => {
                    tuples = self.count("a number of points or cells")?;
                    keep = keyword == b"POINT_DATA";
                    self.of_cells = !keep;
                }
                b"METADATA" => self.metadata(),
                b"FIELD" => self.field(keep)?,
                b"LOOKUP_TABLE" => {
                    let (name, tuples) = (self.name()?, self.count("a size")?);
                    self.cursor.end_line();
                    let kind = self.byte_or_fraction();
                    self.array(name, Role::None, (4, tuples), kind, false)?;
                }
                _ => {
                    if !self.attribute(&keyword, tuples, keep)? {
                        let text = format!("\"{}\" in line {} is not known", shown(&keyword), self.cursor.line);
                        self.left.unreadable("data of points", text);
                        return Ok(());
                    }
                }
            }
            let Some(word) = self.cursor.word() else { return Ok(()) };
            keyword = word.to_ascii_uppercase();
        }
    }

    /// Reads an array of points or cells after its keyword. Whether that is known.
    fn attribute(&mut self, keyword: &[u8], tuples: usize, keep: bool) -> Result<bool, DataError> {
        let (role, mut components) = match keyword {
            b"SCALARS" => (Role::Any, 1),
            b"COLOR_SCALARS" => (Role::Colours, 0),
            b"TEXTURE_COORDINATES" => (Role::Texture, 0),
            b"NORMALS" => (Role::Normals, 3),
            b"VECTORS" => (Role::Any, 3),
            b"TENSORS" => (Role::Any, 9),
            b"TENSORS6" => (Role::Any, 6),
            b"GLOBAL_IDS" | b"PEDIGREE_IDS" => {
                if self.wanted && !self.of_cells {
                    self.left.unreadable(&shown(keyword), "points of the result have no such numbers".to_owned());
                }
                (Role::None, 1)
            }
            _ => return Ok(false),
        };
        let name = self.name()?;
        if components == 0 {
            components = self.count("a number of components")?;
        }
        let kind = if role == Role::Colours { self.byte_or_fraction() } else { self.kind()? };
        let rest = self.cursor.end_line();
        if keyword == b"SCALARS" {
            components = parse(rest).unwrap_or(1);
            if self.cursor.peek().is_some_and(|word| word.eq_ignore_ascii_case(b"LOOKUP_TABLE")) {
                self.cursor.word();
                self.cursor.end_line();
            }
        }
        self.array(name, role, (components, tuples), kind, keep).map(|()| true)
    }

    fn name(&mut self) -> Result<String, DataError> {
        let word = self.cursor.word().ok_or_else(|| cut("a header"))?;
        Ok(String::from_utf8_lossy(&percent_decode(word)).into_owned())
    }

    /// Colours are bytes in binary files, and fractions in text.
    fn byte_or_fraction(&self) -> Type {
        Type::Numbers(if self.cursor.encoding == Encoding::Text { Kind::F32 } else { Kind::U8 })
    }

    fn field(&mut self, keep: bool) -> Result<(), DataError> {
        self.name()?;
        for _ in 0..self.count("a number of arrays")? {
            let mut name = self.name()?;
            // Metadata of the array before. An array may have this name.
            while name == "METADATA" && self.cursor.clone().end_line().is_empty() {
                self.metadata();
                name = self.name()?;
            }
            let (components, tuples) = (self.count("a number of components")?, self.count("a number of points")?);
            let kind = self.kind()?;
            self.cursor.end_line();
            self.array(name, Role::Any, (components, tuples), kind, keep)?;
        }
        Ok(())
    }

    fn array(
        &mut self,
        name: String,
        role: Role,
        (components, tuples): (usize, usize),
        kind: Type,
        keep: bool,
    ) -> Result<(), DataError> {
        let total = components.saturating_mul(tuples);
        let what = || format!("the array {:?}", shown(name.as_bytes()));
        let is_text = self.cursor.encoding == Encoding::Text;
        let is_kept = keep && self.wanted;
        let is_label = self.chosen.is_some() && self.of_cells && components == 1 && role != Role::None;
        if is_label && let Type::Numbers(kind) = kind {
            if self.chosen == Some(name.as_str()) && self.labels.is_none() {
                self.labels = Some(whole_numbers(&mut self.cursor, total, kind, &what())?);
                return Ok(());
            }
            self.names.push(name.clone());
        }
        match kind {
            Type::Numbers(kind) if is_kept => {
                let values = self.cursor.lenient(total, kind, &what())?;
                self.arrays.push(Array { name, role, components, kind, values });
                return Ok(());
            }
            Type::Numbers(kind) => self.cursor.pass(total, kind, &what())?,
            Type::Bits if is_text && is_kept => {
                let values = self.cursor.lenient(total, Kind::U8, &what())?;
                self.arrays.push(Array { name, role, components, kind: Kind::I8, values });
                return Ok(());
            }
            Type::Bits if !is_text => drop(self.cursor.take(total.div_ceil(8)).ok_or_else(|| cut(&what()))?),
            Type::Bits | Type::Unknown => self.cursor.pass(total, Kind::U8, &what())?,
            Type::Variants => {
                for _ in 0..total {
                    self.cursor.word().and_then(|_| self.cursor.word()).ok_or_else(|| cut(&what()))?;
                }
            }
            Type::Strings => {
                for _ in 0..total {
                    let passed = match is_text {
                        true => (!self.cursor.rest.is_empty()).then(|| _ = self.cursor.end_line()),
                        false => self.string(),
                    };
                    passed.ok_or_else(|| cut(&what()))?;
                }
            }
        }
        if self.wanted && role != Role::None {
            let array = format!("array {:?}", plain(&name, 40));
            match (is_kept, self.of_cells) {
                (true, _) => self.left.unreadable(&array, "its values are no numbers".to_owned()),
                (false, true) => self.left.unreadable(&format!("cell {array}"), ON_POINTS.to_owned()),
                // Fields of the whole file.
                (false, false) => {}
            }
        }
        Ok(())
    }

    /// Passes over a string of a binary file. Its first two bits give the size of its length.
    fn string(&mut self) -> Option<()> {
        let bytes = 1usize << (3 - (self.cursor.rest.first()? >> 6));
        let length = self.cursor.take(bytes)?.iter().fold(0u64, |sum, &b| sum << 8 | u64::from(b));
        let most = (1u64 << (8 * bytes - 2)) - 1;
        self.cursor.take(usize::try_from(length & most).ok()?).map(|_| ())
    }
}

/// A name as legacy files have it: other characters than visible ASCII are `%` and two hexadecimal digits for each byte.
fn percent_encode(name: &str) -> String {
    let byte = |b: u8| match b {
        b'!'..=b'~' if !matches!(b, b'"' | b'%') => char::from(b).to_string(),
        _ => format!("%{b:02X}"),
    };
    name.bytes().map(byte).collect()
}

fn percent_decode(word: &[u8]) -> Vec<u8> {
    let (mut name, mut rest) = (Vec::with_capacity(word.len()), word);
    while let [first, after @ ..] = rest {
        let hex = after.get(..2).filter(|_| *first == b'%').and_then(|hex| std::str::from_utf8(hex).ok());
        let byte = hex.and_then(|hex| u8::from_str_radix(hex, 16).ok());
        name.push(byte.unwrap_or(*first));
        rest = if byte.is_some() { &after[2..] } else { after };
    }
    name
}

fn encode(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let arrays = written(held);
    let mut out = Vec::with_capacity(256 + 24 * vertices + 16 * facets + 8 * vertices * arrays.len());
    let line = |out: &mut Vec<u8>, text: String| out.extend_from_slice(text.as_bytes());
    let head = "# vtk DataFile Version 4.2\nsurface\nBINARY\nDATASET POLYDATA";
    line(&mut out, format!("{head}\nPOINTS {vertices} double\n"));
    mesh.positions().iter().flat_map(|p| p.to_array()).for_each(|x| out.extend_from_slice(&x.to_be_bytes()));
    line(&mut out, format!("\nPOLYGONS {facets} {}\n", 4 * facets));
    for facet in mesh.facets() {
        [3, facet[0], facet[1], facet[2]].iter().for_each(|v| out.extend_from_slice(&v.to_be_bytes()));
    }
    if let Some(regions) = held.regions {
        let (kind, numbers) = labels(regions);
        let head = format!("\nCELL_DATA {facets}\nFIELD FieldData 1\n{ARRAY} 1 {facets} {}\n", names(kind).0);
        line(&mut out, head);
        numbers.into_iter().for_each(|number| put_label(kind, number, true, &mut out));
    }
    if !arrays.is_empty() {
        line(&mut out, format!("\nPOINT_DATA {vertices}"));
    }
    let fields = |array: &Array| array.role == Role::Any || array.role == Role::Colours && array.kind != Kind::U8;
    let in_field = arrays.iter().filter(|a| fields(a)).count();
    let others = arrays.iter().filter(|a| !fields(a));
    for (index, array) in others.chain(arrays.iter().filter(|a| fields(a))).enumerate() {
        let (name, n) = (percent_encode(&array.name), array.components);
        if index == arrays.len() - in_field {
            line(&mut out, format!("\nFIELD FieldData {in_field}"));
        }
        let head = match array.role {
            _ if fields(array) => format!("{name} {n} {vertices} {}", names(array.kind).0),
            Role::Normals => format!("NORMALS {name} double"),
            Role::Texture => format!("TEXTURE_COORDINATES {name} {n} double"),
            _ => format!("COLOR_SCALARS {name} {n}"),
        };
        line(&mut out, format!("\n{head}\n"));
        array.values.iter().for_each(|&x| array.kind.put(x, Order::Big, &mut out));
    }
    Ok(out)
}
