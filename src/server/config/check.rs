//! Validation of the options.
//!
//! Purpose: makes a [`ServeConfig`] of [`ServeArgs`]. Invariant: a `ServeConfig` exists only if every value is usable,
//! alone and in combination; it is made before any port is bound. Must not know: the source of a value.

use std::cmp::Ordering;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use super::args::{BackendArgs, DeviceRules, RoleArg, ServeArgs, Source};
use super::limits::Limits;
use jobs::Ceilings;
use jobs::executor::host_name;
use jobs::store::shared::Role;
use transport::{ConnectionLimits, TlsFiles};

use super::values::{ConfigError, addresses, mebibytes, seconds, within, without_password};

/// Indices have 31 bits, less a few that are labels.
const MAX_ELEMENTS: u64 = i32::MAX as u64 - 8;

#[derive(Clone, Debug, PartialEq)]
pub struct ServeConfig {
    /// Where to listen: the first of these that can be had.
    pub listen: Vec<SocketAddr>,
    /// Addresses of the HTTP interface; empty if it is off.
    pub http: Vec<SocketAddr>,
    /// Whether the HTTP interface serves the page for browsers.
    pub ui: bool,
    /// Addresses of the admin port; empty if it is off.
    pub admin: Vec<SocketAddr>,
    pub queue_jobs: usize,
    pub limits: Limits,
    /// Without `memory_bytes`, as the machine allows.
    pub ceilings: Ceilings,
    /// Where jobs are kept; in memory if none.
    pub data_dir: Option<PathBuf>,
    /// The bucket of the blobs; without one they are in the data folder.
    pub bucket: Option<String>,
    /// The database of the jobs, and a file with its password; without one the jobs are in the data folder.
    pub database: Option<(String, Option<PathBuf>)>,
    /// Whether the database may lose jobs that were acknowledged.
    pub store_may_lose: bool,
    pub role: Role,
    /// This server's name among those that share its database.
    pub node: String,
    pub advertise: Option<String>,
    /// Copies of blobs of a shared bucket, bytes.
    pub cache_bytes: u64,
    pub disk_reserve_bytes: u64,
    pub keep: (Duration, Duration),
    pub blob_bytes: u64,
    /// Jobs of JobService that may wait.
    pub waiting_jobs: usize,
    pub max_crashes: u32,
    /// Number of jobs that run at the same time, if given.
    pub jobs_at_once: Option<usize>,
    pub device: DeviceRules,
    pub nice: u8,
    /// For each step of the start.
    pub start: Duration,
    pub tls: Option<TlsFiles>,
    pub requires_keys: bool,
}

impl ServeArgs {
    /// Checks every value. Errors: [`ConfigError`] for the first one that is wrong.
    pub fn check(&self) -> Result<ServeConfig, ConfigError> {
        self.check_all().map_err(|error| match self.sources.of(error.option) {
            Some(source) => ConfigError { value: format!("{} ({source})", error.value), ..error },
            None => error,
        })
    }

