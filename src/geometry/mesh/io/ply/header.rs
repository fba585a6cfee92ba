//! The header, as files have it: Latin-1, blank and indented lines, carriage returns, names like `scalar_distance[<10]`.
//!
//! Purpose: [`read`] takes the header apart.
//! Invariant: names within an element differ. A header is short, whatever its bytes. Must not know: data.

use std::collections::HashMap;

use crate::mesh::attributes::Scalar;
use crate::mesh::io::numbers::{Encoding, Kind, Order, shown};
use crate::mesh::io::{DataError, syntax};

/// A line that is longer is none of a header, and is read so far.
const LONGEST: usize = 4096;
/// Elements and properties of one header, together. Files in use have dozens.
const MOST_NAMES: usize = 4096;

/// Names of types: those that are written, and their newer ones.
const KINDS: [(&str, &str, Kind); 10] = [
    ("char", "int8", Kind::I8),
    ("uchar", "uint8", Kind::U8),
    ("short", "int16", Kind::I16),
    ("ushort", "uint16", Kind::U16),
    ("int", "int32", Kind::I32),
    ("uint", "uint32", Kind::U32),
    ("float", "float32", Kind::F32),
    ("double", "float64", Kind::F64),
    // Of other writers: these are never written.
    ("long", "int64", Kind::I64),
    ("ulong", "uint64", Kind::U64),
];

fn kind(name: &str) -> Option<Kind> {
    KINDS.iter().find(|(old, new, _)| *old == name || *new == name).map(|&(.., kind)| kind)
}

pub(super) fn name(kind: Kind) -> &'static str {
    KINDS.iter().find(|(.., known)| *known == kind).map_or("double", |&(name, ..)| name)
}

/// The type of a scalar's properties. Numbers of 64 bits become int where they fit, else double.
pub(super) fn written(scalar: &Scalar) -> Kind {
    let fit = |x: &f64| (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(x);
    match scalar.number {
        Kind::I64 | Kind::U64 if scalar.values.iter().all(fit) => Kind::I32,
        Kind::I64 | Kind::U64 => Kind::F64,
        kind => kind,
    }
}

/// A number of an element, or a list of them.
#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    /// Type of the length of a list.
    pub(super) length: Option<Kind>,
    pub(super) item: Kind,
    /// The type, if it is not known. In text its numbers are words.
    pub(super) odd: Option<String>,
}

impl Property {
    pub(super) fn is_corners(&self) -> bool {
        matches!(self.name.as_str(), "vertex_indices" | "vertex_index")
            && self.length.is_some()
            && self.odd.is_none()
            && !self.item.is_float()
    }
}

#[derive(Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
}

pub(super) struct Header<'a> {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Those of which the data are not read, since the size of a property is not known.
    pub(super) unread: Vec<Element>,
    pub(super) data: &'a [u8],
    /// The line that the data begin at, from 1.
    pub(super) line: usize,
}

/// Elements of faces: of polygons, of strips of triangles.
pub(super) const FACES: [&str; 2] = ["face", STRIPS];
pub(super) const STRIPS: &str = "tristrips";

impl Header<'_> {
    pub(super) fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }
}

