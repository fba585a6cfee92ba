//! What all rooms of a session share.
//!
//! Purpose: the device and its stages, the host's threads, the surface.
//! Invariant: nothing here changes while a session is open. Must not know: seeds.

use std::sync::Arc;

use super::pipelines::Pipelines;
use crate::Device;
use crate::limits::Limits;
use geometry::rvd::{Capacities, Surface};

pub(super) struct Context {
    pub device: Arc<Device>,
    pub pool: Arc<rayon::ThreadPool>,
    pub pipelines: Arc<Pipelines>,
    pub surface: Arc<Surface>,
    /// Total mass of the surface.
    pub mass: f64,
    /// Seeds at most.
    pub max_seeds: usize,
    /// First capacities.
    pub capacities: Capacities,
}

impl Context {
    pub(super) fn limits(&self) -> Limits {
        Limits::of(&self.device.limits())
    }
}