    fn check_all(&self) -> Result<ServeConfig, ConfigError> {
        self.backend.check()?;
        self.watching.traces()?;
        let is_ephemeral = self.is_ephemeral()?;
        if is_ephemeral && self.security.require_keys {
            let must = "absent: keys lie in the data folder";
            return Err(ConfigError::new("--ephemeral", "given beside --require-keys", must));
        }
        let listen = addresses("--listen", &self.listen)?;
        let tls = self.security.check()?;
        self.security.check_reach("--listen", &self.listen, &listen, tls.is_some())?;
        let mut http = Vec::new();
        if let Some(given) = &self.http_listen {
            http = addresses("--http-listen", given)?;
            self.security.check_reach("--http-listen", given, &http, tls.is_some())?;
        }
        if self.ui && http.is_empty() {
            let must = "beside --http-listen, which serves the page";
            return Err(ConfigError::new("--ui", "given without --http-listen", must));
        }
        if self.ui && !cfg!(feature = "ui") {
            let value = "given, but this program was built without the feature ui";
            return Err(ConfigError::new("--ui", value, "absent"));
        }
        Ok(ServeConfig {
            listen,
            http,
            ui: self.ui,
            tls,
            device: self.device.check()?,
            nice: within("--nice", self.nice, 0..=19)?,
            start: seconds("--start-s", self.start_s)?,
            admin: self.watching.admin(self.security.insecure)?,
            bucket: self.bucket(is_ephemeral)?,
            database: self.database(is_ephemeral)?,
            store_may_lose: self.store_may_lose,
            role: self.role()?,
            node: self.node_name()?,
            advertise: self.advertise.clone(),
            cache_bytes: within("--cache-mib", self.cache_mib, 0..=1 << 30)? << 20,
            disk_reserve_bytes: within("--disk-reserve-mib", self.disk_reserve_mib, 0..=1 << 24)? << 20,
            requires_keys: self.security.require_keys,
            data_dir: if is_ephemeral { None } else { Some(data_dir(self.data_dir.as_ref())?) },
            keep: (self.keep_results, self.keep_jobs),
            blob_bytes: within("--blobs-mib", self.blobs_mib, 1..=1 << 30)? << 20,
            waiting_jobs: within("--waiting-jobs", self.waiting_jobs, 1..=10_000_000)?,
            max_crashes: within("--max-crashes", self.max_crashes, 1..=1000)?,
            jobs_at_once: self.jobs_at_once.map(|jobs| within("--jobs-at-once", jobs, 1..=256)).transpose()?,
            queue_jobs: within("--queue-jobs", self.queue_jobs, 1..=100_000)?,
            limits: Limits {
                max_vertices: within("--max-vertices", self.max_vertices, 3..=MAX_ELEMENTS)?,
                max_facets: within("--max-facets", self.max_facets, 1..=MAX_ELEMENTS)?,
                max_seeds: within("--max-seeds", self.max_seeds, 1..=MAX_ELEMENTS)?,
                max_iterations: within("--max-iterations", self.max_iterations, 0..=1_000_000)?,
                max_streams: within("--max-streams", self.max_streams, 1..=100_000)?,
                max_sessions: within("--max-sessions", self.max_sessions, 0..=10_000)?,
                memory_bytes: within("--memory-mib", self.memory_mib, 1..=1 << 24)? << 20,
                upload: seconds("--upload-s", self.upload_s)?,
                upload_idle: seconds("--upload-idle-s", self.upload_idle_s)?,
                session_idle: seconds("--session-idle-s", self.session_idle_s)?,
                grace: seconds("--grace-s", self.grace_s)?,
                probe: seconds("--probe-s", self.watching.probe_s)?,
                connections: ConnectionLimits {
                    max_connections: within("--max-connections", self.max_connections, 1..=1_000_000)?,
                    max_connections_per_peer: {
                        within("--max-connections-per-peer", self.max_connections_per_peer, 1..=1_000_000)?
                    },
                    first_request: seconds("--first-request-s", self.first_request_s)?,
                    idle: seconds("--idle-connection-s", self.idle_connection_s)?,
                    stall: seconds("--stall-s", self.stall_s)?,
                    ..self.connections.check()?
                },
            },
            ceilings: Ceilings {
                time: Some(seconds("--job-seconds", self.job_seconds)?),
                memory_bytes: mebibytes("--job-memory-mib", self.job_memory_mib)?,
                stuck: seconds("--stuck-s", self.stuck_s)?,
                lost: seconds("--stuck-exit-s", self.stuck_exit_s)?,
            },
        })
    }

    /// Whether nothing is kept. Of --ephemeral and --data-dir the one of the stronger source counts: command line, variable,
    /// file.
    fn is_ephemeral(&self) -> Result<bool, ConfigError> {
        let rank = |option: &str| match self.sources.of(option) {
            Some(Source::File { .. }) => 0,
            Some(_) => 1,
            None => 2,
        };
        if !self.ephemeral || self.data_dir.is_none() {
            return Ok(self.ephemeral);
        }
        match rank("--ephemeral").cmp(&rank("--data-dir")) {
            Ordering::Equal => Err(ConfigError::new("--ephemeral", "given beside --data-dir", "one of the two")),
            order => Ok(order == Ordering::Greater),
        }
    }

