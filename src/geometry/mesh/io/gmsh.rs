//! Gmsh `.msh`, versions 2.0 to 2.2 and 4.1, text and binary. Writes 2.2, binary, which most programs read.
//!
//! Purpose: bytes to triangles with the scalars of their nodes (`$NodeData`), and back. Triangles and quadrangles of higher order
//! are read by their corners; points and lines are passed over. Vertices are the nodes in the order of the file, whatever
//! their tags. Our own reader: the crate `mshio` (0.4) reads version 4.1 without data of nodes, and writes nothing.
//! Must not know: other formats.

use glam::DVec3;

use super::held::{By, Held, Holds};
use super::numbers::{Cursor, Encoding, Kind, Order, cut, shown};
use super::{Codec, Counts, DataError, Soup, VertexNumbers, volumes};
use crate::mesh::TriMesh;
use crate::mesh::attributes::Scalar;

/// See [`Codec`].
pub(super) const CODEC: Codec = Codec {
    extension: "msh",
    decode,
    encode,
    counts: |bytes| read(bytes, false, true).ok().map(|reader| reader.counts),
    holds: Holds { normals: By::None, texture: By::None, colours: false, opacity: false, scalars: true },
    vertices: VertexNumbers::Kept,
};

/// A node of version 2: its tag and coordinates.
const NODE: usize = 28;

fn decode(bytes: &[u8], wanted: bool) -> Result<Soup, DataError> {
    let Reader { mut soup, volumes: count, .. } = read(bytes, wanted, false)?;
    volumes(&mut soup, count, "mesh the surface alone (gmsh -2), or save its triangles too (Mesh.SaveAll)")?;
    Ok(soup)
}

/// Reads all sections, or how much is in them if they are counted.
fn read(bytes: &[u8], wanted: bool, counted: bool) -> Result<Reader<'_>, DataError> {
    let mut reader = Reader {
        cursor: Cursor::new(bytes),
        encoding: Encoding::Text,
        size: Kind::U64,
        is_4: false,
        wanted,
        counted,
        counts: Counts::default(),
        tags: Tags::default(),
        soup: Soup::default(),
        volumes: 0,
    };
    if reader.cursor.word() != Some(b"$MeshFormat") {
        return Err(DataError::Header("it does not begin with \"$MeshFormat\"".to_owned()));
    }
    reader.format()?;
    while let Some(word) = reader.cursor.word() {
        match word {
            b"$Nodes" if !reader.tags.given.is_empty() || reader.counts.vertices > 0 => {
                return Err(reader.cursor.syntax("$Nodes is there twice; merge them"));
            }
            b"$Nodes" if reader.is_4 => reader.nodes_4()?,
            b"$Nodes" => reader.nodes_2()?,
            b"$Elements" if reader.is_4 => reader.elements_4()?,
            b"$Elements" => reader.elements_2()?,
            b"$NodeData" => reader.node_data()?,
            _ => match word.strip_prefix(b"$") {
                Some(name) => {
                    let end = [b"$End", name].concat();
                    let at = reader.cursor.rest.windows(end.len()).position(|window| window == end);
                    let at = at.ok_or_else(|| cut(&shown(word)))?;
                    let passed = reader.cursor.take(at + end.len()).unwrap_or_default();
                    reader.cursor.line += passed.iter().filter(|&&b| b == b'\n').count();
                    continue;
                }
                None => return Err(reader.cursor.syntax(format!("\"{}\" is not the begin of a section", shown(word)))),
            },
        }
        reader.end(word)?;
    }
    Ok(reader)
}

/// The nodes of an element, and of them the corners of a face; 0 corners are a point or a line, `None` a volume.
fn element(kind: i64) -> Option<(usize, Option<usize>)> {
    Some(match kind {
        15 => (1, Some(0)),
        1 => (2, Some(0)),
        8 => (3, Some(0)),
        26 => (4, Some(0)),
        27 => (5, Some(0)),
        28 => (6, Some(0)),
        2 => (3, Some(3)),
        9 => (6, Some(3)),
        20 => (9, Some(3)),
        21 => (10, Some(3)),
        22 => (12, Some(3)),
        23 | 24 => (15, Some(3)),
        25 => (21, Some(3)),
        3 => (4, Some(4)),
        16 => (8, Some(4)),
        10 => (9, Some(4)),
        36 => (16, Some(4)),
        37 => (25, Some(4)),
        38 => (36, Some(4)),
        4 => (4, None),
        5 => (8, None),
        6 => (6, None),
        7 => (5, None),
        11 => (10, None),
        12 => (27, None),
        13 => (18, None),
        14 => (14, None),
        17 => (20, None),
        18 => (15, None),
        19 => (13, None),
        29 => (20, None),
        30 => (35, None),
        31 => (56, None),
        92 => (64, None),
        93 => (125, None),
        _ => return None,
    })
}

