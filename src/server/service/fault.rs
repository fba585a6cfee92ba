//! What callers learn of an error, in every protocol.
//!
//! Purpose: the one table: [`Fault`] of each [`RequestError`]. Each interface puts it in its own words: gRPC in `status`,
//! HTTP in its problems. Invariant: what the caller can mend is `InvalidArgument` with a field; what time mends says when to
//! try again; faults of ours say nothing of our insides. [`refusal`] says which errors count as refusals: what a retry, another
//! server or an operator mends, and not what is wrong with a request. Must not know: where an error arose, how any protocol
//! looks.

use std::time::Duration;

use strum::IntoStaticStr;
use tonic::Code;

use super::RequestError;
use super::access::{Refusal, TENANT};
use crate::metrics::Refused;
use geometry::cvt::density::DensityError;
use geometry::mesh::MeshError;
use geometry::mesh::features::FeatureError;
use geometry::remesh::RemeshError;
use geometry::rvd::RvdError;
use geometry::token::Stopped;
use jobs::JobError;
use jobs::blob::BlobError;
use jobs::executor::api::JobApiError;
use jobs::store::StoreError;
use transport::Rejection;
use wire::WireError;

/// What kind of error it is, as far as a caller acts on it. Its number is that of the canonical code (google.rpc.Code).
#[derive(Clone, Copy, Debug, PartialEq, Eq, IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Kind {
    Cancelled = 1,
    InvalidArgument = 3,
    DeadlineExceeded,
    NotFound,
    AlreadyExists,
    PermissionDenied,
    ResourceExhausted,
    FailedPrecondition,
    Aborted,
    OutOfRange,
    Unimplemented,
    Internal,
    Unavailable,
    DataLoss,
    Unauthenticated,
}

