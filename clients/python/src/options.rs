//! Options out of a dictionary.
//!
//! Purpose: what the package's functions put into one dictionary becomes the engine's options. What is not there, or None, has
//! the engine's default.
//! Invariant: a name that nobody reads is an error, so that a misspelt option is not passed over. Must not know: what is done.

use std::cell::RefCell;
use std::fmt::Display;
use std::str::FromStr;

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use tessera::mesh::attributes::{Attributes, ColourDepth, Colours, Normals, PerCorner, Scalar};
use tessera::mesh::plane::{Plane, PlaneError};
use tessera::mesh::regions::{Region, Regions};
use tessera::{
    Anisotropy, DensityOptions, DensitySource, Placement, Projection, Refine, RemeshOptions, Seeds, Share, Tolerance,
    TriMesh,
};

use crate::arrays;
use crate::errors::input;

/// A dictionary whose entries are taken one by one.
pub(crate) struct Options<'py> {
    dict: &'py Bound<'py, PyDict>,
    read: RefCell<Vec<&'static str>>,
}

impl<'py> Options<'py> {
    pub(crate) fn new(dict: &'py Bound<'py, PyDict>) -> Self {
        Self { dict, read: RefCell::default() }
    }

    /// An entry, unless it is None.
    pub(crate) fn any(&self, name: &'static str) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.read.borrow_mut().push(name);
        Ok(self.dict.get_item(name)?.filter(|value| !value.is_none()))
    }

