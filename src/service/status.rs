//! The only place where an error becomes a status code.
//!
//! Purpose: DESIGN's table, once. Invariant: what the caller can mend is INVALID_ARGUMENT with a
//! field; what time mends has RetryInfo; faults of ours say nothing of our insides.
//! Must not know: where an error arose.

use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use super::RequestError;
use super::access::{Refusal, TENANT};
use super::convert::spec::path_of;
use crate::blob::BlobError;
use crate::cvt::density::DensityError;
use crate::job::JobError;
use crate::job::api::JobApiError;
use crate::job::record::SpecError;
use crate::job::store::StoreError;
use crate::mesh::MeshError;
use crate::mesh::features::FeatureError;
use crate::remesh::RemeshError;
use crate::rvd::RvdError;
use crate::token::Stopped;
use crate::wire::WireError;

impl From<RequestError> for Status {
    fn from(error: RequestError) -> Self {
        let text = error.to_string();
        match error {
            RequestError::Wire(error) => of_wire(error),
            RequestError::Memory { .. } => retry(Code::ResourceExhausted, text, Duration::from_secs(2)),
            RequestError::MessageTooLong { .. } | RequestError::Unpacked { .. } => Status::resource_exhausted(text),
            RequestError::TooMany { .. } => retry(Code::ResourceExhausted, text, Duration::from_secs(1)),
            RequestError::Idle(_) | RequestError::UploadTime(_) | RequestError::Deadline => {
                Status::deadline_exceeded(text)
            }
            RequestError::Stalled(_) => Status::aborted(text),
            RequestError::ClientGone => Status::cancelled(text),
            RequestError::Draining => draining(text),
            RequestError::Slow(_) => {
                tracing::error!(error = %text, "the storage is slow");
                retry(Code::Unavailable, text, Duration::from_secs(5))
            }
            RequestError::Job(error) => of_job(&error),
            RequestError::Blob(error) => of_blob(&error),
            RequestError::JobApi(error) => of_job_api(error),
            RequestError::Access(refusal) => of_refusal(refusal),
            RequestError::Inbound(status) => of_inbound(status),
        }
    }
}

fn of_refusal(refusal: Refusal) -> Status {
    let text = refusal.to_string();
    let quota = |subject: &str, after: Duration| {
        let mut details = ErrorDetails::with_retry_info(Some(after));
        details.add_quota_failure_violation(subject, text.clone());
        Status::with_error_details(Code::ResourceExhausted, text.clone(), details)
    };
    match refusal {
        // No details: nobody is told what of a key is wrong.
        Refusal::Unauthenticated => Status::unauthenticated(text),
        Refusal::Role(_) | Refusal::Tenant => Status::permission_denied(text),
        Refusal::TenantName => invalid(text.clone(), TENANT.to_owned(), text),
        Refusal::Unknown => Status::unimplemented(text),
        Refusal::Rate { wait, .. } => quota("rate", wait),
        Refusal::InFlight { .. } => quota("in-flight", Duration::from_secs(1)),
        Refusal::Bytes { .. } => quota("bytes", Duration::from_secs(30)),
    }
}

fn of_wire(error: WireError) -> Status {
    let text = error.to_string();
    match error {
        WireError::Field { path, reason } => invalid(text, path, reason),
        WireError::Order(_) => invalid(text.clone(), "message".into(), text),
        WireError::Options(error) => of_remesh(&error),
        // A server asks nobody.
        #[cfg(feature = "cli")]
        WireError::Answer(_) => Status::internal("the request failed by a fault of the server"),
    }
}

fn of_job(error: &JobError) -> Status {
    let text = error.to_string();
    match error {
        JobError::QueueFull { retry_after, .. } => retry(Code::ResourceExhausted, text, *retry_after),
        JobError::Draining => draining(text),
        JobError::Panicked(what) => {
            tracing::error!(%what, "work panicked");
            Status::internal("the work failed by a fault of the server; its log says where")
        }
        JobError::WorkerGone => {
            tracing::error!("the engine did not answer");
            Status::internal("the work was lost by a fault of the server; its log may say why")
        }
        JobError::Mesh(error) => of_mesh(error),
        JobError::Remesh(error) => of_remesh(error),
        JobError::Rvd(error) => of_rvd(error),
    }
}

fn of_remesh(error: &RemeshError) -> Status {
    let text = error.to_string();
    let path = match error {
        RemeshError::NoThickness => "mesh.facets".to_owned(),
        RemeshError::Feature(FeatureError::NoSuchEdge { crease, .. }) => format!("mesh.creases[{crease}]"),
        RemeshError::Feature(FeatureError::BadAngle(_)) => "header.crease_angle_deg".to_owned(),
        RemeshError::Feature(FeatureError::Stopped(reason)) => return of_stopped(*reason),
        RemeshError::TooFewSeeds { .. } => "seeds".to_owned(),
        RemeshError::Density(error) => return of_density(error),
        RemeshError::RefineUnfitted => "header.refinement".to_owned(),
        RemeshError::RefineLimit { .. } => "header.refinement.max_points".to_owned(),
        // What an upload carries is checked when it is collected, where its index is known.
        RemeshError::Attributes(_) => "mesh.attributes".to_owned(),
        RemeshError::Rvd(error) => return of_rvd(error),
    };
    invalid(text.clone(), path, text)
}

