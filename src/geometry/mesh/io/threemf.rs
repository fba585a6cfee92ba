//! 3MF, `.3mf`: a zip archive of XML. Writes one object, in text.
//!
//! Purpose: the triangles of all items of the build, each where its transform and those of components place it; objects may lie
//! in other parts of the archive. Coordinates are in the unit of the first part. Colours, materials, textures and beams are left
//! aside. The text is read as it is unpacked, and never whole.
//! Invariant: no more is unpacked than [`super::UNPACKED_RATIO`] times the file; instances, and records of objects, are bounded
//! too. Must not know: other formats.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet, VecDeque};
use std::fmt::Write as _;
use std::io::{self, BufRead, BufReader, Cursor, Read, Write as _};

use glam::{DMat4, DVec3, DVec4};
use quick_xml::Reader as Xml;
use quick_xml::events::{BytesStart, Event};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::held::{By, Held, Holds, Labelled};
use super::numbers::{parse, plain, shown};
use super::packed::{Room, Signature};
use super::{Codec, Counts, DataError, Soup, VertexNumbers, unpacked_limit};
use crate::mesh::TriMesh;

pub(super) const CODEC: Codec = Codec {
    extension: "3mf",
    media_types: &["model/3mf", "application/vnd.ms-package.3dmanufacturing-3dmodel+xml"],
    // Half a vertex and a triangle of about 60 bytes of text, packed.
    facet_bytes: 5,
    signature: Signature::Start(|head| head.bytes.starts_with(b"PK\x03\x04")),
    decode: |bytes, wanted| {
        let mut package = Package::read(bytes, false)?;
        package.build(bytes.len(), wanted.is_some())
    },
    encode,
    counts: |bytes| Package::read(bytes, true).ok()?.counts(bytes.len()),
    holds: Holds {
        normals: By::None,
        texture: By::None,
        colours: false,
        opacity: false,
        scalars: false,
        regions: Labelled::None,
    },
    vertices: VertexNumbers::Kept,
};

const MODEL: &str = "3D/3dmodel.model";
/// Components, or elements of XML, within each other. Files in use have a few.
const DEEPEST: usize = 64;
/// The longest tag or text that is read at once.
const LONGEST: usize = 1 << 20;

/// An object in its place.
#[derive(Clone, Copy)]
struct Instance {
    part: u32,
    object: u32,
    place: DMat4,
}

#[derive(Default)]
struct Object {
    vertices: usize,
    triangles: usize,
    /// Nothing if they are counted.
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    components: Vec<Instance>,
}

struct Package {
    counted: bool,
    objects: Vec<Object>,
    /// By the number of their part and their own.
    places: HashMap<(u32, u32), usize>,
    items: Vec<Instance>,
    /// Names of parts, in the order in which they are read.
    parts: Vec<String>,
    /// Lengths of their units, mm.
    units: Vec<f64>,
    left_aside: HashSet<&'static str>,
    /// For records of objects, components and items.
    room: Room,
    /// Bytes that may still be unpacked.
    left: usize,
}

/// Elements with what no surface carries.
const ASIDE: [(&[u8], &str); 6] = [
    (b"basematerials", "materials"),
    (b"colorgroup", "colours"),
    (b"texture2dgroup", "textures"),
    (b"compositematerials", "materials"),
    (b"beamlattice", "beams"),
    (b"slicestack", "slices"),
];

/// Parts of the namespaces of extensions without which a surface is whole, or that are read.
const KNOWN: [&str; 5] = ["/material/", "/production/", "/slice/", "/trianglesets/", "/beamlattice/"];

/// Units of length, mm.
const UNITS: [(&[u8], f64); 6] = [
    (b"micron", 1e-3),
    (b"millimeter", 1.0),
    (b"centimeter", 10.0),
    (b"inch", 25.4),
    (b"foot", 304.8),
    (b"meter", 1000.0),
];