/// Which vertex a node's tag names.
#[derive(Default)]
struct Tags {
    given: Vec<i64>,
    /// By tag, where these are not one after the other.
    sorted: Vec<(i64, u32)>,
}

impl Tags {
    fn finish(&mut self) -> Result<(), DataError> {
        if self.given.windows(2).all(|pair| pair[0].checked_add(1) == Some(pair[1])) {
            return Ok(());
        }
        self.sorted = self.given.iter().copied().zip(0..).collect();
        self.sorted.sort_unstable();
        match self.sorted.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            None => Ok(()),
            Some(pair) => {
                let (index, message) = (pair[1].1 as usize, format!("another node has the tag {}", pair[1].0));
                Err(DataError::Element { element: "node", index, message })
            }
        }
    }

    fn vertex(&self, tag: i64) -> Option<i64> {
        if self.sorted.is_empty() {
            let at = tag.checked_sub(*self.given.first()?)?;
            return (0..self.given.len() as i64).contains(&at).then_some(at);
        }
        let at = self.sorted.binary_search_by_key(&tag, |&(tag, _)| tag).ok()?;
        Some(i64::from(self.sorted[at].1))
    }
}

struct Reader<'a> {
    cursor: Cursor<'a>,
    encoding: Encoding,
    /// Of counts and tags in version 4.
    size: Kind,
    is_4: bool,
    wanted: bool,
    /// Whether nodes and elements are passed over and added up in `counts`.
    counted: bool,
    counts: Counts,
    tags: Tags,
    soup: Soup,
    volumes: usize,
}