fn of_mesh(error: &MeshError) -> Status {
    let path = match error {
        MeshError::NonFinitePosition { vertex, .. } => format!("mesh.positions[{vertex}]"),
        MeshError::IndexOutOfRange { facet, corner, .. } => format!("mesh.facets[{facet}][{corner}]"),
        MeshError::NoFacets | MeshError::NoArea { .. } => "mesh.facets".to_owned(),
        MeshError::TooLarge { what, .. } => format!("header.mesh.{what}"),
        MeshError::ExtentTooLarge { .. } | MeshError::ExtentTooSmall { .. } => "mesh.positions".to_owned(),
    };
    invalid(error.to_string(), path, error.to_string())
}

fn of_density(error: &DensityError) -> Status {
    let path = match error {
        DensityError::SizeCount { .. } => "mesh.edge_lengths".to_owned(),
        DensityError::BadSize { vertex, .. } => format!("mesh.edge_lengths[{vertex}]"),
        DensityError::BadOption { name, .. } => format!("header.density.{}", name.replace(' ', "_")),
        DensityError::NoCount | DensityError::PointLimit { .. } => "header.seeds.sampled.points".to_owned(),
        DensityError::TooManyPoints { .. } => "header.density".to_owned(),
        DensityError::Stopped(reason) => return of_stopped(*reason),
    };
    invalid(error.to_string(), path, error.to_string())
}

/// A job that was cancelled, or reached one of its ceilings. The same job would reach it again, so nothing says when to
/// try again.
fn of_stopped(reason: Stopped) -> Status {
    let text = reason.to_string();
    let subject = match reason {
        Stopped::Cancelled => return Status::cancelled("the work was cancelled"),
        Stopped::Time { .. } => "job-seconds",
        Stopped::Memory { .. } => "job-memory-mib",
    };
    let details = ErrorDetails::with_quota_failure_violation(subject, text.clone());
    Status::with_error_details(Code::ResourceExhausted, text, details)
}

fn of_rvd(error: &RvdError) -> Status {
    let text = error.to_string();
    let path = match error {
        RvdError::NoSeeds | RvdError::TooManySeeds { .. } => "seeds".to_owned(),
        RvdError::NonFiniteSeed { seed } | RvdError::SeedTooFar { seed, .. } => format!("seeds[{seed}]"),
        RvdError::NoArea => "mesh.facets".to_owned(),
        RvdError::NoSuchSeed { .. } => "edit.edits".to_owned(),
        RvdError::BadWeight { vertex, .. } => format!("mesh.weights[{vertex}]"),
        RvdError::WeightCount { .. } => "mesh.weights".to_owned(),
        RvdError::Stopped(reason) => return of_stopped(*reason),
        RvdError::BackendUnavailable { wanted, reason } => {
            let details = ErrorDetails::with_precondition_failure_violation("BACKEND", wanted.name(), reason.clone());
            return Status::with_error_details(Code::FailedPrecondition, text, details);
        }
        RvdError::NeverFits { .. } => "header".to_owned(),
        RvdError::OutOfMemory { .. } => return retry(Code::ResourceExhausted, text, Duration::from_secs(5)),
        RvdError::DeviceLost(_) => return retry(Code::Unavailable, text, Duration::from_secs(5)),
        RvdError::Device(_) | RvdError::Internal(_) => {
            tracing::error!(error = %text, "work failed");
            return Status::internal("the work failed by a fault of the server; its log says why");
        }
    };
    invalid(text.clone(), path, text)
}