impl Package {
    fn read(bytes: &[u8], counted: bool) -> Result<Self, DataError> {
        let mut package = Self {
            counted,
            objects: Vec::new(),
            places: HashMap::new(),
            items: Vec::new(),
            parts: Vec::new(),
            units: Vec::new(),
            left_aside: HashSet::new(),
            room: Room::of(bytes.len()),
            left: unpacked_limit(bytes.len()),
        };
        let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|error| unread(&error))?;
        let first = package.first(&mut archive)?;
        package.parts.push(first);
        let mut number = 0;
        while let Some(name) = package.parts.get(number).cloned() {
            package.part(&mut archive, number as u32, &name)?;
            number += 1;
        }
        Ok(package)
    }

    /// The part with the build.
    fn first(&mut self, archive: &mut ZipArchive<Cursor<&[u8]>>) -> Result<String, DataError> {
        let mut target = None;
        if archive.index_for_name("_rels/.rels").is_some() {
            self.elements(archive, "_rels/.rels", |_, tag, _| {
                let is_model = attribute(tag, b"Type").is_some_and(|kind| kind.ends_with(b"/3dmodel"));
                if is_model && target.is_none() {
                    target = attribute(tag, b"Target").map(|name| String::from_utf8_lossy(&name).into_owned());
                }
                Ok(())
            })?;
        }
        Ok(target.unwrap_or_else(|| MODEL.to_owned()))
    }

    /// Calls `visit` for the begin and the end of all elements of a part; of an end there is the name alone.
    fn elements(
        &mut self,
        archive: &mut ZipArchive<Cursor<&[u8]>>,
        name: &str,
        mut visit: impl FnMut(&mut Self, &BytesStart<'_>, bool) -> Result<(), DataError>,
    ) -> Result<(), DataError> {
        let name = name.trim_start_matches('/');
        let index = match archive.index_for_name(name) {
            Some(index) => Some(index),
            None => archive.file_names().position(|other| other.eq_ignore_ascii_case(name)),
        };
        let shown = plain(name, 60);
        let index = index.ok_or_else(|| DataError::Header(format!("the archive has no part \"{shown}\"")))?;
        let limit = self.left;
        let file = archive.by_index(index).map_err(|error| unread(&error))?;
        let text = Text { inner: BufReader::new(file), left: limit, of_event: 0 };
        let mut reader = Xml::from_reader(text);
        let mut buffer = Vec::new();
        let wrong = |message: String| DataError::Header(format!("part \"{shown}\": {message}"));
        let mut open = 0usize;
        let result = loop {
            buffer.clear();
            reader.get_mut().of_event = 0;
            let event = match reader.read_event_into(&mut buffer) {
                Ok(event) => event,
                Err(quick_xml::Error::Io(error)) if error.kind() == io::ErrorKind::FileTooLarge => {
                    break Err(DataError::TooLong { limit: unpacked_limit(self.room.bytes()) });
                }
                Err(error) => break Err(wrong(plain(&error.to_string(), 200))),
            };
            let visited = match &event {
                Event::Start(_) if open == DEEPEST => Err(wrong(format!("more than {DEEPEST} elements are open"))),
                Event::Start(tag) => {
                    open += 1;
                    visit(self, tag, false)
                }
                Event::Empty(tag) => visit(self, tag, false).and_then(|()| visit(self, tag, true)),
                Event::End(tag) => {
                    open = open.saturating_sub(1);
                    visit(
                        self,
                        &BytesStart::from_content(
                            String::from_utf8_lossy(tag.name().as_ref()),
                            tag.name().as_ref().len(),
                        ),
                        true,
                    )
                }
                Event::Eof if open > 0 => Err(DataError::Truncated(format!("part \"{shown}\" is not whole"))),
                Event::Eof => break Ok(()),
                _ => Ok(()),
            };
            if let Err(error) = visited {
                break Err(error);
            }
        };
        self.left = reader.get_mut().left;
        result
    }

    fn part(&mut self, archive: &mut ZipArchive<Cursor<&[u8]>>, number: u32, name: &str) -> Result<(), DataError> {
        let mut current: Option<usize> = None;
        let mut in_build = false;
        self.units.push(1.0);
        self.elements(archive, name, |package, tag, is_end| {
            let element = tag.local_name();
            let element = element.as_ref();
            match (element, is_end) {
                (b"model", false) => {
                    Self::check_extensions(tag)?;
                    package.unit(tag, number);
                }
                (b"object", false) => {
                    let id = whole(tag, b"id", "object")?;
                    current = Some(package.objects.len());
                    package.room.take(64)?;
                    package.places.insert((number, id), package.objects.len());
                    package.room.push(&mut package.objects, Object::default())?;
                }
                (b"object", true) => current = None,
                (b"build", _) => in_build = !is_end,
                (b"item", false) if in_build && number == 0 => {
                    let item = package.instance(tag, number, b"item")?;
                    package.room.push(&mut package.items, item)?;
                }
                (b"component", false) => {
                    let component = package.instance(tag, number, b"component")?;
                    if let Some(object) = current.and_then(|at| package.objects.get_mut(at)) {
                        package.room.push(&mut object.components, component)?;
                    }
                }
                (b"vertex" | b"triangle", false) => {
                    let counted = package.counted;
                    let Some(object) = current.and_then(|at| package.objects.get_mut(at)) else { return Ok(()) };
                    match element {
                        b"vertex" => object.vertex(tag, counted)?,
                        _ => object.triangle(tag, counted)?,
                    }
                }
                (other, false) => {
                    let what = ASIDE.iter().find(|(name, _)| *name == other);
                    package.left_aside.extend(what.map(|&(_, what)| what));
                }
                _ => {}
            }
            Ok(())
        })
    }

    /// A file may require extensions, by the prefixes of their namespaces. Errors: one is not known.
    fn check_extensions(tag: &BytesStart<'_>) -> Result<(), DataError> {
        let Some(prefixes) = attribute(tag, b"requiredextensions") else { return Ok(()) };
        let mut spaces = tag.attributes();
        let known: Vec<_> = spaces
            .with_checks(false)
            .flatten()
            .filter(|space| KNOWN.iter().any(|known| String::from_utf8_lossy(&space.value).contains(known)))
            .filter_map(|space| Some(space.key.as_ref().strip_prefix(b"xmlns:")?.to_vec()))
            .collect();
        let mut prefixes = prefixes.split(u8::is_ascii_whitespace).filter(|prefix| !prefix.is_empty());
        match prefixes.find(|prefix| !known.iter().any(|known| known == prefix)) {
            Some(prefix) => {
                let text = format!("it requires the extension {}, which is not read; export it without", shown(prefix));
                Err(DataError::Header(text))
            }
            None => Ok(()),
        }
    }

    fn unit(&mut self, tag: &BytesStart<'_>, part: u32) {
        let name = attribute(tag, b"unit");
        let unit = UNITS.iter().find(|(unit, _)| name.as_deref() == Some(*unit)).map_or(1.0, |&(_, length)| length);
        self.units[part as usize] = unit;
        if unit != 1.0 && part == 0 {
            self.left_aside.insert("the unit, which is not mm");
        }
    }

    fn instance(&mut self, tag: &BytesStart<'_>, part: u32, element: &'static [u8]) -> Result<Instance, DataError> {
        let name = if element == b"item" { "item" } else { "component" };
        let object = whole(tag, b"objectid", name)?;
        let part = match attribute(tag, b"path") {
            None => part,
            Some(path) => {
                let path = String::from_utf8_lossy(&path);
                match self.parts.iter().position(|known| known == path.as_ref()) {
                    Some(known) => known as u32,
                    None => {
                        self.room.take(path.len() + size_of::<String>())?;
                        self.parts.push(path.into_owned());
                        self.parts.len() as u32 - 1
                    }
                }
            }
        };
        let place = match attribute(tag, b"transform") {
            None => DMat4::IDENTITY,
            Some(text) => {
                let numbers: Option<Vec<f64>> = text
                    .split(u8::is_ascii_whitespace)
                    .filter(|word| !word.is_empty())
                    .take(13)
                    .map(|word| parse::<f64>(word).filter(|number| number.is_finite()))
                    .collect();
                let rows = numbers.as_ref().filter(|numbers| numbers.len() == 12);
                let rows = rows.ok_or_else(|| wrong(name, 0, "its transform has not 12 finite numbers".to_owned()))?;
                let row = |k: usize, w: f64| DVec4::new(rows[3 * k], rows[3 * k + 1], rows[3 * k + 2], w);
                DMat4::from_cols(row(0, 0.0), row(1, 0.0), row(2, 0.0), row(3, 1.0))
            }
        };
        Ok(Instance { part, object, place })
    }

    /// All objects of the build in their places; the file has `length` bytes.
    fn instances(
        &self,
        length: usize,
        mut visit: impl FnMut(&Object, usize, DMat4) -> Result<(), DataError>,
    ) -> Result<(), DataError> {
        let mut steps = length.saturating_mul(8).saturating_add(1 << 20);
        let mut bytes = unpacked_limit(length).saturating_mul(2);
        let mut open: VecDeque<(Instance, usize, u32)> = VecDeque::new();
        for (number, &item) in self.items.iter().enumerate() {
            open.push_back((item, 0, 0));
            while let Some((Instance { part, object, place }, depth, from)) = open.pop_back() {
                let wrong = |message: &str| wrong("item", number, message.to_owned());
                let at = self.places.get(&(part, object)).and_then(|&at| Some((at, self.objects.get(at)?)));
                let (at, object) = at.ok_or_else(|| wrong("an object is named, and there is none"))?;
                if depth > DEEPEST {
                    return Err(wrong("its components are nested too deep"));
                }
                let unit = |part: u32| self.units.get(part as usize).copied().unwrap_or(1.0);
                let scale = unit(part) / unit(from);
                let place = if scale == 1.0 { place } else { place * DMat4::from_scale(DVec3::splat(scale)) };
                let made = object.vertices.saturating_mul(24).saturating_add(object.triangles.saturating_mul(12));
                let work = 1 + object.components.len();
                let left = steps.checked_sub(work).zip(bytes.checked_sub(made));
                let repeated = || "it repeats objects more than a file of this size may; write .ply or .obj".to_owned();
                (steps, bytes) = left.ok_or_else(|| DataError::Header(repeated()))?;
                visit(object, at, place)?;
                // The first one is taken out next.
                for &component in object.components.iter().rev() {
                    open.push_back((Instance { place: place * component.place, ..component }, depth + 1, part));
                }
            }
        }
        Ok(())
    }

    fn counts(&self, length: usize) -> Option<Counts> {
        let mut counts = Counts::default();
        self.instances(length, |object, _, _| {
            counts.vertices += object.vertices as u64;
            counts.facets += object.triangles as u64;
            Ok(())
        })
        .ok()?;
        // Objects are kept beside the surface that is made of them.
        let bytes = |object: &Object| 24 * object.vertices as u64 + 12 * object.triangles as u64;
        counts.made_bytes = 2 * self.objects.iter().map(bytes).sum::<u64>() + self.room.taken() as u64;
        Some(counts)
    }

    fn build(&mut self, length: usize, wanted: bool) -> Result<Soup, DataError> {
        let mut soup = Soup::default();
        self.instances(length, |object, at, place| {
            let first = soup.positions.len();
            let is_still = place == DMat4::IDENTITY;
            let count = object.positions.len();
            let placed = |&p: &DVec3| if is_still { p } else { place.transform_point3(p) };
            soup.positions.extend(object.positions.iter().map(placed));
            let mirrored = place.determinant() < 0.0;
            for (index, &[a, b, c]) in object.facets.iter().enumerate() {
                let facet = if mirrored { [a, c, b] } else { [a, b, c] };
                if facet.iter().any(|&v| v as usize >= count) {
                    let message = format!("vertex {} is named, but object {at} has {count}", a.max(b).max(c));
                    return Err(wrong("triangle", index, message));
                }
                soup.facets.push(facet.map(|v| (first as u32).saturating_add(v)));
            }
            Ok(())
        })?;
        if soup.facets.is_empty() && !self.objects.is_empty() {
            let text = if self.items.is_empty() { "the build has no items" } else { "no object has triangles" };
            return Err(DataError::Header(format!("{text}; export it again")));
        }
        let mut names: Vec<&str> = self.left_aside.iter().copied().collect();
        names.sort_unstable();
        for name in names.into_iter().filter(|_| wanted) {
            soup.raw.unreadable(name, "a surface of 3MF is read without".to_owned());
        }
        Ok(soup)
    }
}

