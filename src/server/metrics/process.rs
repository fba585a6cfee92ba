//! What every Prometheus user expects to know of a process.
//!
//! Purpose: the usual `process_` metrics, read from `/proc` when somebody asks. Invariant: reading never fails; what the
//! system does not say is 0. Must not know: what the process does.

use std::fs;
use std::sync::atomic::{AtomicU64, Ordering};

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Registry, Unit};

use jobs::memory;

/// Ticks of a second in `/proc/*/stat`: part of Linux' interface to programs.
const TICKS: f64 = 100.0;

/// See the module's head.
pub(super) struct Process {
    resident: Gauge,
    descriptors: Gauge,
    most_descriptors: Gauge,
    threads: Gauge,
    start: Gauge<f64, AtomicU64>,
    cpu: Counter<f64, AtomicU64>,
}

impl Process {
    pub(super) fn register(registry: &mut Registry) -> Self {
        let process = Self {
            resident: Gauge::default(),
            descriptors: Gauge::default(),
            most_descriptors: Gauge::default(),
            threads: Gauge::default(),
            start: Gauge::default(),
            cpu: Counter::default(),
        };
        let (bytes, seconds) = (Unit::Bytes, || Unit::Seconds);
        registry.register_with_unit("process_resident_memory", "Resident memory", bytes, process.resident.clone());
        registry.register("process_open_fds", "Open file descriptors", process.descriptors.clone());
        registry.register("process_max_fds", "File descriptors that may be open", process.most_descriptors.clone());
        registry.register("process_threads", "Threads", process.threads.clone());
        let start = "When the process began, since 1970";
        registry.register_with_unit("process_start_time", start, seconds(), process.start.clone());
        registry.register_with_unit("process_cpu", "Time of all processors", seconds(), process.cpu.clone());
        process
    }

    /// Looks at the process.
    pub(super) fn look(&self) {
        let whole = |number: Option<u64>| number.and_then(|n| i64::try_from(n).ok()).unwrap_or(0);
        self.resident.set(whole(memory::memory_bytes()));
        self.descriptors.set(whole(descriptors()));
        self.most_descriptors.set(whole(most_descriptors()));
        let stat = fs::read_to_string("/proc/self/stat").ok();
        let stat = stat.as_deref().and_then(Stat::read).unwrap_or_default();
        self.threads.set(whole(Some(stat.threads)));
        self.cpu.inner().store((stat.cpu_ticks as f64 / TICKS).to_bits(), Ordering::Relaxed);
        self.start.set(boot_time().map_or(0.0, |boot| boot + stat.start_ticks as f64 / TICKS));
    }
}

fn descriptors() -> Option<u64> {
    // One of them is the folder that is being read.
    Some((fs::read_dir("/proc/self/fd").ok()?.count() as u64).saturating_sub(1))
}

fn most_descriptors() -> Option<u64> {
    let limits = fs::read_to_string("/proc/self/limits").ok()?;
    limits.lines().find_map(|line| line.strip_prefix("Max open files"))?.split_whitespace().next()?.parse().ok()
}

/// When the machine began, seconds since 1970.
fn boot_time() -> Option<f64> {
    let stat = fs::read_to_string("/proc/stat").ok()?;
    stat.lines().find_map(|line| line.strip_prefix("btime "))?.trim().parse().ok()
}

/// What is read of `/proc/self/stat`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Stat {
    cpu_ticks: u64,
    threads: u64,
    start_ticks: u64,
}

impl Stat {
    /// The second field is the program's name in parentheses, and may hold anything.
    fn read(text: &str) -> Option<Self> {
        let fields: Vec<&str> = text.get(text.rfind(')')? + 1..)?.split_whitespace().collect();
        let number = |field: usize| fields.get(field - 3)?.parse::<u64>().ok();
        Some(Self { cpu_ticks: number(14)? + number(15)?, threads: number(20)?, start_ticks: number(22)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_anything_in_it_is_passed_over() {
        let rest = "S 1 2 3 0 -1 4194304 500 0 0 0 700 300 0 0 20 0 12 0 98765 1000 20";
        let stat = Stat::read(&format!("42 (a) b ) c) {rest}"));
        assert_eq!(stat, Some(Stat { cpu_ticks: 1000, threads: 12, start_ticks: 98765 }));
        assert_eq!((Stat::read(""), Stat::read("42 (a) S 1")), (None, None));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_process_is_seen() {
        let process = Process::register(&mut Registry::default());
        process.look();
        assert!(process.resident.get() > 1 << 20 && process.threads.get() > 0);
        assert!(process.descriptors.get() > 2 && process.most_descriptors.get() >= process.descriptors.get());
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
        let age = now - process.start.get();
        assert!((-2.0..7.0 * 24.0 * 3600.0).contains(&age), "{age}");
    }
}