    fn role(&self) -> Result<Role, ConfigError> {
        match self.role {
            RoleArg::All => Ok(Role::All),
            _ if self.store.is_none() => {
                Err(ConfigError::new("--role", "gateway or worker without --store", "all: a server alone does all"))
            }
            RoleArg::Gateway => Ok(Role::Gateway),
            RoleArg::Worker => Ok(Role::Worker),
        }
    }

    fn node_name(&self) -> Result<String, ConfigError> {
        let Some(name) = &self.node else { return Ok(format!("{}-{}", host_name(), std::process::id())) };
        match (1..=128).contains(&name.len()) && name.bytes().all(|byte| byte.is_ascii_graphic()) {
            true => Ok(name.clone()),
            false => {
                Err(ConfigError::new("--node", format!("{name:?}"), "1 to 128 printable characters without spaces"))
            }
        }
    }

    fn database(&self, is_ephemeral: bool) -> Result<Option<(String, Option<PathBuf>)>, ConfigError> {
        let Some(url) = &self.store else {
            return match &self.store_password_file {
                Some(_) => Err(ConfigError::new("--store-password-file", "given without --store", "beside --store")),
                None => Ok(None),
            };
        };
        let wrong = |must: &'static str| ConfigError::new("--store", format!("{:?}", without_password(url)), must);
        match () {
            () if !cfg!(feature = "postgres") => {
                Err(wrong("absent: this program was built without the feature postgres"))
            }
            () if !["postgres://", "postgresql://"].iter().any(|scheme| url.starts_with(scheme)) => {
                Err(wrong("postgres://USER@HOST/DATABASE"))
            }
            () if url.contains("password=") => {
                let value = "a URL with the parameter password";
                Err(ConfigError::new("--store", value, "without it: give --store-password-file"))
            }
            () if is_ephemeral => Err(wrong("absent beside --ephemeral, which keeps nothing")),
            () if self.blobs.is_none() => {
                Err(wrong("beside --blobs s3://BUCKET: servers that share jobs share their blobs"))
            }
            () => Ok(Some((url.clone(), self.store_password_file.clone()))),
        }
    }

    fn bucket(&self, is_ephemeral: bool) -> Result<Option<String>, ConfigError> {
        let Some(url) = &self.blobs else { return Ok(None) };
        let wrong = |must: &'static str| ConfigError::new("--blobs", format!("{url:?}"), must);
        if !cfg!(feature = "s3") {
            return Err(wrong("absent: this program was built without the feature s3"));
        }
        if is_ephemeral {
            return Err(wrong("absent beside --ephemeral: results would outlive the jobs that name them"));
        }
        match url.strip_prefix("s3://").map(|rest| rest.split('/').next().unwrap_or_default()) {
            Some(name) if !name.is_empty() => Ok(Some(url.clone())),
            _ => Err(wrong("s3://BUCKET or s3://BUCKET/PREFIX")),
        }
    }
}

/// The data folder of a server: the given one, or the user's. Errors: [`ConfigError`] if both are missing.
pub fn data_dir(given: Option<&PathBuf>) -> Result<PathBuf, ConfigError> {
    let variable = |name| std::env::var_os(name).map(PathBuf::from).filter(|path: &PathBuf| path.is_absolute());
    let state = || variable("XDG_STATE_HOME").or_else(|| Some(variable("HOME")?.join(".local/state")));
    given.cloned().or_else(|| Some(state()?.join("tessera"))).ok_or_else(|| {
        ConfigError::new("--data-dir", "not given, and the user has no home", "a folder; or give --ephemeral")
    })
}

impl BackendArgs {
    pub fn check(&self) -> Result<(), ConfigError> {
        self.gpu_memory_bytes()?;
        self.threads.map_or(Ok(()), |threads| within("--threads", threads, 1..=4096).map(drop))
    }

    /// Memory of a GPU that a job may take, bytes.
    pub fn gpu_memory_bytes(&self) -> Result<Option<u64>, ConfigError> {
        mebibytes("--gpu-memory-mib", self.gpu_memory_mib)
    }
}
