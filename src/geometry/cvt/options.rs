//! How iterations are done.
//!
//! Invariant: the defaults are those of the command and the service. Must not know: backends.

/// Where seeds go after each step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Projection {
    /// They stay where the step put them, near the surface.
    #[default]
    Free,
    /// Each is moved to the closest point of the surface.
    OnSurface,
}

/// How iterations are done.
#[derive(Clone, Copy, Debug, Default)]
pub struct CvtOptions {
    /// Where seeds go after each step.
    pub projection: Projection,
    /// Most seeds there is room for; 0 means as many as are given at first.
    pub max_seeds: usize,
}

impl CvtOptions {
    /// The defaults.
    pub fn new() -> Self {
        Self::default()
    }

    setters! {
        with_projection(projection: Projection),
        with_max_seeds(max_seeds: usize),
    }
}
