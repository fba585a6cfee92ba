//! Jobs between messages and records.
//!
//! Purpose: [`spec`] has specifications, [`job`] jobs, events and lists, both ways. Here are the parts of both: paths of
//! fields, enums, times.
//! Invariant: an unknown enum value and a oneof without a choice are errors with the path of the field, never defaults. What
//! is not set stays so. Nothing is lost on the way to a record and back.
//! Must not know: whether a specification makes sense (`job::record`), streams, status codes.

pub(super) mod job;
pub(super) mod spec;

#[cfg(test)]
mod tests;

use std::fmt;

use geometry::mesh::io::Format;
use jobs::blob::Digest;
use jobs::record::state::State;
use jobs::record::{self, JobId, Time};
use wire::{WireError, proto};

/// The path of a field, written out only when something is wrong with it.
#[derive(Clone, Copy)]
pub(super) enum At<'a> {
    /// A field of the message itself.
    Top(&'static str),
    /// A field of a field.
    Field(&'a At<'a>, &'static str),
    /// An element of a repeated field.
    Item(&'a At<'a>, usize),
}

impl At<'_> {
    fn to(&self, name: &'static str) -> At<'_> {
        At::Field(self, name)
    }

    fn item(&self, index: usize) -> At<'_> {
        At::Item(self, index)
    }

    fn wrong(&self, reason: impl Into<String>) -> WireError {
        WireError::field(self.to_string(), reason)
    }

    /// The field must be there.
    fn need<T>(&self, value: Option<T>, hint: &str) -> Result<T, WireError> {
        value.ok_or_else(|| self.wrong(format!("is missing; {hint}")))
    }
}

impl fmt::Display for At<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Top(name) => f.write_str(name),
            Self::Field(parent, name) => write!(f, "{parent}.{name}"),
            Self::Item(parent, index) => write!(f, "{parent}[{index}]"),
        }
    }
}

/// An enum that messages and records both have.
trait Choice: Sized {
    /// Nothing for a value that the messages do not have; `Some(None)` for the one that says nothing.
    fn read(value: i32) -> Option<Option<Self>>;

    /// The value in messages.
    fn value(self) -> i32;

    /// What was chosen, if anything was.
    fn choice(at: &At<'_>, value: i32) -> Result<Option<Self>, WireError> {
        Self::read(value).ok_or_else(|| WireError::unknown_enum(&at.to_string(), value))
    }

    /// What was chosen, where something must be.
    fn chosen(at: &At<'_>, value: i32) -> Result<Self, WireError> {
        at.need(Self::choice(at, value)?, "choose one")
    }

    /// The value of what may be left open.
    fn value_of(choice: Option<Self>) -> i32 {
        choice.map_or(0, Self::value)
    }
}

/// Both directions of enums whose variants have the same names. A variant that only one side has does not compile.
macro_rules! choices {
    ($($ours:ty, $theirs:ident: $($name:ident)*;)*) => {
        $(impl Choice for $ours {
            fn read(value: i32) -> Option<Option<Self>> {
                match proto::$theirs::try_from(value) {
                    Ok(proto::$theirs::Unspecified) => Some(None),
                    $(Ok(proto::$theirs::$name) => Some(Some(Self::$name)),)*
                    Err(_) => None,
                }
            }

            fn value(self) -> i32 {
                match self {
                    $(Self::$name => proto::$theirs::$name.into(),)*
                }
            }
        })*
    };
}

impl Choice for Format {
    fn read(value: i32) -> Option<Option<Self>> {
        if value == 0 { Some(None) } else { Self::of_number(value).map(Some) }
    }

    fn value(self) -> i32 {
        self.number()
    }
}

choices! {
    State, JobState: Queued Running Succeeded Failed Cancelled Expired;
    record::ArrayForm, ArrayForm: F32 F64 U32 U8 Text;
    record::AttributeKind, AttributeKind: Normals TextureCoordinates Colours Scalar;
    record::BackendName, BackendChoice: Auto Gpu Parallel Serial;
    record::DensityKind, DensitySource: Uniform Weights EdgeLengths Curvature FeatureSize;
    record::ProjectionRule, Projection: Free OnSurface;
    record::PlacementRule, Placement: Fitted Surface Centroids;
    record::BoundaryRule, BoundaryRule: Keep Free;
    record::ThinRule, ThinRule: Finer Even;
    record::MeasureRule, Measure: Topology Full;
    record::RvdOutput, RvdOutput: Cells Centroids Sums;
    record::StepKindName, StepKind: Lloyd Lbfgs;
    record::SendSeeds, SeedsWanted: Never Last Each;
    record::FailureKind, JobFailureKind: BadInput MissingInput TooLarge Unavailable Crashed Internal;
}

/// A digest at the path `at`.
pub(super) fn digest(at: &At<'_>, text: &str) -> Result<Digest, WireError> {
    text.parse().map_err(|error: jobs::blob::DigestError| at.wrong(format!("is no digest: {error}")))
}

/// The name of a job.
pub(crate) fn job_id(text: &str) -> Result<JobId, WireError> {
    text.parse().map_err(|error: record::JobIdError| At::Top("id").wrong(format!("names no job: {error}")))
}

/// Parts of a second that a duration or a time may have, besides whole ones.
const NANOS: std::ops::Range<i32> = 0..1_000_000_000;

/// Milliseconds of seconds and nanoseconds that were checked, rounded up.
fn milliseconds(seconds: u64, nanos: i32) -> u64 {
    let parts = u64::from(nanos.unsigned_abs()).div_ceil(1_000_000);
    seconds.saturating_mul(1000).saturating_add(parts)
}

/// A duration in milliseconds, rounded up.
fn duration_ms(at: &At<'_>, duration: prost_types::Duration) -> Result<u64, WireError> {
    match u64::try_from(duration.seconds) {
        Ok(seconds) if NANOS.contains(&duration.nanos) => Ok(milliseconds(seconds, duration.nanos)),
        _ => Err(at.wrong("is no duration from 0 on, with nanos from 0 to 999999999")),
    }
}

fn duration(ms: u64) -> prost_types::Duration {
    let (seconds, nanos) = split(ms);
    prost_types::Duration { seconds, nanos }
}

/// The first millisecond that is not before a time.
fn time(at: &At<'_>, time: prost_types::Timestamp) -> Result<Time, WireError> {
    if !NANOS.contains(&time.nanos) {
        return Err(at.wrong("is no time: nanos go from 0 to 999999999"));
    }
    // No job is older than 1970.
    Ok(u64::try_from(time.seconds).map_or(Time(0), |seconds| Time(milliseconds(seconds, time.nanos))))
}

fn timestamp(Time(ms): Time) -> prost_types::Timestamp {
    let (seconds, nanos) = split(ms);
    prost_types::Timestamp { seconds, nanos }
}

/// Seconds and nanoseconds.
fn split(ms: u64) -> (i64, i32) {
    let nanos = i32::try_from(ms % 1000).unwrap_or_default() * 1_000_000;
    (i64::try_from(ms / 1000).unwrap_or(i64::MAX), nanos)
}