impl Object {
    fn vertex(&mut self, tag: &BytesStart<'_>, counted: bool) -> Result<(), DataError> {
        let index = self.vertices;
        self.vertices += 1;
        if counted {
            return Ok(());
        }
        let mut position = [f64::NAN; 3];
        each(tag, |name, value| {
            if let Some(axis) = [b"x", b"y", b"z"].iter().position(|axis| axis.as_slice() == name) {
                let number = parse(value.trim_ascii());
                position[axis] = number.ok_or_else(|| wrong("vertex", index, not(value, "a number")))?;
            }
            Ok(())
        })?;
        if position.iter().any(|x| x.is_nan()) {
            return Err(wrong("vertex", index, "it has not x, y and z".to_owned()));
        }
        self.positions.push(DVec3::from_array(position));
        Ok(())
    }

    fn triangle(&mut self, tag: &BytesStart<'_>, counted: bool) -> Result<(), DataError> {
        let index = self.triangles;
        self.triangles += 1;
        if counted {
            return Ok(());
        }
        let mut facet = [u32::MAX; 3];
        each(tag, |name, value| {
            if let Some(corner) = [b"v1", b"v2", b"v3"].iter().position(|corner| corner.as_slice() == name) {
                let number = parse(value.trim_ascii());
                facet[corner] = number.ok_or_else(|| wrong("triangle", index, not(value, "a number of a vertex")))?;
            }
            Ok(())
        })?;
        self.facets.push(facet);
        Ok(())
    }
}

