//! What a server may be told, and what of it makes sense.
//!
//! Purpose: [`ServeArgs`] as clap and the environment give it, [`ServeConfig`] once it is checked.
//! Invariant: a `ServeConfig` exists only if every value is usable; it is made before any port is
//! bound. Must not know: how a value is used, any other room.

#[cfg(feature = "cli")]
use std::net::{SocketAddr, ToSocketAddrs};
#[cfg(feature = "cli")]
use std::path::PathBuf;
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
pub(crate) struct BackendArgs {
    /// Which backend should do the work.
    #[arg(long, value_enum, default_value_t, env = "TESSERA_BACKEND")]
    pub backend: BackendArg,
    /// Let a software adapter stand in for a GPU (slower than the CPU backend; for tests).
    #[arg(long, env = "TESSERA_GPU_SOFTWARE")]
    pub gpu_software: bool,
    /// Threads of the CPU backend; all cores if not given.
    #[arg(long, value_name = "T", value_parser = whole::<usize>, env = "TESSERA_THREADS")]
    pub threads: Option<usize>,
}

#[cfg(feature = "cli")]
/// `tessera serve`'s options.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Server and its limits")]
pub(crate) struct ServeArgs {
    /// Address or name, and port to listen on; port 0 takes a free one and prints it.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:50051", env = "TESSERA_LISTEN")]
    pub listen: String,
    /// Folder where jobs, results and uploads are kept; one server at a time may use it. The user's state directory if not
    /// given: $XDG_STATE_HOME/tessera, or ~/.local/state/tessera.
    #[arg(long, value_name = "DIR", env = "TESSERA_DATA_DIR", conflicts_with = "ephemeral")]
    pub data_dir: Option<PathBuf>,
    /// Keep jobs, results and uploads in memory: they are gone with the server.
    #[arg(long, env = "TESSERA_EPHEMERAL")]
    pub ephemeral: bool,
    /// How long results are kept after a job has ended, e.g. 90s, 30m, 24h or 7d.
    #[arg(long, value_name = "TIME", default_value = "24h", value_parser = period, env = "TESSERA_KEEP_RESULTS")]
    pub keep_results: Duration,
    /// How long jobs are listed after they have ended and their results are gone.
    #[arg(long, value_name = "TIME", default_value = "7d", value_parser = period, env = "TESSERA_KEEP_JOBS")]
    pub keep_jobs: Duration,
    /// MiB of blobs that are kept: uploads and results. The least recently used that nothing needs go first.
    #[arg(long, value_name = "MIB", default_value_t = 65_536, value_parser = whole::<u64>, env = "TESSERA_BLOBS_MIB")]
    pub blobs_mib: u64,
    /// Jobs of JobService that may wait; one more is refused with RESOURCE_EXHAUSTED.
    #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = whole::<usize>, env = "TESSERA_WAITING_JOBS")]
    pub waiting_jobs: usize,
    /// Times that a job may be at work when the server goes down; then it fails and is not tried again.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = whole::<u32>, env = "TESSERA_MAX_CRASHES")]
    pub max_crashes: u32,
    /// Jobs at work at once; one more may be of a tenant that has none at work. A quarter of the cores, but 2 to 8, if not
    /// given.
    #[arg(long, value_name = "N", value_parser = whole::<usize>, env = "TESSERA_JOBS_AT_ONCE")]
    pub jobs_at_once: Option<usize>,
    /// Jobs of streams that may wait for their turn; one more is refused with RESOURCE_EXHAUSTED.
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = whole::<usize>, env = "TESSERA_QUEUE_JOBS")]
    pub queue_jobs: usize,
    /// Streams open at once, waiting, uploading and interactive ones included.
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = whole::<usize>, env = "TESSERA_MAX_STREAMS")]
    pub max_streams: usize,
    /// Interactive CVT sessions open at once.
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = whole::<usize>, env = "TESSERA_MAX_SESSIONS")]
    pub max_sessions: usize,
    /// Largest number of mesh vertices.
    #[arg(long, value_name = "N", default_value_t = 20_000_000, value_parser = whole::<u64>, env = "TESSERA_MAX_VERTICES")]
    pub max_vertices: u64,
    /// Largest number of mesh facets.
    #[arg(long, value_name = "N", default_value_t = 40_000_000, value_parser = whole::<u64>, env = "TESSERA_MAX_FACETS")]
    pub max_facets: u64,
    /// Largest number of seeds.
    #[arg(long, value_name = "N", default_value_t = 4_000_000, value_parser = whole::<u64>, env = "TESSERA_MAX_SEEDS")]
    pub max_seeds: u64,
    /// Most iterations in one request.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = whole::<u32>, env = "TESSERA_MAX_ITERATIONS")]
    pub max_iterations: u32,
    /// Uploaded geometry and waiting results of all streams together that are held in memory, MiB.
    #[arg(long, value_name = "MIB", default_value_t = 4096, value_parser = whole::<u64>, env = "TESSERA_MEMORY_MIB")]
    pub memory_mib: u64,
    /// Seconds of work that a job may take; one that reaches this ends with RESOURCE_EXHAUSTED. Waiting does not count.
    #[arg(long, value_name = "S", default_value_t = 3600.0, env = "TESSERA_JOB_SECONDS")]
    pub job_seconds: f64,
    /// MiB by which the process may grow while a job is at work; a job that reaches this ends with RESOURCE_EXHAUSTED. Three
    /// quarters of the machine's or the container's memory if not given.
    #[arg(long, value_name = "MIB", value_parser = whole::<u64>, env = "TESSERA_JOB_MEMORY_MIB")]
    pub job_memory_mib: Option<u64>,
    /// Seconds that work may go on after it was told to stop; from then on health says NOT_SERVING.
    #[arg(long, value_name = "S", default_value_t = 10.0, env = "TESSERA_STUCK_S")]
    pub stuck_s: f64,
    /// Seconds after that until the process ends with exit code 75, for its supervisor to start it anew.
    #[arg(long, value_name = "S", default_value_t = 50.0, env = "TESSERA_STUCK_EXIT_S")]
    pub stuck_exit_s: f64,
    /// Seconds that running work gets to end after SIGTERM.
    #[arg(long, value_name = "S", default_value_t = 30.0, env = "TESSERA_GRACE_S")]
    pub grace_s: f64,
    /// Seconds between two probes of an idle backend: a tiny diagram whose answer is known. While one fails health says
    /// NOT_SERVING.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_PROBE_S")]
    pub probe_s: f64,
    /// Address and port for operators: metrics, health and readiness over HTTP. None if not given; anything but loopback needs
    /// --insecure.
    #[arg(long, value_name = "ADDRESS:PORT", env = "TESSERA_ADMIN_LISTEN")]
    pub admin_listen: Option<String>,
    /// Listen without protection on addresses that others reach.
    #[arg(long, env = "TESSERA_INSECURE")]
    pub insecure: bool,
    /// Collector of OpenTelemetry traces (OTLP over gRPC), e.g. http://127.0.0.1:4317. None if not given.
    #[arg(long, value_name = "URL", env = "TESSERA_OTLP_ENDPOINT")]
    pub otlp_endpoint: Option<String>,
    /// Part of the traces that is exported, 0 to 1; those that a caller samples always are.
    #[arg(long, value_name = "R", default_value_t = 1.0, env = "TESSERA_OTLP_RATIO")]
    pub otlp_ratio: f64,
    /// Connections open at once; the process's limit on open files lowers it where it must.
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = whole::<usize>, env = "TESSERA_MAX_CONNECTIONS")]
    pub max_connections: usize,
    /// Connections open at once from one address (one /64 network with IPv6).
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = whole::<usize>, env = "TESSERA_MAX_CONNECTIONS_PER_PEER")]
    pub max_connections_per_peer: usize,
    /// Seconds until a new connection must have sent its first request.
    #[arg(long, value_name = "S", default_value_t = 20.0, env = "TESSERA_FIRST_REQUEST_S")]
    pub first_request_s: f64,
    /// Seconds until a connection without open streams is closed.
    #[arg(long, value_name = "S", default_value_t = 300.0, env = "TESSERA_IDLE_CONNECTION_S")]
    pub idle_connection_s: f64,
    /// Seconds after which a stream is reset if its client takes none of the bytes that wait for it.
    #[arg(long, value_name = "S", default_value_t = 120.0, env = "TESSERA_STALL_S")]
    pub stall_s: f64,
    /// Seconds for a whole upload.
    #[arg(long, value_name = "S", default_value_t = 1800.0, env = "TESSERA_UPLOAD_S")]
    pub upload_s: f64,
    /// Seconds between two messages of an upload.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_UPLOAD_IDLE_S")]
    pub upload_idle_s: f64,
    /// Seconds between two commands of an interactive session.
    #[arg(long, value_name = "S", default_value_t = 600.0, env = "TESSERA_SESSION_IDLE_S")]
    pub session_idle_s: f64,
    /// Who works. Last, since its heading holds for what comes after it.
    #[command(flatten, next_help_heading = "Who works")]
    pub backend: BackendArgs,
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
    /// Uploaded geometry and waiting results in memory, all streams together, bytes.
    pub memory_bytes: u64,
    /// Connections at once.
    pub max_connections: usize,
    /// Connections at once from one address.
    pub max_connections_per_peer: usize,
    /// For a new connection to send its first request.
    pub first_request: Duration,
    /// For a connection without open streams.
    pub idle_connection: Duration,
    /// For a whole upload.
    pub upload: Duration,
    /// Between two messages of an upload.
    pub upload_idle: Duration,
    /// Between two commands of a session.
    pub session_idle: Duration,
    /// For a client to take any of the bytes that wait for it.
    pub stall: Duration,
    /// For work to end after the shutdown began.
    pub grace: Duration,
    /// Between two probes of an idle backend.
    pub probe: Duration,
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
            max_connections: 1024,
            max_connections_per_peer: 256,
            first_request: Duration::from_secs(20),
            idle_connection: Duration::from_secs(300),
            upload: Duration::from_secs(1800),
            upload_idle: Duration::from_secs(60),
            session_idle: Duration::from_secs(600),
            stall: Duration::from_secs(120),
            grace: Duration::from_secs(30),
            probe: Duration::from_secs(60),
        }
    }
}

