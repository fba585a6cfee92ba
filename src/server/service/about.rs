//! What a server knows of itself from its start on.
//!
//! Invariant: nothing here changes. Must not know: messages.

use std::time::{Duration, Instant};

#[derive(Clone, Debug)]
pub struct About {
    /// Revision of the sources, if the build was told.
    pub revision: Option<&'static str>,
    /// Features that were compiled in.
    pub features: Vec<&'static str>,
    pub started: Instant,
    /// Memory of the machine or its container, bytes, if it is known.
    pub machine_bytes: Option<u64>,
    /// By how many bytes the process may grow during a job, if there is a limit.
    pub job_limit_bytes: Option<u64>,
    /// Time at work of one job, if there is a limit.
    pub job_time: Option<Duration>,
    pub jobs_at_once: usize,
}

impl About {
    /// The revision that the build was told of by the variable `TESSERA_REVISION`.
    pub const REVISION: Option<&'static str> = option_env!("TESSERA_REVISION");
}

impl Default for About {
    fn default() -> Self {
        let features =
            [("gpu", true), ("otlp", cfg!(feature = "otlp")), ("pictures", true), ("s3", cfg!(feature = "s3"))];
        Self {
            revision: Self::REVISION,
            features: features.into_iter().filter_map(|(name, is_in)| is_in.then_some(name)).collect(),
            started: Instant::now(),
            machine_bytes: None,
            job_limit_bytes: None,
            job_time: None,
            jobs_at_once: 1,
        }
    }
}
