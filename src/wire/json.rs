//! Messages as JSON.
//!
//! Purpose: [`to_value`] and [`from_value`], by protobuf's own mapping, with the names of fields as the schema has them and
//! whole numbers as numbers; [`schemas`] says for documents what that looks like. Invariant: a message comes back equal, each
//! number with the same bits; a field that the schema does not have is an error. Must not know: what messages mean.

use std::sync::LazyLock;

use prost::{Message, Name};
use prost_reflect::{
    Cardinality, DescriptorPool, DynamicMessage, EnumDescriptor, FieldDescriptor, Kind, MessageDescriptor,
    SerializeOptions,
};
use serde_json::{Map, Value, json};

use super::proto::DESCRIPTORS;

static POOL: LazyLock<DescriptorPool> = LazyLock::new(|| DescriptorPool::decode(DESCRIPTORS).unwrap_or_default());

pub fn descriptor<M: Name>() -> Option<MessageDescriptor> {
    POOL.get_message_by_name(&M::full_name())
}

/// A message as JSON; fields that are not set are left out.
pub fn to_value<M: Message + Name>(message: &M) -> Value {
    let written = descriptor::<M>().and_then(|descriptor| {
        let mut dynamic = DynamicMessage::new(descriptor);
        dynamic.transcode_from(message).ok()?;
        let options = SerializeOptions::new().use_proto_field_name(true).stringify_64_bit_integers(false);
        dynamic.serialize_with_options(serde_json::value::Serializer, &options).ok()
    });
    written.unwrap_or_default()
}

/// A message of JSON. Names of fields may be written as the schema has them or in camel case.
///
/// # Errors
/// What cannot be read, and where it is known the field.
pub fn from_value<M: Message + Name + Default>(value: Value) -> Result<M, String> {
    let descriptor = descriptor::<M>().ok_or("no such message")?;
    let dynamic = DynamicMessage::deserialize(descriptor, value).map_err(|error| error.to_string())?;
    dynamic.transcode_to().map_err(|error| error.to_string())
}

/// JSON schemas of a message and of those within it, by their names, with the comments of the schema; they refer to each other
/// below `place`.
pub fn schemas<M: Name>(place: &str) -> Map<String, Value> {
    let mut all = Map::new();
    if let Some(message) = descriptor::<M>() {
        add(&message, place, &mut all);
    }
    all
}

/// The comment of a field, as one paragraph.
pub(crate) fn comment(field: &FieldDescriptor) -> String {
    let file = field.parent_file();
    let places = file.file_descriptor_proto().source_code_info.iter().flat_map(|info| &info.location);
    let comment = places.into_iter().find(|place| place.path == field.path());
    let text = comment.map_or("", |place| place.leading_comments());
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn add(message: &MessageDescriptor, place: &str, all: &mut Map<String, Value>) {
    if all.contains_key(message.name()) {
        return;
    }
    // Its place is taken before its fields are looked at: messages may refer to each other.
    all.insert(message.name().to_owned(), Value::Null);
    let mut properties = Map::new();
    for field in message.fields() {
        let mut schema = if field.is_map() {
            json!({ "type": "object", "additionalProperties": { "type": "string" } })
        } else if field.cardinality() == Cardinality::Repeated {
            json!({ "type": "array", "items": value(&field.kind(), place, all) })
        } else {
            value(&field.kind(), place, all)
        };
        schema["description"] = comment(&field).into();
        properties.insert(field.name().to_owned(), schema);
    }
    let schema = json!({ "type": "object", "additionalProperties": false, "properties": properties });
    all.insert(message.name().to_owned(), schema);
}

fn value(kind: &Kind, place: &str, all: &mut Map<String, Value>) -> Value {
    match kind {
        Kind::Double | Kind::Float => json!({ "type": "number" }),
        Kind::Bool => json!({ "type": "boolean" }),
        Kind::String | Kind::Bytes => json!({ "type": "string" }),
        Kind::Enum(of) => json!({ "type": "string", "enum": names(of) }),
        // Durations, as "1.5s".
        Kind::Message(of) if of.package_name() == "google.protobuf" => json!({ "type": "string" }),
        Kind::Message(of) => {
            add(of, place, all);
            json!({ "$ref": format!("{place}{}", of.name()) })
        }
        _ => json!({ "type": "integer" }),
    }
}

fn names(of: &EnumDescriptor) -> Vec<String> {
    of.values().map(|value| value.name().to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::proto::{Density, DensitySource, JobSpec, RemeshOptions, job_spec};

    #[test]
    fn a_message_comes_back() {
        let density = Density { source: DensitySource::Lfs.into(), gradation: Some(0.1 + 0.2), ..Density::default() };
        let options =
            RemeshOptions { points: Some(7), seed: Some(u64::MAX), density: Some(density), ..Default::default() };
        let spec = JobSpec { work: Some(job_spec::Work::Remesh(options)), priority: Some(-3), ..JobSpec::default() };
        let json = to_value(&spec);
        assert_eq!(json["remesh"]["seed"], u64::MAX);
        assert_eq!(json["remesh"]["density"]["source"], "DENSITY_SOURCE_LFS");
        assert_eq!(json["remesh"].get("lloyd"), None);
        let text: Value = serde_json::from_str(&json.to_string()).unwrap();
        assert_eq!(from_value::<JobSpec>(text).unwrap(), spec);
        assert!(from_value::<JobSpec>(serde_json::json!({ "remesh": { "point": 3 } })).unwrap_err().contains("point"));
    }

    #[test]
    fn every_message_has_a_schema() {
        let all = schemas::<crate::proto::JobSpec>("#/");
        assert!(all.values().all(Value::is_object), "{all:?}");
        assert_eq!(all["JobArrays"]["properties"]["creases"]["$ref"], "#/ArrayRef");
        assert!(all["ArrayRef"]["properties"]["digest"]["description"].as_str().is_some_and(|text| !text.is_empty()));
    }
}
