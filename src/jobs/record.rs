//! A job as data: what is asked for, and where it stands.
//!
//! Purpose: [`Job`] is a [`Spec`] and a [`Status`]; both can be kept, sent and read again by another process.
//! Invariant: the specification never changes; the status changes only by [`Change`], along the machine of
//! [`state`]. Times are given from outside: there is no clock here.
//! Must not know: stores, queues, messages, how a job is done.

pub mod event;
mod legacy;
mod spec;
pub mod state;
mod task;

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::blob::{Digest, from_hex, to_hex};
use crate::record::state::{State, TransitionError, apply};

pub use spec::Spec;
pub use task::{ArrayRef, Arrays, AttributeRef, Command, Deadlines, MeshSource, Operation, ResultFormat, Task};
pub(crate) use task::{sets, steps};

/// Milliseconds since 1970, UTC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Time(pub u64);

impl Time {
    #[must_use]
    pub fn after(self, time: Duration) -> Self {
        Self(self.0.saturating_add(u64::try_from(time.as_millis()).unwrap_or(u64::MAX)))
    }
}

/// The name of a job: the time of its creation and a random number, so that names sort by time and differ between
/// processes. Written as 32 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JobId(pub(crate) [u8; 16]);

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a job's name has 32 hexadecimal digits, 0-9 and a-f")]
pub struct JobIdError;

impl JobId {
    /// 48 bits of the time and the low 80 bits of `random`, which the caller takes from a source that others do not have.
    pub fn new(created: Time, random: u128) -> Self {
        let time = u128::from(created.0 & ((1 << 48) - 1)) << 80;
        Self((time | (random & ((1 << 80) - 1))).to_be_bytes())
    }

    /// The least name of a job created at `time`.
    pub fn first_of(time: Time) -> Self {
        // A time that no name can hold is after all of them.
        if time.0 >> 48 != 0 { Self([0xff; 16]) } else { Self::new(time, 0) }
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&to_hex(&self.0))
    }
}

impl fmt::Debug for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

impl FromStr for JobId {
    type Err = JobIdError;

    fn from_str(text: &str) -> Result<Self, JobIdError> {
        from_hex(text).map(Self).map_err(|_| JobIdError)
    }
}

impl Serialize for JobId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for JobId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(de::Error::custom)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    pub id: JobId,
    pub spec: Spec,
    pub status: Status,
}

impl Job {
    /// Whether a later status is what this change of the job made.
    pub fn became(&self, later: &Status, change: &Change) -> bool {
        let made = self.status.changed(self.spec.task().deadlines, change.clone(), later.changed);
        made.is_ok_and(|made| made == *later)
    }
}

/// Names of executors that went away with a job, as far as they are kept.
const KEPT_CRASHES: usize = 8;

/// Where a job is in its life. Fields that a later release adds are passed over: servers of two releases may share a database.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    pub state: State,
    /// Rises with every change of the state. A change names the version that it has seen.
    pub version: u64,
    pub created: Time,
    pub changed: Time,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started: Option<Time>,
    pub attempts: u32,
    /// Times its executor went away without a word.
    pub crashes: u32,
    /// Which executors these were, the last few.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub crashed_on: Vec<String>,
    /// When it expires unless its state changes before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub due: Option<Time>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub holder: Option<Holder>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outcome: Option<Outcome>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Holder {
    /// Which process, as it calls itself.
    pub name: String,
    /// When others may take the job for orphaned, unless the lease is renewed.
    pub until: Time,
}

impl Holder {
    /// The name of a process of the server `server`.
    pub fn name(server: &str, process: u32, unique: u32) -> String {
        format!("{server}{OF_SERVER}{process} {unique:08x}")
    }

    /// The server, by its operator's name, if [`Self::name`] made the name of the process.
    pub fn server(&self) -> Option<&str> {
        self.name.rsplit_once(OF_SERVER).map(|(server, _)| server)
    }
}

const OF_SERVER: &str = " process ";

/// How a job ended. A cancelled one has none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Outcome {
    Succeeded(ResultSet),
    Failed(Failure),
    Expired(Cause),
}

