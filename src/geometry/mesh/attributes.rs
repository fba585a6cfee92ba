//! Attributes of a surface: normals, texture coordinates, colours, scalars, regions.
//!
//! Purpose: [`Attributes`] stands beside a [`TriMesh`], which knows nothing of it. Invariant: every array has the count that
//! the mesh asks for, indices are in range and numbers finite; normals are of unit length, or zero where none is known;
//! names of scalars differ. Must not know: files, messages, how attributes get from one mesh to another.

use glam::{DVec2, DVec3};

use super::numbers::NumberType;
use super::regions::{Regions, RegionsError};
use super::{MAX_ELEMENTS, TriMesh};

/// Values by corner, so that facets around a vertex may have different ones; such edges are seams.
#[derive(Clone, Debug, PartialEq)]
pub struct PerCorner<T> {
    /// The values, each once or more often.
    pub values: Vec<T>,
    /// For each facet, the value at each of its corners: indices into `values`.
    pub corners: Vec<[u32; 3]>,
}

/// Directions that shading takes for the surface's.
#[derive(Clone, Debug, PartialEq)]
pub enum Normals {
    /// One for each vertex.
    PerVertex(Vec<DVec3>),
    /// Facets around a vertex may differ, as at creases.
    PerCorner(PerCorner<DVec3>),
}

/// How a file held colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColourDepth {
    /// Whole numbers from 0 to 255, here divided by 255; a file that can hold them so gets them so.
    Eight,
    /// Floating point.
    #[default]
    Float,
}

/// Red, green, blue and opacity of each vertex, nominally from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Colours {
    /// One for each vertex. Opacity is 1 where none was given.
    pub values: Vec<[f64; 4]>,
    /// Number type of the source.
    pub depth: ColourDepth,
}

/// A named number of each vertex, or a vector or tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Scalar {
    /// Name: text without control characters and without spaces at its ends. At most [`MAX_NAME_BYTES`].
    pub name: String,
    /// Type in the source. A remesh interpolates numbers with fractions, and takes whole ones from the nearest vertex.
    pub number: NumberType,
    /// Numbers of each vertex, 1 to [`MAX_COMPONENTS`].
    pub components: usize,
    /// `components` for each vertex, any unit.
    pub values: Vec<f64>,
}

impl Scalar {
    /// One number with fractions for each vertex.
    pub fn new(name: impl Into<String>, values: Vec<f64>) -> Self {
        Self { name: name.into(), number: NumberType::F64, components: 1, values }
    }
}

/// The most numbers that a scalar has at each vertex.
pub const MAX_COMPONENTS: usize = 64;

/// Doubles hold all whole numbers below this one, which may itself be another one rounded.
const LEAST_INEXACT: f64 = 9_007_199_254_740_992.0;

/// The longest name of a scalar, bytes.
pub const MAX_NAME_BYTES: usize = 128;

/// Why an attribute was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AttributeError {
    /// An array is too short or too long.
    #[error("{attribute}: {count} are given for {expected} {of}; give one for each")]
    Count {
        /// Which attribute.
        attribute: String,
        /// How many were given.
        count: usize,
        /// How many the mesh asks for.
        expected: usize,
        /// "vertices" or "facets".
        of: &'static str,
    },
    /// A number is NaN or infinite.
    #[error("{attribute}: value {index} is not finite")]
    NonFinite {
        /// Which attribute.
        attribute: String,
        /// Which of its values, from 0.
        index: usize,
    },
    /// A corner names a value that is not there.
    #[error("{attribute}: facet {facet}, corner {corner} names value {index}, but there are {values}")]
    IndexOutOfRange {
        /// Which attribute.
        attribute: String,
        /// Index of the facet, from 0.
        facet: usize,
        /// 0, 1 or 2.
        corner: usize,
        /// The index as given.
        index: u32,
        /// Number of values.
        values: usize,
    },
    /// More values than 32-bit indices can name.
    #[error("{attribute}: {count} values are more than 32-bit indices can name")]
    TooLarge {
        /// Which attribute.
        attribute: String,
        /// How many were given.
        count: usize,
    },
    /// A scalar's name will not do.
    #[error("a scalar cannot be named {name:?}: {reason}")]
    Name {
        /// The name as given, at most [`MAX_NAME_BYTES`] of it.
        name: String,
        /// The defect.
        reason: &'static str,
    },
    /// A vertex has no number, or too many.
    #[error("scalar {name:?} has {components} numbers a vertex; 1 to {MAX_COMPONENTS} are possible")]
    Components {
        /// The scalar's name.
        name: String,
        /// How many were given.
        components: usize,
    },
    /// A whole number that double precision rounds.
    #[error("scalar {name:?}: value {index} is not below 2^53, where whole numbers are rounded; give smaller ones")]
    Inexact {
        /// The scalar's name.
        name: String,
        /// Which of its values, from 0.
        index: usize,
    },
    /// Regions will not do.
    #[error(transparent)]
    Regions(#[from] RegionsError),
    /// A file holds it in a way that cannot be understood.
    #[error("{attribute}: {message}")]
    Unreadable {
        /// Which attribute.
        attribute: String,
        /// Where and why.
        message: String,
    },
    /// The attributes were made for a mesh of other counts.
    #[error("the attributes are of a mesh with {vertices} vertices and {facets} facets, not of this one")]
    OtherMesh {
        /// Vertices of that mesh.
        vertices: usize,
        /// Facets of that mesh.
        facets: usize,
    },
}

