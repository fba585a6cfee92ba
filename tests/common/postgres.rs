//! A PostgreSQL server of the test program's own.
//!
//! Purpose: [`database`] makes a new database in the program's one cluster; [`Cluster::stop_immediate`] and [`Cluster::start`]
//! are the crash and the return of its server. Invariant: the cluster lies in a temporary folder, listens there and on a free
//! port of 127.0.0.1, and ends with the test program, however that ends: a guard process waits for the end of its input.
//! Root cannot run the server: then the user `postgres` does. `TESSERA_TEST_POSTGRES` is `required` (no PostgreSQL is a failure),
//! `auto` or `off`; tests that `#[needs(postgres)]` are ignored without one.
#![allow(dead_code)]

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use jobs::postgres::PostgresOptions;

/// The password of the user `tessera` at the port. At the socket it is not asked for.
pub const PASSWORD: &str = "pass word/%@";

/// Starts and stops the server as it is told by its input, one word a line. At the end of its input it clears up.
const GUARD: &str = r#"
while read -r word; do
    case $word in
    start) "$1/postgres" -D "$2/data" >>"$2/log" 2>&1 & server=$! ;;
    stop) kill -QUIT "$server"; wait "$server"; server= ;;
    esac
    echo "$word"
done
if [ -n "$server" ]; then kill -QUIT "$server"; wait "$server"; fi
rm -rf "$2"
"#;

pub struct Cluster {
    programs: PathBuf,
    folder: PathBuf,
    pub port: u16,
    guard: Mutex<(Child, ChildStdin, BufReader<ChildStdout>)>,
    databases: AtomicU32,
}

/// A database of a cluster.
#[derive(Clone)]
pub struct Database {
    pub cluster: &'static Cluster,
    pub name: String,
}

/// A new database in the cluster that all tests of the program share.
pub fn database() -> Database {
    static CLUSTER: OnceLock<Cluster> = OnceLock::new();
    CLUSTER.get_or_init(Cluster::new).database()
}

/// A new database in a cluster of its own, for tests that stop it. The cluster lives as long as the program.
pub fn database_apart() -> Database {
    Box::leak(Box::new(Cluster::new())).database()
}

/// Where the programs of PostgreSQL are, the newest first.
fn programs() -> PathBuf {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    let mut debian: Vec<PathBuf> = fs::read_dir("/usr/lib/postgresql")
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path().join("bin"))
        .collect();
    debian.sort_by_key(|folder| std::cmp::Reverse(folder.to_string_lossy().len()));
    debian.reverse();
    folders.extend(debian);
    // The server looks for its other programs beside itself.
    let found = folders.iter().find_map(|folder| fs::canonicalize(folder.join("postgres")).ok());
    found.expect("PostgreSQL is not installed (Debian: postgresql)").parent().unwrap().to_owned()
}

/// The user and group that may run the server, if this process is root.
fn user() -> Option<(u32, u32)> {
    if !rustix::process::geteuid().is_root() {
        return None;
    }
    let users = fs::read_to_string("/etc/passwd").unwrap();
    let line = users.lines().find(|line| line.starts_with("postgres:")).expect("there is no user postgres");
    let mut numbers = line.split(':').skip(2).map(|word| word.parse().unwrap());
    Some((numbers.next().unwrap(), numbers.next().unwrap()))
}

fn as_user(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(program);
    if let Some((user, group)) = user() {
        command.uid(user).gid(group);
    }
    command
}

impl Cluster {
    fn new() -> Self {
        let programs = programs();
        // The path of a socket must be short.
        let folder = tempfile::Builder::new().prefix("tessera-pg").tempdir_in("/tmp").unwrap().keep();
        if let Some((user, group)) = user() {
            std::os::unix::fs::chown(&folder, Some(user), Some(group)).unwrap();
        }
        let (data, secret) = (folder.join("data"), folder.join("secret"));
        fs::write(&secret, PASSWORD).unwrap();
        std::os::unix::fs::chown(&secret, user().map(|ids| ids.0), None).unwrap();
        let made = as_user(programs.join("initdb"))
            .args([
                "-U",
                "tessera",
                "-E",
                "UTF8",
                "--locale=C",
                "--no-sync",
                "--auth-local=trust",
                "--auth-host=scram-sha-256",
            ])
            .arg("--pwfile")
            .arg(&secret)
            .arg("-D")
            .arg(&data)
            .current_dir(&folder)
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let port = crate::process::free_port();
        // A connection that is being opened delays the end of the server until the time for its authentication is over.
        // A process that is killed loses nothing that the system has: without a power cut, a sync shows nothing.
        let settings = format!(
            "listen_addresses = '127.0.0.1'\nport = {port}\nunix_socket_directories = '{}'\nfsync = off\n\
             max_connections = 500\nshared_buffers = 32MB\nautovacuum_naptime = 5s\n\
             authentication_timeout = 3s\n",
            folder.display()
        );
        let mut file = fs::OpenOptions::new().append(true).open(data.join("postgresql.conf")).unwrap();
        file.write_all(settings.as_bytes()).unwrap();
        let mut guard = as_user("sh")
            .args(["-c", GUARD, "guard"])
            .args([&programs, &folder])
            .current_dir(&folder)
            // Not ended with the terminal's group: it has to clear up.
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (input, output) = (guard.stdin.take().unwrap(), BufReader::new(guard.stdout.take().unwrap()));
        let cluster =
            Self { programs, folder, port, guard: Mutex::new((guard, input, output)), databases: AtomicU32::new(0) };
        cluster.start();
        cluster
    }