#[cfg(feature = "cli")]
/// A server's configuration, checked.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ServeConfig {
    /// Where to listen: the first of these that can be had.
    pub listen: Vec<SocketAddr>,
    /// The same for operators; nowhere if empty.
    pub admin: Vec<SocketAddr>,
    /// Jobs that may wait.
    pub queue_jobs: usize,
    /// What one request may ask for.
    pub limits: Limits,
    /// What one job may take.
    pub ceilings: JobCeilings,
    /// Where jobs are kept; in memory if none.
    pub data_dir: Option<PathBuf>,
    /// How long results and jobs are kept.
    pub keep: (Duration, Duration),
    /// Bytes of blobs.
    pub blob_bytes: u64,
    /// Jobs of JobService that may wait.
    pub waiting_jobs: usize,
    /// Crashes of a job.
    pub max_crashes: u32,
    /// Jobs at work at once, if it is said.
    pub jobs_at_once: Option<usize>,
}

/// What one job may take, and how long it may take to stop.
#[cfg(feature = "cli")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct JobCeilings {
    /// Time at work.
    pub time: Duration,
    /// Bytes by which the process may grow; as the machine allows if not given.
    pub memory_bytes: Option<u64>,
    /// From being told to stop to being stuck.
    pub stuck: Duration,
    /// From there to the end of the process.
    pub lost: Duration,
}

