//! STL, ascii and binary, with the `stl_io` crate.
//!
//! Purpose: bytes to triangles and back. Corners with the same position bits become one vertex
//! (0 and -0 are the same), numbered by first use; normals are left aside.
//! Why some of the reading is done around the crate: it takes every file that begins with "solid " for ascii, which many
//! binary ones do, so the records of binary files are read here; of several solids it reads the first; it wants keywords in
//! lower case and a name after "solid"; and it refuses normals that are no numbers. Must not know: other formats.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::io::{Cursor, ErrorKind, Read, Seek};

use glam::DVec3;
use stl_io::{Normal, Triangle, Vertex};

use super::held::{By, Held, Holds, Labelled, check_single};
use super::regions::{Labels, by_name, names};
use super::{Codec, Counts, DataError, Soup, Unfit, VertexNumbers};
use crate::mesh::TriMesh;
use crate::mesh::regions::Regions;

pub(super) const CODEC: Codec = Codec {
    extension: "stl",
    media_types: &[
        "model/stl",
        "model/x.stl-binary",
        "model/x.stl-ascii",
        "application/sla",
        "application/vnd.ms-pki.stl",
    ],
    facet_bytes: RECORD as u64,
    signature: super::packed::Signature::Start(|head| is_binary(head) || is_solid(head.text())),
    decode: |bytes, wanted| decode(bytes, wanted.is_some()),
    encode,
    counts,
    holds: Holds {
        normals: By::None,
        texture: By::None,
        colours: false,
        opacity: false,
        scalars: false,
        regions: Labelled::Name,
    },
    vertices: VertexNumbers::Absent,
};

pub(in crate::mesh) const HEADER: usize = 84;
pub(in crate::mesh) const RECORD: usize = 50;

/// Whether the first word is "solid", with no comment before it: the title of a VTK file may be that word too.
fn is_solid(text: &[u8]) -> bool {
    text.trim_ascii_start().split(u8::is_ascii_whitespace).next() == Some(&b"solid"[..])
}

fn is_binary(head: &super::packed::Head<'_>) -> bool {
    declared_facets(head.bytes).is_some_and(|count| head.has_length(HEADER as u64 + RECORD as u64 * count as u64))
}

fn decode(bytes: &[u8], wanted: bool) -> Result<Soup, DataError> {
    let mut welder = Welder::default();
    if is_ascii(bytes) {
        let text = bytes.to_ascii_lowercase();
        let (mut labels, mut solids) = (Labels::default(), 0);
        each_solid(&text, bytes, |solid, name| {
            let before = welder.soup.facets.len();
            welder.read(&mut Cursor::new(solid))?;
            // Solids without a name are one each.
            solids += 1;
            let label = (name, if name.is_empty() { solids } else { 0 });
            labels.push(label, if wanted { welder.soup.facets.len() - before } else { 0 });
            Ok(())
        })?;
        welder.soup.raw.regions = Some(labels.finish("solids", |(name, _), rank| by_name(name, rank)));
    } else {
        if wanted && bytes.get(..80).is_some_and(|head| head.windows(6).any(|word| word == b"COLOR=")) {
            welder.soup.raw.unreadable("the colour in the header", "a surface carries colours of vertices".to_owned());
        }
        let short = || DataError::Truncated("it ends inside the header".to_owned());
        let declared = declared_facets(bytes).ok_or_else(short)?;
        match layout(bytes, declared) {
            Layout::Plain(count) => {
                let records = &bytes[HEADER..].as_chunks::<RECORD>().0[..count];
                records.iter().for_each(|record| welder.take(record));
                let mut labels = Labels::default();
                records.iter().filter(|_| wanted).for_each(|record| labels.push(trailing(record) as i64, 1));
                welder.soup.raw.regions = Some(labels.numbered("colours or attributes of facets"));
            }
            Layout::Extended => extended(bytes).for_each(|record| welder.take(record)),
            Layout::Short(held) => {
                return Err(DataError::Truncated(format!("{declared} facets are declared and {held} are there")));
            }
        }
    }
    Ok(welder.soup)
}

/// Vertices and facets: three vertices each, since it is not looked which are the same.
fn counts(bytes: &[u8]) -> Option<Counts> {
    let facets = if is_ascii(bytes) {
        let begins = |line: &&[u8]| line.trim_ascii_start().get(..5).is_some_and(|w| w.eq_ignore_ascii_case(b"facet"));
        bytes.split(|&b| b == b'\n').filter(begins).count()
    } else {
        let declared = declared_facets(bytes)?;
        match layout(bytes, declared) {
            Layout::Plain(count) => count,
            Layout::Extended => declared,
            Layout::Short(_) => return None,
        }
    } as u64;
    Some(Counts { vertices: 3 * facets, facets, made_bytes: 0 })
}