impl Reader<'_> {
    fn format(&mut self) -> Result<(), DataError> {
        let version: f64 = self.cursor.parsed("a version")?;
        let (kind, size): (u8, u8) = (self.cursor.parsed("0 or 1")?, self.cursor.parsed("a size of numbers")?);
        self.is_4 = version >= 4.1;
        if !(self.is_4 && version < 5.0 || (2.0..3.0).contains(&version)) {
            return Err(self.cursor.syntax(format!("version {version} is not read; save it as 4.1 or 2.2")));
        }
        self.size = match size {
            4 => Kind::U32,
            8 => Kind::U64,
            _ => return Err(self.cursor.syntax(format!("numbers of {size} bytes are not known"))),
        };
        if kind == 1 {
            self.cursor.end_line();
            let one = self.cursor.take(4).ok_or_else(|| cut("the header"))?;
            let order = if one == [0, 0, 0, 1] { Order::Big } else { Order::Little };
            self.encoding = Encoding::Binary(order);
        }
        self.end(b"$MeshFormat")
    }

    /// The end of a section.
    fn end(&mut self, section: &[u8]) -> Result<(), DataError> {
        let name = section.strip_prefix(b"$").unwrap_or(section);
        match self.cursor.word() {
            Some(word) if word.strip_prefix(b"$End") == Some(name) => Ok(()),
            Some(word) if !self.cursor.rest.is_empty() => {
                Err(self.cursor.syntax(format!("\"{}\" is not $End{}", shown(word), shown(name))))
            }
            _ => Err(cut(&shown(section))),
        }
    }

    /// A number of text in either encoding, at the end of its line.
    fn heading(&mut self, what: &str) -> Result<usize, DataError> {
        let count = self.cursor.parsed(what)?;
        if self.encoding != Encoding::Text {
            self.cursor.end_line();
        }
        Ok(count)
    }

    fn int(&mut self, what: &str) -> Result<i64, DataError> {
        self.cursor.integer(Kind::I32, self.encoding, what)
    }

    fn size(&mut self, what: &str) -> Result<usize, DataError> {
        self.cursor.count(self.size, self.encoding, what)
    }

    fn nodes_2(&mut self) -> Result<(), DataError> {
        let count = self.heading("a number of nodes")?;
        let (encoding, left) = (self.encoding, self.cursor.rest.len());
        let least = if encoding == Encoding::Text { 8 } else { NODE };
        if count.saturating_mul(least) > left + 1 {
            return Err(DataError::Truncated(format!("{count} nodes are declared and {left} bytes follow")));
        }
        match encoding {
            _ if self.counted => {
                self.counts.vertices += count as u64;
                // A node is its number and three coordinates.
                let (words, kind) = if encoding == Encoding::Text { (4, Kind::F64) } else { (NODE, Kind::U8) };
                self.cursor.lenient(count.saturating_mul(words), kind, encoding, "nodes", false)?;
            }
            Encoding::Text => {
                for _ in 0..count {
                    self.tags.given.push(self.cursor.parsed("a node's number")?);
                    let p = self.cursor.floats(3, Kind::F64, encoding, "a node")?;
                    self.soup.positions.push(DVec3::from_slice(&p));
                }
            }
            Encoding::Binary(order) => {
                let records = self.cursor.take(count.saturating_mul(NODE)).ok_or_else(|| cut("nodes"))?;
                for record in records.as_chunks::<NODE>().0 {
                    self.tags.given.extend(Kind::I32.integers(&record[..4], order));
                    self.soup.positions.push(DVec3::from_slice(&Kind::F64.floats(&record[4..], order)));
                }
            }
        }
        self.tags.finish()
    }

    fn nodes_4(&mut self) -> Result<(), DataError> {
        if self.encoding != Encoding::Text {
            self.cursor.end_line();
        }
        let blocks = self.size("a number of blocks")?;
        for _ in 0..3 {
            self.size("a number of nodes")?;
        }
        for _ in 0..blocks {
            let dimension = self.int("a dimension")?;
            self.int("an entity")?;
            let parametric = self.int("0 or 1")?;
            let count = self.size("a number of nodes")?;
            let each = 3 + if parametric == 0 { 0 } else { usize::try_from(dimension).unwrap_or(0).min(3) };
            if self.counted {
                self.cursor.lenient(count, self.size, self.encoding, "nodes", false)?;
                self.cursor.lenient(count.saturating_mul(each), Kind::F64, self.encoding, "nodes", false)?;
                self.counts.vertices += count as u64;
                continue;
            }
            let tags = self.cursor.integers(count, self.size, self.encoding, "nodes")?;
            self.tags.given.extend(tags);
            let numbers = self.cursor.floats(count.saturating_mul(each), Kind::F64, self.encoding, "nodes")?;
            self.soup.positions.extend(numbers.chunks_exact(each).map(|p| DVec3::from_slice(&p[..3])));
        }
        self.tags.finish()
    }

    /// How many nodes elements of a type have.
    fn element(&self, kind: i64) -> Result<(usize, Option<usize>), DataError> {
        element(kind).ok_or_else(|| DataError::Header(format!("elements of type {kind} are not known")))
    }

    /// Counts elements, whose numbers these are, and passes over them.
    fn count(&mut self, elements: usize, corners: Option<usize>, numbers: usize, kind: Kind) -> Result<(), DataError> {
        self.cursor.lenient(numbers, kind, self.encoding, "elements", false)?;
        self.counts.facets += elements as u64 * corners.map_or(0, |n| n.saturating_sub(2)) as u64;
        Ok(())
    }

    fn push(&mut self, index: usize, corners: Option<usize>, nodes: &[i64]) -> Result<(), DataError> {
        let wrong = |message: String| DataError::Element { element: "element", index, message };
        match corners {
            Some(0) => {}
            None => self.volumes += 1,
            Some(n) => {
                let mut vertices = [0; 4];
                for (vertex, &tag) in vertices.iter_mut().zip(&nodes[..n]) {
                    let found = self.tags.vertex(tag);
                    *vertex = found.ok_or_else(|| wrong(format!("node {tag} is named, and there is none")))?;
                }
                self.soup.push_polygon(&vertices[..n]).map_err(wrong)?;
            }
        }
        Ok(())
    }

    fn elements_2(&mut self) -> Result<(), DataError> {
        let count = self.heading("a number of elements")?;
        let mut index = 0;
        while index < count {
            // Text has a heading before each element.
            let (kind, block, tags) = if self.encoding == Encoding::Text {
                self.int("an element's number")?;
                (self.int("an element's type")?, 1, self.int("a number of tags")?)
            } else {
                let kind = self.int("an element's type")?;
                (kind, self.int("a number of elements")?, self.int("a number of tags")?)
            };
            let (nodes, corners) = self.element(kind)?;
            let (Ok(tags), Ok(block)) = (usize::try_from(tags), usize::try_from(block)) else {
                return Err(self.cursor.syntax("a number of elements or tags is negative"));
            };
            if block == 0 {
                return Err(self.cursor.syntax("a block of elements is empty"));
            }
            let head = tags.saturating_add(usize::from(self.encoding != Encoding::Text));
            let each = head.saturating_add(nodes);
            let all = block.saturating_mul(each);
            if self.counted {
                self.count(block, corners, all, Kind::I32)?;
                index = index.saturating_add(block);
                continue;
            }
            let numbers = self.cursor.integers(all, Kind::I32, self.encoding, "elements")?;
            for record in numbers.chunks_exact(each) {
                self.push(index, corners, &record[head..])?;
                index += 1;
            }
        }
        Ok(())
    }

    fn elements_4(&mut self) -> Result<(), DataError> {
        if self.encoding != Encoding::Text {
            self.cursor.end_line();
        }
        let blocks = self.size("a number of blocks")?;
        for _ in 0..3 {
            self.size("a number of elements")?;
        }
        let mut index = 0;
        for _ in 0..blocks {
            self.int("a dimension")?;
            self.int("an entity")?;
            let kind = self.int("an element's type")?;
            let count = self.size("a number of elements")?;
            let (nodes, corners) = self.element(kind)?;
            let all = count.saturating_mul(nodes + 1);
            if self.counted {
                self.count(count, corners, all, self.size)?;
                continue;
            }
            let numbers = self.cursor.integers(all, self.size, self.encoding, "elements")?;
            for record in numbers.chunks_exact(nodes + 1) {
                self.push(index, corners, &record[1..])?;
                index += 1;
            }
        }
        Ok(())
    }

    /// A number for each node is a scalar.
    fn node_data(&mut self) -> Result<(), DataError> {
        let mut name = String::new();
        for k in 0..self.cursor.parsed::<usize>("a number of names")? {
            self.cursor.pass_blank();
            if self.cursor.rest.is_empty() {
                return Err(cut("$NodeData"));
            }
            let line = self.cursor.end_line();
            if k == 0 {
                name = String::from_utf8_lossy(line).trim_matches('"').to_owned();
            }
        }
        for _ in 0..self.cursor.parsed::<usize>("a number of times")? {
            self.cursor.word().ok_or_else(|| cut("$NodeData"))?;
        }
        let mut told = [0usize; 3];
        for k in 0..self.cursor.parsed::<usize>("a number of whole numbers")? {
            let number = self.cursor.parsed("a whole number")?;
            if let Some(told) = told.get_mut(k) {
                *told = number;
            }
        }
        let [_, components, count] = told;
        if self.encoding != Encoding::Text {
            self.cursor.end_line();
        }
        let keep = self.wanted && components == 1 && count == self.soup.positions.len();
        let mut values = vec![f64::NAN; if keep { count } else { 0 }];
        let (encoding, left) = (self.encoding, self.cursor.rest.len());
        // A row has a digit at least.
        if count > left {
            return Err(DataError::Truncated(format!("{count} nodes with data are declared and {left} bytes follow")));
        }
        for _ in 0..count {
            let tag = self.cursor.integer(Kind::I32, encoding, "a node")?;
            let row = self.cursor.lenient(components, Kind::F64, encoding, "$NodeData", keep)?;
            let vertex = self.tags.vertex(tag).and_then(|v| values.get_mut(v as usize));
            if let (Some(value), Some(&number)) = (vertex, row.first()) {
                *value = number;
            }
        }
        if keep {
            self.soup.raw.scalars.push(Scalar { name, values });
        } else if self.wanted {
            let text = "a surface carries a number for every node, and nothing else of a Gmsh file".to_owned();
            self.soup.raw.unreadable(&format!("$NodeData {:?}", shown(name.as_bytes())), text);
        }
        Ok(())
    }
}

