//! Gmsh `.msh`, versions 2.0 to 2.2 and 4.1, text and binary. Writes 2.2, binary, which most programs read.
//!
//! Purpose: bytes to triangles with the scalars of their nodes (`$NodeData`), and back. Triangles and quadrangles of higher order
//! are read by their corners; points and lines are passed over, and so are unknown sections. Vertices are the nodes in the order of the file, whatever
//! their tags. Our own reader: the crate `mshio` (0.4) reads version 4.1 without data of nodes, and writes nothing.
//! Must not know: other formats.

use std::collections::HashMap;
use std::ops::RangeInclusive;

use glam::DVec3;

use super::held::{By, Held, Holds, Labelled};
use super::numbers::{Cursor, Encoding, Kind, Order, cut, shown};
use super::regions::{self, Labels, numbers};
use super::{Codec, Counts, DataError, Others, Soup, VertexNumbers};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{MAX_COMPONENTS, Scalar};
use crate::mesh::regions::{MAX_REGIONS, Region};

pub(super) const CODEC: Codec = Codec {
    extension: "msh",
    media_types: &["application/x-gmsh", "model/gmsh", "model/x-gmsh"],
    // Half a node of three doubles and its number, and an element of three nodes with its own and its tags.
    facet_bytes: 30,
    signature: super::packed::Signature::Words(&["$MeshFormat"]),
    decode: |bytes, wanted| decode(bytes, wanted.is_some()),
    encode,
    counts: |bytes| read(bytes, false, true).ok().map(|reader| reader.counts),
    holds: Holds {
        normals: By::None,
        texture: By::None,
        colours: false,
        opacity: false,
        scalars: true,
        regions: Labelled::Name,
    },
    vertices: VertexNumbers::Kept,
};

/// A node of version 2: its tag and coordinates.
const NODE: usize = 28;

fn decode(bytes: &[u8], wanted: bool) -> Result<Soup, DataError> {
    let Reader { mut soup, others, groups, parts, names, .. } = read(bytes, wanted, false)?;
    soup.raw.regions = Some(match groups.count() {
        ..=1 => parts.numbered("parts of the model"),
        _ => groups.finish("physical groups", |number, _| {
            let name = names.get(&number).map_or_else(String::new, |name| regions::name(name));
            Region { number, name }
        }),
    });
    others.leave(&mut soup, "mesh the surface alone (gmsh -2), or save its triangles too (Mesh.SaveAll)")?;
    Ok(soup)
}

/// Reads all sections, or how much is in them if they are counted.
fn read(bytes: &[u8], wanted: bool, counted: bool) -> Result<Reader<'_>, DataError> {
    let mut reader = Reader { cursor: Cursor::new(bytes), wanted, counted, ..Reader::default() };
    if reader.cursor.word() != Some(b"$MeshFormat") {
        return Err(DataError::Header("it does not begin with \"$MeshFormat\"".to_owned()));
    }
    reader.format()?;
    while let Some(word) = reader.cursor.word() {
        match word {
            b"$Nodes" | b"$ParametricNodes" if !reader.tags.given.is_empty() || reader.counts.vertices > 0 => {
                return Err(reader.cursor.syntax("$Nodes is there twice; merge them"));
            }
            b"$Nodes" | b"$ParametricNodes" if reader.is_4 => reader.nodes_4()?,
            b"$Nodes" => reader.nodes_2(false)?,
            b"$ParametricNodes" => reader.nodes_2(true)?,
            b"$Elements" if reader.is_4 => reader.elements_4()?,
            b"$Elements" => reader.elements_2()?,
            b"$NodeData" => {
                // What cannot be read of data is left aside.
                let begin = (reader.cursor.rest, reader.cursor.line);
                let read = reader.node_data().and_then(|()| reader.end(word));
                if let Err(error) = read {
                    (reader.cursor.rest, reader.cursor.line) = begin;
                    reader.pass_section(word, b"NodeData")?;
                    if wanted {
                        reader.soup.raw.unreadable("$NodeData", error.to_string());
                    }
                }
                continue;
            }
            b"$PhysicalNames" | b"$Entities" if wanted => {
                // Both say what labels mean, and no more: what is wrong with them is left aside.
                let mut section = reader.cursor.clone();
                reader.pass_section(word, word.get(1..).unwrap_or_default())?;
                section.rest = &section.rest[..section.rest.len() - reader.cursor.rest.len()];
                let after = std::mem::replace(&mut reader.cursor, section);
                let read = if word == b"$Entities" { reader.entities() } else { reader.physical_names() };
                reader.cursor = after;
                if let Err(error) = read {
                    reader.soup.raw.unreadable(&shown(word), error.to_string());
                }
                continue;
            }
            _ => {
                let Some(name) = word.strip_prefix(b"$") else {
                    let text = format!("\"{}\" is not the begin of a section", shown(word));
                    return Err(reader.cursor.syntax(text));
                };
                reader.pass_section(word, name)?;
                if wanted && matches!(name, b"ElementData" | b"ElementNodeData") {
                    let text = "a surface carries numbers of nodes".to_owned();
                    reader.soup.raw.unreadable(&shown(word), text);
                }
                continue;
            }
        }
        reader.end(word)?;
    }
    Ok(reader)
}

