//! Media types and schemas of values.
//!
//! Purpose: the words that handlers and the OpenAPI document share. Invariant: the words of an enum come from its type. Must not
//! know: routes.

use schemars::{Schema, SchemaGenerator, json_schema};
use strum::VariantNames;

pub(super) const JSON: &str = "application/json";
pub(super) const PROBLEM: &str = "application/problem+json";
pub(super) const BYTES: &str = "application/octet-stream";
pub(super) const EVENTS: &str = "text/event-stream";

/// Makes the schema of a value. The generator collects the types that have a name.
pub(super) type Shape = fn(&mut SchemaGenerator) -> Schema;

/// A schema among the document's components.
pub(super) fn named(name: &str) -> Schema {
    json_schema!({ "$ref": format!("#/components/schemas/{name}") })
}

pub(super) fn digest(_: &mut SchemaGenerator) -> Schema {
    named("Digest")
}

pub(super) fn job_id(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "string", "pattern": "^[0-9a-f]{32}$" })
}

pub(super) fn text(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "string" })
}

pub(super) fn whole(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "integer", "minimum": 0 })
}

/// Labels in a query: one parameter each.
pub(super) fn labels(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "array", "items": { "type": "string", "pattern": "^[^=]+=.*$" } })
}

/// One word of an enum.
pub(super) fn word<E: VariantNames>(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "string", "enum": E::VARIANTS })
}

/// One word of an enum, or null.
pub(super) fn word_or_null<E: VariantNames>(_: &mut SchemaGenerator) -> Schema {
    let words = E::VARIANTS.iter().copied().map(Some).chain([None]);
    json_schema!({ "type": ["string", "null"], "enum": words.collect::<Vec<_>>() })
}
