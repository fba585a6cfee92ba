//! Messages as JSON.
//!
//! Purpose: [`to_value`] and [`from_value`], by protobuf's own mapping, with the names of fields as the schema has them and
//! whole numbers as numbers. Invariant: a message comes back equal, each number with the same bits; a field that the schema
//! does not have is an error. Must not know: what messages mean.

use std::sync::LazyLock;

use prost::{Message, Name};
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, SerializeOptions};
use serde_json::Value;

use super::proto::DESCRIPTORS;

static POOL: LazyLock<DescriptorPool> = LazyLock::new(|| DescriptorPool::decode(DESCRIPTORS).unwrap_or_default());

/// What the schema says of a message.
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
}