/// The attributes of a mesh, empty at first. What would break the invariant is refused, with its name and the value's index.
///
/// ```
/// use tessera::mesh::attributes::{AttributeError, Attributes, Scalar};
/// use tessera::mesh::shapes::Shape;
/// let mesh = Shape::Square.build(2);
/// let mut attributes = Attributes::new(&mesh);
/// attributes.add_scalar(Scalar::new("height", vec![0.0; 4]))?;
/// let short = attributes.add_scalar(Scalar::new("width", vec![0.0; 3]));
/// assert!(matches!(short, Err(AttributeError::Count { count: 3, expected: 4, .. })));
/// # Ok::<(), AttributeError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Attributes {
    vertices: usize,
    facets: usize,
    normals: Option<Normals>,
    texture: Option<PerCorner<DVec2>>,
    colours: Option<Colours>,
    scalars: Vec<Scalar>,
    regions: Option<Regions>,
}

const NORMALS: &str = "normals";
const TEXTURE: &str = "texture coordinates";
const COLOURS: &str = "colours";

impl Attributes {
    /// No attributes, for `mesh`.
    pub fn new(mesh: &TriMesh) -> Self {
        Self {
            vertices: mesh.positions().len(),
            facets: mesh.facets().len(),
            normals: None,
            texture: None,
            colours: None,
            scalars: Vec::new(),
            regions: None,
        }
    }

    /// Those of a mesh whose vertices are these of the present one, some twice or not at all, with as many facets.
    pub(crate) fn of_vertices(&self, kept: &[u32]) -> Self {
        fn select<T: Clone>(values: &mut Vec<T>, each: usize, kept: &[u32]) {
            *values = kept.iter().flat_map(|&v| values[each * v as usize..][..each].iter().cloned()).collect();
        }
        let mut all = self.clone();
        all.vertices = kept.len();
        if let Some(Normals::PerVertex(values)) = &mut all.normals {
            select(values, 1, kept);
        }
        if let Some(Colours { values, .. }) = &mut all.colours {
            select(values, 1, kept);
        }
        for Scalar { components, values, .. } in &mut all.scalars {
            select(values, *components, kept);
        }
        all
    }

    /// Those of a mesh that has these vertices and facets of the present one.
    pub(crate) fn of_part(&self, vertices: &[u32], facets: &[u32]) -> Self {
        let mut all = self.of_vertices(vertices);
        all.facets = facets.len();
        let select = |corners: &[[u32; 3]]| facets.iter().map(|&f| corners[f as usize]).collect();
        if let Some(Normals::PerCorner(normals)) = &mut all.normals {
            normals.corners = select(&normals.corners);
        }
        if let Some(texture) = &mut all.texture {
            texture.corners = select(&texture.corners);
        }
        all.regions = self.regions.as_ref().map(|regions| regions.of(Some(facets)).into_owned());
        all
    }

