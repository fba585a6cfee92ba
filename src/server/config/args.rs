//! The options of a server, as the command line has them.
//!
//! Purpose: [`ServeArgs`], the one struct that describes every option: its name, its variable, its default and its help.
//! The file (`file`) and the printed form (`options`) follow from it. Invariant: parsers here check single values; `check`
//! checks their combinations. Must not know: the use of values.

use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};

use super::limits::ConnectionArgs;
use super::security::SecurityArgs;
use super::values::{period, whole};
use crate::config::values::{ConfigError, addresses, mebibytes, seconds};
use geometry::rvd::{BackendChoice, BackendKind};
use telemetry::Traces;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum BackendArg {
    /// The GPU if available, else the parallel CPU backend.
    #[default]
    Auto,
    /// The GPU, or an error.
    Gpu,
    /// Double precision on all threads of the pool.
    Parallel,
    /// Double precision on one thread.
    Serial,
}

impl From<BackendArg> for BackendChoice {
    fn from(arg: BackendArg) -> Self {
        match arg {
            BackendArg::Auto => Self::Auto,
            BackendArg::Gpu => Self::Only(BackendKind::Gpu),
            BackendArg::Parallel => Self::Only(BackendKind::Parallel),
            BackendArg::Serial => Self::Only(BackendKind::Serial),
        }
    }
}

/// How many adapters share a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Adapters(pub usize);

impl Default for Adapters {
    fn default() -> Self {
        Self(1)
    }
}

fn adapters(text: &str) -> Result<Adapters, String> {
    match whole(text) {
        Ok(number) if (1..=64).contains(&number) => Ok(Adapters(number)),
        _ if text == "all" => Ok(Adapters(usize::MAX)),
        _ => Err("a whole number from 1 to 64 is needed, or all".to_owned()),
    }
}

/// Backend and threads: the options of every subcommand that computes.
#[derive(Args, Clone, Debug, Default)]
pub struct BackendArgs {
    /// Which backend should do the work.
    #[arg(long, value_enum, default_value_t, env = "TESSERA_BACKEND")]
    pub backend: BackendArg,
    /// Let a software adapter stand in for a GPU (slower than the CPU backend; for tests).
    #[arg(long, env = "TESSERA_GPU_SOFTWARE")]
    pub gpu_software: bool,
    /// Threads of the CPU backend; all cores if not given.
    #[arg(long, value_name = "T", value_parser = whole::<usize>, env = "TESSERA_THREADS")]
    pub threads: Option<usize>,
    /// GPU adapters that share the facets of a job in ranges: a number, or all. Results have the same bits on one.
    #[arg(long, value_name = "N|all", default_value = "1", value_parser = adapters, env = "TESSERA_GPU_ADAPTERS")]
    pub gpu_adapters: Adapters,
    /// MiB of a GPU's memory that one job may take. Records of facets that it does not hold are sent whenever their turn comes, which is
    /// slower. Not limited if not given.
    #[arg(long, value_name = "MIB", value_parser = whole::<u64>, env = "TESSERA_GPU_MEMORY_MIB")]
    pub gpu_memory_mib: Option<u64>,
    /// How long a GPU may take for one submission; a server has an option for it.
    #[arg(skip)]
    pub gpu_timeout: Option<Duration>,
}