/// Nodes of the elements of the types 0 to 31.
const NODES: [usize; 32] =
    [0, 2, 3, 4, 4, 8, 6, 5, 3, 6, 9, 10, 27, 18, 14, 1, 8, 20, 15, 13, 9, 10, 12, 15, 15, 21, 4, 5, 6, 20, 35, 56];

/// The nodes of an element, and of them the corners of a face; 0 corners are a point or a line, `None` a volume.
fn element(kind: i64) -> Option<(usize, Option<usize>)> {
    let nodes = match kind {
        1..=31 => NODES[kind as usize],
        36 => 16,
        37 => 25,
        38 => 36,
        92 => 64,
        93 => 125,
        _ => return None,
    };
    let corners = match kind {
        15 | 1 | 8 | 26..=28 => Some(0),
        2 | 9 | 20..=25 => Some(3),
        3 | 10 | 16 | 36..=38 => Some(4),
        _ => None,
    };
    Some((nodes, corners))
}

/// Which vertex a node's tag names.
#[derive(Default)]
struct Tags {
    given: Vec<i64>,
    /// Sorted by tag, if tags are not consecutive.
    sorted: Vec<(i64, u32)>,
}

impl Tags {
    fn finish(&mut self) -> Result<(), DataError> {
        if self.given.windows(2).all(|pair| pair[0].checked_add(1) == Some(pair[1])) {
            return Ok(());
        }
        self.sorted = self.given.iter().copied().zip(0..).collect();
        self.sorted.sort_unstable();
        let Some(pair) = self.sorted.windows(2).find(|pair| pair[0].0 == pair[1].0) else { return Ok(()) };
        let (index, message) = (pair[1].1 as usize, format!("another node has the tag {}", pair[1].0));
        Err(DataError::Element { element: "node", index, message })
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

#[derive(Default)]
struct Reader<'a> {
    cursor: Cursor<'a>,
    /// Type of counts and tags in version 4.
    size: Kind,
    is_4: bool,
    wanted: bool,
    /// Whether elements of an unknown type were left aside.
    has_unknown: bool,
    /// Whether nodes and elements are passed over and added up in `counts`.
    counted: bool,
    counts: Counts,
    tags: Tags,
    soup: Soup,
    others: Others,
    /// Physical groups of facets, and their parts of the model.
    groups: Labels<i64>,
    parts: Labels<i64>,
    /// Names of physical groups of surfaces, and the groups of parts in version 4.
    names: HashMap<i64, &'a [u8]>,
    groups_of_parts: HashMap<i64, i64>,
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
            self.cursor.encoding = Encoding::Binary(if one == [0, 0, 0, 1] { Order::Big } else { Order::Little });
        }
        self.end(b"$MeshFormat")
    }

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

    /// Passes over the rest of a section.
    fn pass_section(&mut self, word: &[u8], name: &[u8]) -> Result<(), DataError> {
        let end = [b"$End", name].concat();
        let at = self.cursor.rest.windows(end.len()).position(|window| window == end);
        let length = at.ok_or_else(|| cut(&shown(word)))? + end.len();
        let passed = self.cursor.take(length).unwrap_or_default();
        self.cursor.line += passed.iter().filter(|&&b| b == b'\n').count();
        Ok(())
    }

    /// A number of text in either encoding, at the end of its line.
    fn heading(&mut self, what: &str) -> Result<usize, DataError> {
        let count = self.cursor.parsed(what)?;
        self.cursor.begin_data();
        Ok(count)
    }

    /// Begins a section of version 4 in blocks: a number of these, and three others.
    fn blocks(&mut self) -> Result<usize, DataError> {
        self.cursor.begin_data();
        let blocks = self.size("a number of blocks")?;
        for _ in 0..3 {
            self.size("a number of nodes or elements")?;
        }
        Ok(blocks)
    }

    fn int(&mut self, what: &str) -> Result<i64, DataError> {
        self.cursor.integer(Kind::I32, what)
    }

    fn size(&mut self, what: &str) -> Result<usize, DataError> {
        self.cursor.count(self.size, what)
    }

    /// Nodes; if they are parametric, each has its place on a part of the model, with a number for each of its dimensions.
    fn nodes_2(&mut self, is_parametric: bool) -> Result<(), DataError> {
        let count = self.heading("a number of nodes")?;
        // A node is its number and three coordinates.
        let (least, words, kind) =
            if self.cursor.encoding == Encoding::Text { (8, 4, Kind::F64) } else { (NODE, NODE, Kind::U8) };
        let left = self.cursor.rest.len();
        if count.saturating_mul(least) > left + 1 {
            return Err(DataError::Truncated(format!("{count} nodes are declared and {left} bytes follow")));
        }
        if self.counted {
            self.counts.vertices += count as u64;
        }
        if self.counted && !is_parametric {
            self.cursor.pass(count.saturating_mul(words), kind, "nodes")?;
            return Ok(());
        }
        for _ in 0..count {
            if self.counted {
                self.cursor.pass(words, kind, "nodes")?;
            } else {
                self.tags.given.push(self.cursor.integer(Kind::I32, "a node's number")?);
                let mut p = [0.0; 3];
                for x in &mut p {
                    *x = self.cursor.float(Kind::F64, "a number")?;
                }
                self.soup.positions.push(DVec3::from_array(p));
            }
            if is_parametric {
                let dimension = self.int("a dimension")?;
                self.int("a part of the model")?;
                let numbers = if let 1 | 2 = dimension { dimension as usize } else { 0 };
                self.cursor.pass(numbers, Kind::F64, "nodes")?;
            }
        }
        self.tags.finish()
    }

    fn nodes_4(&mut self) -> Result<(), DataError> {
        for _ in 0..self.blocks()? {
            let dimension = self.int("a dimension")?;
            self.int("an entity")?;
            let parametric = self.int("0 or 1")?;
            let count = self.size("a number of nodes")?;
            let each = 3 + if parametric == 0 { 0 } else { usize::try_from(dimension).unwrap_or(0).min(3) };
            if self.counted {
                self.cursor.pass(count, self.size, "nodes")?;
                self.cursor.pass(count.saturating_mul(each), Kind::F64, "nodes")?;
                self.counts.vertices += count as u64;
                continue;
            }
            self.tags.given.extend(self.cursor.integers(count, self.size, "nodes")?);
            let numbers = self.cursor.floats(count.saturating_mul(each), Kind::F64, "nodes")?;
            self.soup.positions.extend(numbers.chunks_exact(each).map(|p| DVec3::from_slice(&p[..3])));
        }
        self.tags.finish()
    }

    /// Names of physical groups: a line each, with a dimension, a number and the name in quotes.
    fn physical_names(&mut self) -> Result<(), DataError> {
        for _ in 0..self.cursor.parsed::<usize>("a number of names")? {
            let (dimension, tag): (i64, i64) = (self.cursor.parsed("a dimension")?, self.cursor.parsed("a group")?);
            let name = self.cursor.end_line();
            let name = name.strip_prefix(b"\"").unwrap_or(name);
            if dimension == 2 && self.names.len() < MAX_REGIONS {
                self.names.insert(tag.saturating_abs(), name.strip_suffix(b"\"").unwrap_or(name));
            }
        }
        Ok(())
    }

    /// The first physical group of each surface of the model, in version 4.
    fn entities(&mut self) -> Result<(), DataError> {
        self.cursor.begin_data();
        let mut counts = [0; 4];
        for count in &mut counts {
            *count = self.size("a number of entities")?;
        }
        for (dimension, count) in counts.into_iter().enumerate().take(3) {
            for _ in 0..count {
                let tag = self.int("an entity")?;
                self.cursor.pass(if dimension == 0 { 3 } else { 6 }, Kind::F64, "entities")?;
                let groups = self.size("a number of groups")?;
                let groups = self.cursor.integers(groups, Kind::I32, "groups")?;
                if let Some(group) = groups.first().filter(|_| dimension == 2) {
                    self.groups_of_parts.insert(tag, group.saturating_abs());
                }
                if dimension > 0 {
                    let borders = self.size("a number of borders")?;
                    self.cursor.pass(borders, Kind::I32, "borders")?;
                }
            }
        }
        Ok(())
    }

    /// Elements of one type, each with `head` numbers before its nodes, the last of them tags: their physical group and part of
    /// the model, unless `label` has them. The first has the number `index`; returns the next one.
    fn block(
        &mut self,
        index: usize,
        count: usize,
        (kind, head, tags): (i64, usize, usize),
        (int, label): (Kind, Option<[i64; 2]>),
    ) -> Result<usize, DataError> {
        let Some((nodes, corners)) = element(kind) else {
            if self.cursor.encoding != Encoding::Text {
                return Err(DataError::Header(format!("elements of type {kind} are not known; save it as text")));
            }
            // Each has a line of its own. The first line of a block of version 4 has ended.
            for k in 0..count {
                if self.cursor.rest.is_empty() {
                    return Err(cut("elements"));
                }
                if self.is_4 && k == 0 {
                    self.cursor.end_line();
                }
                self.cursor.end_line();
            }
            if self.wanted && !std::mem::replace(&mut self.has_unknown, true) {
                let text = format!("elements of type {kind} are not known");
                self.soup.raw.unreadable("elements", text);
            }
            return Ok(index.saturating_add(count));
        };
        let each = head.saturating_add(nodes);
        let all = count.saturating_mul(each);
        if self.counted {
            self.cursor.pass(all, int, "elements")?;
            self.counts.facets += count as u64 * corners.map_or(0, |n| n.saturating_sub(2)) as u64;
        } else {
            let numbers = self.cursor.integers(all, int, "elements")?;
            for (k, record) in numbers.chunks_exact(each).enumerate() {
                let before = self.soup.facets.len();
                self.push(index + k, corners, &record[head..])?;
                let more = self.soup.facets.len() - before;
                if self.wanted && more > 0 {
                    let tags = &record[head - tags..head];
                    let tag = |k: usize| tags.get(k).copied().unwrap_or(0);
                    let [group, part] = label.unwrap_or_else(|| [tag(0).saturating_abs(), tag(1)]);
                    self.groups.push(group, more);
                    self.parts.push(part, more);
                }
            }
        }
        Ok(index.saturating_add(count))
    }

    fn push(&mut self, index: usize, corners: Option<usize>, nodes: &[i64]) -> Result<(), DataError> {
        let wrong = |message: String| DataError::Element { element: "element", index, message };
        match corners {
            Some(0) => self.others.thin += 1,
            None => self.others.volumes += 1,
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
            let is_text = self.cursor.encoding == Encoding::Text;
            if is_text {
                self.int("an element's number")?;
            }
            let kind = self.int("an element's type")?;
            let block = if is_text { 1 } else { self.int("a number of elements")? };
            let tags = self.int("a number of tags")?;
            let (Ok(tags), Ok(block)) = (usize::try_from(tags), usize::try_from(block)) else {
                return Err(self.cursor.syntax("a number of elements or tags is negative"));
            };
            if block == 0 {
                return Err(self.cursor.syntax("a block of elements is empty"));
            }
            let head = tags.saturating_add(usize::from(!is_text));
            index = self.block(index, block, (kind, head, tags), (Kind::I32, None))?;
        }
        Ok(())
    }

    fn elements_4(&mut self) -> Result<(), DataError> {
        let mut index = 0;
        for _ in 0..self.blocks()? {
            self.int("a dimension")?;
            let part = self.int("an entity")?;
            let group = self.groups_of_parts.get(&part).copied().unwrap_or(0);
            let kind = self.int("an element's type")?;
            let count = self.size("a number of elements")?;
            index = self.block(index, count, (kind, 1, 0), (self.size, Some([group, part])))?;
        }
        Ok(())
    }

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
        let mut given = [0usize; 3];
        for k in 0..self.cursor.parsed::<usize>("a number of whole numbers")? {
            let number = self.cursor.parsed("a whole number")?;
            if let Some(given) = given.get_mut(k) {
                *given = number;
            }
        }
        let [_, components, count] = given;
        self.cursor.begin_data();
        let keep = self.wanted && (1..=MAX_COMPONENTS).contains(&components) && count == self.soup.positions.len();
        let left = self.cursor.rest.len();
        // A row has a digit for each number at least.
        if count.saturating_mul(components) > left {
            return Err(DataError::Truncated(format!("{count} nodes with data are declared and {left} bytes follow")));
        }
        let mut values = vec![f64::NAN; if keep { components * count } else { 0 }];
        for _ in 0..count {
            let tag = self.int("a node")?;
            let numbers = self.cursor.lenient(components, Kind::F64, "$NodeData")?;
            if let Some(vertex) = self.tags.vertex(tag)
                && let Some(to) = values.get_mut(components * vertex as usize..).and_then(|v| v.get_mut(..components))
            {
                to.copy_from_slice(&numbers);
            }
        }
        if keep {
            self.soup.raw.scalars.push(Scalar { components, ..Scalar::new(name, values) });
        } else if self.wanted {
            let text = "a surface carries a number for every node, and nothing else of a Gmsh file".to_owned();
            self.soup.raw.unreadable(&format!("$NodeData {:?}", shown(name.as_bytes())), text);
        }
        Ok(())
    }
}

