//! What messages are as JSON, for documents.
//!
//! Purpose: [`of`] gives JSON schemas of a message and of those within it, as [`json`](super::json) writes them, with the
//! comments of the schema. Invariant: nothing is written by hand. Must not know: documents.

use prost::Name;
use prost_reflect::{Cardinality, EnumDescriptor, FieldDescriptor, Kind, MessageDescriptor};
use serde_json::{Map, Value, json};

use super::json::descriptor;

/// Schemas by the names of their messages; they refer to each other below `place`.
pub fn of<M: Name>(place: &str) -> Map<String, Value> {
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

    #[test]
    fn every_message_has_a_schema() {
        let all = of::<crate::proto::JobSpec>("#/");
        assert!(all.values().all(Value::is_object), "{all:?}");
        assert_eq!(all["JobArrays"]["properties"]["creases"]["$ref"], "#/ArrayRef");
        assert!(all["ArrayRef"]["properties"]["digest"]["description"].as_str().is_some_and(|text| !text.is_empty()));
    }
}
