//! What a surface carries, as messages.
//!
//! Purpose: [`check`] takes headers, [`collect`] uploaded arrays; [`headers`] and [`chunks`] make messages. Server and client
//! use all four: a remesh carries attributes both ways. Invariant: an attribute is known by its place in the list of headers,
//! in errors and in chunks. Must not know: streams, jobs, how attributes get to a result.

use glam::{DVec2, DVec3};

use super::chunks::{chunks as cut, facet_chunks, number_chunks, point_chunks};
use super::counts::MeshCounts;
use super::options::within;
use super::proto::{self, ArrayForm, ArrayKind, AttributeHeader, AttributeKind, AttributeType, Chunk};
use super::{WireError, unknown_enum};
use geometry::mesh::TriMesh;
use geometry::mesh::attributes::{
    AttributeError, Attributes, ColourDepth, Colours, MAX_COMPONENTS, Normals, PerCorner, Scalar, check_name,
};
use geometry::mesh::numbers::{NumberType, Order};
use geometry::mesh::regions::{MAX_REGIONS, Region, Regions};

/// Doubles hold all whole numbers up to this one.
const LARGEST_EXACT: f64 = 9_007_199_254_740_991.0;

/// The most bytes of names of regions.
const MOST_OF_NAMES: usize = 2 << 20;

/// The most attributes of a surface.
const MOST: usize = 256;

/// Types of numbers, by their names in headers and in arrays of jobs.
const TYPES: [(AttributeType, ArrayForm, NumberType); 10] = [
    (AttributeType::F64, ArrayForm::F64, NumberType::F64),
    (AttributeType::F32, ArrayForm::F32, NumberType::F32),
    (AttributeType::U8, ArrayForm::U8, NumberType::U8),
    (AttributeType::I8, ArrayForm::I8, NumberType::I8),
    (AttributeType::U16, ArrayForm::U16, NumberType::U16),
    (AttributeType::I16, ArrayForm::I16, NumberType::I16),
    (AttributeType::U32, ArrayForm::U32, NumberType::U32),
    (AttributeType::I32, ArrayForm::I32, NumberType::I32),
    (AttributeType::U64, ArrayForm::U64, NumberType::U64),
    (AttributeType::I64, ArrayForm::I64, NumberType::I64),
];

fn number(given: AttributeType) -> NumberType {
    TYPES.iter().find(|(known, ..)| *known == given).map_or(NumberType::F64, |&(.., number)| number)
}

/// The word of a type in the names of a result's parts: "F64".
pub fn word_of(number: NumberType) -> &'static str {
    let name = TYPES.iter().find(|(.., known)| *known == number).map_or("", |(_, form, _)| form.as_str_name());
    name.trim_start_matches("ARRAY_FORM_")
}

/// The type of an array of a job; none of a text.
pub fn type_of(form: ArrayForm) -> Option<AttributeType> {
    TYPES.iter().find(|(_, known, _)| *known == form).map(|&(given, ..)| given)
}

/// The numbers of an array of a job that is no text.
pub fn number_of(form: ArrayForm) -> NumberType {
    type_of(form).map_or(NumberType::F64, number)
}

/// A header that makes sense.
#[derive(Clone, Debug, PartialEq)]
pub struct AttributeCounts {
    pub kind: AttributeKind,
    pub name: String,
    /// Values, numbers of each, and their type.
    pub values: u64,
    pub numbers: u64,
    pub number: NumberType,
    pub by_corner: bool,
    /// Regions that have names.
    pub regions: Vec<Region>,
}

impl AttributeCounts {
    /// Of the values and of the corners. The latter is `Unspecified` where there are none.
    pub fn array_kinds(&self) -> (ArrayKind, ArrayKind) {
        match self.kind {
            AttributeKind::Normals => (ArrayKind::Normals, ArrayKind::NormalCorners),
            AttributeKind::TextureCoordinates => (ArrayKind::TextureCoordinates, ArrayKind::TextureCorners),
            AttributeKind::Colours => (ArrayKind::Colours, ArrayKind::Unspecified),
            AttributeKind::Regions => (ArrayKind::Regions, ArrayKind::Unspecified),
            AttributeKind::Scalar | AttributeKind::Unspecified => (ArrayKind::Scalars, ArrayKind::Unspecified),
        }
    }
}

