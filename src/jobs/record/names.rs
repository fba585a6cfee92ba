//! The names of a specification as the library's own types.
//!
//! Purpose: what is done ([`Kind`]), by which backend, in which format. Invariant: every name has one meaning. Must not
//! know: how a job is done.

use super::{BackendName, CvtCommand, CvtWork, JobSpec, WorkSpec};
use geometry::rvd::{BackendChoice, BackendKind};

/// The kind of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A whole remesh.
    Remesh,
    /// A diagram.
    Rvd,
    /// A session.
    Cvt,
}

impl Kind {
    /// "remesh", "rvd" or "cvt".
    pub fn name(self) -> &'static str {
        match self {
            Self::Remesh => "remesh",
            Self::Rvd => "rvd",
            Self::Cvt => "cvt",
        }
    }
}

impl JobSpec {
    /// What is done.
    pub fn kind(&self) -> Kind {
        match self.work {
            WorkSpec::Remesh(_) => Kind::Remesh,
            WorkSpec::Rvd(_) => Kind::Rvd,
            WorkSpec::Cvt(_) => Kind::Cvt,
        }
    }

    /// The backend that is asked for.
    pub fn choice(&self) -> BackendChoice {
        match self.backend {
            None | Some(BackendName::Auto) => BackendChoice::Auto,
            Some(BackendName::Gpu) => BackendChoice::Only(BackendKind::Gpu),
            Some(BackendName::Parallel) => BackendChoice::Only(BackendKind::Parallel),
            Some(BackendName::Serial) => BackendChoice::Only(BackendKind::Serial),
        }
    }
}

impl CvtWork {
    /// The steps of all commands.
    pub fn steps(&self) -> u64 {
        let steps = |command: &CvtCommand| match command {
            CvtCommand::Step { iterations, .. } => u64::from(*iterations),
            CvtCommand::Edit { .. } => 0,
        };
        self.commands.iter().map(steps).sum()
    }
}