#[cfg(feature = "cli")]
/// A value that makes no sense.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{option} is {value}; it must be {must}")]
pub(crate) struct ConfigError {
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
    pub(crate) fn check(&self) -> Result<ServeConfig, ConfigError> {
        self.backend.check()?;
        let most = MAX_ELEMENTS;
        Ok(ServeConfig {
            listen: addresses("--listen", &self.listen)?,
            admin: self.admin()?,
            data_dir: if self.ephemeral { None } else { Some(self.data_dir()?) },
            keep: (self.keep_results, self.keep_jobs),
            blob_bytes: within("--blobs-mib", self.blobs_mib, 1, 1 << 30, "1 to 1073741824")? << 20,
            waiting_jobs: within("--waiting-jobs", self.waiting_jobs as u64, 1, 10_000_000, "1 to 10000000")? as usize,
            max_crashes: within("--max-crashes", self.max_crashes.into(), 1, 1000, "1 to 1000")? as u32,
            jobs_at_once: match self.jobs_at_once {
                Some(jobs) => Some(within("--jobs-at-once", jobs as u64, 1, 256, "1 to 256")? as usize),
                None => None,
            },
            queue_jobs: within("--queue-jobs", self.queue_jobs as u64, 1, 100_000, "1 to 100000")? as usize,
            limits: Limits {
                max_vertices: within("--max-vertices", self.max_vertices, 3, most, "3 to 2147483639")?,
                max_facets: within("--max-facets", self.max_facets, 1, most, "1 to 2147483639")?,
                max_seeds: within("--max-seeds", self.max_seeds, 1, most, "1 to 2147483639")?,
                max_iterations: within("--max-iterations", self.max_iterations.into(), 0, 1_000_000, "at most 1000000")?
                    as u32,
                max_streams: within("--max-streams", self.max_streams as u64, 1, 100_000, "1 to 100000")? as usize,
                max_sessions: within("--max-sessions", self.max_sessions as u64, 0, 10_000, "at most 10000")? as usize,
                memory_bytes: within("--memory-mib", self.memory_mib, 1, 1 << 24, "1 to 16777216")? << 20,
                max_connections: within("--max-connections", self.max_connections as u64, 1, 1_000_000, "1 to 1000000")?
                    as usize,
                max_connections_per_peer: within(
                    "--max-connections-per-peer",
                    self.max_connections_per_peer as u64,
                    1,
                    1_000_000,
                    "1 to 1000000",
                )? as usize,
                first_request: seconds("--first-request-s", self.first_request_s)?,
                idle_connection: seconds("--idle-connection-s", self.idle_connection_s)?,
                upload: seconds("--upload-s", self.upload_s)?,
                upload_idle: seconds("--upload-idle-s", self.upload_idle_s)?,
                session_idle: seconds("--session-idle-s", self.session_idle_s)?,
                stall: seconds("--stall-s", self.stall_s)?,
                grace: seconds("--grace-s", self.grace_s)?,
                probe: seconds("--probe-s", self.probe_s)?,
            },
            ceilings: JobCeilings {
                time: seconds("--job-seconds", self.job_seconds)?,
                memory_bytes: match self.job_memory_mib {
                    Some(mib) => Some(within("--job-memory-mib", mib, 1, 1 << 24, "1 to 16777216")? << 20),
                    None => None,
                },
                stuck: seconds("--stuck-s", self.stuck_s)?,
                lost: seconds("--stuck-exit-s", self.stuck_exit_s)?,
            },
        })
    }
}