#[derive(Debug)]
pub struct UploadedAttribute {
    pub counts: AttributeCounts,
    /// All numbers of all values.
    pub numbers: Vec<f64>,
    /// Empty if it is not given by corner.
    pub corners: Vec<[u32; 3]>,
}

/// Checks what is said of a mesh before anything of it arrives.
pub fn check(headers: &[AttributeHeader], mesh: MeshCounts) -> Result<Vec<AttributeCounts>, WireError> {
    // More values than corners cannot be of use, and would get around the limit on facets.
    check_within(headers, mesh, 3 * mesh.facets)
}

/// The same, with at most so many values by corner.
pub fn check_within(
    headers: &[AttributeHeader],
    mesh: MeshCounts,
    by_corner: u64,
) -> Result<Vec<AttributeCounts>, WireError> {
    if headers.len() > MOST {
        return Err(WireError::field("attributes", format!("has {} entries; {MOST} may be", headers.len())));
    }
    let mut all: Vec<AttributeCounts> = Vec::with_capacity(headers.len());
    for (i, header) in headers.iter().enumerate() {
        let counts = check_one(i, header, mesh, by_corner)?;
        if all.iter().any(|other| (other.kind, &other.name) == (counts.kind, &counts.name)) {
            let text = "is a second one of its kind and name";
            return Err(WireError::field(format!("attributes[{i}]"), text));
        }
        all.push(counts);
    }
    Ok(all)
}