impl Kind {
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// What a program can read of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Detail {
    Field { path: String, description: String },
    Retry(Duration),
    Quota { subject: &'static str, description: String },
    Precondition { kind: &'static str, subject: String, description: String },
    Missing { kind: &'static str, name: String, description: String },
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    pub kind: Kind,
    pub text: String,
    pub details: Vec<Detail>,
    /// As refusals are counted, if it is one.
    pub refused: Option<Refused>,
}

impl Fault {
    pub fn new(kind: Kind, text: impl Into<String>) -> Self {
        Self { kind, text: text.into(), details: Vec::new(), refused: None }
    }

    pub fn with(mut self, detail: Detail) -> Self {
        self.details.push(detail);
        self
    }

    /// In one word: what has to be otherwise, which limit is reached, what is not there, why it is refused; else its kind.
    pub fn reason(&self) -> &'static str {
        let told = self.details.iter().find_map(|detail| match detail {
            Detail::Quota { subject, .. } => Some(*subject),
            Detail::Precondition { kind, .. } | Detail::Missing { kind, .. } => Some(*kind),
            Detail::Field { .. } | Detail::Retry(_) => None,
        });
        told.or(self.refused.map(Refused::name)).unwrap_or_else(|| self.kind.name())
    }
}

impl From<RequestError> for Fault {
    fn from(error: RequestError) -> Self {
        let refused = refusal(&error);
        Self { refused, ..of(error) }
    }
}

fn of(error: RequestError) -> Fault {
    let text = error.to_string();
    match error {
        RequestError::Wire(error) => of_wire(error),
        RequestError::Transport(rejection) => of_rejection(&rejection, text),
        RequestError::TooMany { .. } => retry(Kind::ResourceExhausted, text, Duration::from_secs(1)),
        RequestError::Idle(_) | RequestError::UploadTime(_) | RequestError::Deadline => {
            Fault::new(Kind::DeadlineExceeded, text)
        }
        RequestError::Stalled(_) => Fault::new(Kind::Aborted, text),
        RequestError::ClientGone => Fault::new(Kind::Cancelled, text),
        RequestError::Draining => draining(text),
        RequestError::Elsewhere { .. } | RequestError::SeedsElsewhere { .. } => {
            retry(Kind::Unavailable, text, Duration::from_secs(1))
        }
        RequestError::SessionEnded { .. } => draining(text),
        RequestError::Slow(_) => {
            tracing::error!(error = %text, "the storage is slow");
            retry(Kind::Unavailable, text, Duration::from_secs(5))
        }
        RequestError::Job(error) => of_job(&error),
        RequestError::Blob(error) => of_blob(&error),
        RequestError::JobApi(error) => of_job_api(error),
        RequestError::Access(refusal) => of_refusal(refusal),
        // Said by the transport of gRPC, which has a status of its own.
        RequestError::Inbound(_) => Fault::new(Kind::InvalidArgument, text),
    }
}

fn of_rejection(rejection: &Rejection, text: String) -> Fault {
    match rejection {
        Rejection::Memory { .. } => retry(Kind::ResourceExhausted, text, Duration::from_secs(2)),
        Rejection::MessageTooLong { .. } | Rejection::Unpacked { .. } => Fault::new(Kind::ResourceExhausted, text),
        Rejection::Damaged => Fault::new(Kind::InvalidArgument, text),
        Rejection::Draining => draining(text),
    }
}

fn of_refusal(refusal: Refusal) -> Fault {
    let text = refusal.to_string();
    let quota = |subject, after| {
        let quota = Detail::Quota { subject, description: text.clone() };
        Fault::new(Kind::ResourceExhausted, text.clone()).with(Detail::Retry(after)).with(quota)
    };
    match refusal {
        // No details: what of a key is wrong stays here.
        Refusal::Unauthenticated => Fault::new(Kind::Unauthenticated, text),
        Refusal::Role(_) | Refusal::Tenant | Refusal::Host | Refusal::Origin => {
            Fault::new(Kind::PermissionDenied, text)
        }
        Refusal::TenantName => invalid(text.clone(), TENANT.to_owned(), text),
        Refusal::Hosts => invalid(text.clone(), "host".to_owned(), text),
        Refusal::MediaType => invalid(text.clone(), "content-type".to_owned(), text),
        Refusal::Unknown => Fault::new(Kind::Unimplemented, text),
        Refusal::Rate { wait, .. } => quota("rate", wait),
        Refusal::InFlight { .. } => quota("in-flight", Duration::from_secs(1)),
        Refusal::Bytes { .. } => quota("bytes", Duration::from_secs(30)),
    }
}

fn of_wire(error: WireError) -> Fault {
    let text = error.to_string();
    match error {
        WireError::Field { path, reason } => invalid(text, path, reason),
        WireError::Order(_) => invalid(text.clone(), "message".into(), text),
        // A server calls no other.
        WireError::Answer(_) => Fault::new(Kind::Internal, "the request failed by a fault of the server"),
    }
}

fn of_job(error: &JobError) -> Fault {
    let text = error.to_string();
    match error {
        JobError::QueueFull { retry_after, .. } => retry(Kind::ResourceExhausted, text, *retry_after),
        JobError::Draining => draining(text),
        JobError::Panicked(what) => {
            tracing::error!(%what, "work panicked");
            Fault::new(Kind::Internal, "the work failed by a fault of the server; its log says where")
        }
        JobError::WorkerGone => {
            tracing::error!("the engine did not answer");
            Fault::new(Kind::Internal, "the work was lost by a fault of the server; its log may say why")
        }
        JobError::Mesh(error) => of_mesh(error),
        JobError::Remesh(error) => of_remesh(error),
        JobError::Rvd(error) => of_rvd(error),
    }
}

fn of_remesh(error: &RemeshError) -> Fault {
    let text = error.to_string();
    let path = match error {
        RemeshError::NoThickness => "mesh.facets".to_owned(),
        RemeshError::Feature(FeatureError::NoSuchEdge { crease, .. }) => format!("mesh.creases[{crease}]"),
        RemeshError::Feature(FeatureError::BadAngle(_)) => "header.options.crease_angle".to_owned(),
        RemeshError::Feature(FeatureError::Stopped(reason)) => return of_stopped(*reason),
        RemeshError::TooFewSeeds { .. } => "seeds".to_owned(),
        RemeshError::EdgeTooLong { .. } => "header.options.density.edge_length".to_owned(),
        RemeshError::Density(error) => return of_density(error),
        RemeshError::BadLift { .. } => "header.options.anisotropy".to_owned(),
        RemeshError::Beside { one: "a mirror plane", .. }
        | RemeshError::NothingOnSide { .. }
        | RemeshError::SeamLost { .. }
        | RemeshError::FacetsInPlane { .. } => "header.options.mirror".to_owned(),
        RemeshError::Beside { one: "periodic boundaries", .. }
        | RemeshError::NotPeriodic { .. }
        | RemeshError::PeriodicLost { .. } => "header.options.periodic".to_owned(),
        RemeshError::Beside { .. } => "header.options.density".to_owned(),
        RemeshError::RefineUnfitted => "header.options.max_deviation".to_owned(),
        RemeshError::RefineLimit { .. } => "header.options.max_points".to_owned(),
        RemeshError::Part(_)
        | RemeshError::AllKept
        | RemeshError::KeptAcrossJunction { .. }
        | RemeshError::RimsMissed { .. } => "header.options.keep".to_owned(),
        RemeshError::KeptBesideSeeds => "seeds".to_owned(),
        RemeshError::TooFewForRims { .. } => "header.options.points".to_owned(),
        RemeshError::CreasesDropped { .. } | RemeshError::CreasesBroken { .. } => {
            "header.options.strict_creases".to_owned()
        }
        // What an upload carries is checked when it is collected, where its index is known.
        RemeshError::Attributes(_) => "mesh.attributes".to_owned(),
        RemeshError::Rvd(error) => return of_rvd(error),
    };
    invalid(text.clone(), path, text)
}

fn of_mesh(error: &MeshError) -> Fault {
    let path = match error {
        MeshError::NonFinitePosition { vertex, .. } => format!("mesh.positions[{vertex}]"),
        MeshError::IndexOutOfRange { facet, corner, .. } => format!("mesh.facets[{facet}][{corner}]"),
        MeshError::NoFacets | MeshError::NoArea { .. } => "mesh.facets".to_owned(),
        MeshError::TooLarge { what, .. } => format!("header.mesh.{what}"),
        MeshError::ExtentTooLarge { .. } | MeshError::ExtentTooSmall { .. } => "mesh.positions".to_owned(),
    };
    invalid(error.to_string(), path, error.to_string())
}

fn of_density(error: &DensityError) -> Fault {
    let path = match error {
        DensityError::SizeCount { .. } => "mesh.edge_lengths".to_owned(),
        DensityError::BadSize { vertex, .. } => format!("mesh.edge_lengths[{vertex}]"),
        DensityError::MetricCount { .. } => "mesh.metric".to_owned(),
        DensityError::MetricNotFinite { vertex }
        | DensityError::MetricNotPositive { vertex, .. }
        | DensityError::MetricRange { vertex } => format!("mesh.metric[{vertex}]"),
        DensityError::BadOption { name, .. } => format!("header.options.density.{}", name.replace(' ', "_")),
        DensityError::ZonesBeside { .. } | DensityError::ZonesNeed { .. } | DensityError::Part(_) => {
            "header.options.density.size_in".to_owned()
        }
        DensityError::NoCount | DensityError::PointLimit { .. } => "header.options.points".to_owned(),
        DensityError::TooManyPoints { .. } => "header.options.density".to_owned(),
        DensityError::Stopped(reason) => return of_stopped(*reason),
    };
    invalid(error.to_string(), path, error.to_string())
}

/// A job that was cancelled, or reached one of its ceilings. The same job would reach it again, so nothing says when to
/// try again.
fn of_stopped(reason: Stopped) -> Fault {
    let text = reason.to_string();
    let subject = match reason {
        Stopped::Cancelled => return Fault::new(Kind::Cancelled, "the work was cancelled"),
        Stopped::Time { .. } => "job-seconds",
        Stopped::Memory { .. } => "job-memory-mib",
    };
    Fault::new(Kind::ResourceExhausted, text.clone()).with(Detail::Quota { subject, description: text })
}

fn of_rvd(error: &RvdError) -> Fault {
    let text = error.to_string();
    let path = match error {
        RvdError::NoSeeds | RvdError::TooManySeeds { .. } => "seeds".to_owned(),
        RvdError::NonFiniteSeed { seed } | RvdError::SeedTooFar { seed, .. } => format!("seeds[{seed}]"),
        RvdError::NoArea => "mesh.facets".to_owned(),
        RvdError::NoSuchSeed { .. } => "edit.edits".to_owned(),
        RvdError::BadWeight { vertex, .. } => format!("mesh.weights[{vertex}]"),
        RvdError::BadLift { vertex } => format!("mesh.lift[{vertex}]"),
        RvdError::WeightCount { .. } => "mesh.weights".to_owned(),
        RvdError::Stopped(reason) => return of_stopped(*reason),
        RvdError::BackendUnavailable { wanted, reason } => {
            let (subject, description) = (wanted.name().to_owned(), reason.clone());
            let detail = Detail::Precondition { kind: "BACKEND", subject, description };
            return Fault::new(Kind::FailedPrecondition, text).with(detail);
        }
        RvdError::NeverFits { .. } => "header".to_owned(),
        RvdError::OutOfMemory { .. } => return retry(Kind::ResourceExhausted, text, Duration::from_secs(5)),
        RvdError::DeviceLost(_) => return retry(Kind::Unavailable, text, Duration::from_secs(5)),
        // No job of a server is read in windows.
        RvdError::Device(_) | RvdError::Internal(_) | RvdError::Unreadable(_) | RvdError::NoPieces => {
            tracing::error!(error = %text, "work failed");
            return Fault::new(Kind::Internal, "the work failed by a fault of the server; its log says why");
        }
    };
    invalid(text.clone(), path, text)
}

fn of_blob(error: &BlobError) -> Fault {
    let text = error.to_string();
    let path = match error {
        BlobError::NotFound { digest } => return not_found("blob", digest.to_string(), text),
        BlobError::UploadNotFound { digest } => return not_found("upload", digest.to_string(), text),
        BlobError::WrongOffset { .. } | BlobError::OutOfRange { .. } => {
            return Fault::new(Kind::OutOfRange, text.clone()).with(field("offset", text));
        }
        BlobError::ChunkTooLarge { .. } | BlobError::PastEnd { .. } => "data",
        BlobError::ChecksumMismatch { .. } => "crc32c",
        BlobError::Incomplete { .. } => "finish",
        BlobError::DigestMismatch { .. } => "digest",
        BlobError::WrongSize { .. } | BlobError::TooLarge { .. } => "size_bytes",
        BlobError::Damaged { .. } => return Fault::new(Kind::DataLoss, text),
        // What others have in use is none of the caller's business.
        BlobError::QuotaExceeded { needed_bytes, .. } => {
            let text = format!("no room for {needed_bytes} more bytes now; delete results, or try again later");
            return retry(Kind::ResourceExhausted, text, Duration::from_secs(5));
        }
        BlobError::TooManyUploads { .. } => return retry(Kind::ResourceExhausted, text, Duration::from_secs(5)),
        BlobError::OwnQuotaExceeded { used_bytes, limit_bytes, .. } => {
            return of_refusal(Refusal::Bytes { used_bytes: *used_bytes, limit_bytes: *limit_bytes });
        }
        BlobError::StorageFull => {
            tracing::error!("the disk of the blobs is full");
            return retry(Kind::ResourceExhausted, text, Duration::from_secs(30));
        }
        BlobError::Pinned { digest } => return precondition("PINNED", &digest.to_string(), text),
        // The log has the rest: paths and addresses of the storage.
        BlobError::InUse { .. } | BlobError::Unavailable(_) => {
            tracing::error!(error = %text, "the blob storage failed");
            let text = "the blob storage failed; try again, and look at the server's log if it stays so".to_owned();
            return retry(Kind::Unavailable, text, Duration::from_secs(5));
        }
        BlobError::Database(_) => return away(&text),
        BlobError::Busy { .. } => return retry(Kind::Unavailable, text, Duration::from_secs(1)),
    };
    invalid(text.clone(), path.to_owned(), text)
}

fn of_job_api(error: JobApiError) -> Fault {
    let text = error.to_string();
    match error {
        JobApiError::Input { field, problem } => invalid(text, field, problem),
        JobApiError::TooLarge { .. } | JobApiError::TooLong { .. } => invalid(text.clone(), "spec".to_owned(), text),
        JobApiError::Packed { .. } => {
            let path = "spec.mesh.file";
            invalid(format!("{path} {text}"), path.to_owned(), text)
        }
        JobApiError::Store(error) => of_store(&error),
        JobApiError::Blob(error) => of_blob(&error),
        JobApiError::Job(error) => of_job(&error),
    }
}

/// The database that servers share is away. The log has the rest.
fn away(error: &str) -> Fault {
    tracing::warn!(error, "the database does not answer");
    retry(Kind::Unavailable, "the database does not answer; try again".to_owned(), Duration::from_secs(2))
}

fn of_store(error: &StoreError) -> Fault {
    let text = error.to_string();
    match error {
        StoreError::NotFound { id } => not_found("job", id.to_string(), text),
        StoreError::InputMissing { digest } => not_found("blob", digest.to_string(), text),
        StoreError::AlreadyExists { .. } => {
            Fault::new(Kind::AlreadyExists, text.clone()).with(field("request_id", text))
        }
        StoreError::Transition { id, .. } | StoreError::NotEnded { id, .. } => {
            precondition("JOB_STATE", &id.to_string(), text)
        }
        // Somebody else was faster; the same call may succeed.
        StoreError::NameTaken { .. } | StoreError::Stale { .. } => retry(Kind::Aborted, text, Duration::from_secs(1)),
        StoreError::Closed => draining(text),
        StoreError::Broken { .. } => {
            tracing::error!(error = %text, "the store of jobs takes nothing any more");
            let text = "the store of jobs cannot be written now; its server must be started again".to_owned();
            retry(Kind::Unavailable, text, Duration::from_secs(30))
        }
        StoreError::Unavailable { .. } => away(&text),
        StoreError::InUse { .. }
        | StoreError::Unusable { .. }
        | StoreError::Damaged { .. }
        | StoreError::Unreadable { .. }
        | StoreError::UnknownVersion { .. }
        | StoreError::Io { .. } => {
            tracing::error!(error = %text, "the store of jobs failed");
            Fault::new(Kind::Internal, "the store of jobs failed; the server's log says why")
        }
    }
}

fn field(path: impl Into<String>, description: String) -> Detail {
    Detail::Field { path: path.into(), description }
}

fn invalid(text: String, path: String, description: String) -> Fault {
    Fault::new(Kind::InvalidArgument, text).with(field(path, description))
}

fn not_found(kind: &'static str, name: String, text: String) -> Fault {
    let description = text.clone();
    Fault::new(Kind::NotFound, text).with(Detail::Missing { kind, name, description })
}

fn precondition(kind: &'static str, subject: &str, text: String) -> Fault {
    let (subject, description) = (subject.to_owned(), text.clone());
    Fault::new(Kind::FailedPrecondition, text).with(Detail::Precondition { kind, subject, description })
}

fn retry(kind: Kind, text: String, after: Duration) -> Fault {
    Fault::new(kind, text).with(Detail::Retry(after))
}

fn draining(text: String) -> Fault {
    retry(Kind::Unavailable, text, Duration::from_secs(5))
}

pub(super) fn refusal(error: &RequestError) -> Option<Refused> {
    match error {
        RequestError::Transport(Rejection::Memory { .. }) => Some(Refused::Memory),
        RequestError::Transport(Rejection::MessageTooLong { .. }) => Some(Refused::MessageSize),
        RequestError::TooMany { .. } => Some(Refused::Streams),
        RequestError::Draining
        | RequestError::Elsewhere { .. }
        | RequestError::SessionEnded { .. }
        | RequestError::Transport(Rejection::Draining) => Some(Refused::Draining),
        RequestError::Job(error) | RequestError::JobApi(JobApiError::Job(error)) => refusal_of_job(error),
        RequestError::Blob(error) | RequestError::JobApi(JobApiError::Blob(error)) => refusal_of_blob(error),
        RequestError::JobApi(
            JobApiError::TooLarge { .. } | JobApiError::TooLong { .. } | JobApiError::Packed { .. },
        ) => Some(Refused::TooLarge),
        // The transport's word for a message that is too long, and ours for memory that is used up.
        RequestError::Inbound(status) => match status.code() {
            Code::OutOfRange => Some(Refused::MessageSize),
            Code::ResourceExhausted => Some(Refused::Memory),
            _ => None,
        },
        _ => None,
    }
}

fn refusal_of_job(error: &JobError) -> Option<Refused> {
    match error {
        JobError::QueueFull { .. } => Some(Refused::Queue),
        JobError::Draining => Some(Refused::Draining),
        _ => match error.as_rvd()? {
            RvdError::OutOfMemory { .. } => Some(Refused::Memory),
            RvdError::NeverFits { .. } => Some(Refused::TooLarge),
            _ => None,
        },
    }
}

fn refusal_of_blob(error: &BlobError) -> Option<Refused> {
    match error {
        BlobError::QuotaExceeded { .. } | BlobError::TooManyUploads { .. } | BlobError::StorageFull => {
            Some(Refused::Storage)
        }
        BlobError::TooLarge { .. } => Some(Refused::TooLarge),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::token::Stopped;
    use jobs::executor::api::Memory;
    use wire::WireError;

    #[test]
    fn faults_of_a_request_are_no_refusals() {
        assert_eq!(refusal(&WireError::Order("no").into()), None);
        assert_eq!(refusal(&JobError::from(Stopped::Cancelled).into()), None);
        assert_eq!(refusal(&JobError::from(RvdError::NoSeeds).into()), None);
        assert_eq!(refusal(&RequestError::Deadline), None);
    }

    #[test]
    fn what_may_succeed_elsewhere_is_one() {
        let full = JobError::QueueFull { waiting: 1, retry_after: std::time::Duration::ZERO };
        assert_eq!(refusal(&full.clone().into()), Some(Refused::Queue));
        assert_eq!(refusal(&JobApiError::Job(full).into()), Some(Refused::Queue));
        assert_eq!(
            refusal(&JobApiError::TooLarge { of: Memory::Host, needed_bytes: 2, limit_bytes: 1 }.into()),
            Some(Refused::TooLarge)
        );
        assert_eq!(refusal(&BlobError::StorageFull.into()), Some(Refused::Storage));
        assert_eq!(refusal(&RequestError::Draining), Some(Refused::Draining));
    }
}