    /// Those of a mesh that has first this one's vertices and facets, then the other's. `own` are this one's facets. Both have the same
    /// attributes; of normals the other's may be by corner where this one's are by vertex.
    pub(crate) fn followed_by(mut self, own: &[[u32; 3]], other: Self) -> Self {
        fn append<T>(first: &mut PerCorner<T>, second: PerCorner<T>) {
            let values = first.values.len() as u32;
            first.values.extend(second.values);
            first.corners.extend(second.corners.iter().map(|corners| corners.map(|k| k + values)));
        }
        self.vertices += other.vertices;
        self.facets += other.facets;
        match (&mut self.normals, other.normals) {
            (Some(Normals::PerVertex(values)), Some(Normals::PerVertex(more))) => values.extend(more),
            (Some(Normals::PerCorner(normals)), Some(Normals::PerCorner(more))) => append(normals, more),
            (Some(normals), Some(Normals::PerCorner(more))) => {
                if let Normals::PerVertex(values) = normals {
                    let mut all = PerCorner { values: std::mem::take(values), corners: own.to_vec() };
                    append(&mut all, more);
                    *normals = Normals::PerCorner(all);
                }
            }
            (normals, _) => *normals = None,
        }
        match (&mut self.texture, other.texture) {
            (Some(texture), Some(more)) => append(texture, more),
            (texture, _) => *texture = None,
        }
        match (&mut self.colours, other.colours) {
            (Some(colours), Some(more)) => colours.values.extend(more.values),
            (colours, _) => *colours = None,
        }
        self.scalars.iter_mut().zip(other.scalars).for_each(|(own, more)| own.values.extend(more.values));
        self.regions = self.regions.zip(other.regions).map(|(own, more)| {
            let of_facet = own.of_facet().iter().chain(more.of_facet()).copied().collect();
            own.with_facets(of_facet)
        });
        self
    }

    /// Takes normals, of any length but infinite; they are made unit. A normal of length 0 means that none is known there.
    pub fn set_normals(&mut self, mut normals: Normals) -> Result<(), AttributeError> {
        match &normals {
            Normals::PerVertex(values) => check_count(NORMALS, values.len(), self.vertices, "vertices")?,
            Normals::PerCorner(normals) => self.check_corners(NORMALS, normals)?,
        }
        let (Normals::PerVertex(values) | Normals::PerCorner(PerCorner { values, .. })) = &mut normals;
        check_finite(NORMALS, values, |n| n.is_finite())?;
        values.iter_mut().for_each(|n| *n = unit(*n));
        self.normals = Some(normals);
        Ok(())
    }

    /// Takes texture coordinates: u and v of each corner.
    pub fn set_texture(&mut self, texture: PerCorner<DVec2>) -> Result<(), AttributeError> {
        self.check_corners(TEXTURE, &texture)?;
        check_finite(TEXTURE, &texture.values, |uv| uv.is_finite())?;
        self.texture = Some(texture);
        Ok(())
    }

    /// Takes colours. Numbers from 0 to 255, as some programs write, are divided by 255: whole numbers of which one exceeds 1,
    /// or fractions of which most are at least 2. Others stay as they are.
    pub fn set_colours(&mut self, mut colours: Colours) -> Result<(), AttributeError> {
        check_count(COLOURS, colours.values.len(), self.vertices, "vertices")?;
        check_finite(COLOURS, &colours.values, |c| c.iter().all(|x| x.is_finite()))?;
        colours.divide_bytes();
        self.colours = Some(colours);
        Ok(())
    }

    /// Takes one more scalar. Values may be NaN, where nothing was measured, and not infinite. Single precision becomes double,
    /// and so does a type of whole numbers that does not hold all values.
    pub fn add_scalar(&mut self, mut scalar: Scalar) -> Result<(), AttributeError> {
        let Scalar { name, components, values, .. } = &scalar;
        check_name(name)?;
        let name = || name.clone();
        if self.scalars.iter().any(|other| other.name == scalar.name) {
            return Err(AttributeError::Name { name: name(), reason: "another scalar has this name" });
        }
        if !(1..=MAX_COMPONENTS).contains(components) {
            return Err(AttributeError::Components { name: name(), components: *components });
        }
        let attribute = format!("scalar {:?}", scalar.name);
        if !values.len().is_multiple_of(*components) {
            let (count, expected) = (values.len(), components * self.vertices);
            return Err(AttributeError::Count { attribute, count, expected, of: "vertices" });
        }
        check_count(&attribute, values.len() / components, self.vertices, "vertices")?;
        check_finite(&attribute, values, |x| !x.is_infinite())?;
        if scalar.number.is_float() || !values.iter().all(|&x| scalar.number.has(x)) {
            scalar.number = NumberType::F64;
        } else if let Some(index) = values.iter().position(|x| x.abs() >= LEAST_INEXACT) {
            return Err(AttributeError::Inexact { name: name(), index });
        }
        self.scalars.push(scalar);
        Ok(())
    }