/// A name that stands in quotes: nothing stands for a quote itself.
pub(super) fn quoted(name: &str) -> String {
    name.replace('"', "'")
}

/// Physical groups have positive numbers of 32 bits.
pub(super) const GROUPS: RangeInclusive<i64> = 1..=i32::MAX as i64;

fn encode(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let mut out = Vec::with_capacity(
        256 + NODE * vertices + 24 * facets + (4 * held.scalars.len() + 8 * held.components()) * vertices,
    );
    let int = |out: &mut Vec<u8>, n: u32| out.extend_from_slice(&n.to_le_bytes());
    out.extend_from_slice(b"$MeshFormat\n2.2 1 8\n");
    int(&mut out, 1);
    out.extend_from_slice(b"\n$EndMeshFormat\n");
    let groups = held.regions.map_or_else(Vec::new, |regions| numbers(regions, &GROUPS));
    let regions = held.regions.map_or_else(Default::default, |regions| regions.all());
    let named: Vec<_> = groups.iter().zip(regions).filter(|(_, region)| !region.name.is_empty()).collect();
    if !named.is_empty() {
        out.extend_from_slice(format!("$PhysicalNames\n{}\n", named.len()).as_bytes());
        for (group, region) in named {
            out.extend_from_slice(format!("2 {group} \"{}\"\n", quoted(&region.name)).as_bytes());
        }
        out.extend_from_slice(b"$EndPhysicalNames\n");
    }
    out.extend_from_slice(format!("$Nodes\n{vertices}\n").as_bytes());
    for (tag, p) in (1..).zip(mesh.positions()) {
        int(&mut out, tag);
        p.to_array().iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
    }
    out.extend_from_slice(format!("\n$EndNodes\n$Elements\n{facets}\n").as_bytes());
    // Triangles, all in one block, with two tags each: of the physical group and of the part of the model.
    [2, facets as u32, 2].iter().for_each(|&n| int(&mut out, n));
    for (tag, facet) in (1..).zip(mesh.facets()) {
        let region = held.regions.map(|regions| regions.of_facet()[tag as usize - 1]);
        // A part of its own for each group: Gmsh gives all facets of a part the same groups.
        let group = region.map_or(1, |region| groups[region as usize] as u32);
        [tag, group, group].iter().for_each(|&n| int(&mut out, n));
        facet.iter().for_each(|v| int(&mut out, v + 1));
    }
    out.extend_from_slice(b"\n$EndElements");
    for scalar in held.scalars {
        // A name, a time, and three numbers: the step, how many numbers a node has, how many nodes.
        let (name, n) = (quoted(&scalar.name), scalar.components);
        // Gmsh knows nodes of one, three and nine numbers.
        let wide = [1, 3, 9].into_iter().find(|wide| *wide >= n).unwrap_or(n);
        let head = format!("\n$NodeData\n1\n\"{name}\"\n1\n0\n3\n0\n{wide}\n{vertices}\n");
        out.extend_from_slice(head.as_bytes());
        for (tag, values) in (1..).zip(scalar.values.chunks_exact(n)) {
            int(&mut out, tag);
            let padded = values.iter().copied().chain(std::iter::repeat(0.0)).take(wide);
            padded.for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
        }
        out.extend_from_slice(b"\n$EndNodeData");
    }
    Ok(out)
}
