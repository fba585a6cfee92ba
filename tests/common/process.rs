//! What processes hold, which ports are free, and where a server listens that was started as one.
#![allow(dead_code)]

use std::io::{BufRead, BufReader};
use std::process::Child;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// A port of 127.0.0.1 for a server that has to be given one. A socket that is bound and does not listen keeps it as long as this
/// process lives: the system gives the port to no other, and no connection begins there.
pub fn free_port() -> u16 {
    let held = tokio::net::TcpSocket::new_v4().unwrap();
    held.set_reuseaddr(true).unwrap();
    held.bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let port = held.local_addr().unwrap().port();
    std::mem::forget(held);
    port
}

/// Memory that a process holds, bytes; 0 where the system does not say.
fn resident_bytes_of(process: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmRSS:"));
    line.and_then(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok()).unwrap_or(0) * 1024
}

/// Memory that this process holds, bytes; 0 where the system does not say.
pub fn resident_bytes() -> u64 {
    resident_bytes_of("self")
}

/// Resident memory in bytes, open descriptors and threads of a process.
#[cfg(target_os = "linux")]
pub fn resources_of(process: &Child) -> (u64, usize, usize) {
    let count = |what: &str| std::fs::read_dir(format!("/proc/{}/{what}", process.id())).unwrap().count();
    let bytes = resident_bytes_of(&process.id().to_string());
    assert!(bytes > 0, "the process has ended");
    (bytes, count("fd"), count("task"))
}

/// The most memory from `new` on.
pub struct MemoryPeak(Arc<(AtomicBool, AtomicU64)>, u64);

impl MemoryPeak {
    pub fn new() -> Self {
        let state = Arc::new((AtomicBool::new(true), AtomicU64::new(0)));
        let seen = Arc::clone(&state);
        std::thread::spawn(move || {
            while seen.0.load(Ordering::Relaxed) {
                seen.1.fetch_max(resident_bytes(), Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(2));
            }
        });
        Self(state, resident_bytes())
    }

    /// By how much it was more than at first, MiB.
    pub fn grown_mib(self) -> f64 {
        self.0.0.store(false, Ordering::Relaxed);
        self.0.1.load(Ordering::Relaxed).saturating_sub(self.1) as f64 / f64::from(1 << 20)
    }
}

/// What a server says once it listens, line by line, without the words in front. Its output is a pipe.
fn announced(server: &mut Child) -> impl FnMut(&str) -> String {
    let mut lines = BufReader::new(server.stdout.take().unwrap()).lines();
    move |words| {
        let line = lines.next().expect("it says where it listens").unwrap();
        line.strip_prefix(words).unwrap_or_else(|| panic!("{line}")).to_owned()
    }
}

/// The address at which a server listens.
pub fn address_of(server: &mut Child) -> String {
    announced(server)("tessera listens on ")
}

/// The same, and the address of its admin port.
pub fn addresses_of(server: &mut Child) -> (String, String) {
    let mut after = announced(server);
    (after("tessera listens on "), after("tessera tells operators on "))
}
