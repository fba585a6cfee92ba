//! Errors to exit codes.

use std::path::PathBuf;

use geometry::mesh::MeshError;
use geometry::mesh::io::FileError;
use geometry::remesh::RemeshError;
use geometry::rvd::RvdError;
use geometry::token::Stopped;
use jobs::JobError;
use picture::PictureError;
pub(crate) use server::config::{self, ConfigError};
use telemetry::TelemetryError;

const USAGE: u8 = 2;
const DATA: u8 = 65;
const NO_INPUT: u8 = 66;
const UNAVAILABLE: u8 = 69;
const INTERNAL: u8 = 70;
const NO_FOLDER: u8 = 73;
const IO: u8 = 74;
const STUCK: u8 = 75;
const NO_DEVICE: u8 = 76;
/// A threshold of `tessera load` does not hold; a code of its own, so that a script can tell it from a failure.
const THRESHOLD: u8 = 79;
const INTERRUPTED: u8 = super::interrupt::CODE;

pub(crate) const HELP: &str = "Exit codes:
  0    done
  2    wrong usage: an option is missing, unknown or out of its range
  65   the input is no surface, or a file does not say what it should
  66   an input file is missing or cannot be read, or the server has no such job or blob
  69   the server, the GPU or the memory is not to be had, or the server's answer is wrong
  70   the job has no result or is in another state than the command needs, or an error in this program
  73   the folder of an output file is missing
  74   an output file or the standard output cannot be written
  75   work did not stop when it was told to; a server is to be started anew
  76   the device was lost and did not come back; a server is to be started anew
  79   a threshold of `load --fail-if` was crossed; the report was written all the same
  130  interrupted";

/// Errors that are a sentence, each kind with its exit code. Before them other errors with theirs.
macro_rules! kinds {
    (others { $($other:ty: $its_code:ident;)* } $($(#[$doc:meta])* $name:ident: $code:ident;)*) => {
        $(
            $(#[$doc])*
            #[derive(Debug, thiserror::Error)]
            #[error("{0}")]
            pub(crate) struct $name(pub(crate) String);
        )*

        fn of_kind(cause: &(dyn std::error::Error + 'static)) -> Option<u8> {
            $(if cause.is::<$name>() {
                return Some($code);
            })*
            $(if cause.is::<$other>() {
                return Some($its_code);
            })*
            None
        }
    };
}

kinds! {
    others {
        ConfigError: USAGE;
        config::FileError: USAGE;
        TelemetryError: USAGE;
        NoInput: NO_INPUT;
        NoFolder: NO_FOLDER;
        MeshError: DATA;
    }
    /// Options that do not go together, or ask for something that does not exist.
    Usage: USAGE;
    /// TLS files that a server cannot use.
    BadTls: USAGE;
    /// A file with wrong content.
    BadInput: DATA;
    /// A result that could not be written.
    NotWritten: IO;
    /// A server or a device that does not answer, or answers wrongly.
    Unavailable: UNAVAILABLE;
    /// A job, a blob or a result that the server does not have.
    Absent: NO_INPUT;
    /// A job without a result, or in another state than the command needs.
    NoResult: INTERNAL;
    /// A device that was lost and did not come back.
    NoDevice: NO_DEVICE;
    /// Thresholds that were crossed by a load that ran to its end.
    Crossed: THRESHOLD;
    /// Work that goes on though it was told to stop.
    Stuck: STUCK;
}

#[derive(Debug, thiserror::Error)]
#[error("cannot read {}: {cause}", path.display())]
pub(crate) struct NoInput {
    pub(crate) path: PathBuf,
    pub(crate) cause: std::io::Error,
}

#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: there is no folder {}; make it first", path.display(), folder.display())]
pub(crate) struct NoFolder {
    pub(crate) path: PathBuf,
    pub(crate) folder: PathBuf,
}

/// The exit code for an error, by the first cause in its chain that has one.
pub(crate) fn code(error: &anyhow::Error) -> u8 {
    error.chain().find_map(known).unwrap_or(INTERNAL)
}

fn known(cause: &(dyn std::error::Error + 'static)) -> Option<u8> {
    let of_file = |error: &FileError| match error {
        FileError::UnknownFormat { .. } => USAGE,
        FileError::Data { .. } => DATA,
        FileError::Io { action: "read", .. } => NO_INPUT,
        FileError::Io { .. } => IO,
    };
    let of_picture = |error: &PictureError| match error {
        PictureError::Size(..) | PictureError::Direction(_) => Some(USAGE),
        PictureError::Write { .. } => Some(IO),
        _ => None,
    };
    of_kind(cause)
        .or_else(|| cause.downcast_ref().map(of_file))
        .or_else(|| cause.downcast_ref().and_then(of_picture))
        .or_else(|| cause.downcast_ref().map(of_job))
        .or_else(|| cause.downcast_ref().map(of_remesh))
        .or_else(|| cause.downcast_ref().map(of_rvd))
}

fn of_job(error: &JobError) -> u8 {
    match error {
        JobError::QueueFull { .. } | JobError::Draining => UNAVAILABLE,
        JobError::Panicked(_) | JobError::WorkerGone => INTERNAL,
        JobError::Mesh(_) => DATA,
        JobError::Rvd(error) => of_rvd(error),
        JobError::Remesh(error) => of_remesh(error),
    }
}

fn of_remesh(error: &RemeshError) -> u8 {
    match error {
        RemeshError::Rvd(error) => of_rvd(error),
        _ => DATA,
    }
}

fn of_rvd(error: &RvdError) -> u8 {
    match error {
        RvdError::Stopped(Stopped::Cancelled) => INTERRUPTED,
        RvdError::Stopped(_) => UNAVAILABLE,
        RvdError::OutOfMemory { .. }
        | RvdError::NeverFits { .. }
        | RvdError::DeviceLost(_)
        | RvdError::Device(_)
        | RvdError::BackendUnavailable { .. } => UNAVAILABLE,
        RvdError::Internal(_) => INTERNAL,
        RvdError::Unreadable(_) => IO,
        _ => DATA,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_found_under_context() {
        let error = anyhow::Error::new(RvdError::NoSeeds).context("computing");
        assert_eq!(code(&error), DATA);
        let error = anyhow::Error::new(Unavailable("no".into())).context("asking");
        assert_eq!(code(&error), UNAVAILABLE);
        assert_eq!(code(&anyhow::Error::new(Usage("x".into()))), USAGE);
        assert_eq!(code(&anyhow::anyhow!("what?")), INTERNAL);
    }
}
