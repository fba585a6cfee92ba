//! What a server may be told, and what of it makes sense.
//!
//! Purpose: [`ServeArgs`] as clap and the environment give it, [`ServeConfig`] once it is checked.
//! Invariant: a `ServeConfig` exists only if every value is usable; it is made before any port is
//! bound. Must not know: how a value is used, any other room.

#[cfg(feature = "cli")]
use std::net::SocketAddr;
use std::time::Duration;

#[cfg(feature = "cli")]
use clap::{Args, ValueEnum};

#[cfg(feature = "cli")]
/// Indices have 31 bits, less a few that are labels.
const MAX_ELEMENTS: u64 = i32::MAX as u64 - 8;

#[cfg(feature = "cli")]
/// Which backend should do the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum BackendArg {
    /// The GPU if there is one, else the parallel CPU backend.
    #[default]
    Auto,
    /// The GPU, or an error.
    Gpu,
    /// f64 on all threads of the pool.
    Parallel,
    /// f64 on one thread.
    Serial,
}

#[cfg(feature = "cli")]
/// Who works and with how much: the options that every working subcommand has.
#[derive(Args, Clone, Debug, Default)]
pub struct BackendArgs {
    /// Which backend should do the work.
    #[arg(long, value_enum, default_value_t, env = "TESSERA_BACKEND")]
    pub backend: BackendArg,
    /// Let a software adapter stand in for a GPU (slower than the CPU backend; for tests).
    #[arg(long, env = "TESSERA_GPU_SOFTWARE")]
    pub gpu_software: bool,
    /// Threads of the CPU backend; all cores if not given.
    #[arg(long, value_name = "T", env = "TESSERA_THREADS")]
    pub threads: Option<usize>,
}

#[cfg(feature = "cli")]
/// `tessera serve`'s options.
#[derive(Args, Clone, Debug)]
pub struct ServeArgs {
    /// Address and port to listen on; port 0 takes a free one and prints it.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:50051", env = "TESSERA_LISTEN")]
    pub listen: SocketAddr,
    /// Who works.
    #[command(flatten)]
    pub backend: BackendArgs,
    /// Jobs that may wait for the device; one more is refused with RESOURCE_EXHAUSTED.
    #[arg(long, value_name = "N", default_value_t = 32, env = "TESSERA_QUEUE_JOBS")]
    pub queue_jobs: usize,
    /// Streams open at once, waiting, uploading and interactive ones included.
    #[arg(long, value_name = "N", default_value_t = 256, env = "TESSERA_MAX_STREAMS")]
    pub max_streams: usize,
    /// Interactive CVT sessions open at once.
    #[arg(long, value_name = "N", default_value_t = 16, env = "TESSERA_MAX_SESSIONS")]
    pub max_sessions: usize,
    /// Largest number of mesh vertices.
    #[arg(long, value_name = "N", default_value_t = 20_000_000, env = "TESSERA_MAX_VERTICES")]
    pub max_vertices: u64,
    /// Largest number of mesh facets.
    #[arg(long, value_name = "N", default_value_t = 40_000_000, env = "TESSERA_MAX_FACETS")]
    pub max_facets: u64,
    /// Largest number of seeds.
    #[arg(long, value_name = "N", default_value_t = 4_000_000, env = "TESSERA_MAX_SEEDS")]
    pub max_seeds: u64,
    /// Most iterations in one request.
    #[arg(long, value_name = "N", default_value_t = 10_000, env = "TESSERA_MAX_ITERATIONS")]
    pub max_iterations: u32,
    /// Geometry of all streams together that is held in memory, MiB.
    #[arg(long, value_name = "MIB", default_value_t = 4096, env = "TESSERA_MEMORY_MIB")]
    pub memory_mib: u64,
    /// Seconds that running work gets to end after SIGTERM.
    #[arg(long, value_name = "S", default_value_t = 30.0, env = "TESSERA_GRACE_S")]
    pub grace_s: f64,
    /// Seconds after which a client that reads nothing is cut.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_STALL_S")]
    pub stall_s: f64,
    /// Seconds between two messages of an upload.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_UPLOAD_IDLE_S")]
    pub upload_idle_s: f64,
    /// Seconds between two commands of an interactive session.
    #[arg(long, value_name = "S", default_value_t = 600.0, env = "TESSERA_SESSION_IDLE_S")]
    pub session_idle_s: f64,
}

