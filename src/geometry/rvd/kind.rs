//! Which implementation of the diagram does the work.
//!
//! Purpose: [`BackendKind`], a name for each, and [`BackendChoice`] of a caller. Must not know: how a backend is opened.

/// Which implementation does the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BackendKind {
    /// Double precision, one thread.
    Serial,
    /// Double precision, all threads of the pool.
    Parallel,
    /// Single precision on a wgpu device.
    Gpu,
}

impl BackendKind {
    /// All backends, the fastest first.
    pub const ALL: [Self; 3] = [Self::Gpu, Self::Parallel, Self::Serial];

    /// "serial", "parallel" or "gpu".
    pub fn name(self) -> &'static str {
        match self {
            Self::Serial => "serial",
            Self::Parallel => "parallel",
            Self::Gpu => "gpu",
        }
    }
}

/// Which backend should do the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BackendChoice {
    /// The GPU if there is one, else the parallel backend.
    #[default]
    Auto,
    /// This one or an error.
    Only(BackendKind),
}