    /// Whether any has a value for each vertex or corner.
    pub(crate) fn are_by_vertex(&self) -> bool {
        self.normals.is_some() || self.texture.is_some() || self.colours.is_some() || !self.scalars.is_empty()
    }

    /// Keeps the scalars whose names are accepted.
    pub(crate) fn retain_scalars(&mut self, keep: impl Fn(&str) -> bool) {
        self.scalars.retain(|scalar| keep(&scalar.name));
    }

    /// Takes the region of each facet.
    pub fn set_regions(&mut self, regions: Regions) -> Result<(), AttributeError> {
        check_count("regions", regions.of_facet().len(), self.facets, "facets")?;
        self.regions = Some(regions);
        Ok(())
    }

    /// The regions, if any.
    pub fn regions(&self) -> Option<&Regions> {
        self.regions.as_ref()
    }

    /// The normals, if any.
    pub fn normals(&self) -> Option<&Normals> {
        self.normals.as_ref()
    }

    /// The texture coordinates, if any.
    pub fn texture(&self) -> Option<&PerCorner<DVec2>> {
        self.texture.as_ref()
    }

    /// The colours, if any.
    pub fn colours(&self) -> Option<&Colours> {
        self.colours.as_ref()
    }

    /// Scalars, in the order in which they were added.
    pub fn scalars(&self) -> &[Scalar] {
        &self.scalars
    }

    /// Whether the mesh has no attributes.
    pub fn is_empty(&self) -> bool {
        self.normals.is_none()
            && self.texture.is_none()
            && self.colours.is_none()
            && self.scalars.is_empty()
            && self.regions.is_none()
    }

    /// Checks that they can be `mesh`'s.
    pub fn check_mesh(&self, mesh: &TriMesh) -> Result<(), AttributeError> {
        if (self.vertices, self.facets) == (mesh.positions().len(), mesh.facets().len()) {
            return Ok(());
        }
        Err(AttributeError::OtherMesh { vertices: self.vertices, facets: self.facets })
    }

    fn check_corners<T>(&self, attribute: &str, given: &PerCorner<T>) -> Result<(), AttributeError> {
        check_count(attribute, given.corners.len(), self.facets, "facets")?;
        let values = given.values.len();
        if values > MAX_ELEMENTS {
            return Err(AttributeError::TooLarge { attribute: attribute.to_owned(), count: values });
        }
        for (facet, corners) in given.corners.iter().enumerate() {
            if let Some(corner) = corners.iter().position(|&i| i as usize >= values) {
                let (attribute, index) = (attribute.to_owned(), corners[corner]);
                return Err(AttributeError::IndexOutOfRange { attribute, facet, corner, index, values });
            }
        }
        Ok(())
    }
}

/// Most fractions from 0 to 255 are at least this. Light from 0 to 1 may be brighter than that, but in few places.
const LEAST_BYTE: f64 = 2.0;

/// Whether numbers are from 0 to 255, and not from 0 to 1.
fn are_bytes(numbers: impl Iterator<Item = f64>) -> bool {
    let (mut are_whole, mut exceeds_one, mut positive, mut large) = (true, false, 0usize, 0usize);
    for x in numbers {
        if !(0.0..=255.0).contains(&x) {
            return false;
        }
        are_whole &= x.fract() == 0.0;
        exceeds_one |= x > 1.0;
        positive += usize::from(x > 0.0);
        large += usize::from(x >= LEAST_BYTE);
    }
    if are_whole { exceeds_one } else { 2 * large >= positive }
}

