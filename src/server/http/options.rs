//! What is asked for, as a query and as JSON have it.
//!
//! Purpose: [`Asked`] is names and values, whichever way they came; [`Asked::remesh`] makes a job's message of them.
//! [`all`] has the schema of each option, for the OpenAPI document.
//! Invariant: an option has one name, that of the command line; one that is not known, is there twice or cannot be read is
//! refused by its name. What is not given stays so. Must not know: whether a specification makes sense.

use std::collections::BTreeMap;
use std::time::Duration;

use form_urlencoded::parse;
use serde_json::{Map, Value, json};

use super::problem::wrong;
use super::schema::{BYTES, named};
use crate::service::RequestError;
use geometry::mesh::io::Format;
use jobs::blob::Digest;
use wire::fields::{Fields, whole};
use wire::proto::{
    ArrayForm, ArrayRef, BackendChoice, CreateJobRequest, JobArrays, JobSpec, MeshFile, job_mesh, job_spec,
    result_format,
};
use wire::{fields, proto};

type Read<T> = Result<T, RequestError>;

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
    pub(super) fn of_json(object: Map<String, Value>) -> Read<Self> {
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

    pub(super) fn text(&mut self, name: &str) -> Option<String> {
        self.values.remove(name)
    }

    pub(super) fn digest(&mut self, name: &str) -> Read<Option<Digest>> {
        self.take(name, "a digest: the SHA-256 of a blob, 64 hexadecimal digits", |text| text.parse().ok())
    }

    pub(super) fn format(&mut self, name: &str) -> Read<Option<Format>> {
        self.take(name, &format!("one of {}", format_names()), Format::from_extension)
    }

    /// A list of text in a blob.
    fn list(&mut self, name: &str) -> Read<Option<ArrayRef>> {
        let list = |digest: Digest| ArrayRef { digest: digest.to_string(), form: ArrayForm::Text.into(), count: 0 };
        Ok(self.digest(name)?.map(list))
    }

    fn duration(&mut self, name: &str) -> Read<Option<prost_types::Duration>> {
        let seconds = self.take(name, "seconds, above 0", |text| {
            text.parse::<f64>().ok().filter(|seconds| *seconds > 0.0 && *seconds < 1e9)
        })?;
        let parts = |seconds: f64| Duration::from_millis((1e3 * seconds).ceil() as u64).try_into().ok();
        Ok(seconds.and_then(parts))
    }

    pub(super) fn labels(&mut self) -> BTreeMap<String, String> {
        std::mem::take(&mut self.labels)
    }

    pub(super) fn finish(self) -> Read<()> {
        match self.values.into_keys().next() {
            Some(name) => Err(wrong(name, "is no option; GET /v1/openapi.json lists all")),
            None if !self.labels.is_empty() => Err(wrong("label", "is no option here")),
            None => Ok(()),
        }
    }

    /// The remesh of a surface in a blob, and the request's id.
    pub(super) fn remesh(mut self, blob: Digest, format: Format, to: Format) -> Read<(JobSpec, String)> {
        let mut options = Fields::default();
        for field in fields::all() {
            let Some(text) = self.values.remove(&field.name) else { continue };
            let must = |must| wrong(&*field.name, format!("is {text:?}; it must be {must}"));
            options.set(&field.name, &text).map_err(must)?;
        }
        let arrays = JobArrays {
            edge_lengths: self.list("sizes")?,
            metric: self.list("metric")?,
            creases: self.list("creases")?,
            ..JobArrays::default()
        };
        let attributes = self.take("attributes", "true or false", |text| text.parse().ok())?;
        let file = MeshFile { digest: blob.to_string(), format: format.number(), attributes };
        let named = |text: &str| BackendChoice::from_str_name(&format!("BACKEND_CHOICE_{}", text.to_ascii_uppercase()));
        let backend = |text: &str| named(text).filter(|choice| *choice != BackendChoice::Unspecified);
        let message = JobSpec {
            mesh: Some(proto::JobMesh { source: Some(job_mesh::Source::File(file)) }),
            work: Some(job_spec::Work::Remesh(options.finish())),
            arrays: Some(arrays).filter(|arrays| *arrays != JobArrays::default()),
            backend: self.take("backend", "auto, gpu, parallel or serial", backend)?.unwrap_or_default().into(),
            result: Some(proto::ResultFormat { form: Some(result_format::Form::File(to.number())) }),
            priority: self.take("priority", "a whole number from -100 to 100", |text| text.parse().ok())?,
            queue_deadline: self.duration("queue_deadline_s")?,
            run_deadline: self.duration("run_deadline_s")?,
            labels: self.labels().into_iter().collect(),
        };
        let request_id = self.text("request_id").unwrap_or_default();
        self.finish()?;
        Ok((message, request_id))
    }
}