fn encode(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let mut out = Vec::with_capacity(256 + NODE * vertices + 24 * facets + 12 * vertices * held.scalars.len());
    let int = |out: &mut Vec<u8>, n: u32| out.extend_from_slice(&n.to_le_bytes());
    out.extend_from_slice(b"$MeshFormat\n2.2 1 8\n");
    int(&mut out, 1);
    out.extend_from_slice(format!("\n$EndMeshFormat\n$Nodes\n{vertices}\n").as_bytes());
    for (tag, p) in (1..).zip(mesh.positions()) {
        int(&mut out, tag);
        p.to_array().iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
    }
    out.extend_from_slice(format!("\n$EndNodes\n$Elements\n{facets}\n").as_bytes());
    // Triangles, all in one block, with two tags each: of the physical group and of the part of the model.
    [2, facets as u32, 2].iter().for_each(|&n| int(&mut out, n));
    for (tag, facet) in (1..).zip(mesh.facets()) {
        [tag, 1, 1].iter().for_each(|&n| int(&mut out, n));
        facet.iter().for_each(|v| int(&mut out, v + 1));
    }
    out.extend_from_slice(b"\n$EndElements");
    for scalar in held.scalars {
        // A name, a time, and three numbers: the step, how many numbers a node has, how many nodes.
        let head = format!("\n$NodeData\n1\n\"{}\"\n1\n0\n3\n0\n1\n{vertices}\n", scalar.name);
        out.extend_from_slice(head.as_bytes());
        for (tag, value) in (1..).zip(&scalar.values) {
            int(&mut out, tag);
            out.extend_from_slice(&value.to_le_bytes());
        }
        out.extend_from_slice(b"\n$EndNodeData");
    }
    Ok(out)
}