fn of_blob(error: &BlobError) -> Status {
    let text = error.to_string();
    let path = match error {
        BlobError::NotFound { digest } => return not_found("blob", digest.to_string(), text),
        BlobError::UploadNotFound { digest } => return not_found("upload", digest.to_string(), text),
        BlobError::WrongOffset { .. } | BlobError::OutOfRange { .. } => {
            let details = ErrorDetails::with_bad_request_violation("offset", text.clone());
            return Status::with_error_details(Code::OutOfRange, text, details);
        }
        BlobError::ChunkTooLarge { .. } | BlobError::PastEnd { .. } => "data",
        BlobError::ChecksumMismatch { .. } => "crc32c",
        BlobError::Incomplete { .. } => "finish",
        BlobError::DigestMismatch { .. } => "digest",
        BlobError::WrongSize { .. } | BlobError::TooLarge { .. } => "size_bytes",
        BlobError::Damaged { .. } => return Status::data_loss(text),
        // What others have in use is none of the caller's business.
        BlobError::QuotaExceeded { needed_bytes, .. } => {
            let text = format!("no room for {needed_bytes} more bytes now; delete results, or try again later");
            return retry(Code::ResourceExhausted, text, Duration::from_secs(5));
        }
        BlobError::TooManyUploads { .. } => return retry(Code::ResourceExhausted, text, Duration::from_secs(5)),
        BlobError::OwnQuotaExceeded { used_bytes, limit_bytes, .. } => {
            return of_refusal(Refusal::Bytes { used_bytes: *used_bytes, limit_bytes: *limit_bytes });
        }
        BlobError::StorageFull => {
            tracing::error!("the disk of the blobs is full");
            return retry(Code::ResourceExhausted, text, Duration::from_secs(30));
        }
        BlobError::Pinned { digest } => return precondition("PINNED", &digest.to_string(), text),
        // The log has the rest: paths and addresses of the storage.
        BlobError::InUse { .. } | BlobError::Unavailable(_) => {
            tracing::error!(error = %text, "the blob storage failed");
            let text = "the blob storage failed; try again, and look at the server's log if it stays so".to_owned();
            return retry(Code::Unavailable, text, Duration::from_secs(5));
        }
    };
    invalid(text.clone(), path.to_owned(), text)
}

fn of_job_api(error: JobApiError) -> Status {
    let text = error.to_string();
    match error {
        JobApiError::Spec(error) => of_spec(&error),
        JobApiError::Input { field, problem } => {
            let path = path_of(&field);
            invalid(format!("{path} {problem}"), path, problem)
        }
        JobApiError::TooLarge { .. } => invalid(text.clone(), "spec".to_owned(), text),
        JobApiError::Store(error) => of_store(&error),
        JobApiError::Blob(error) => of_blob(&error),
        JobApiError::Job(error) => of_job(&error),
    }
}

/// Says the field as messages call it.
fn of_spec(error: &SpecError) -> Status {
    let path = path_of(error.field());
    let text = error.to_string();
    let text = match text.strip_prefix(error.field()) {
        Some(rest) if !error.field().is_empty() => format!("{path}{rest}"),
        _ => text,
    };
    invalid(text.clone(), path, text)
}

fn of_store(error: &StoreError) -> Status {
    let text = error.to_string();
    match error {
        StoreError::NotFound { id } => not_found("job", id.to_string(), text),
        StoreError::AlreadyExists { .. } => {
            let details = ErrorDetails::with_bad_request_violation("request_id", text.clone());
            Status::with_error_details(Code::AlreadyExists, text, details)
        }
        StoreError::Transition { id, .. } | StoreError::NotEnded { id, .. } => {
            precondition("JOB_STATE", &id.to_string(), text)
        }
        // Somebody else was faster; the same call may succeed.
        StoreError::NameTaken { .. } | StoreError::Stale { .. } => retry(Code::Aborted, text, Duration::from_secs(1)),
        StoreError::Closed => draining(text),
        StoreError::Broken { .. } => {
            tracing::error!(error = %text, "the store of jobs takes nothing any more");
            let text = "the store of jobs cannot be written now; its server must be started again".to_owned();
            retry(Code::Unavailable, text, Duration::from_secs(30))
        }
        StoreError::InUse { .. }
        | StoreError::Damaged { .. }
        | StoreError::Unreadable { .. }
        | StoreError::UnknownVersion { .. }
        | StoreError::Io { .. } => {
            tracing::error!(error = %text, "the store of jobs failed");
            Status::internal("the store of jobs failed; the server's log says why")
        }
    }
}

/// What the transport says of a message that it could not read.
fn of_inbound(status: Status) -> Status {
    match status.code() {
        // tonic's word for a message over the cap.
        Code::OutOfRange => Status::resource_exhausted(status.message()),
        // Whatever is wrong with what a client sends is no fault of the server.
        Code::Internal => Status::invalid_argument(status.message()),
        _ => status,
    }
}

fn invalid(text: String, path: String, description: String) -> Status {
    let details = ErrorDetails::with_bad_request_violation(path, description);
    Status::with_error_details(Code::InvalidArgument, text, details)
}

fn not_found(kind: &str, name: String, text: String) -> Status {
    let details = ErrorDetails::with_resource_info(kind, name, "", text.clone());
    Status::with_error_details(Code::NotFound, text, details)
}

fn precondition(kind: &str, subject: &str, text: String) -> Status {
    let details = ErrorDetails::with_precondition_failure_violation(kind, subject, text.clone());
    Status::with_error_details(Code::FailedPrecondition, text, details)
}

fn retry(code: Code, text: String, after: Duration) -> Status {
    Status::with_error_details(code, text, ErrorDetails::with_retry_info(Some(after)))
}

fn draining(text: String) -> Status {
    retry(Code::Unavailable, text, Duration::from_secs(5))
}