    /// The same as some type.
    pub(crate) fn get<T>(&self, name: &'static str, what: &str) -> PyResult<Option<T>>
    where
        T: for<'a> FromPyObject<'a, 'py>,
    {
        let Some(value) = self.any(name)? else { return Ok(None) };
        let wrong = || input(format!("{name} is {value}; {what} is needed"));
        value.extract::<T>().map(Some).map_err(|_| wrong())
    }

    /// One of some words.
    fn word<T: Copy>(&self, name: &'static str, words: &[(&str, T)]) -> PyResult<Option<T>> {
        let Some(word) = self.get::<String>(name, "a word")? else { return Ok(None) };
        let found = words.iter().find(|(of, _)| *of == word).map(|(_, value)| *value);
        let all = || words.iter().map(|(word, _)| *word).collect::<Vec<_>>().join(", ");
        found.map(Some).ok_or_else(|| input(format!("{name} is {word:?}; it is one of {}", all())))
    }

    fn list<T>(
        &self,
        name: &'static str,
        read: impl Fn(&Bound<'_, PyAny>, &str) -> PyResult<Vec<T>>,
    ) -> PyResult<Option<Vec<T>>> {
        self.any(name)?.map(|array| read(&array, name)).transpose()
    }

    /// After the last entry.
    pub(crate) fn end(self) -> PyResult<()> {
        for key in self.dict.keys() {
            let key = key.cast_into::<PyString>()?.to_string();
            if !self.read.borrow().contains(&key.as_str()) {
                return Err(input(format!("there is no option {key}")));
            }
        }
        Ok(())
    }

    /// Which backend, and its threads.
    pub(crate) fn backend(&self) -> PyResult<(String, Option<usize>)> {
        let name = self.get("backend", "a word")?.unwrap_or_else(|| "auto".to_owned());
        Ok((name, self.get("threads", "a whole number, at least 1")?))
    }

    /// Seeds that are given, or drawn.
    pub(crate) fn seeds(&self) -> PyResult<Seeds> {
        let seed = self.get("seed", "a whole number from 0 to 2**64 - 1")?.unwrap_or(Seeds::RANDOM_SEED);
        let points: Option<usize> = self.get("points", "a whole number, at least 1")?;
        let facets: Option<usize> = self.get("facets", "a whole number, at least 1")?;
        let given = self.list("seeds", arrays::points)?;
        if let Some(facets) = facets {
            if points.is_some() || given.is_some() {
                return Err(input("facets is given beside points or seeds; give one of them"));
            }
            if facets == 0 {
                return Err(input("facets is 0; at least 1 is needed"));
            }
            return Ok(Seeds::Share { of: Share::Facets(facets), seed });
        }
        match (given, points) {
            (Some(_), Some(_)) => Err(input("points and seeds are given; give one of them")),
            (Some(seeds), None) => Ok(Seeds::Given(seeds)),
            (None, Some(0)) => Err(input("points is 0; at least 1 is needed")),
            (None, Some(points)) => Ok(Seeds::Sample { points, seed }),
            (None, None) => Ok(Seeds::Implied { seed }),
        }
    }

    /// Where edges are short and where long.
    pub(crate) fn density(&self) -> PyResult<DensityOptions> {
        let words = [("uniform", 0), ("curvature", 1), ("lfs", 2), ("error", 3), ("error_max", 4)];
        let named = self.word("density", &words)?;
        let (sizes, weights) = (self.list("sizes", arrays::numbers)?, self.list("weights", arrays::numbers)?);
        if let Some(metric) = self.list("metric", arrays::tensors)? {
            if !matches!(named, None | Some(0)) || sizes.is_some() || weights.is_some() {
                return Err(input("density, sizes, weights and metric exclude each other; give one of them"));
            }
            for name in ["edge_length", "gradation", "adaptivity", "size_in"] {
                if self.any(name)?.is_some() {
                    return Err(input(format!("{name} is given beside metric; leave one of the two out")));
                }
            }
            return Ok(DensityOptions::from_source(DensitySource::Metric(metric)));
        }
        let source = match (named, sizes, weights) {
            (None | Some(0), None, None) => DensitySource::Uniform,
            (Some(1), None, None) => DensitySource::Curvature,
            (Some(2), None, None) => DensitySource::FeatureSize,
            (Some(3), None, None) => DensitySource::Error,
            (Some(_), None, None) => DensitySource::ErrorMax,
            (None | Some(0), Some(sizes), None) => DensitySource::Sizes(sizes),
            (None | Some(0), None, Some(weights)) => DensitySource::Weights(weights),
            _ => return Err(input("density, sizes and weights exclude each other; give one of them")),
        };
        let mut density = DensityOptions::from_source(source);
        density.edge_length = self.get("edge_length", "a number above 0")?;
        if let Some(gradation) = self.get("gradation", "a number above 0")? {
            density.gradation = gradation;
        }
        if let Some(adaptivity) = self.get("adaptivity", "a number from 0 to 1")? {
            density.adaptivity = adaptivity;
        }
        density.zones = self.parts("size_in")?;
        density.check().map_err(input)?;
        Ok(density)
    }

    /// Where seeds go after each step.
    pub(crate) fn projection(&self) -> PyResult<Projection> {
        let words = [("free", Projection::Free), ("surface", Projection::OnSurface)];
        Ok(self.word("projection", &words)?.unwrap_or_default())
    }

    /// All of a remesh of `mesh`.
    pub(crate) fn remesh(&self, mesh: &TriMesh) -> PyResult<RemeshOptions> {
        let mut options = RemeshOptions::new(self.seeds()?);
        options.density = self.density()?;
        options.projection = self.projection()?;
        let steps = "a whole number, at least 0";
        options.lloyd = self.get("lloyd", steps)?.unwrap_or(options.lloyd);
        options.newton = self.get("newton", steps)?.unwrap_or(options.newton);
        let words =
            [("fitted", Placement::Fitted), ("surface", Placement::Surface), ("centroids", Placement::Centroids)];
        options.placement = self.word("placement", &words)?.unwrap_or(options.placement);
        let angle = self.get("crease_angle", "an angle from 0 to 180 degrees")?.unwrap_or(options.crease_angle_deg);
        if !(0.0..=180.0).contains(&angle) {
            return Err(input(format!("crease_angle is {angle}; an angle from 0 to 180 degrees is needed")));
        }
        options.crease_angle_deg = angle;
        options.creases = self.list("creases", arrays::edges)?.unwrap_or_default();
        options.keep_boundaries =
            self.word("boundaries", &[("keep", true), ("free", false)])?.unwrap_or(options.keep_boundaries);
        options.keep_thin = self.word("thin", &[("finer", true), ("even", false)])?.unwrap_or(options.keep_thin);
        options.anisotropy = self.anisotropy()?;
        options.weld = self.weld()?;
        options.keep_non_manifold =
            self.word("non_manifold", &[("keep", true), ("cut", false)])?.unwrap_or(options.keep_non_manifold);
        (options.keep, options.only) = (self.parts("keep")?, self.parts("only")?);
        options.keep_rims = self.get("keep_rims", "True or False")?.unwrap_or(options.keep_rims);
        options.strict_creases = self.get("strict_creases", "True or False")?.unwrap_or(options.strict_creases);
        options.mirror = self.mirror()?;
        options.periodic = self.parts("periodic")?;
        options.source_map = self.get("source_map", "True or False")?.unwrap_or(options.source_map);
        options.measure = self.get("measure", "True or False")?.unwrap_or(options.measure);
        options.refine = self.refine(&options.seeds)?;
        options.attributes = self.any("attributes")?.map(|given| attributes(&given, mesh)).transpose()?;
        Ok(options)
    }

    /// A number, or "auto".
    fn anisotropy(&self) -> PyResult<Anisotropy> {
        let needed = "a number from 0 to 10, or \"auto\"";
        if let Some(given) = self.any("anisotropy")?
            && given.extract::<String>().is_ok_and(|word| word == "auto")
        {
            return Ok(Anisotropy::Auto);
        }
        match self.get("anisotropy", needed)? {
            None | Some(0.0) => Ok(Anisotropy::None),
            Some(share) if Anisotropy::SHARES.contains(&share) => Ok(Anisotropy::Share(share)),
            Some(share) => Err(input(format!("anisotropy is {share}; {needed} is needed"))),
        }
    }

    /// A plane, as a text.
    fn mirror(&self) -> PyResult<Option<Plane>> {
        let text: Option<String> = self.get("mirror", "a text")?;
        let wrong = |error: PlaneError| input(format!("mirror: {error}"));
        text.map(|text| text.parse().map_err(wrong)).transpose()
    }

    /// Parts of the surface, zones or motions, as texts.
    fn parts<T: FromStr<Err: Display>>(&self, name: &'static str) -> PyResult<Vec<T>> {
        let texts: Vec<String> = self.get(name, "a list of texts")?.unwrap_or_default();
        texts.iter().map(|text| text.parse::<T>().map_err(|error| input(format!("{name}: {error}")))).collect()
    }

    /// A length, or percent of the diagonal with their sign.
    fn weld(&self) -> PyResult<Option<Tolerance>> {
        let needed = "a length above 0, or percent of the diagonal as \"0.01%\"";
        let Some(given) = self.any("weld")? else { return Ok(None) };
        let text = given.extract::<String>().ok();
        let percent = text.as_deref().and_then(|text| text.trim().strip_suffix('%')).map(str::parse::<f64>);
        let (number, weld): (_, fn(f64) -> Tolerance) = match percent {
            Some(percent) => (percent.ok(), Tolerance::DiagonalPercent),
            None => (given.extract::<f64>().ok(), Tolerance::Length),
        };
        match number.filter(|x| x.is_finite() && *x > 0.0) {
            Some(number) => Ok(Some(weld(number))),
            None => Err(input(format!("weld is {given}; {needed} is needed"))),
        }
    }

    /// Points that are added, as the command adds them.
    fn refine(&self, seeds: &Seeds) -> PyResult<Option<Refine>> {
        let percent: Option<f64> = self.get("max_deviation", "percent above 0")?;
        let most: Option<usize> = self.get("max_points", "a whole number, at least 1")?;
        let Some(percent) = percent else {
            return most.map_or(Ok(None), |_| Err(input("max_points is for max_deviation, which is not given")));
        };
        if !(percent.is_finite() && percent > 0.0) {
            return Err(input(format!("max_deviation is {percent}; percent above 0 are needed")));
        }
        if most.is_none() && matches!(seeds, Seeds::Implied { .. }) {
            return Err(input("max_deviation without points needs max_points"));
        }
        Ok(Some(Refine { tolerance: Tolerance::DiagonalPercent(percent), max_points: most }))
    }
}

/// What `mesh` carries, of a dictionary of arrays.
pub(crate) fn attributes(given: &Bound<'_, PyAny>, mesh: &TriMesh) -> PyResult<Attributes> {
    let dict = given.cast::<PyDict>().map_err(|_| input("attributes is no dictionary"))?;
    let options = Options::new(dict);
    let mut attributes = Attributes::new(mesh);
    let normals = options.list("normals", arrays::points)?;
    let corners = options.list("normal_corners", arrays::triples)?;
    if let Some(values) = normals {
        let normals = match corners {
            Some(corners) => Normals::PerCorner(PerCorner { values, corners }),
            None => Normals::PerVertex(values),
        };
        attributes.set_normals(normals).map_err(input)?;
    }
    if let Some(values) = options.list("texture", arrays::pairs)? {
        // Without corners there is one for each vertex.
        let corners = options.list("texture_corners", arrays::triples)?.unwrap_or_else(|| mesh.facets().to_vec());
        attributes.set_texture(PerCorner { values, corners }).map_err(input)?;
    } else {
        options.any("texture_corners")?;
    }
    let eight: bool = options.get("colours_of_eight_bits", "True or False")?.unwrap_or_default();
    if let Some(values) = options.list("colours", arrays::fours)? {
        let depth = if eight { ColourDepth::Eight } else { ColourDepth::Float };
        attributes.set_colours(Colours { values, depth }).map_err(input)?;
    }
    if let Some(scalars) = options.any("scalars")? {
        let scalars = scalars.cast::<PyDict>().map_err(|_| input("scalars is no dictionary"))?;
        for (name, values) in scalars.iter() {
            let name: String = name.extract().map_err(|_| input("a scalar's name is no text"))?;
            let (values, form, components): (Bound<'_, PyAny>, String, usize) =
                values.extract().map_err(|_| input("a scalar is no array with its type and its number of columns"))?;
            let number = arrays::number(&form)?;
            let values = arrays::numbers(&values, &name)?;
            attributes.add_scalar(Scalar { name, number, components, values }).map_err(input)?;
        }
    }
    if let Some(numbers) = options.any("regions")? {
        let numbers = arrays::numbers(&numbers, "regions")?.into_iter().map(|x| x as i64).collect::<Vec<_>>();
        let names: Vec<(i64, String)> = options.get("region_names", "numbers with names")?.unwrap_or_default();
        let named = names.into_iter().map(|(number, name)| Region { number, name }).collect();
        let regions = Regions::of_named(&numbers, named).map_err(input)?;
        attributes.set_regions(regions).map_err(input)?;
    } else {
        options.any("region_names")?;
    }
    options.end()?;
    Ok(attributes)
}