pub(super) fn read(bytes: &[u8]) -> Result<Header<'_>, DataError> {
    let (mut rest, line_break) = (bytes, line_break(bytes));
    let (mut encoding, mut elements) = (None, Vec::new());
    // Of a property whose type is not known.
    let mut unreadable = None;
    // Names of the current element, with how often each came.
    let mut names = HashMap::new();
    let mut declared = 0;
    for line in 1.. {
        if rest.is_empty() {
            break;
        }
        let end = rest.iter().position(|&b| b == line_break).unwrap_or(rest.len());
        let text = String::from_utf8_lossy(&rest[..end.min(LONGEST)]).into_owned();
        rest = rest.get(end + 1..).unwrap_or_default();
        let syntax = |message: &str| syntax(line, message);
        let wrong = |word: &str, text: &str| syntax(&format!("\"{}\" {text}", shown(word.trim().as_bytes())));
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        declared += usize::from(matches!(words[..], ["element" | "property", ..]));
        if declared > MOST_NAMES {
            return Err(syntax(&format!("the header has more than {MOST_NAMES} elements and properties")));
        }
        match words[..] {
            ["ply" | "PLY"] if line == 1 => {}
            _ if line == 1 => return Err(syntax("a PLY file begins with a line \"ply\"")),
            [] | ["comment" | "obj_info", ..] => {}
            ["format", name, version] if is_version(version) => {
                let found = match name {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::Binary(Order::Little),
                    "binary_big_endian" => Encoding::Binary(Order::Big),
                    _ => return Err(wrong(name, "is no format of PLY")),
                };
                if encoding.replace(found).is_some_and(|before| before != found) {
                    return Err(syntax("the format is declared a second time, as another one"));
                }
            }
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return Err(wrong(count, "is not the number of an element's rows"));
                };
                if elements.iter().any(|element: &Element| element.name == name) {
                    return Err(syntax(&format!("element \"{}\" is declared a second time", shown(name.as_bytes()))));
                }
                names.clear();
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", ref rest @ ..] => {
                let (length, item, name) = match *rest {
                    ["list", length, item, ref name @ ..] => (Some(length), item, name),
                    [item, ref name @ ..] => (None, item, name),
                    [] => return Err(syntax("a property has a type and a name")),
                };
                let odd = length.into_iter().chain([item]).find(|name| kind(name).is_none());
                if let Some(odd) = odd {
                    unreadable.get_or_insert((elements.len(), wrong(odd, "is no type of a property")));
                }
                let odd = odd.map(str::to_owned);
                let length = length.map(|name| kind(name).unwrap_or(Kind::U64));
                let item = kind(item).unwrap_or_default();
                let Some(element) = elements.last_mut().filter(|_| !name.is_empty()) else {
                    return Err(syntax("a property has a name, and an element before it"));
                };
                element.properties.push(Property { name: unlike(&mut names, name.join("_")), length, item, odd });
            }
            ["end_header"] => {
                let Some(encoding) = encoding else {
                    return Err(DataError::Header("there is no line \"format\"".to_owned()));
                };
                if let Some((number, error)) = unreadable {
                    let unread = Vec::new();
                    let mut header = Header { encoding, elements, unread, data: rest, line: line + 1 };
                    // The size of such a property is not known in binary data. Elements that matter stand before it, or it is text.
                    if encoding != Encoding::Text {
                        header.unread = header.elements.split_off(number - 1);
                    }
                    return if super::check_elements(&header).is_ok() { Ok(header) } else { Err(error) };
                }
                return Ok(Header { encoding, elements, unread: Vec::new(), data: rest, line: line + 1 });
            }
            _ => return Err(wrong(&text, "is no line of a header")),
        }
    }
    Err(DataError::Truncated("it ends inside the header".to_owned()))
}

/// Two integers with a dot between them.
fn is_version(text: &str) -> bool {
    let is_integer = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
    text.split_once('.').is_some_and(|(major, minor)| is_integer(major) && is_integer(minor))
}

/// The name, or one after it: two properties with one name are two all the same.
fn unlike(names: &mut HashMap<String, usize>, name: String) -> String {
    let mut other = name.clone();
    while names.contains_key(&other) {
        let count = names.entry(name.clone()).or_insert(0);
        *count += 1;
        other = if *count == 1 { format!("{name}_again") } else { format!("{name}_again{count}") };
    }
    names.insert(other.clone(), 0);
    other
}

/// The first character that ends a line ends all of them; a line feed may have a carriage return before it.
fn line_break(bytes: &[u8]) -> u8 {
    match bytes.iter().position(|b| matches!(b, b'\n' | b'\r')) {
        Some(at) if bytes[at] == b'\r' && bytes.get(at + 1) != Some(&b'\n') => b'\r',
        _ => b'\n',
    }
}
