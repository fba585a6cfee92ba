//! The options of the device.
//!
//! Purpose: has [`DeviceArgs`], and [`DeviceRules`] after the checks.
//! Must not know: devices.

use std::time::Duration;

use clap::{Args, ValueEnum};

use super::values::{ConfigError, mebibytes, seconds, whole};

/// Reaction to a device that does not return.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum OnLoss {
    /// End with exit code 76, so that a supervisor restarts the server, perhaps on another machine.
    #[default]
    Exit,
    /// Continue on the CPU. Health, `tessera info` and every result show it.
    Cpu,
}

/// Options about the device.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Device")]
pub struct DeviceArgs {
    /// MiB of the device's memory that jobs at work may need together; a job that needs more is refused. Not limited if not
    /// given: a job for which the device has no room then ends with an error.
    #[arg(long, value_name = "MIB", value_parser = whole::<u64>, env = "TESSERA_DEVICE_MEMORY_MIB")]
    pub device_memory_mib: Option<u64>,
    /// Seconds that the device may take for one piece of work; then it counts as lost.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_DEVICE_TIMEOUT_S")]
    pub device_timeout_s: f64,
    /// Reaction if a lost device cannot be reopened.
    #[arg(long, value_enum, default_value_t, env = "TESSERA_ON_DEVICE_LOSS")]
    pub on_device_loss: OnLoss,
    /// Seconds for which a lost device is tried again before that.
    #[arg(long, value_name = "S", default_value_t = 30.0, env = "TESSERA_DEVICE_LOSS_S")]
    pub device_loss_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceRules {
    /// Memory for jobs, if limited, bytes.
    pub memory_bytes: Option<u64>,
    /// For one piece of work.
    pub timeout: Duration,
    /// What to do if a lost device does not return within `patience`.
    pub on_loss: OnLoss,
    /// How long to wait for a lost device.
    pub patience: Duration,
}

impl DeviceArgs {
    pub(super) fn check(&self) -> Result<DeviceRules, ConfigError> {
        Ok(DeviceRules {
            memory_bytes: mebibytes("--device-memory-mib", self.device_memory_mib)?,
            timeout: seconds("--device-timeout-s", self.device_timeout_s)?,
            on_loss: self.on_device_loss,
            patience: seconds("--device-loss-s", self.device_loss_s)?,
        })
    }
}
