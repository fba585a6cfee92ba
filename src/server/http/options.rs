//! What is asked for, as a query and as JSON have it.
//!
//! Purpose: [`Asked`] is names and values, whichever way they came; [`Asked::remesh`] makes a specification of them.
//! Invariant: an option has one name, that of the command line; one that is not known, is there twice or cannot be read is
//! refused by its name. What is not given stays so. Must not know: whether a specification makes sense.

use std::collections::BTreeMap;

use form_urlencoded::parse;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::media;
use super::problem::wrong;
use crate::service::RequestError;
use jobs::blob::Digest;
use jobs::record::{
    ArrayForm, ArrayRef, Deadlines, DensityKind, DensitySpec, JobSpec, MeshFormat, MeshSource, PlacementRule,
    ProjectionRule, RefineSpec, RemeshWork, ResultFormat, SeedSource, Tolerance, WorkSpec,
};

type Read<T> = Result<T, RequestError>;

/// See the module's head.
#[derive(Debug, Default)]
pub(super) struct Asked {
    values: BTreeMap<String, String>,
    labels: BTreeMap<String, String>,
}

impl Asked {
    /// From a query. A label is `label=KEY=VALUE`, as often as there are labels.
    pub(super) fn of_query(query: Option<&str>) -> Read<Self> {
        let mut asked = Self::default();
        for (name, value) in parse(query.unwrap_or_default().as_bytes()) {
            if name == "label" {
                let Some((key, value)) = value.split_once('=') else {
                    return Err(wrong("label", "is KEY=VALUE"));
                };
                asked.labels.insert(key.to_owned(), value.to_owned());
            } else if asked.values.insert(name.to_string(), value.into_owned()).is_some() {
                return Err(wrong(name, "is there twice; give it once"));
            }
        }
        Ok(asked)
    }

    /// From an object of JSON with the same names; `labels` is an object of texts.
    pub(super) fn of_json(object: serde_json::Map<String, Value>) -> Read<Self> {
        let mut asked = Self::default();
        for (name, value) in object {
            let text = match value {
                Value::Null => continue,
                Value::Object(labels) if name == "labels" => {
                    for (key, value) in labels {
                        let Value::String(value) = value else {
                            return Err(wrong(format!("labels.{key}"), "is a text"));
                        };
                        asked.labels.insert(key, value);
                    }
                    continue;
                }
                Value::String(text) => text,
                Value::Bool(_) | Value::Number(_) => value.to_string(),
                Value::Array(_) | Value::Object(_) => return Err(wrong(name, "is a text, a number, true or false")),
            };
            asked.values.insert(name, text);
        }
        Ok(asked)
    }

    /// Takes a value that `read` can read; else says what it must be.
    pub(super) fn take<T>(&mut self, name: &str, must: &str, read: impl Fn(&str) -> Option<T>) -> Read<Option<T>> {
        let Some(text) = self.values.remove(name) else { return Ok(None) };
        match read(&text) {
            Some(value) => Ok(Some(value)),
            None => Err(wrong(name, format!("is {text:?}; it must be {must}"))),
        }
    }

    pub(super) fn whole<T: TryFrom<u64>>(&mut self, name: &str) -> Read<Option<T>> {
        self.take(name, "a whole number, and not too large", |text| T::try_from(whole(text)?).ok())
    }

    fn number(&mut self, name: &str) -> Read<Option<f64>> {
        self.take(name, "a number", |text| text.parse::<f64>().ok().filter(|number| number.is_finite()))
    }

    fn choice<T: DeserializeOwned>(&mut self, name: &str, must: &str) -> Read<Option<T>> {
        self.take(name, must, |text| {
            let word = match text {
                // Words of the command line.
                "lfs" => "feature_size",
                "surface" if name == "projection" => "on_surface",
                other => other,
            };
            serde_json::from_value(Value::String(word.to_owned())).ok()
        })
    }

    pub(super) fn text(&mut self, name: &str) -> Option<String> {
        self.values.remove(name)
    }

    pub(super) fn digest(&mut self, name: &str) -> Read<Option<Digest>> {
        self.take(name, "a digest: the SHA-256 of a blob, 64 hexadecimal digits", |text| text.parse().ok())
    }

    pub(super) fn format(&mut self, name: &str) -> Read<Option<MeshFormat>> {
        self.take(name, &format!("one of {}", media::names()), media::of_name)
    }

    /// A list of text in a blob.
    fn list(&mut self, name: &str) -> Read<Option<ArrayRef>> {
        Ok(self.digest(name)?.map(|blob| ArrayRef { blob, form: ArrayForm::Text, count: 0 }))
    }

    fn milliseconds(&mut self, name: &str) -> Read<Option<u64>> {
        let seconds = self.take(name, "seconds, above 0", |text| {
            text.parse::<f64>().ok().filter(|seconds| *seconds > 0.0 && *seconds < 1e9)
        })?;
        Ok(seconds.map(|seconds| (1e3 * seconds).ceil() as u64))
    }

    /// The labels.
    pub(super) fn labels(&mut self) -> BTreeMap<String, String> {
        std::mem::take(&mut self.labels)
    }

