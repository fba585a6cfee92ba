//! The usual `process_` metrics of Prometheus.
//!
//! Purpose: read anew for each answer. Invariant: reading never fails; a figure that the system does not give is 0.
//! Must not know: what the process does.

use std::sync::atomic::AtomicU64;

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Registry, Unit};

use super::{add, plain};

pub(super) struct Process {
    resident: Gauge,
    descriptors: Gauge,
    most_descriptors: Gauge,
    threads: Gauge,
    start: Gauge<f64, AtomicU64>,
    cpu: Counter<f64, AtomicU64>,
}

impl Process {
    pub(super) fn register(r: &mut Registry) -> Self {
        let (seconds, start) = (|| Some(Unit::Seconds), "When the process began, since 1970");
        Self {
            resident: add(r, "process_resident_memory", Some(Unit::Bytes), "Resident memory", Gauge::default()),
            descriptors: plain(r, "process_open_fds", "Open file descriptors"),
            most_descriptors: plain(r, "process_max_fds", "File descriptors that may be open"),
            threads: plain(r, "process_threads", "Threads"),
            start: add(r, "process_start_time", seconds(), start, Gauge::default()),
            cpu: add(r, "process_cpu", seconds(), "Time of all processors", Counter::default()),
        }
    }

    pub(super) fn look(&self) {
        #[cfg(target_os = "linux")]
        {
            let now = metrics_process::collector::collect();
            let whole = |number: Option<u64>| number.and_then(|n| i64::try_from(n).ok()).unwrap_or(0);
            self.resident.set(whole(now.resident_memory_bytes));
            self.descriptors.set(whole(now.open_fds));
            self.most_descriptors.set(whole(now.max_fds));
            self.threads.set(whole(now.threads));
            self.start.set(now.start_time_seconds.map_or(0.0, |seconds| seconds as f64));
            let cpu = now.cpu_seconds_total.unwrap_or(0.0);
            self.cpu.inner().store(cpu.to_bits(), std::sync::atomic::Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