/// The options that a query and an object of JSON have in common, each with its schema. Types and texts are those of the protobuf
/// schema where it has the same field.
pub(super) fn all() -> Map<String, Value> {
    let described = |text: &str, mut schema: Value| {
        schema["description"] = text.into();
        schema
    };
    let format = |text: &str| described(text, json!({ "type": "string", "enum": Format::ALL.map(Format::extension) }));
    let list = |text: &str| described(text, named("Digest").into());
    let of_spec = fields::schema::<JobSpec>;
    let seconds = |name: &str| {
        let mut schema = of_spec(name);
        schema["exclusiveMinimum"] = 0.into();
        described(&format!("Seconds. {}", schema["description"].as_str().unwrap_or_default()), schema)
    };
    let mut priority = of_spec("priority");
    (priority["minimum"], priority["maximum"]) = ((-100).into(), 100.into());
    let own = [
        ("format", format("Format of the mesh. `/v1/remesh` without it: by Content-Type, else by the first bytes.")),
        ("to", format("Format of the result. Not given: by Accept, else that of the mesh.")),
        ("sizes", list("Digest of a blob of text with the target edge length of each vertex, one a line.")),
        (
            "metric",
            list(
                "Digest of a blob of text with the metric tensor of each vertex, a line each: m11 m12 m22 m13 m23 m33.",
            ),
        ),
        (
            "creases",
            list("Digest of a blob of text with edges that are creases whatever their angle: two vertices a line."),
        ),
        ("attributes", fields::schema::<MeshFile>("attributes")),
        ("backend", of_spec("backend")),
        ("priority", priority),
        ("queue_deadline_s", seconds("queue_deadline")),
        ("run_deadline_s", seconds("run_deadline")),
        ("request_id", fields::schema::<CreateJobRequest>("request_id")),
    ];
    let of_remesh = fields::all().into_iter().map(|field| (field.name.clone(), field.schema()));
    own.map(|(name, schema)| (name.to_owned(), schema)).into_iter().chain(of_remesh).collect()
}

/// The schema of an object of JSON with the options of a job.
pub(super) fn schema() -> Value {
    let mut options = all();
    let labels = fields::schema::<JobSpec>("labels")["description"].take();
    options.insert("mesh".to_owned(), named("Digest").into());
    options.insert("reuse".to_owned(), fields::schema::<CreateJobRequest>("reuse"));
    options.insert(
        "labels".to_owned(),
        json!({ "type": "object", "additionalProperties": { "type": "string" }, "description": labels }),
    );
    json!({ "type": "object", "required": ["mesh", "format"], "additionalProperties": false, "properties": options })
}

pub(super) fn media_type(format: Format) -> &'static str {
    format.media_types().first().copied().unwrap_or(BYTES)
}

/// All names, for a message.
pub(super) fn format_names() -> String {
    Format::ALL.map(Format::extension).join(", ")
}

/// The format that the first of these media types means, if one does.
pub(super) fn format_of_types(header: &str) -> Option<Format> {
    header.split(',').find_map(|one| {
        let media = one.split(';').next().unwrap_or_default().trim();
        Format::ALL.into_iter().find(|format| format.media_types().iter().any(|t| t.eq_ignore_ascii_case(media)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use jobs::record::Spec;

    fn spec(query: &str) -> Result<Spec, String> {
        let read = || {
            let asked = Asked::of_query(Some(query))?;
            let (message, request_id) = asked.remesh(Digest::of(b"a"), Format::Obj, Format::Ply)?;
            Ok::<_, RequestError>(Spec::new(message, "me".to_owned(), request_id)?)
        };
        read().map_err(|error| error.to_string())
    }

    #[test]
    fn a_query_and_an_object_ask_for_the_same() {
        let query = spec("points=1e4&seed=7&density=lfs&lloyd=3&thin=even&attributes=false&label=a=b%20c&priority=-3");
        let object = serde_json::json!({
            "points": 10_000, "seed": 7, "density": "lfs", "lloyd": "3", "thin": "even", "attributes": false,
            "labels": { "a": "b c" }, "priority": -3, "projection": null,
        });
        let Value::Object(object) = object else { panic!("an object") };
        let asked = Asked::of_json(object).unwrap();
        let (other, _) = asked.remesh(Digest::of(b"a"), Format::Obj, Format::Ply).unwrap();
        assert_eq!(*query.unwrap().message(), other);
    }

    #[test]
    fn what_cannot_be_is_named() {
        for (query, name) in [
            ("point=1", "point is no option"),
            ("points=-1", "points is \"-1\""),
            ("points=1.5", "points is"),
            ("points=1&points=2", "points is there twice"),
            (
                "density=blue",
                "density is \"blue\"; it must be uniform, weights, edge_lengths, curvature, lfs, error, error_max or metric",
            ),
            ("edge_length=nan", "edge_length"),
            ("label=a", "label is KEY=VALUE"),
            ("points=9&max_points=70", "spec.remesh.max_points is given without max_deviation"),
            ("sizes=abc", "sizes is"),
            ("queue_deadline_s=0", "queue_deadline_s"),
        ] {
            let refused = spec(query).unwrap_err();
            assert!(refused.starts_with(name), "{query}: {refused}");
        }
    }

    #[test]
    fn every_format_has_types_of_its_own() {
        for format in Format::ALL {
            assert!(!format.media_types().is_empty());
            assert!(format.media_types().iter().all(|media| format_of_types(media) == Some(format)));
        }
        assert_eq!(format_of_types("text/html, model/obj;q=0.9"), Some(Format::Obj));
        assert_eq!(format_of_types("*/*"), None);
    }
}
