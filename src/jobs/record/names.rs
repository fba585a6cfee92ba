//! The kinds of jobs. Invariant: every kind has one name. Must not know: how a job is done.

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
