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
/// Work did not stop when it was told to; only a new process can go on.
const STUCK: u8 = 75;
/// The device was lost and did not come back; only a new process can go on.
const NO_DEVICE: u8 = 76;
/// A threshold of `tessera load` does not hold; a code of its own, so that a script can tell it from a failure.
const THRESHOLD: u8 = 79;
const INTERRUPTED: u8 = super::interrupt::CODE;

/// What `--help` says of them.
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

/// Options that do not go together, or ask for what is not there.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Usage(pub(crate) String);

/// Files of TLS that a server cannot use.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct BadTls(pub(crate) String);

/// A file that cannot be read or does not say what it should.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct BadInput(pub(crate) String);

/// A file that is not there, or may not be read.
#[derive(Debug, thiserror::Error)]
#[error("cannot read {}: {cause}", path.display())]
pub(crate) struct NoInput {
    /// The file.
    pub(crate) path: PathBuf,
    /// What the system said.
    pub(crate) cause: std::io::Error,
}

/// A file that is to be made in a folder that is not there.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: there is no folder {}; make it first", path.display(), folder.display())]
pub(crate) struct NoFolder {
    /// The file.
    pub(crate) path: PathBuf,
    /// The folder.
    pub(crate) folder: PathBuf,
}

/// A result that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct NotWritten(pub(crate) String);

/// Somebody else's service or device is not there.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Unavailable(pub(crate) String);

/// A job, a blob or a result that the server does not have.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Absent(pub(crate) String);

/// A job that has no result, or is not where the command needs it to be.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct NoResult(pub(crate) String);

/// A device that was lost and did not come back.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct NoDevice(pub(crate) String);

/// Thresholds that were crossed by a load that ran to its end.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Crossed(pub(crate) String);

/// Work that goes on though it was told to stop.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Stuck(pub(crate) String);

/// The exit code for an error, by the first cause in its chain that has one.
pub(crate) fn code(error: &anyhow::Error) -> u8 {
    error.chain().find_map(known).unwrap_or(INTERNAL)
}

fn known(cause: &(dyn std::error::Error + 'static)) -> Option<u8> {
    if cause.is::<Usage>()
        || cause.is::<ConfigError>()
        || cause.is::<config::FileError>()
        || cause.is::<BadTls>()
        || cause.is::<TelemetryError>()
    {
        return Some(USAGE);
    }
    match cause.downcast_ref::<FileError>() {
        Some(FileError::UnknownFormat { .. }) => return Some(USAGE),
        Some(FileError::Data { .. }) => return Some(DATA),
        Some(FileError::Io { action: "read", .. }) => return Some(NO_INPUT),
        Some(FileError::Io { .. }) => return Some(IO),
        None => {}
    }
    if cause.is::<NoDevice>() {
        return Some(NO_DEVICE);
    }
    if cause.is::<Crossed>() {
        return Some(THRESHOLD);
    }
    if cause.is::<Stuck>() {
        return Some(STUCK);
    }
    if cause.is::<NoInput>() || cause.is::<Absent>() {
        return Some(NO_INPUT);
    }
    if cause.is::<NoResult>() {
        return Some(INTERNAL);
    }
    if cause.is::<NoFolder>() {
        return Some(NO_FOLDER);
    }
    if cause.is::<NotWritten>() {
        return Some(IO);
    }
    match cause.downcast_ref::<PictureError>() {
        Some(PictureError::Size { .. } | PictureError::Direction { .. }) => return Some(USAGE),
        Some(PictureError::Write { .. }) => return Some(IO),
        _ => {}
    }
    if cause.is::<BadInput>() || cause.is::<MeshError>() {
        return Some(DATA);
    }
    if cause.is::<Unavailable>() {
        return Some(UNAVAILABLE);
    }
    if let Some(error) = cause.downcast_ref::<JobError>() {
        return Some(of_job(error));
    }
    if let Some(error) = cause.downcast_ref::<RemeshError>() {
        return Some(of_remesh(error));
    }
    cause.downcast_ref::<RvdError>().map(of_rvd)
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
        RemeshError::TooFewSeeds { .. }
        | RemeshError::NoThickness
        | RemeshError::Feature(_)
        | RemeshError::Density(_)
        | RemeshError::RefineUnfitted
        | RemeshError::RefineLimit { .. }
        | RemeshError::Attributes(_) => DATA,
    }
}

fn of_rvd(error: &RvdError) -> u8 {
    match error {
        RvdError::Stopped(Stopped::Cancelled) => INTERRUPTED,
        RvdError::Stopped(_) => UNAVAILABLE,
        RvdError::OutOfMemory { .. } | RvdError::NeverFits { .. } | RvdError::DeviceLost(_) | RvdError::Device(_) => {
            UNAVAILABLE
        }
        RvdError::BackendUnavailable { .. } => UNAVAILABLE,
        RvdError::Internal(_) => INTERNAL,
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