#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Server and its limits")]
pub struct ServeArgs {
    /// File with options, in TOML: `max_streams = 64` for --max-streams. Variables override the file, and the command line
    /// overrides both. `tessera config print` shows the result.
    #[arg(long, value_name = "FILE", env = "TESSERA_CONFIG")]
    pub config: Option<PathBuf>,
    /// Address or name, and port to listen on; port 0 takes a free one and prints it.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:50051", env = "TESSERA_LISTEN")]
    pub listen: String,
    /// Address or name, and port of the HTTP interface: meshes by `curl`, jobs and blobs (docs/http.md). Off by default. As
    /// with --listen, an address other than loopback needs TLS and keys, or --insecure.
    #[arg(long, value_name = "ADDRESS:PORT", env = "TESSERA_HTTP_LISTEN")]
    pub http_listen: Option<String>,
    /// Serve a page for browsers on the HTTP port: drop a mesh, watch it converge, compare, download (docs/page.md).
    #[arg(long, env = "TESSERA_UI")]
    pub ui: bool,
    /// Folder where jobs, results and uploads are kept; one server at a time may use it. The user's state directory if not
    /// given: $XDG_STATE_HOME/tessera, or ~/.local/state/tessera.
    #[arg(long, value_name = "DIR", env = "TESSERA_DATA_DIR")]
    pub data_dir: Option<PathBuf>,
    /// Keep jobs, results and uploads in memory: they are lost when the server ends.
    #[arg(long, env = "TESSERA_EPHEMERAL")]
    pub ephemeral: bool,
    /// Keep blobs in a bucket instead: s3://BUCKET or s3://BUCKET/PREFIX on any S3-compatible store. The variables
    /// AWS_ENDPOINT, AWS_REGION, AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_ALLOW_HTTP set its address and
    /// credentials.
    #[arg(long, value_name = "URL", env = "TESSERA_BLOBS")]
    pub blobs: Option<String>,
    /// Keep jobs in a PostgreSQL database that several servers share: postgres://USER@HOST/DATABASE (docs/cluster.md). Needs
    /// --blobs. The data folder then holds keys and copies of blobs.
    #[arg(long, value_name = "URL", env = "TESSERA_STORE", hide_env_values = true)]
    pub store: Option<String>,
    /// File that holds the password of the database. If not given, the password comes from the URL, or from the file that the
    /// variable PGPASSFILE names.
    #[arg(long, value_name = "FILE", env = "TESSERA_STORE_PASSWORD_FILE")]
    pub store_password_file: Option<PathBuf>,
    /// Use a database whose `synchronous_commit` is `off` or `local`: a crash or a failover then loses jobs that were acknowledged.
    #[arg(long, env = "TESSERA_STORE_MAY_LOSE")]
    pub store_may_lose: bool,
    /// What this server does, of those that share a database: a gateway takes calls and does no work, a worker does work and
    /// takes no calls.
    #[arg(long, value_enum, default_value_t, env = "TESSERA_ROLE")]
    pub role: RoleArg,
    /// This server's name among those that share a database, for `tessera cluster`. The host's name and the process's number if
    /// not given.
    #[arg(long, value_name = "NAME", env = "TESSERA_NODE")]
    pub node: Option<String>,
    /// Where clients reach this server, for answers of others that do no streams: http://HOST:PORT. The address listened on if not given.
    #[arg(long, value_name = "URL", env = "TESSERA_ADVERTISE")]
    pub advertise: Option<String>,
    /// MiB of copies of blobs that are kept in the data folder, so that the same input is fetched once. With --store; 0 is none.
    #[arg(long, value_name = "MIB", default_value_t = 1024, value_parser = whole::<u64>, env = "TESSERA_CACHE_MIB")]
    pub cache_mib: u64,
    /// MiB of the disk that uploads and results leave free, so that the journal of jobs always has room.
    #[arg(long, value_name = "MIB", default_value_t = 64, value_parser = whole::<u64>, env = "TESSERA_DISK_RESERVE_MIB")]
    pub disk_reserve_mib: u64,
    /// How long results are kept after a job has ended, e.g. 90s, 30m, 24h or 7d.
    #[arg(long, value_name = "TIME", default_value = "24h", value_parser = period, env = "TESSERA_KEEP_RESULTS")]
    pub keep_results: Duration,
    /// How long jobs are listed after their results are removed.
    #[arg(long, value_name = "TIME", default_value = "7d", value_parser = period, env = "TESSERA_KEEP_JOBS")]
    pub keep_jobs: Duration,
    /// MiB of blobs that are kept: uploads and results. The least recently used that nothing needs go first.
    #[arg(long, value_name = "MIB", default_value_t = 65_536, value_parser = whole::<u64>, env = "TESSERA_BLOBS_MIB")]
    pub blobs_mib: u64,
    /// Jobs of JobService that may wait; one more is refused with RESOURCE_EXHAUSTED.
    #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = whole::<usize>, env = "TESSERA_WAITING_JOBS")]
    pub waiting_jobs: usize,
    /// Server crashes after which a job that was at work fails, if nothing else was; else it is tried once more, alone.
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
    /// Seconds that work may continue after its cancellation; after that health says NOT_SERVING.
    #[arg(long, value_name = "S", default_value_t = 10.0, env = "TESSERA_STUCK_S")]
    pub stuck_s: f64,
    /// Further seconds until the process ends with exit code 75, so that its supervisor restarts it.
    #[arg(long, value_name = "S", default_value_t = 50.0, env = "TESSERA_STUCK_EXIT_S")]
    pub stuck_exit_s: f64,
    /// How far threads at work give way to all others, 0 to 19 (Unix): calls are answered at once though all cores are busy.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = whole::<u8>, env = "TESSERA_NICE")]
    pub nice: u8,
    /// Seconds that each step of the start may take: opening the storage, opening the device, reading the journal.
    #[arg(long, value_name = "S", default_value_t = 300.0, env = "TESSERA_START_S")]
    pub start_s: f64,
    /// Seconds that running work gets to end after SIGTERM.
    #[arg(long, value_name = "S", default_value_t = 30.0, env = "TESSERA_GRACE_S")]
    pub grace_s: f64,
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
    #[command(flatten)]
    pub device: DeviceArgs,
    #[command(flatten)]
    pub security: SecurityArgs,
    #[command(flatten)]
    pub connections: ConnectionArgs,
    #[command(flatten)]
    pub watching: WatchingArgs,
    /// The backend. Last, since its heading applies to all later options.
    #[command(flatten, next_help_heading = "Backend")]
    pub backend: BackendArgs,
    /// The source of each value, for messages.
    #[arg(skip)]
    pub sources: Sources,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// The program.
    Default,
    File {
        file: String,
        /// From 1 on.
        line: usize,
    },
    Environment(String),
    Line(String),
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::File { file, line } => write!(f, "{file}:{line}"),
            Self::Environment(name) => write!(f, "the variable {name}"),
            Self::Line(option) => write!(f, "{option} on the command line"),
        }
    }
}

