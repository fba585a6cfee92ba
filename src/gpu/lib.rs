//! The device, and the GPU backend of the diagram.
//!
//! Purpose: [`device`] opens one persistent wgpu device and turns everything that can go wrong with it into [`GpuError`];
//! [`buffers`] allocates and moves bytes; [`dispatch`] says what it allows, and turns counts of items into workgroups and
//! parts; `submitter` makes the calls that a driver may hold up; `timing` reads the device's clock; [`shader`] composes WGSL.
//! These know no facet and no seed. [`diagram`] is the backend on top of them. [`BackendOptions`] opens any backend, this one
//! or those of the CPU, also in a build without the feature `device`. Invariant: no panic and no silent error leaves here. A
//! lost device is reported as [`GpuError::Lost`] by the next call. Must not know: jobs, messages, files.

#![warn(unreachable_pub)]

mod backends;
#[cfg(feature = "device")]
pub mod buffers;
#[cfg(feature = "device")]
pub mod device;
#[cfg(feature = "device")]
pub mod diagram;
#[cfg(feature = "device")]
mod dispatch;
#[cfg(feature = "device")]
pub mod shader;
#[cfg(feature = "device")]
mod submitter;
#[cfg(feature = "device")]
mod timing;

pub use backends::{BackendOptions, NoGpu, auto_backend};
#[cfg(feature = "device")]
pub(crate) use device::Traffic;
#[cfg(feature = "device")]
pub use device::{Device, DeviceOptions};
/// For callers with shaders of their own.
#[cfg(feature = "device")]
pub use wgpu;

/// What can go wrong on a device.
#[cfg(feature = "device")]
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// No adapter that may be used. `found` lists those that may not, and why.
    #[error("no usable GPU adapter; found: {}", if .found.is_empty() { "none".to_owned() } else { .found.join("; ") })]
    NoAdapter {
        /// "name (backend, type): why not".
        found: Vec<String>,
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

/// A session that may be opened.
#[derive(Clone, Copy, Debug)]
pub struct SessionForecast {
    /// Facets of its surface.
    pub facets: u64,
    /// Seeds at most.
    pub seeds: u64,
    /// Whether the surface has weights.
    pub graded: bool,
    /// Whether seeds are moved.
    pub moved: bool,
    /// Whether the surface is lifted.
    pub lifted: bool,
}

impl SessionForecast {
    /// Bytes that it takes on a device: those of the plan that allocates. 0 if this build has no GPU backend.
    pub fn device_bytes(&self) -> u64 {
        #[cfg(feature = "device")]
        return diagram::forecast::session_bytes(self);
        #[cfg(not(feature = "device"))]
        return 0;
    }
}