/// Text that is unpacked, up to a limit, and up to another one between two calls that set `of_event` to 0.
struct Text<R> {
    inner: R,
    left: usize,
    of_event: usize,
}

impl<R: BufRead> Read for Text<R> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let read = self.fill_buf()?.read(to)?;
        self.consume(read);
        Ok(read)
    }
}

impl<R: BufRead> BufRead for Text<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.left == 0 {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        if self.of_event > LONGEST {
            return Err(io::Error::other("a tag or a text is longer than 1 MiB"));
        }
        self.inner.fill_buf()
    }

    fn consume(&mut self, bytes: usize) {
        self.left = self.left.saturating_sub(bytes);
        self.of_event += bytes;
        self.inner.consume(bytes);
    }
}

fn unread(error: &zip::result::ZipError) -> DataError {
    DataError::Header(format!("the zip archive cannot be read: {}", plain(&error.to_string(), 200)))
}

fn wrong(element: &'static str, index: usize, message: String) -> DataError {
    DataError::Element { element, index, message }
}

fn not(value: &[u8], what: &str) -> String {
    format!("\"{}\" is not {what}", shown(value))
}

fn each(tag: &BytesStart<'_>, mut visit: impl FnMut(&[u8], &[u8]) -> Result<(), DataError>) -> Result<(), DataError> {
    tag.attributes()
        .with_checks(false)
        .flatten()
        .try_for_each(|found| visit(found.key.local_name().as_ref(), &found.value))
}