/// Text with a solid for each region, binary without regions.
fn encode(mesh: &TriMesh, held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    check_single(mesh)?;
    if let Some(regions) = held.regions {
        return Ok(solids(mesh, regions).into_bytes());
    }
    let triangles: Vec<Triangle> = (0..mesh.facets().len()).map(|facet| triangle(mesh, facet)).collect();
    let mut out = Vec::with_capacity(HEADER + RECORD * triangles.len());
    stl_io::write_stl(&mut out, triangles.iter()).map_err(|error| DataError::Header(error.to_string()))?;
    Ok(out)
}

fn triangle(mesh: &TriMesh, facet: usize) -> Triangle {
    let [a, b, c] = mesh.corners(facet);
    // Scaled first, so that a small surface keeps its normals.
    let (ab, ac) = (b - a, c - a);
    let size = ab.abs().max(ac.abs()).max_element();
    let scale = if size > 0.0 { size } else { 1.0 };
    let normal = (ab / scale).cross(ac / scale).normalize_or_zero();
    let single = |p: DVec3| p.as_vec3().to_array();
    Triangle { normal: Normal::new(single(normal)), vertices: [a, b, c].map(|p| Vertex::new(single(p))) }
}

/// One solid for each region with facets.
fn solids(mesh: &TriMesh, regions: &Regions) -> String {
    let names = names(regions, str::to_owned);
    let mut text = String::with_capacity(240 * mesh.facets().len());
    // The shortest digits that read back as the same bits.
    let vector = |text: &mut String, word: &str, [x, y, z]: [f32; 3]| {
        let _ = writeln!(text, "{word} {x:e} {y:e} {z:e}");
    };
    for (name, facets) in names.iter().zip(regions.facets_by_region()).filter(|(_, facets)| !facets.is_empty()) {
        let _ = writeln!(text, "solid {name}");
        for facet in facets {
            let Triangle { normal, vertices } = triangle(mesh, facet as usize);
            vector(&mut text, "facet normal", normal.0);
            text.push_str("outer loop\n");
            vertices.iter().for_each(|vertex| vector(&mut text, "vertex", vertex.0));
            text.push_str("endloop\nendfacet\n");
        }
        let _ = writeln!(text, "endsolid {name}");
    }
    text
}

/// The facets of a binary file of this length with these first bytes, which [`RECORD`] bytes each follow one another.
pub(in crate::mesh) fn facets_alone(head: &[u8], bytes: u64) -> Result<usize, Unfit> {
    let declared = declared_facets(head)
        .filter(|&count| bytes == HEADER as u64 + RECORD as u64 * count as u64)
        .ok_or_else(|| Unfit::Kind("the file is text, or not as long as its header says".to_owned()))?;
    Ok(declared)
}

fn declared_facets(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(80..HEADER)?.first_chunk::<4>()?;
    Some(u32::from_le_bytes(*count) as usize)
}

/// How the facets of a binary file lie.
enum Layout {
    /// This many, one record after the other.
    Plain(usize),
    /// Each record is followed by as many bytes as its last two bytes say.
    Extended,
    /// There are fewer than declared.
    Short(usize),
}

/// A count in the header may be of an earlier state of the file, and bytes of other programs may follow each record or the
/// last one. The rest counts as facets if it is a whole number of records whose coordinates are near those before, less the
/// points at its end: they are padding.
fn layout(bytes: &[u8], declared: usize) -> Layout {
    let body = bytes.len().saturating_sub(HEADER);
    let held = body / RECORD;
    if declared > held {
        return Layout::Short(held);
    }
    if declared == held || body == 0 {
        return Layout::Plain(declared);
    }
    let ends: Vec<&[u8; RECORD]> = extended(bytes).take(declared).collect();
    let length: usize = ends.iter().map(|record| RECORD + trailing(record)).sum();
    if ends.len() == declared && length == body && length > RECORD * declared {
        return Layout::Extended;
    }
    let (known, rest) = bytes[HEADER..].as_chunks::<RECORD>().0.split_at(declared);
    let most = known.iter().flat_map(corners).flatten().fold(f32::MIN_POSITIVE, |most, x| most.max(x.abs()));
    // Without declared facets any finite coordinates will do.
    let bound = if declared == 0 { f32::MAX } else { 1000.0 * most };
    let are_facets = || rest.iter().all(|record| corners(record).as_flattened().iter().all(|x| x.abs() <= bound));
    if !body.is_multiple_of(RECORD) || !are_facets() {
        return Layout::Plain(declared);
    }
    let is_point = |record: &&[u8; RECORD]| matches!(corners(record), [a, b, c] if a == b && b == c);
    Layout::Plain(held - rest.iter().rev().take_while(is_point).count())
}

