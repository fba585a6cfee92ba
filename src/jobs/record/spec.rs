//! What a job is asked to do.
//!
//! Purpose: [`Spec`] is a message that was checked, with its tenant and its request's id; [`Spec::task`] is the same for
//! those that do it. [`task`](super::task) has the checks. Invariant: the message is kept and answered as it came, and a
//! specification that was kept is read again, whatever the limits of the server are now. Records of layouts 1 and 2 are
//! read as the message that asks for the same. Must not know: stores, limits of a server.

use std::sync::Arc;

use prost::Message;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};
use serde_json::Value;

use super::legacy;
use super::task::Task;
use wire::{WireError, json, proto};

/// The longest specification, bytes of the message.
const MAX_SPEC_BYTES: usize = 64 << 10;

#[derive(Clone, Debug)]
pub struct Spec {
    /// Whose job it is; empty if the server knows no tenants.
    pub tenant: String,
    /// The same id and the same body give the same job again; empty if each request makes a job of its own.
    pub request_id: String,
    message: Arc<proto::JobSpec>,
    task: Arc<Task>,
}

impl PartialEq for Spec {
    fn eq(&self, other: &Self) -> bool {
        (&self.tenant, &self.request_id, &self.message) == (&other.tenant, &other.request_id, &other.message)
    }
}

impl Spec {
    /// Checks everything that can be checked without the blobs. Errors: [`WireError::Field`] for the first field that is
    /// wrong, by its path in a request to create the job.
    pub fn new(message: proto::JobSpec, tenant: String, request_id: String) -> Result<Self, WireError> {
        let bytes = message.encoded_len();
        let spec = Self::kept(message, tenant, request_id)?;
        if bytes > MAX_SPEC_BYTES {
            let text = format!("has {bytes} bytes; at most {MAX_SPEC_BYTES} are taken: put long lists into blobs");
            return Err(WireError::field("spec", text));
        }
        Ok(spec)
    }

    /// [`Self::new`] for a record, whose length was within the limit of its time.
    fn kept(message: proto::JobSpec, tenant: String, request_id: String) -> Result<Self, WireError> {
        for (field, text) in [("tessera-tenant", &tenant), ("request_id", &request_id)] {
            if text.len() > 128 || !text.chars().all(|c| c.is_ascii_graphic()) {
                let shown: String = text.chars().take(80).collect();
                let rule = "give at most 128 printable ASCII characters without spaces";
                return Err(WireError::field(field, format!("is {shown:?}; {rule}")));
            }
        }
        let task = Task::of(&message).map_err(|error| error.under("spec"))?;
        Ok(Self { tenant, request_id, message: Arc::new(message), task: Arc::new(task) })
    }

    pub fn message(&self) -> &proto::JobSpec {
        &self.message
    }

    pub fn task(&self) -> &Task {
        &self.task
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    #[serde(default, skip_serializing_if = "String::is_empty")]
    tenant: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    request_id: String,
    spec: Value,
}

impl Serialize for Spec {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (tenant, request_id) = (self.tenant.clone(), self.request_id.clone());
        let spec = json::to_value(self.message());
        if spec.is_null() {
            return Err(ser::Error::custom("a specification that cannot be written"));
        }
        Kept { tenant, request_id, spec }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Spec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let record = legacy::upgrade(Value::deserialize(deserializer)?);
        let Kept { tenant, request_id, spec } = serde_json::from_value(record).map_err(de::Error::custom)?;
        let message = json::from_value(spec).map_err(de::Error::custom)?;
        Self::kept(message, tenant, request_id).map_err(de::Error::custom)
    }
}