impl Colours {
    /// How many components a file with bytes cuts: they are not from 0 to 1.
    pub(crate) fn outside(&self) -> usize {
        // Half a step of bytes is their rounding.
        let beyond = |x: &&f64| !(-0.5 / 255.0..=1.0 + 0.5 / 255.0).contains(*x);
        self.values.iter().flatten().filter(beyond).count()
    }

    /// Makes colours from 0 to 255 such from 0 to 1. Opacity may have either range.
    fn divide_bytes(&mut self) {
        if !are_bytes(self.values.iter().flat_map(|colour| colour[..3].iter().copied())) {
            return;
        }
        let opacity = are_bytes(self.values.iter().map(|colour| colour[3]));
        for colour in &mut self.values {
            colour[..if opacity { 4 } else { 3 }].iter_mut().for_each(|x| *x /= 255.0);
        }
        let is_byte = |x: &f64| (0.0..=1.0).contains(x) && (255.0 * x).round() / 255.0 == *x;
        if self.values.iter().flatten().all(is_byte) {
            self.depth = ColourDepth::Eight;
        }
    }
}

impl<T: Copy + PartialEq + Default> PerCorner<T> {
    /// One value for each vertex, if the mesh's facets around each vertex agree; the default for one without a facet.
    pub fn per_vertex(&self, facets: &[[u32; 3]], vertices: usize) -> Option<Vec<T>> {
        let mut values: Vec<Option<T>> = vec![None; vertices];
        for (&vertex, &index) in facets.iter().flatten().zip(self.corners.iter().flatten()) {
            let value = self.values[index as usize];
            if *values[vertex as usize].get_or_insert(value) != value {
                return None;
            }
        }
        Some(values.into_iter().map(Option::unwrap_or_default).collect())
    }
}

/// Scales to length 1. A vector of length 1 up to rounding keeps its bits; zero stays zero.
pub fn unit(v: DVec3) -> DVec3 {
    if (v.length_squared() - 1.0).abs() <= 1e-14 {
        return v;
    }
    // Scaled first, so that squares neither overflow nor vanish.
    let size = v.abs().max_element();
    if size > 0.0 { (v / size).normalize() } else { DVec3::ZERO }
}

/// Whether a scalar can have this name.
pub fn check_name(name: &str) -> Result<(), AttributeError> {
    let reason = if name.is_empty() {
        "give it one"
    } else if name.len() > MAX_NAME_BYTES {
        "a name has at most 128 bytes"
    } else if name.contains(char::is_control) || name.trim() != name {
        "leave out control characters, and spaces at its ends"
    } else {
        return Ok(());
    };
    Err(AttributeError::Name { name: name.chars().take(MAX_NAME_BYTES).collect(), reason })
}

fn check_count(attribute: &str, count: usize, expected: usize, of: &'static str) -> Result<(), AttributeError> {
    if count == expected {
        return Ok(());
    }
    Err(AttributeError::Count { attribute: attribute.to_owned(), count, expected, of })
}

