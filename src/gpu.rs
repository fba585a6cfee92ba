//! The GPU: one device, its buffers, its shaders.
//!
//! Purpose: [`device`] opens one persistent wgpu device and turns everything that can go wrong
//! with it into [`GpuError`]; [`limits`] says what it allows; [`buffers`] allocates and moves bytes; [`dispatch`] turns numbers
//! of items into workgroups and parts; `submitter` makes the calls that a driver may hold up; `timing` reads the device's clock; [`shader`] composes WGSL.
//! Invariant: no panic and no silent error leaves here; a lost device is reported as
//! [`GpuError::Lost`] by the next call.
//! Must not know: meshes, facets, seeds, jobs. Numbers of things are numbers here.

pub mod buffers;
pub mod device;
pub mod dispatch;
pub mod limits;
pub mod shader;
mod spare;
mod submitter;
mod timing;

pub(crate) use device::Traffic;
pub use device::{Device, DeviceOptions};

/// What can go wrong on a device.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// No adapter that may be used. `found` lists those that may not, and why.
    #[error("no usable GPU adapter; found: {}", if .found.is_empty() { "none".to_owned() } else { .found.join("; ") })]
    NoAdapter {
        /// "name (backend, type): why not".
        found: Vec<String>,
    },
    /// The adapter lacks something that the shaders need.
    #[error("adapter {adapter} offers {offered} {what}, {needed} are needed")]
    Unsupported {
        /// The adapter's name.
        adapter: String,
        /// Which limit.
        what: &'static str,
        /// Its value.
        offered: u64,
        /// What the shaders need.
        needed: u64,
    },
    /// A buffer is larger than this device allows, however much memory is free.
    #[error("{what} needs {needed_bytes} bytes and this device allows {limit_bytes}")]
    NeverFits {
        /// Which buffer.
        what: String,
        /// Bytes it needs.
        needed_bytes: u64,
        /// The device's limit.
        limit_bytes: u64,
    },
    /// A buffer, or all of them, do not fit now. Smaller ones may.
    #[error("{needed_bytes} bytes of device memory are needed for {what}, {limit_bytes} can be had")]
    OutOfMemory {
        /// Which buffer, or "all buffers".
        what: String,
        /// Bytes asked for.
        needed_bytes: u64,
        /// Bytes that can be had, as far as the device says.
        limit_bytes: u64,
    },
    /// The device is gone; open a new one.
    #[error("the device was lost: {0}")]
    Lost(String),
    /// A submission did not end in time; the device must be taken for hung.
    #[error("the device did not answer within {seconds} s")]
    Timeout {
        /// How long was waited.
        seconds: u64,
    },
    /// A call was refused or failed; a bug here or in the driver.
    #[error("the device failed: {0}")]
    Failed(String),
    /// A shader could not be composed; a bug here.
    #[error(transparent)]
    Shader(#[from] shader::ComposeError),
}