#[cfg(feature = "cli")]
impl ServeArgs {
    /// Where jobs are kept.
    fn data_dir(&self) -> Result<PathBuf, ConfigError> {
        let variable = |name| std::env::var_os(name).map(PathBuf::from).filter(|path: &PathBuf| path.is_absolute());
        let state = || variable("XDG_STATE_HOME").or_else(|| Some(variable("HOME")?.join(".local/state")));
        self.data_dir.clone().or_else(|| Some(state()?.join("tessera"))).ok_or_else(|| ConfigError {
            option: "--data-dir",
            value: "not given, and the user has no home".to_owned(),
            must: "a folder; or give --ephemeral",
        })
    }
}

#[cfg(feature = "cli")]
impl ServeArgs {
    /// Where operators are listened to.
    fn admin(&self) -> Result<Vec<SocketAddr>, ConfigError> {
        let Some(listen) = &self.admin_listen else { return Ok(Vec::new()) };
        let found = addresses("--admin-listen", listen)?;
        if !self.insecure && found.iter().any(|address| !address.ip().is_loopback()) {
            return Err(ConfigError {
                option: "--admin-listen",
                value: format!("{listen:?}"),
                must: "a loopback address, as 127.0.0.1:9090, since everybody who reaches it can read it; or give --insecure",
            });
        }
        Ok(found)
    }