/// What one request may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Mesh vertices.
    pub max_vertices: u64,
    /// Mesh facets.
    pub max_facets: u64,
    /// Seeds.
    pub max_seeds: u64,
    /// Iterations.
    pub max_iterations: u32,
    /// Streams at once.
    pub max_streams: usize,
    /// Interactive sessions at once.
    pub max_sessions: usize,
    /// Uploaded geometry in memory, all streams together, bytes.
    pub memory_bytes: u64,
    /// Between two messages of an upload.
    pub upload_idle: Duration,
    /// Between two commands of a session.
    pub session_idle: Duration,
    /// For a client to read a message.
    pub stall: Duration,
    /// For work to end after the shutdown began.
    pub grace: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_vertices: 20_000_000,
            max_facets: 40_000_000,
            max_seeds: 4_000_000,
            max_iterations: 10_000,
            max_streams: 256,
            max_sessions: 16,
            memory_bytes: 4 << 30,
            upload_idle: Duration::from_secs(60),
            session_idle: Duration::from_secs(600),
            stall: Duration::from_secs(60),
            grace: Duration::from_secs(30),
        }
    }
}

#[cfg(feature = "cli")]
/// A server's configuration, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct ServeConfig {
    /// Where to listen.
    pub listen: SocketAddr,
    /// Jobs that may wait.
    pub queue_jobs: usize,
    /// What one request may ask for.
    pub limits: Limits,
}

#[cfg(feature = "cli")]
/// A value that makes no sense.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{option} is {value}; it must be {must}")]
pub struct ConfigError {
    /// The option's name on the command line.
    pub option: &'static str,
    /// As given.
    pub value: String,
    /// What it must be.
    pub must: &'static str,
}

#[cfg(feature = "cli")]
impl ServeArgs {
    /// Checks every value.
    ///
    /// # Errors
    /// [`ConfigError`] for the first one that is wrong.
    pub fn check(&self) -> Result<ServeConfig, ConfigError> {
        self.backend.check()?;
        let most = MAX_ELEMENTS;
        Ok(ServeConfig {
            listen: self.listen,
            queue_jobs: count("--queue-jobs", self.queue_jobs as u64, 1, 100_000, "1 to 100000")? as usize,
            limits: Limits {
                max_vertices: count("--max-vertices", self.max_vertices, 3, most, "3 to 2147483639")?,
                max_facets: count("--max-facets", self.max_facets, 1, most, "1 to 2147483639")?,
                max_seeds: count("--max-seeds", self.max_seeds, 1, most, "1 to 2147483639")?,
                max_iterations: count("--max-iterations", self.max_iterations.into(), 0, 1_000_000, "at most 1000000")?
                    as u32,
                max_streams: count("--max-streams", self.max_streams as u64, 1, 100_000, "1 to 100000")? as usize,
                max_sessions: count("--max-sessions", self.max_sessions as u64, 0, 10_000, "at most 10000")? as usize,
                memory_bytes: count("--memory-mib", self.memory_mib, 1, 1 << 24, "1 to 16777216")? << 20,
                upload_idle: seconds("--upload-idle-s", self.upload_idle_s)?,
                session_idle: seconds("--session-idle-s", self.session_idle_s)?,
                stall: seconds("--stall-s", self.stall_s)?,
                grace: seconds("--grace-s", self.grace_s)?,
            },
        })
    }
}

#[cfg(feature = "cli")]
impl BackendArgs {
    /// Checks the number of threads.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn check(&self) -> Result<(), ConfigError> {
        match self.threads {
            Some(threads) => count("--threads", threads as u64, 1, 4096, "1 to 4096").map(|_| ()),
            None => Ok(()),
        }
    }
}

#[cfg(feature = "cli")]
fn count(option: &'static str, value: u64, least: u64, most: u64, must: &'static str) -> Result<u64, ConfigError> {
    if (least..=most).contains(&value) {
        Ok(value)
    } else {
        Err(ConfigError { option, value: value.to_string(), must })
    }
}

#[cfg(feature = "cli")]
fn seconds(option: &'static str, value: f64) -> Result<Duration, ConfigError> {
    if (0.01..=86_400.0).contains(&value) {
        return Ok(Duration::from_secs_f64(value));
    }
    Err(ConfigError { option, value: value.to_string(), must: "0.01 to 86400 seconds" })
}

#[cfg(all(test, feature = "cli"))]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        serve: ServeArgs,
    }

    fn parse(line: &[&str]) -> Result<ServeConfig, ConfigError> {
        Line::parse_from([&["tessera"], line].concat()).serve.check()
    }

    #[test]
    fn the_defaults_are_the_library_s() {
        assert_eq!(parse(&[]).unwrap().limits, Limits::default());
    }

    #[test]
    fn what_makes_no_sense_is_named() {
        for line in [["--queue-jobs", "0"], ["--grace-s", "NaN"], ["--max-seeds", "4294967296"], ["--threads", "0"]] {
            assert_eq!(parse(&line).unwrap_err().option, line[0]);
        }
    }
}
