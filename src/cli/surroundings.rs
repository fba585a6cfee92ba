//! The environment that the program runs in, as far as it has to be changed.
//!
//! Purpose: on Linux, Mesa's layer that sorts GPUs asks the desktop which one it uses. In a container there is no desktop,
//! and libwayland then prints `error: XDG_RUNTIME_DIR is invalid or not set` for every look at the GPUs. The layer is left
//! out in that case, for this process alone, by the variable that Mesa has for it. It stays where somebody chooses a GPU by
//! it (`MESA_VK_DEVICE_SELECT`, `DRI_PRIME`) and where there is a desktop. Invariant: changed before any thread starts, and
//! never again: so it is sound, and the `unsafe` of setting a variable is `temp_env`'s. Must not know: GPUs.

use std::ffi::OsString;
use std::path::Path;

/// Ends the process with what `run` returns.
pub(crate) fn within(run: impl FnOnce() -> u8) -> std::process::ExitCode {
    match addition(|name| std::env::var_os(name)) {
        None => run().into(),
        // Not back to the caller: the variable would be taken away again beside threads that still run.
        Some((name, value)) => temp_env::with_var(name, Some(value), || std::process::exit(run().into())),
    }
}

fn addition(variable: impl Fn(&str) -> Option<OsString>) -> Option<(&'static str, &'static str)> {
    let absolute = |name| variable(name).is_some_and(|path| Path::new(&path).is_absolute());
    let desktop = absolute("XDG_RUNTIME_DIR") || absolute("WAYLAND_DISPLAY") || variable("WAYLAND_SOCKET").is_some();
    let chosen =
        ["NODEVICE_SELECT", "MESA_VK_DEVICE_SELECT", "DRI_PRIME"].into_iter().any(|name| variable(name).is_some());
    (cfg!(target_os = "linux") && !desktop && !chosen).then_some(("NODEVICE_SELECT", "1"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layer_stays_where_it_has_something_to_say() {
        let added = |variables: &[(&str, &str)]| {
            addition(|name| variables.iter().find(|(n, _)| *n == name).map(|(_, value)| value.into())).is_some()
        };
        for container in
            [&[][..], &[("XDG_RUNTIME_DIR", "")], &[("XDG_RUNTIME_DIR", "run"), ("WAYLAND_DISPLAY", "wayland-0")]]
        {
            assert_eq!(added(container), cfg!(target_os = "linux"), "{container:?}");
        }
        for other in [
            [("XDG_RUNTIME_DIR", "/run/user/1000")],
            [("WAYLAND_DISPLAY", "/run/wayland-0")],
            [("WAYLAND_SOCKET", "5")],
            [("NODEVICE_SELECT", "1")],
            [("MESA_VK_DEVICE_SELECT", "10de:2684")],
            [("DRI_PRIME", "1")],
        ] {
            assert!(!added(&other), "{other:?}");
        }
    }
}