fn check_one(i: usize, header: &AttributeHeader, mesh: MeshCounts, most: u64) -> Result<AttributeCounts, WireError> {
    let path = |field: &str| format!("attributes[{i}].{field}");
    let unknown = |field: &str, value: i32| unknown_enum(path(field), value);
    let AttributeHeader { kind, name, r#type, values, by_corner, components, regions } = header.clone();
    let known = AttributeKind::try_from(kind).ok().filter(|known| *known != AttributeKind::Unspecified);
    let kind = known.ok_or_else(|| unknown("kind", kind))?;
    let number = AttributeType::try_from(r#type).map(number).map_err(|_| unknown("type", r#type))?;
    let (is_scalar, is_region) = (kind == AttributeKind::Scalar, kind == AttributeKind::Regions);
    let is_wrong = match kind {
        AttributeKind::Regions => number.is_float(),
        AttributeKind::Colours => !number.is_float() && number != NumberType::U8,
        _ => !number.is_float() && !is_scalar,
    };
    if is_wrong && is_region {
        return Err(WireError::field(path("type"), "is one of numbers with fractions; regions have whole ones"));
    } else if is_wrong {
        let text = "is one of whole numbers; scalars and regions have these, and colours U8";
        return Err(WireError::field(path("type"), text));
    }
    if !is_region && !regions.is_empty() {
        return Err(WireError::field(path("regions"), "is given; it is for regions"));
    }
    if regions.len() > MAX_REGIONS {
        let text = format!("has {} entries; {MAX_REGIONS} may be", regions.len());
        return Err(WireError::field(path("regions"), text));
    }
    // They come back in one message, which clients take up to 4 MiB of.
    if regions.iter().map(|region| region.name.len()).sum::<usize>() > MOST_OF_NAMES {
        let text = format!("has names of more than {MOST_OF_NAMES} bytes; shorten them");
        return Err(WireError::field(path("regions"), text));
    }
    let named = |region: proto::Region| Region { number: region.number, name: region.name };
    let regions = regions.into_iter().map(named).collect();
    if is_scalar {
        check_name(&name).map_err(|error| WireError::field(path("name"), error.to_string()))?;
    } else if !name.is_empty() {
        return Err(WireError::field(path("name"), "is given; scalars alone have names"));
    } else if components != 0 {
        return Err(WireError::field(path("components"), "is given; it is for scalars"));
    }
    within(&path("components"), components.into(), 0, MAX_COMPONENTS as u64)?;
    let (numbers, by_corner) = match kind {
        AttributeKind::Normals => (3, by_corner),
        AttributeKind::TextureCoordinates => (2, true),
        AttributeKind::Colours => (4, false),
        AttributeKind::Regions => (1, false),
        AttributeKind::Scalar | AttributeKind::Unspecified => (components.max(1).into(), false),
    };
    match by_corner {
        true => within(&path("values"), values, 1, most)?,
        false if is_region && values != mesh.facets => {
            let text = format!("is {values}; give one value for each of the {} facets", mesh.facets);
            return Err(WireError::field(path("values"), text));
        }
        false if is_region => {}
        false if values != mesh.vertices => {
            let text = format!("is {values}; give one value for each of the {} vertices", mesh.vertices);
            return Err(WireError::field(path("values"), text));
        }
        false => {}
    }
    Ok(AttributeCounts { kind, name, values, numbers, number, by_corner, regions })
}

pub fn collect(mesh: &TriMesh, uploaded: Vec<UploadedAttribute>) -> Result<Attributes, WireError> {
    let mut attributes = Attributes::new(mesh);
    for (i, UploadedAttribute { counts, mut numbers, corners }) in uploaded.into_iter().enumerate() {
        let points = || numbers.as_chunks::<3>().0.iter().map(|&n| DVec3::from_array(n)).collect();
        let taken = match counts.kind {
            AttributeKind::Normals if counts.by_corner => {
                attributes.set_normals(Normals::PerCorner(PerCorner { values: points(), corners }))
            }
            AttributeKind::Normals => attributes.set_normals(Normals::PerVertex(points())),
            AttributeKind::TextureCoordinates => {
                let values = numbers.as_chunks::<2>().0.iter().map(|&uv| DVec2::from_array(uv)).collect();
                attributes.set_texture(PerCorner { values, corners })
            }
            AttributeKind::Colours => {
                let depth = if counts.number.is_float() { ColourDepth::Float } else { ColourDepth::Eight };
                if depth == ColourDepth::Eight {
                    numbers.iter_mut().for_each(|x| *x /= 255.0);
                }
                attributes.set_colours(Colours { values: numbers.as_chunks::<4>().0.to_vec(), depth })
            }
            AttributeKind::Regions => {
                if let Some(at) = numbers.iter().position(|x| x.abs() > LARGEST_EXACT) {
                    let text = "is not below 2^53, where whole numbers are rounded; give smaller ones";
                    return Err(WireError::field(format!("attributes[{i}].values[{at}]"), text));
                }
                let numbers: Vec<i64> = numbers.iter().map(|&x| x as i64).collect();
                let regions = Regions::of_named(&numbers, counts.regions).map_err(AttributeError::from);
                regions.and_then(|regions| attributes.set_regions(regions))
            }
            AttributeKind::Scalar | AttributeKind::Unspecified => attributes.add_scalar(Scalar {
                name: counts.name,
                number: counts.number,
                components: counts.numbers as usize,
                values: numbers,
            }),
        };
        taken.map_err(|error| {
            let path = match &error {
                AttributeError::NonFinite { index, .. } => format!("attributes[{i}].values[{index}]"),
                AttributeError::IndexOutOfRange { facet, corner, .. } => {
                    format!("attributes[{i}].corners[{facet}][{corner}]")
                }
                _ => format!("attributes[{i}]"),
            };
            WireError::field(path, error.to_string())
        })?;
    }
    Ok(attributes)
}

/// Headers of all that there is.
pub fn headers(attributes: &Attributes) -> Vec<AttributeHeader> {
    let mut all = Vec::new();
    let mut push = |kind: AttributeKind, name: &str, values: usize, by_corner, r#type: AttributeType| {
        let (kind, r#type) = (kind.into(), r#type.into());
        all.push(AttributeHeader {
            kind,
            name: name.to_owned(),
            r#type,
            values: values as u64,
            by_corner,
            components: 0,
            regions: Vec::new(),
        });
    };
    match attributes.normals() {
        Some(Normals::PerVertex(n)) => push(AttributeKind::Normals, "", n.len(), false, AttributeType::F64),
        Some(Normals::PerCorner(n)) => push(AttributeKind::Normals, "", n.values.len(), true, AttributeType::F64),
        None => {}
    }
    if let Some(texture) = attributes.texture() {
        push(AttributeKind::TextureCoordinates, "", texture.values.len(), true, AttributeType::F64);
    }
    if let Some(Colours { values, depth }) = attributes.colours() {
        let kind = if *depth == ColourDepth::Eight { AttributeType::U8 } else { AttributeType::F64 };
        push(AttributeKind::Colours, "", values.len(), false, kind);
    }
    for Scalar { name, number, components, values } in attributes.scalars() {
        let given = TYPES.iter().find(|(.., known)| known == number).map_or(AttributeType::F64, |&(given, ..)| given);
        all.push(AttributeHeader {
            kind: AttributeKind::Scalar.into(),
            name: name.clone(),
            r#type: given.into(),
            values: (values.len() / components) as u64,
            by_corner: false,
            components: *components as u32,
            regions: Vec::new(),
        });
    }
    if let Some(regions) = attributes.regions() {
        let of = |region: &Region| proto::Region { number: region.number, name: region.name.clone() };
        all.push(AttributeHeader {
            kind: AttributeKind::Regions.into(),
            r#type: AttributeType::I64.into(),
            values: regions.of_facet().len() as u64,
            regions: regions.all().iter().map(of).collect(),
            ..AttributeHeader::default()
        });
    }
    all
}

/// Headers of all that there is: what a request named, in its order, then what it asked for by options.
pub fn headers_like(attributes: &Attributes, request: &[AttributeCounts]) -> Vec<AttributeHeader> {
    let all = headers(attributes);
    let same = |a: &AttributeHeader, b: &AttributeCounts| (a.kind(), &a.name) == (b.kind, &b.name);
    let (mut named, more): (Vec<_>, Vec<_>) =
        all.into_iter().partition(|header| request.iter().any(|asked| same(header, asked)));
    named.sort_by_key(|header| request.iter().position(|asked| same(header, asked)));
    named.into_iter().chain(more).collect()
}

/// Chunks of some arrays, made one at a time.
type Chunks<'a> = Box<dyn Iterator<Item = Chunk> + Send + 'a>;

/// All arrays of `attributes`, under the places that `headers` gives them.
pub fn chunks<'a>(attributes: &'a Attributes, headers: &[AttributeHeader]) -> Vec<Chunks<'a>> {
    let mut all: Vec<Chunks<'a>> = Vec::new();
    match attributes.normals() {
        Some(Normals::PerVertex(normals)) => all.push(Box::new(point_chunks(ArrayKind::Normals, normals))),
        Some(Normals::PerCorner(normals)) => {
            all.push(Box::new(point_chunks(ArrayKind::Normals, &normals.values)));
            all.push(Box::new(facet_chunks(ArrayKind::NormalCorners, &normals.corners)));
        }
        None => {}
    }
    if let Some(texture) = attributes.texture() {
        let put = |uv: &DVec2, out: &mut Vec<u8>| {
            uv.to_array().iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes()));
        };
        all.push(Box::new(cut(ArrayKind::TextureCoordinates, &texture.values, 16, put)));
        all.push(Box::new(facet_chunks(ArrayKind::TextureCorners, &texture.corners)));
    }
    if let Some(Colours { values, depth }) = attributes.colours() {
        match depth {
            ColourDepth::Eight => {
                let put = |colour: &[f64; 4], out: &mut Vec<u8>| out.extend(colour.map(|x| (x * 255.0).round() as u8));
                all.push(Box::new(cut(ArrayKind::Colours, values, 4, put)));
            }
            ColourDepth::Float => all.push(Box::new(number_chunks(ArrayKind::Colours, values.as_flattened()))),
        }
    }
    for Scalar { name, number, values, .. } in attributes.scalars() {
        let is_it = |h: &AttributeHeader| h.kind == i32::from(AttributeKind::Scalar) && h.name == *name;
        let Some(attribute) = headers.iter().position(is_it).and_then(|i| u32::try_from(i).ok()) else { continue };
        let put = |x: &f64, out: &mut Vec<u8>| number.put(*x, Order::Little, out);
        let numbers = cut(ArrayKind::Scalars, values, number.bytes(), put);
        all.push(Box::new(numbers.map(move |chunk| Chunk { attribute, ..chunk })));
    }
    if let Some(regions) = attributes.regions() {
        let put = |&region: &u32, out: &mut Vec<u8>| {
            out.extend_from_slice(&regions.all()[region as usize].number.to_le_bytes());
        };
        all.push(Box::new(cut(ArrayKind::Regions, regions.of_facet(), 8, put)));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(kind: AttributeKind, values: u64) -> AttributeHeader {
        let name = if kind == AttributeKind::Scalar { "a".to_owned() } else { String::new() };
        AttributeHeader { kind: kind.into(), values, name, ..AttributeHeader::default() }
    }

    #[test]
    fn headers_are_checked_before_anything_arrives() {
        let mesh = MeshCounts { vertices: 4, facets: 2, coordinate_bytes: 8, ..MeshCounts::default() };
        let path = |headers: &[AttributeHeader]| match check(headers, mesh) {
            Err(WireError::Field { path, .. }) => path,
            other => panic!("{other:?}"),
        };
        let scalar = header(AttributeKind::Scalar, 4);
        let all = [header(AttributeKind::TextureCoordinates, 6), scalar.clone(), header(AttributeKind::Colours, 4)];
        assert_eq!(check(&all, mesh).unwrap().len(), 3);
        assert_eq!(path(&[scalar.clone(), scalar.clone()]), "attributes[1]");
        assert_eq!(path(&[header(AttributeKind::Normals, 3)]), "attributes[0].values");
        assert_eq!(path(&[header(AttributeKind::TextureCoordinates, 7)]), "attributes[0].values");
        assert_eq!(path(&[header(AttributeKind::TextureCoordinates, 0)]), "attributes[0].values");
        assert_eq!(path(&[header(AttributeKind::Unspecified, 4)]), "attributes[0].kind");
        assert_eq!(path(&[AttributeHeader { name: "a\nb".into(), ..scalar.clone() }]), "attributes[0].name");
        assert_eq!(path(&[AttributeHeader { r#type: 99, ..scalar.clone() }]), "attributes[0].type");
        let texture = || header(AttributeKind::TextureCoordinates, 6);
        assert_eq!(path(&[AttributeHeader { r#type: 3, ..texture() }]), "attributes[0].type");
        assert_eq!(path(&[AttributeHeader { components: 2, ..texture() }]), "attributes[0].components");
        assert_eq!(path(&[AttributeHeader { components: 65, ..scalar.clone() }]), "attributes[0].components");
        assert_eq!(path(&vec![scalar; 257]), "attributes");
        let regions = AttributeHeader { r#type: 8, ..header(AttributeKind::Regions, 2) };
        assert_eq!(check(std::slice::from_ref(&regions), mesh).unwrap()[0].numbers, 1);
        assert_eq!(path(&[AttributeHeader { values: 4, ..regions.clone() }]), "attributes[0].values");
        assert_eq!(path(&[AttributeHeader { r#type: 2, ..regions.clone() }]), "attributes[0].type");
        assert_eq!(path(&[AttributeHeader { name: "a".into(), ..regions.clone() }]), "attributes[0].name");
        let named = vec![proto::Region { number: 1, name: "steel".into() }];
        assert_eq!(path(&[AttributeHeader { regions: named.clone(), ..texture() }]), "attributes[0].regions");
        assert!(check(&[AttributeHeader { regions: named, ..regions.clone() }], mesh).is_ok());
        let long = |number| proto::Region { number, name: "a".repeat(128) };
        let long = (0..1 + (MOST_OF_NAMES / 128) as i64).map(long).collect();
        assert_eq!(path(&[AttributeHeader { regions: long, ..regions }]), "attributes[0].regions");
    }
}