/// The records of a file whose records are followed by further bytes.
fn extended(bytes: &[u8]) -> impl Iterator<Item = &[u8; RECORD]> {
    let mut rest = bytes.get(HEADER..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (record, behind) = rest.split_first_chunk::<RECORD>()?;
        rest = behind.get(trailing(record)..).unwrap_or_default();
        Some(record)
    })
}

/// The number in the last two bytes of a record.
fn trailing(record: &[u8; RECORD]) -> usize {
    usize::from(u16::from_le_bytes([record[RECORD - 2], record[RECORD - 1]]))
}

fn corners(record: &[u8; RECORD]) -> [[f32; 3]; 3] {
    let mut numbers = record.as_chunks::<4>().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).skip(3);
    [(); 3].map(|()| [(); 3].map(|()| numbers.next().unwrap_or(f32::NAN)))
}

/// Text begins with "solid" and has not exactly the size that a binary file of its count would have.
fn is_ascii(bytes: &[u8]) -> bool {
    let binary_size = declared_facets(bytes).and_then(|n| n.checked_mul(RECORD)).map(|n| n + HEADER);
    bytes.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
        && binary_size != Some(bytes.len())
        // A binary file that is cut short has a size of its own, but hardly text throughout.
        && !bytes[..bytes.len().min(512)].contains(&0)
}

/// Visits each solid of an ascii file, under a title that the crate takes, with its name. `text` is the file in lower case.
fn each_solid<'a>(
    text: &[u8],
    file: &'a [u8],
    mut visit: impl FnMut(&[u8], &'a [u8]) -> Result<(), DataError>,
) -> Result<(), DataError> {
    let mut solid: Vec<u8> = Vec::new();
    let mut name: &[u8] = b"";
    let mut open = false;
    for (line, written) in text.split(|&b| b == b'\n').zip(file.split(|&b| b == b'\n')) {
        let word = line.trim_ascii();
        if word.is_empty() {
            continue;
        }
        if !open {
            solid.clear();
            solid.extend_from_slice(b"solid -\n");
            open = true;
            name = b"";
            if word.starts_with(b"solid") {
                name = written.trim_ascii().get(5..).unwrap_or_default().trim_ascii();
                continue;
            }
        }
        // Normals are left aside, and the crate refuses those that are no numbers, as exporters give slivers.
        solid.extend_from_slice(if word.starts_with(b"facet") { b"facet normal 0 0 0" } else { word });
        solid.push(b'\n');
        if word.starts_with(b"endsolid") {
            visit(&solid, name)?;
            open = false;
        }
    }
    if open { visit(&solid, name) } else { Ok(()) }
}

#[derive(Default)]
struct Welder {
    soup: Soup,
    /// By the bits of positions. The hash has another key each time, so that nobody can send positions that all fall into one slot.
    numbers: HashMap<[u32; 3], u32, foldhash::fast::RandomState>,
}

impl Welder {
    fn read<R: Read + Seek>(&mut self, source: &mut R) -> Result<(), DataError> {
        let failed = |index: usize, error: std::io::Error| match error.kind() {
            ErrorKind::UnexpectedEof => DataError::Truncated(format!("it ends in or after facet {index}")),
            _ => DataError::Element { element: "facet", index, message: error.to_string().chars().take(160).collect() },
        };
        let facets = stl_io::create_stl_reader(source).map_err(|error| failed(0, error))?;
        for triangle in facets {
            let triangle = triangle.map_err(|error| failed(self.soup.facets.len(), error))?;
            let facet = triangle.vertices.map(|v| self.number(v.0));
            self.soup.facets.push(facet);
        }
        Ok(())
    }

    /// A binary file's facet: its normal, its corners, two bytes that are a colour or mean nothing.
    fn take(&mut self, record: &[u8; RECORD]) {
        let facet = corners(record).map(|position| self.number(position));
        self.soup.facets.push(facet);
    }

    fn number(&mut self, position: [f32; 3]) -> u32 {
        // Adding 0 makes -0 the same as 0.
        let next = self.soup.positions.len() as u32;
        let number = *self.numbers.entry(position.map(|x| (x + 0.0).to_bits())).or_insert(next);
        if number == next {
            self.soup.positions.push(DVec3::from_array(position.map(f64::from)));
        }
        number
    }
}