    /// Where traces go, and which part of them.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub(crate) fn traces(&self) -> Result<Option<Traces>, ConfigError> {
        // The variable that programs with OpenTelemetry share.
        let shared = || std::env::var("OTEL_EXPORTER_OTLP_ENDPOINT").ok().filter(|url| !url.is_empty());
        let wrong = |option, value: String, must| Err(ConfigError { option, value, must });
        if !(0.0..=1.0).contains(&self.otlp_ratio) {
            return wrong("--otlp-ratio", self.otlp_ratio.to_string(), "a number from 0 to 1");
        }
        let Some(endpoint) = self.otlp_endpoint.clone().or_else(shared) else { return Ok(None) };
        if !cfg!(feature = "otlp") {
            return wrong("--otlp-endpoint", endpoint, "left out: this program was built without the feature otlp");
        }
        match endpoint.strip_prefix("http://").is_some_and(|host| !host.is_empty()) {
            true => Ok(Some(Traces { endpoint, ratio: self.otlp_ratio })),
            false => wrong(
                "--otlp-endpoint",
                endpoint,
                "a URL as http://127.0.0.1:4317; https is not supported, use a collector on this host",
            ),
        }
    }
}

/// Where traces go.
#[cfg(feature = "cli")]
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(not(feature = "otlp"), allow(dead_code))]
pub(crate) struct Traces {
    /// A collector of OTLP over gRPC.
    pub endpoint: String,
    /// The part that is exported.
    pub ratio: f64,
}

#[cfg(feature = "cli")]
/// A time as people write it: a number and s, m, h or d.
///
/// # Errors
/// A sentence for who wrote it.
pub(crate) fn period(text: &str) -> Result<Duration, String> {
    let unit = |letter| match letter {
        's' => Some(1.0),
        'm' => Some(60.0),
        'h' => Some(3600.0),
        'd' => Some(86_400.0),
        _ => None,
    };
    let parsed = text.char_indices().next_back().and_then(|(at, letter)| {
        let seconds = text[..at].parse::<f64>().ok()? * unit(letter)?;
        (0.0..=1e9).contains(&seconds).then(|| Duration::from_secs_f64(seconds))
    });
    parsed.ok_or_else(|| "a time is needed, as 90s, 30m, 24h or 7d".to_owned())
}

#[cfg(feature = "cli")]
impl BackendArgs {
    /// Checks the number of threads.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub(crate) fn check(&self) -> Result<(), ConfigError> {
        match self.threads {
            Some(threads) => within("--threads", threads as u64, 1, 4096, "1 to 4096").map(|_| ()),
            None => Ok(()),
        }
    }
}

#[cfg(feature = "cli")]
fn within(option: &'static str, value: u64, least: u64, most: u64, must: &'static str) -> Result<u64, ConfigError> {
    if (least..=most).contains(&value) {
        Ok(value)
    } else {
        Err(ConfigError { option, value: value.to_string(), must })
    }
}

#[cfg(feature = "cli")]
/// What a name and a port stand for, addresses of IPv4 first: a client that asks for one by number asks for those.
fn addresses(option: &'static str, listen: &str) -> Result<Vec<SocketAddr>, ConfigError> {
    let wrong = |must| ConfigError { option, value: format!("{listen:?}"), must };
    let (host, port) = listen
        .rsplit_once(':')
        .filter(|(host, _)| !host.contains("//"))
        .ok_or_else(|| wrong("an address and a port, as 127.0.0.1:50051, localhost:50051 or [::]:50051"))?;
    port.parse::<u16>().map_err(|_| wrong("an address and a port from 0 to 65535, as 127.0.0.1:50051"))?;
    if host.is_empty() {
        return Err(wrong("an address and a port; 0.0.0.0:50051 or [::]:50051 listens on all"));
    }
    let found =
        listen.to_socket_addrs().map_err(|_| wrong("an address of this machine or a name that can be resolved"))?;
    let mut found: Vec<SocketAddr> = found.collect();
    found.sort_by_key(SocketAddr::is_ipv6);
    match found.is_empty() {
        true => Err(wrong("a name that has an address")),
        false => Ok(found),
    }
}

#[cfg(feature = "cli")]
/// A whole number as people write it: `10000`, `1e4`.
///
/// # Errors
/// A sentence for who wrote it.
pub(crate) fn whole<N: TryFrom<u64>>(text: &str) -> Result<N, String> {
    number(text).and_then(|n| n.try_into().ok()).ok_or_else(|| {
        let words = "a whole number is needed, as 10000 or 1e4";
        if number(text).is_some() { format!("{words}, and a smaller one") } else { words.to_owned() }
    })
}

