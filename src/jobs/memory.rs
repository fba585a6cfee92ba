//! Memory of this process and of the machine.
//!
//! Purpose: what Linux says of it; nothing elsewhere. Invariant: reading never fails, it says `None`.
//! Must not know: what the memory is for.

/// The most memory that this process ever held, bytes; `None` where the system does not say.
pub fn peak_memory_bytes() -> Option<u64> {
    status_bytes("VmHWM:")
}

/// The memory that this process holds, bytes; `None` where the system does not say.
pub fn memory_bytes() -> Option<u64> {
    status_bytes("VmRSS:")
}

fn status_bytes(name: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    kibibytes(&status, name)
}

/// The value of a line `name N kB`, bytes.
fn kibibytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find(|line| line.starts_with(name))?;
    let kibibytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes * 1024)
}

/// The memory that this process may come to: what the machine has, or its container if that has less. `None` where the
/// system does not say.
pub fn machine_memory_bytes() -> Option<u64> {
    let machine = kibibytes(&std::fs::read_to_string("/proc/meminfo").ok()?, "MemTotal:")?;
    let limit = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    Some(limit.and_then(|text| text.trim().parse::<u64>().ok()).map_or(machine, |limit| limit.min(machine)))
}