/// What a job gives: blobs. Fields of a later release are passed over, as in [`Status`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResultSet {
    /// Each under its name, such as "mesh.ply", "seeds" or "report".
    pub blobs: std::collections::BTreeMap<String, Digest>,
    /// Digest of all that decides their bits. Results of earlier releases have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fingerprint: Option<Digest>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Failure {
    pub kind: FailureKind,
    pub message: String,
}

/// Kinds of failures, as far as a caller acts on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, strum::VariantNames)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum FailureKind {
    /// The input or an option is wrong: the same job fails again.
    BadInput,
    MissingInput,
    /// It needs more memory or time than it may have.
    TooLarge,
    /// The work could not be done now, as without a device: another try may succeed.
    Unavailable,
    /// The process went down while the job was running, more than once.
    Crashed,
    Internal,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, strum::VariantNames)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Cause {
    QueueDeadline,
    RunDeadline,
    Kept,
}

/// A change of a job's state, with what it brings.
#[derive(Clone, Debug, PartialEq, strum::EnumDiscriminants)]
#[strum_discriminants(name(Transition), derive(Hash))]
pub enum Change {
    /// [`Transition::Claim`]: counts an attempt.
    Claim(Holder),
    Release,
    /// [`Transition::Orphan`]: counts a crash.
    Orphan,
    Succeed(ResultSet),
    Fail(Failure),
    Cancel,
    /// [`Transition::Expire`]: a result is no longer named, so that its blobs may go.
    Expire(Cause),
}

impl Change {
    pub fn transition(&self) -> Transition {
        self.into()
    }
}

impl Status {
    pub fn new(deadlines: Deadlines, now: Time) -> Self {
        Self {
            state: State::Queued,
            version: 1,
            created: now,
            changed: now,
            started: None,
            attempts: 0,
            crashes: 0,
            crashed_on: Vec::new(),
            due: deadlines.queue.map(|limit| now.after(limit)),
            holder: None,
            outcome: None,
        }
    }

    /// The fingerprint of the result, while it is kept.
    pub fn fingerprint(&self) -> Option<Digest> {
        match &self.outcome {
            Some(Outcome::Succeeded(result)) => result.fingerprint,
            _ => None,
        }
    }

    pub fn changed(&self, deadlines: Deadlines, change: Change, now: Time) -> Result<Self, TransitionError> {
        let state = apply(self.state, change.transition())?;
        let mut next = Self { state, version: self.version + 1, changed: now, due: None, holder: None, ..self.clone() };
        match change {
            Change::Claim(holder) => {
                next.attempts += 1;
                next.started = Some(now);
                next.due = deadlines.run.map(|limit| now.after(limit));
                next.holder = Some(holder);
            }
            // The deadline of the queue counts from the time that the job last began to wait.
            Change::Release => next.due = deadlines.queue.map(|limit| now.after(limit)),
            Change::Orphan => {
                next.crashes += 1;
                next.crashed_on.extend(self.holder.as_ref().map(|holder| holder.name.clone()));
                let surplus = next.crashed_on.len().saturating_sub(KEPT_CRASHES);
                next.crashed_on.drain(..surplus);
                next.due = deadlines.queue.map(|limit| now.after(limit));
            }
            Change::Succeed(result) => next.outcome = Some(Outcome::Succeeded(result)),
            Change::Fail(failure) => {
                next.crashes += u32::from(failure.kind == FailureKind::Crashed);
                next.outcome = Some(Outcome::Failed(failure));
            }
            Change::Cancel => {}
            Change::Expire(cause) => next.outcome = Some(Outcome::Expired(cause)),
        }
        Ok(next)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Kind {
    Remesh,
    Rvd,
    Cvt,
}

impl Kind {
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// Memory of a job, or what there is for jobs, bytes. Sums never overflow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bytes {
    pub host: u64,
    /// Of the device; 0 for a job on a CPU.
    pub device: u64,
}

impl Bytes {
    pub const MAX: Self = Self { host: u64::MAX, device: u64::MAX };

    pub fn fits(self, room: Self) -> bool {
        self.host <= room.host && self.device <= room.device
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        Self { host: self.host.saturating_add(other.host), device: self.device.saturating_add(other.device) }
    }

    pub(crate) fn minus(self, other: Self) -> Self {
        Self { host: self.host.saturating_sub(other.host), device: self.device.saturating_sub(other.device) }
    }
}
