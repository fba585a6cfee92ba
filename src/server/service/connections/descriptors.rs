//! How many connections the process's file descriptors allow.
//!
//! Invariant: some descriptors are left for files, devices and the listener. Must not know: connections.

use std::io;

/// Descriptors that connections leave to everything else.
const RESERVE: usize = 64;

/// Descriptors taken as in use where they cannot be counted.
const IN_USE_IF_UNKNOWN: usize = 64;

/// Returns `wanted`, or fewer if the soft limit on open files is lower; at least 1.
pub(super) fn connections(wanted: usize) -> usize {
    let Some(soft) = soft_limit() else { return wanted };
    wanted.min(soft.saturating_sub(in_use() + RESERVE)).max(1)
}

/// Whether accepting failed since the process, or the system, has no descriptor left.
pub(super) fn exhausted(error: &io::Error) -> bool {
    out_of_descriptors(error)
}

fn in_use() -> usize {
    std::fs::read_dir("/dev/fd").map_or(IN_USE_IF_UNKNOWN, Iterator::count)
}

#[cfg(unix)]
fn soft_limit() -> Option<usize> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile).current?;
    Some(usize::try_from(limit).unwrap_or(usize::MAX))
}

#[cfg(not(unix))]
fn soft_limit() -> Option<usize> {
    None
}

#[cfg(unix)]
fn out_of_descriptors(error: &io::Error) -> bool {
    use rustix::io::Errno;
    Errno::from_io_error(error).is_some_and(|errno| errno == Errno::MFILE || errno == Errno::NFILE)
}

#[cfg(not(unix))]
fn out_of_descriptors(_error: &io::Error) -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_leave_a_reserve() {
        assert_eq!(connections(1), 1);
        if let Some(soft) = soft_limit() {
            assert!(connections(usize::MAX) <= soft.saturating_sub(RESERVE).max(1));
        }
        #[cfg(unix)]
        assert!(exhausted(&rustix::io::Errno::MFILE.into()));
        assert!(!exhausted(&io::ErrorKind::ConnectionAborted.into()));
    }
}