#[cfg(feature = "cli")]
/// The same, from 1 on.
///
/// # Errors
/// A sentence for who wrote it.
pub(crate) fn count(text: &str) -> Result<u32, String> {
    match whole(text) {
        Ok(number) if number > 0 => Ok(number),
        _ => Err(format!("a whole number from 1 to {} is needed, as 10000 or 1e4", u32::MAX)),
    }
}

#[cfg(feature = "cli")]
fn number(text: &str) -> Option<u64> {
    /// Up to here every whole number is one of double precision.
    const EXACT: f64 = (1u64 << 53) as f64;
    let real = || text.parse::<f64>().ok().filter(|x| (0.0..=EXACT).contains(x) && x.fract() == 0.0);
    text.parse().ok().or_else(|| real().map(|x| x as u64))
}

#[cfg(feature = "cli")]
fn seconds(option: &'static str, value: f64) -> Result<Duration, ConfigError> {
    if (0.01..=86_400.0).contains(&value) {
        return Ok(Duration::from_secs_f64(value));
    }
    Err(ConfigError { option, value: value.to_string(), must: "0.01 to 86400 seconds" })
}

#[cfg(feature = "cli")]
#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        serve: ServeArgs,
    }

    fn parse(line: &[&str]) -> Result<ServeConfig, ConfigError> {
        Line::try_parse_from([&["tessera"], line].concat()).unwrap().serve.check()
    }

    #[test]
    fn the_defaults_are_the_library_s() {
        assert_eq!(parse(&[]).unwrap().limits, Limits::default());
    }

    #[test]
    fn numbers_are_taken_as_people_write_them() {
        for (text, number) in
            [("10000", 10_000), ("1e4", 10_000), ("1E4", 10_000), ("2.5e3", 2500), ("7.0", 7), ("+3", 3)]
        {
            assert_eq!((whole(text), count(text)), (Ok(number), Ok(number as u32)), "{text}");
        }
        assert_eq!(whole("18446744073709551615"), Ok(u64::MAX));
        assert_eq!((whole("0"), count("0").is_err()), (Ok(0u32), true));
        for text in ["", "1.5", "-1", "1e-3", "1e400", "inf", "nan", "10k", "10,000", "0x10", "5000000000", "1e20"] {
            assert!(whole::<u32>(text).is_err() && count(text).is_err(), "{text}");
        }
    }

    #[test]
    fn names_are_resolved() {
        let here: SocketAddr = "127.0.0.1:50051".parse().unwrap();
        assert_eq!(parse(&[]).unwrap().listen, [here]);
        assert!(parse(&["--listen", "localhost:50051"]).unwrap().listen[0].ip().is_loopback());
        assert_eq!(parse(&["--listen", "[::1]:0"]).unwrap().listen, ["[::1]:0".parse().unwrap()]);
        for bad in [
            "",
            "50051",
            ":50051",
            "localhost",
            "localhost:",
            "localhost:x",
            "127.0.0.1:65536",
            "http://localhost:1",
            "::1",
        ] {
            assert_eq!(parse(&["--listen", bad]).unwrap_err().option, "--listen", "{bad}");
        }
        assert!(parse(&["--listen", "no such name:1"]).is_err());
    }

    #[test]
    fn times_are_taken_with_their_unit() {
        for (text, seconds) in [("90s", 90.0), ("1.5m", 90.0), ("24h", 86_400.0), ("7d", 604_800.0), ("0s", 0.0)] {
            assert_eq!(period(text), Ok(Duration::from_secs_f64(seconds)), "{text}");
        }
        for text in ["", "7", "d", "-1s", "1w", "1 h", "nans", "infd", "1e20d", "5µ"] {
            assert!(period(text).is_err(), "{text}");
        }
    }

    #[test]
    fn what_makes_no_sense_is_named() {
        for line in [["--queue-jobs", "0"], ["--grace-s", "NaN"], ["--max-seeds", "4294967296"], ["--threads", "0"]] {
            assert_eq!(parse(&line).unwrap_err().option, line[0]);
        }
    }
}