fn check_finite<T>(attribute: &str, values: &[T], finite: impl Fn(&T) -> bool) -> Result<(), AttributeError> {
    let wrong = |index| Err(AttributeError::NonFinite { attribute: attribute.to_owned(), index });
    values.iter().position(|value| !finite(value)).map_or(Ok(()), wrong)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn what_is_wrong_is_named() {
        let mesh = Shape::Square.build(2);
        let mut attributes = Attributes::new(&mesh);
        let short = attributes.set_normals(Normals::PerVertex(vec![DVec3::Z; 3])).unwrap_err();
        assert!(matches!(short, AttributeError::Count { count: 3, expected: 4, of: "vertices", .. }));
        let uv = |corners| PerCorner { values: vec![DVec2::ZERO; 2], corners };
        let few = attributes.set_texture(uv(vec![[0, 1, 1]])).unwrap_err();
        assert!(matches!(few, AttributeError::Count { count: 1, expected: 2, of: "facets", .. }));
        let far = attributes.set_texture(uv(vec![[0, 1, 1], [0, 2, 0]])).unwrap_err();
        assert!(matches!(far, AttributeError::IndexOutOfRange { facet: 1, corner: 1, index: 2, values: 2, .. }));
        let mut values = vec![[1.0; 4]; 4];
        values[2][3] = f64::NAN;
        let nan = attributes.set_colours(Colours { values, depth: ColourDepth::Float }).unwrap_err();
        assert!(matches!(nan, AttributeError::NonFinite { index: 2, .. }));
        attributes.add_scalar(Scalar::new("a", vec![0.0; 4])).unwrap();
        attributes.add_scalar(Scalar::new("gaps", vec![0.0, f64::NAN, 1.0, 2.0])).unwrap();
        for name in ["", "a", " b", "b\n", "a\tb", "\u{7f}", &"x".repeat(129)] {
            assert!(
                matches!(attributes.add_scalar(Scalar::new(name, vec![0.0; 4])), Err(AttributeError::Name { .. })),
                "{name}"
            );
        }
        for name in ["von Mises (MPa)", "Température", "1a", "a/b"] {
            attributes.add_scalar(Scalar::new(name, vec![0.0; 4])).unwrap();
        }
        assert!(attributes.check_mesh(&mesh).is_ok());
        assert!(attributes.check_mesh(&Shape::Plane.build(500)).is_err());
    }

    #[test]
    fn colours_up_to_255_are_divided() {
        let mut attributes = Attributes::new(&Shape::Square.build(2));
        let mut set = |values: [[f64; 4]; 4]| {
            attributes.set_colours(Colours { values: values.to_vec(), depth: ColourDepth::Float }).unwrap();
            let Colours { values, depth } = attributes.colours().unwrap().clone();
            (values, depth)
        };
        let bytes = set([[255.0, 51.0, 0.0, 1.0]; 4]);
        assert_eq!(bytes, (vec![[1.0, 0.2, 0.0, 1.0]; 4], ColourDepth::Eight));
        assert_eq!(set([[127.5, 0.0, 0.0, 255.0]; 4]), (vec![[0.5, 0.0, 0.0, 1.0]; 4], ColourDepth::Float));
        for kept in [[1.0, 0.2, 0.0, 1.0], [1.5, 0.0, 0.0, 1.0], [300.0, 0.0, 0.0, 1.0], [255.0, -1.0, 0.0, 1.0]] {
            assert_eq!(set([kept; 4]).0, [kept; 4]);
        }
        // A few places that are brighter than 1 do not make the rest black.
        let mut lit = [[0.25, 0.5, 0.0, 1.0]; 4];
        lit[3] = [2.0, 3.5, 1.0, 1.0];
        assert_eq!(set(lit), (lit.to_vec(), ColourDepth::Float));
        let mut dark = [[0.0, 1.0, 0.0, 1.0]; 4];
        dark[3] = [2.0, 0.0, 0.0, 1.0];
        assert_eq!(set(dark).0[3], [2.0 / 255.0, 0.0, 0.0, 1.0]);
        let outside = |colour| Colours { values: vec![colour; 4], depth: ColourDepth::Float }.outside();
        assert_eq!(outside([1.001, -0.001, 0.0, 1.0]), 0);
        assert_eq!(outside([1.5, -1.0, 0.5, 255.0]), 12);
    }

    #[test]
    fn normals_become_unit() {
        let mut attributes = Attributes::new(&Shape::Square.build(2));
        let given = vec![DVec3::new(0.6, 0.8, 0.0), DVec3::ZERO, DVec3::splat(1e-300), DVec3::new(0.0, 3e300, 4e300)];
        attributes.set_normals(Normals::PerVertex(given.clone())).unwrap();
        let Some(Normals::PerVertex(normals)) = attributes.normals() else { panic!("they were given per vertex") };
        assert_eq!((normals[0], normals[1]), (given[0], DVec3::ZERO));
        for n in &normals[2..] {
            assert!((n.length() - 1.0).abs() < 1e-15, "{n}");
        }
    }

    #[test]
    fn corners_that_agree_are_one_per_vertex() {
        let facets = [[0, 1, 2], [2, 1, 3]];
        let mut given = PerCorner { values: vec![1.0, 2.0, 3.0, 4.0, 2.0], corners: vec![[0, 1, 2], [2, 4, 3]] };
        assert_eq!(given.per_vertex(&facets, 5), Some(vec![1.0, 2.0, 3.0, 4.0, 0.0]));
        given.values[4] = 2.5;
        assert_eq!(given.per_vertex(&facets, 5), None);
    }
}