/// The sources of all options that have a value, by name.
#[derive(Clone, Debug, Default)]
pub struct Sources(pub(super) BTreeMap<String, Source>);

impl Sources {
    /// The source of an option's value (`--name`), if it is not the command line.
    pub(super) fn of(&self, option: &str) -> Option<&Source> {
        let key = option.trim_start_matches("--").replace('-', "_");
        self.0.get(&key).filter(|source| matches!(source, Source::File { .. } | Source::Environment(_)))
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum RoleArg {
    /// Takes calls and does work.
    #[default]
    All,
    /// Takes calls alone, and needs no GPU.
    Gateway,
    /// Does work alone: of its ports it opens the admin port.
    Worker,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum OnLoss {
    /// End with exit code 76, so that a supervisor restarts the server, perhaps on another machine.
    #[default]
    Exit,
    /// Continue on the CPU. Health, `tessera info` and every result show it.
    Cpu,
}

#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Device")]
pub struct DeviceArgs {
    /// MiB of the device's memory that jobs at work may need together; a job that needs more is refused. Not limited if not
    /// given: a job for which the device has no room then ends with an error.
    #[arg(long, value_name = "MIB", value_parser = whole::<u64>, env = "TESSERA_DEVICE_MEMORY_MIB")]
    pub device_memory_mib: Option<u64>,
    /// Seconds that the device may take for one piece of work; then it counts as lost.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_DEVICE_TIMEOUT_S")]
    pub device_timeout_s: f64,
    /// Reaction if a lost device cannot be reopened.
    #[arg(long, value_enum, default_value_t, env = "TESSERA_ON_DEVICE_LOSS")]
    pub on_device_loss: OnLoss,
    /// Seconds for which a lost device is tried again before that.
    #[arg(long, value_name = "S", default_value_t = 30.0, env = "TESSERA_DEVICE_LOSS_S")]
    pub device_loss_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceRules {
    /// Memory for jobs, if limited, bytes.
    pub memory_bytes: Option<u64>,
    /// For one piece of work.
    pub timeout: Duration,
    /// What to do if a lost device does not return within `patience`.
    pub on_loss: OnLoss,
    /// How long to wait for a lost device.
    pub patience: Duration,
}

impl DeviceArgs {
    pub(super) fn check(&self) -> Result<DeviceRules, ConfigError> {
        Ok(DeviceRules {
            memory_bytes: mebibytes("--device-memory-mib", self.device_memory_mib)?,
            timeout: seconds("--device-timeout-s", self.device_timeout_s)?,
            on_loss: self.on_device_loss,
            patience: seconds("--device-loss-s", self.device_loss_s)?,
        })
    }
}

#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Metrics, health and traces")]
pub struct WatchingArgs {
    /// Seconds between two probes of an idle backend: a tiny diagram with a known answer. While a probe fails, health says
    /// NOT_SERVING.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_PROBE_S")]
    pub probe_s: f64,
    /// Address and port for operators: metrics, health and readiness over HTTP. None if not given; anything but loopback needs
    /// --admin-public.
    #[arg(long, value_name = "ADDRESS:PORT", env = "TESSERA_ADMIN_LISTEN")]
    pub admin_listen: Option<String>,
    /// Let other machines reach the admin port, which asks for no key. --insecure does so too.
    #[arg(long, env = "TESSERA_ADMIN_PUBLIC")]
    pub admin_public: bool,
    /// Collector of OpenTelemetry traces (OTLP over gRPC), e.g. http://127.0.0.1:4317. None if not given.
    #[arg(long, value_name = "URL", env = "TESSERA_OTLP_ENDPOINT")]
    pub otlp_endpoint: Option<String>,
    /// Share of the traces to export, 0 to 1; traces sampled by a caller are always exported.
    #[arg(long, value_name = "R", default_value_t = 1.0, env = "TESSERA_OTLP_RATIO")]
    pub otlp_ratio: f64,
}

impl WatchingArgs {
    /// Addresses of the admin port; empty if it is off.
    pub(super) fn admin(&self, insecure: bool) -> Result<Vec<SocketAddr>, ConfigError> {
        let Some(listen) = &self.admin_listen else { return Ok(Vec::new()) };
        let found = addresses("--admin-listen", listen)?;
        if !insecure && !self.admin_public && found.iter().any(|address| !address.ip().to_canonical().is_loopback()) {
            let must = "a loopback address, as 127.0.0.1:9090, since it asks for no key; or give --admin-public";
            return Err(ConfigError::new("--admin-listen", format!("{listen:?}"), must));
        }
        Ok(found)
    }

    /// The collector of traces, and the part that is exported.
    pub fn traces(&self) -> Result<Option<Traces>, ConfigError> {
        // The variable that programs with OpenTelemetry share.
        let shared = || std::env::var("OTEL_EXPORTER_OTLP_ENDPOINT").ok().filter(|url| !url.is_empty());
        let wrong = |option, value: String, must: &'static str| Err(ConfigError::new(option, value, must));
        if !(0.0..=1.0).contains(&self.otlp_ratio) {
            return wrong("--otlp-ratio", self.otlp_ratio.to_string(), "a number from 0 to 1");
        }
        let Some(endpoint) = self.otlp_endpoint.clone().or_else(shared) else { return Ok(None) };
        if !cfg!(feature = "otlp") {
            return wrong("--otlp-endpoint", endpoint, "left out: this program was built without the feature otlp");
        }
        if endpoint.contains('@') {
            let must = "a URL without a name and a password, which logs would show";
            return wrong("--otlp-endpoint", "a URL with an @".to_owned(), must);
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