    /// Nothing else was asked for.
    pub(super) fn finish(self) -> Read<()> {
        match self.values.into_keys().next() {
            Some(name) => Err(wrong(name, "is no option; GET /v1/openapi.json lists all")),
            None if !self.labels.is_empty() => Err(wrong("label", "is no option here")),
            None => Ok(()),
        }
    }

    /// The remesh of a surface in a blob.
    pub(super) fn remesh(mut self, blob: Digest, format: MeshFormat, to: MeshFormat, tenant: &str) -> Read<JobSpec> {
        let seeds = SeedSource::Sampled { points: self.whole("points")?, random_seed: self.whole("seed")? };
        let mut work = RemeshWork::new(seeds);
        work.density = DensitySpec {
            source: self.choice::<DensityKind>("density", "uniform, curvature or lfs")?,
            edge_length: self.number("edge_length")?,
            edge_lengths: self.list("sizes")?,
            weights: None,
            adaptivity: self.number("adaptivity")?,
            gradation: self.number("gradation")?,
        };
        work.lloyd_steps = self.whole("lloyd")?;
        work.newton_steps = self.whole("newton")?;
        work.projection = self.choice::<ProjectionRule>("projection", "free or surface")?;
        work.placement = self.choice::<PlacementRule>("placement", "fitted, surface or centroids")?;
        work.crease_angle_deg = self.number("crease_angle")?;
        work.creases = self.list("creases")?;
        work.boundaries = self.choice("boundaries", "keep or free")?;
        work.thin = self.choice("thin", "finer or even")?;
        work.measure = self.choice("measure", "topology or full")?;
        let max_points = self.whole("max_points")?;
        work.refinement = match (self.number("max_deviation")?, max_points) {
            (Some(percent), max_points) => {
                Some(RefineSpec { tolerance: Tolerance::DiagonalPercent(percent), max_points })
            }
            (None, Some(_)) => return Err(wrong("max_points", "needs max_deviation")),
            (None, None) => None,
        };
        let attributes = self.take("attributes", "true or false", |text| text.parse().ok())?;
        let spec = JobSpec {
            mesh: MeshSource::File { blob, format, attributes },
            work: WorkSpec::Remesh(Box::new(work)),
            backend: self.choice("backend", "auto, gpu, parallel or serial")?,
            result: Some(ResultFormat::File(to)),
            priority: self.take("priority", "a whole number from -100 to 100", |text| text.parse().ok())?,
            deadlines: Deadlines {
                queue_ms: self.milliseconds("queue_deadline_s")?,
                run_ms: self.milliseconds("run_deadline_s")?,
            },
            labels: self.labels(),
            tenant: tenant.to_owned(),
            request_id: self.text("request_id").unwrap_or_default(),
        };
        self.finish()?;
        Ok(spec)
    }
}

/// A whole number as people write it: `10000`, `1e4`.
fn whole(text: &str) -> Option<u64> {
    /// Up to here every whole number is one of double precision.
    const EXACT: f64 = (1u64 << 53) as f64;
    let real = || text.parse::<f64>().ok().filter(|x| (0.0..=EXACT).contains(x) && x.fract() == 0.0);
    text.parse().ok().or_else(|| real().map(|x| x as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(query: &str) -> Result<JobSpec, String> {
        let asked = Asked::of_query(Some(query)).map_err(|error| error.to_string())?;
        asked.remesh(Digest::of(b"a"), MeshFormat::Obj, MeshFormat::Ply, "me").map_err(|error| error.to_string())
    }

    #[test]
    fn a_query_and_an_object_ask_for_the_same() {
        let query = spec("points=1e4&seed=7&density=lfs&lloyd=3&thin=even&attributes=false&label=a=b%20c&priority=-3");
        let object = serde_json::json!({
            "points": 10_000, "seed": 7, "density": "feature_size", "lloyd": "3", "thin": "even", "attributes": false,
            "labels": { "a": "b c" }, "priority": -3, "projection": null,
        });
        let Value::Object(object) = object else { panic!("an object") };
        let asked = Asked::of_json(object).unwrap();
        let other = asked.remesh(Digest::of(b"a"), MeshFormat::Obj, MeshFormat::Ply, "me").unwrap();
        assert_eq!(query.unwrap(), other);
        other.check().unwrap();
    }

    #[test]
    fn what_cannot_be_is_named() {
        for (query, name) in [
            ("point=1", "point is no option"),
            ("points=-1", "points is \"-1\""),
            ("points=1.5", "points is"),
            ("points=1&points=2", "points is there twice"),
            ("density=blue", "density is \"blue\"; it must be uniform, curvature or lfs"),
            ("edge_length=nan", "edge_length"),
            ("label=a", "label is KEY=VALUE"),
            ("max_points=7", "max_points needs max_deviation"),
            ("sizes=abc", "sizes is"),
            ("queue_deadline_s=0", "queue_deadline_s"),
        ] {
            let refused = spec(query).unwrap_err();
            assert!(refused.starts_with(name), "{query}: {refused}");
        }
    }
}
