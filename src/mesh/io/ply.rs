//! Stanford PLY: ascii and both binary orders, read through the `ply-rs-bw` crate.
//!
//! Purpose: bytes to triangles and back. `vertex` needs scalar properties x, y, z; `face` a list property
//! `vertex_indices` or `vertex_index`. All else is skipped.
//! Why the ascii data are read here ([`ascii`]): the crate's grammar knows no `.5`, no `1.` and no `nan`,
//! and wants each element on a line of its own; files in use have all of them.
//! Why most binary data are, too ([`records`]): the crate goes through a call for each number, at a tenth of the
//! speed of memory.
//! Why a header is looked at before the crate gets it ([`header`]): it refuses what many files have.
//! Invariant: declared counts are checked against the bytes that are there before anything is read.
//! Must not know: other formats.

use std::io::ErrorKind;

use glam::DVec3;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    BeginList, ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};

use super::held::Held;
use super::{DataError, Soup};
use crate::mesh::TriMesh;

mod ascii;
mod attributes;
mod counts;
mod header;
mod records;
pub(super) use attributes::{attributes, encode_with};
pub(super) use counts::counts;
use header::Parted;

pub(super) fn decode(bytes: &[u8]) -> Result<Soup, DataError> {
    let Parted { header, data, line } = header::read(bytes)?;
    check_header(&header, data.len())?;
    if header.encoding == Encoding::Ascii {
        return ascii::decode(data, line, &header);
    }
    if let Some(soup) = records::decode(data, &header) {
        return Ok(soup);
    }
    let (mut reader, vertices) = (Reader::new(data), Parser::<Vertex>::new());
    let mut soup = Soup::default();
    let mut faces = Vec::new();
    for (name, element) in &header.elements {
        match name.as_str() {
            "vertex" => {
                let read = vertices.read_payload_for_element(&mut reader, element, &header);
                soup.positions = read.map_err(payload_error)?.into_iter().map(|v| v.0).collect();
            }
            "face" => {
                let read = Parser::<Face>::new().read_payload_for_element(&mut reader, element, &header);
                faces = read.map_err(payload_error)?;
            }
            _ => {
                let read = Parser::<Skipped>::new().read_payload_for_element(&mut reader, element, &header);
                read.map_err(payload_error)?;
            }
        }
    }
    soup.facets.reserve(faces.len());
    let mut corners = Vec::new();
    for (index, face) in faces.iter().enumerate() {
        face.corners(&mut corners);
        let pushed = soup.push_polygon(&corners);
        pushed.map_err(|message| DataError::Element { element: "face", index, message })?;
    }
    Ok(soup)
}

pub(super) fn encode(mesh: &TriMesh) -> Vec<u8> {
    encode_with(mesh, &Held::default())
}

/// Refuses headers without a surface, and counts that the remaining bytes cannot hold.
fn check_header(header: &Header, remaining: usize) -> Result<(), DataError> {
    let element = |name: &str| {
        header.elements.get(name).ok_or_else(|| {
            let strips = header.elements.contains_key("tristrips");
            let hint = if strips { "; strips (\"tristrips\") are not read, write them as faces" } else { "" };
            DataError::Header(format!("there is no element \"{name}\"{hint}"))
        })
    };
    let is_scalar = |e: &ElementDef, n: &str| matches!(e.properties.get(n), Some(p) if matches!(p.data_type, PropertyType::Scalar(_)));
    let vertex = element("vertex")?;
    if let Some(missing) = ["x", "y", "z"].into_iter().find(|n| !is_scalar(vertex, n)) {
        return Err(DataError::Header(format!("element \"vertex\" has no scalar property \"{missing}\"")));
    }
    let is_index_list = |data_type: &PropertyType| match data_type {
        PropertyType::List(_, item) => !matches!(item, ScalarType::Float | ScalarType::Double),
        PropertyType::Scalar(_) => false,
    };
    if !element("face")?.properties.iter().any(|(n, p)| is_index_name(n) && is_index_list(&p.data_type)) {
        let message = "element \"face\" has no list property \"vertex_indices\" or \"vertex_index\" of integers";
        return Err(DataError::Header(message.to_owned()));
    }
    let mut needed = 0u128;
    for (name, element) in &header.elements {
        let sizes = element.properties.values().map(|p| least_bytes(&p.data_type, header.encoding));
        // An ascii element is a line; a binary one without properties would be nothing at all,
        // and any number of them would fit.
        let each: u128 = sizes.sum();
        if each == 0 && element.count > 0 {
            return Err(DataError::Header(format!("element \"{name}\" has no properties")));
        }
        needed += each * element.count as u128;
    }
    // The last line of an ascii file may lack its line break.
    if needed > remaining as u128 + 1 {
        let message = format!("the header declares at least {needed} bytes of data and {remaining} follow");
        return Err(DataError::Truncated(message));
    }
    Ok(())
}