fn attribute<'t>(tag: &'t BytesStart<'_>, name: &[u8]) -> Option<Cow<'t, [u8]>> {
    let found = tag.attributes().with_checks(false).flatten().find(|found| found.key.local_name().as_ref() == name)?;
    Some(found.value)
}

fn whole(tag: &BytesStart<'_>, name: &[u8], element: &'static str) -> Result<u32, DataError> {
    let value = attribute(tag, name).unwrap_or_default();
    parse(value.trim_ascii()).ok_or_else(|| wrong(element, 0, not(&value, "a number of an object")))
}

fn encode(mesh: &TriMesh, _held: &Held<'_>) -> Result<Vec<u8>, DataError> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let mut text = String::with_capacity(512 + 90 * vertices + 50 * facets);
    text.push_str(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model unit=\"millimeter\" \
         xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\">\n<resources>\n\
         <object id=\"1\" type=\"model\">\n<mesh>\n<vertices>\n",
    );
    // Debug formatting is the shortest text that reads back as the same bits.
    for p in mesh.positions() {
        let _ = writeln!(text, "<vertex x=\"{:?}\" y=\"{:?}\" z=\"{:?}\"/>", p.x, p.y, p.z);
    }
    text.push_str("</vertices>\n<triangles>\n");
    for [a, b, c] in mesh.facets() {
        let _ = writeln!(text, "<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\"/>");
    }
    text.push_str(
        "</triangles>\n</mesh>\n</object>\n</resources>\n<build>\n<item objectid=\"1\"/>\n</build>\n</model>\n",
    );
    let types = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
        <Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\
        <Default Extension=\"rels\" ContentType=\"application/vnd.openxmlformats-package.relationships+xml\"/>\
        <Default Extension=\"model\" ContentType=\"application/vnd.ms-package.3dmanufacturing-3dmodel+xml\"/></Types>\n";
    let relations = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
         <Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\"><Relationship \
         Target=\"/{MODEL}\" Id=\"rel0\" Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\"/>\
         </Relationships>\n"
    );
    // The same surface gives the same bytes.
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(zip::DateTime::default());
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: &str, text: &str| -> Result<(), zip::result::ZipError> {
        archive.start_file(name, options)?;
        Ok(archive.write_all(text.as_bytes())?)
    };
    add("[Content_Types].xml", types)
        .and_then(|()| add("_rels/.rels", &relations))
        .and_then(|()| add(MODEL, &text))
        .and_then(|()| archive.finish())
        .map(Cursor::into_inner)
        .map_err(|error| DataError::Header(format!("the zip archive cannot be written: {error}")))
}