    fn tell(&self, word: &str) {
        let mut guard = self.guard.lock().unwrap_or_else(PoisonError::into_inner);
        writeln!(guard.1, "{word}").unwrap();
        let mut said = String::new();
        guard.2.read_line(&mut said).unwrap();
        assert_eq!(said.trim(), word);
    }

    /// Ends the server at once, as if its process had been killed. Nothing is written any more.
    pub fn stop_immediate(&self) {
        self.tell("stop");
    }

    /// Starts the server, and waits until it answers.
    pub fn start(&self) {
        self.tell("start");
        let end = Instant::now() + Duration::from_secs(60);
        let is_ready = || {
            let mut ready = Command::new(self.programs.join("pg_isready"));
            ready.args(["-q", "-h"]).arg(&self.folder).args(["-p", &self.port.to_string(), "-U", "tessera"]);
            ready.status().unwrap().success()
        };
        while !is_ready() {
            assert!(Instant::now() < end, "{}", fs::read_to_string(self.folder.join("log")).unwrap());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Runs SQL in a database of the cluster, and gives what it prints.
    pub fn sql(&self, database: &str, sql: &str) -> String {
        let out = Command::new(self.programs.join("psql"))
            .args(["-X", "-A", "-t", "-q", "-v", "ON_ERROR_STOP=1", "-U", "tessera", "-p", &self.port.to_string()])
            .arg("-h")
            .arg(&self.folder)
            .args(["-d", database, "-c", sql])
            .output()
            .unwrap();
        assert!(out.status.success(), "{sql}: {}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8(out.stdout).unwrap().trim().to_owned()
    }

    /// From now on the port offers TLS with this certificate and key, in PEM.
    pub fn offer_tls(&self, cert: &str, key: &str) {
        for (name, text) in [("server.crt", cert), ("server.key", key)] {
            let path = self.folder.join("data").join(name);
            fs::write(&path, text).unwrap();
            fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
            std::os::unix::fs::chown(&path, user().map(|ids| ids.0), None).unwrap();
        }
        self.sql("postgres", "alter system set ssl = on");
        self.sql("postgres", "select pg_reload_conf()");
        let end = Instant::now() + Duration::from_secs(20);
        while self.sql("postgres", "show ssl") != "on" {
            assert!(Instant::now() < end, "{}", fs::read_to_string(self.folder.join("log")).unwrap());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn database(&'static self) -> Database {
        let name = format!("test{}", self.databases.fetch_add(1, Ordering::Relaxed));
        self.sql("postgres", &format!("create database {name}"));
        Database { cluster: self, name }
    }
}

impl Database {
    /// Its address by the socket, without a password.
    pub fn url(&self) -> String {
        let folder = percent(&self.cluster.folder);
        format!("postgres://tessera@localhost:{}/{}?host={folder}", self.cluster.port, self.name)
    }

    /// A store's options. A busy machine is no database that is away.
    pub fn options(&self, holder: &str) -> PostgresOptions {
        PostgresOptions { acquire: Duration::from_secs(6), ..PostgresOptions::new(self.url(), holder) }
    }

    /// Its address by the port, for the given user and password.
    pub fn url_by_port(&self, user: &str) -> String {
        format!("postgres://{user}@127.0.0.1:{}/{}", self.cluster.port, self.name)
    }

    pub fn sql(&self, sql: &str) -> String {
        self.cluster.sql(&self.name, sql)
    }
}

fn percent(path: &Path) -> String {
    form_urlencoded::byte_serialize(path.to_string_lossy().as_bytes()).collect()
}