fn least_bytes(data_type: &PropertyType, encoding: Encoding) -> u128 {
    let (PropertyType::Scalar(first) | PropertyType::List(first, _)) = data_type;
    match (encoding, first) {
        // A digit and what separates it from the next.
        (Encoding::Ascii, _) => 2,
        (_, ScalarType::Char | ScalarType::UChar) => 1,
        (_, ScalarType::Short | ScalarType::UShort) => 2,
        (_, ScalarType::Int | ScalarType::UInt | ScalarType::Float) => 4,
        (_, ScalarType::Double) => 8,
    }
}

fn is_index_name(name: &str) -> bool {
    matches!(name, "vertex_indices" | "vertex_index")
}

fn header_error(error: ParseError) -> DataError {
    match (error.kind(), error.line()) {
        (ErrorKind::UnexpectedEof, _) => DataError::Truncated("it ends inside the header".to_owned()),
        (_, Some(line)) => DataError::Syntax { line, message: first_line(&error) },
        (_, None) => DataError::Header(first_line(&error)),
    }
}

fn payload_error(error: ParseError) -> DataError {
    match (error.kind(), error.line()) {
        (ErrorKind::UnexpectedEof, _) => DataError::Truncated(first_line(&error)),
        (_, Some(line)) => DataError::Syntax { line, message: first_line(&error) },
        (_, None) => DataError::Header(first_line(&error)),
    }
}

/// The crate's messages quote the input over several lines; one short line is enough.
fn first_line(error: &ParseError) -> String {
    let text = error.to_string().replace(['\n', '\t'], " ");
    let text = text
        .split_once(": ")
        .map_or(text.as_str(), |(head, tail)| if head.starts_with("Line ") { tail } else { &text });
    text.chars().take(160).collect::<String>().trim().to_owned()
}

#[derive(Default)]
struct Vertex(DVec3);

impl Vertex {
    fn set(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        match name {
            "x" => self.0.x = value,
            "y" => self.0.y = value,
            "z" => self.0.z = value,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match property {
            Property::Char(v) => self.set(name, f64::from(v)),
            Property::UChar(v) => self.set(name, f64::from(v)),
            Property::Short(v) => self.set(name, f64::from(v)),
            Property::UShort(v) => self.set(name, f64::from(v)),
            Property::Int(v) => self.set(name, f64::from(v)),
            Property::UInt(v) => self.set(name, f64::from(v)),
            Property::Float(v) => self.set(name, f64::from(v)),
            Property::Double(v) => self.set(name, v),
            _ => PropertyAccessResult::Ignored,
        }
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        self.set(name, f64::from(value))
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        self.set(name, value)
    }
}

/// `int` and `uint` lists, which all known writers use, are filled in place; narrower types
/// are widened.
#[derive(Default)]
struct Face {
    signed: Vec<i32>,
    unsigned: Vec<u32>,
}

impl Face {
    fn corners(&self, out: &mut Vec<i64>) {
        out.clear();
        out.extend(self.signed.iter().map(|&v| i64::from(v)));
        out.extend(self.unsigned.iter().map(|&v| i64::from(v)));
    }
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn begin_list_int(&mut self, name: &str, _: usize) -> BeginList<'_, i32> {
        if is_index_name(name) { BeginList::Fill(&mut self.signed) } else { BeginList::UseSetter }
    }

    fn begin_list_uint(&mut self, name: &str, _: usize) -> BeginList<'_, u32> {
        if is_index_name(name) { BeginList::Fill(&mut self.unsigned) } else { BeginList::UseSetter }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if !is_index_name(name) {
            return PropertyAccessResult::Ignored;
        }
        match property {
            Property::ListChar(list) => self.signed = list.into_iter().map(i32::from).collect(),
            Property::ListUChar(list) => self.signed = list.into_iter().map(i32::from).collect(),
            Property::ListShort(list) => self.signed = list.into_iter().map(i32::from).collect(),
            Property::ListUShort(list) => self.signed = list.into_iter().map(i32::from).collect(),
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}
