//! The one persistent device.
//!
//! Purpose: choose an adapter, open it with all the limits it has, submit, wait, and report. Invariant: callbacks only set
//! flags; [`Device::check`] reads them after each step. wgpu's `poll` panics on a lost device, so it is never called on one
//! known to be lost, and a panic inside is turned into [`GpuError::Lost`]. No caller waits longer than the timeout for a driver
//! that does not answer: not for the end of its work, not when it submits, not when it drops the device. Must not know: what is
//! computed.

use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use wgpu::Adapter;

use super::GpuError;
use super::submitter::Submitter;
use super::timing::{LANES, Timer};
use crate::buffers::Spare;

/// Which adapters may be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceOptions {
    /// Whether an adapter that runs on the CPU will do. Off by default: it is slower than the CPU backend.
    pub software: bool,
    /// Only adapters whose name contains this, whatever the case.
    pub name: Option<String>,
    /// How long one submission may take before the device counts as hung.
    pub timeout: Duration,
    /// No buffer larger than this, and no more of one seen by a shader, though the adapter allows more: what
    /// another device's limits come to can be tried so.
    pub most_buffer_bytes: Option<u64>,
    /// Memory that a session may take. One that needs more keeps some of its records on the device, and sends the others when
    /// their turn comes.
    pub memory_bytes: Option<u64>,
}

impl Default for DeviceOptions {
    fn default() -> Self {
        Self {
            software: false,
            name: None,
            timeout: Duration::from_secs(60),
            most_buffer_bytes: None,
            memory_bytes: None,
        }
    }
}

/// What `tessera doctor` prints of an adapter.
#[derive(Clone, Debug, PartialEq)]
pub struct AdapterSummary {
    /// As the driver calls it.
    pub name: String,
    /// "vulkan", "metal", "dx12".
    pub backend: String,
    /// "discrete", "integrated", "virtual", "software" or "other".
    pub kind: &'static str,
    /// Driver and version.
    pub driver: String,
    /// Whether it runs on the CPU.
    pub software: bool,
    /// Largest buffer, bytes.
    pub max_buffer_bytes: u64,
    /// Largest part of a buffer that a shader can see, bytes.
    pub max_binding_bytes: u64,
    /// Storage buffers that one shader can see.
    pub max_storage_buffers: u32,
    /// Workgroups in one dimension of a dispatch.
    pub max_workgroups: u32,
    /// Smallest and largest subgroup.
    pub subgroup: (u32, u32),
    /// What is missing to run on it, if anything.
    pub unusable: Option<String>,
}

/// Storage buffers that the largest of the shaders binds: what WebGPU guarantees.
pub const STORAGE_BUFFERS: u32 = 8;
/// Invocations per workgroup of all shaders.
pub const WORKGROUP: u32 = 64;

/// Devices that are opened on one software adapter at most, for tests of several.
const MOST_SOFTWARE: usize = 4;

/// What 64-bit sums by one atomic take.
const WIDE_ATOMICS: wgpu::Features = wgpu::Features::SHADER_INT64.union(wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS);

fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::PRIMARY;
    // Our own stages write the indirect arguments, within bounds. Checking them costs one more dispatch each.
    descriptor.flags = wgpu::InstanceFlags::from_build_config() - wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL;
    wgpu::Instance::new(descriptor)
}

/// Kinds of adapters, the best first.
const KINDS: [(wgpu::DeviceType, &str); 5] = [
    (wgpu::DeviceType::DiscreteGpu, "discrete"),
    (wgpu::DeviceType::VirtualGpu, "virtual"),
    (wgpu::DeviceType::IntegratedGpu, "integrated"),
    (wgpu::DeviceType::Other, "other"),
    (wgpu::DeviceType::Cpu, "software"),
];

fn rank(adapter: &Adapter) -> usize {
    let device_type = adapter.get_info().device_type;
    KINDS.iter().position(|kind| kind.0 == device_type).unwrap_or_default()
}

fn summarize(adapter: &Adapter) -> AdapterSummary {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    AdapterSummary {
        unusable: shortage(&info.name, &limits),
        name: info.name,
        backend: info.backend.to_string(),
        kind: KINDS[rank(adapter)].1,
        driver: [info.driver, info.driver_info].join(" ").trim().to_owned(),
        software: info.device_type == wgpu::DeviceType::Cpu,
        max_buffer_bytes: limits.max_buffer_size,
        max_binding_bytes: limits.max_storage_buffer_binding_size,
        max_storage_buffers: limits.max_storage_buffers_per_shader_stage,
        max_workgroups: limits.max_compute_workgroups_per_dimension,
        subgroup: (info.subgroup_min_size, info.subgroup_max_size),
    }
}

/// What the shaders lack within `limits`.
fn shortage(adapter: &str, limits: &wgpu::Limits) -> Option<String> {
    let needs = [
        ("storage buffers per stage", limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS),
        ("invocations per workgroup", limits.max_compute_invocations_per_workgroup, WORKGROUP),
        ("workgroups per dimension", limits.max_compute_workgroups_per_dimension, 65_535),
    ];
    let (what, offered, needed) = needs.into_iter().find(|(_, offered, needed)| offered < needed)?;
    Some(format!("adapter {adapter} offers {offered} {what}, {needed} are needed"))
}

/// All adapters of this machine, best first.
pub fn adapters() -> Vec<AdapterSummary> {
    let instance = instance();
    ranked(&instance).iter().map(summarize).collect()
}

fn ranked(instance: &wgpu::Instance) -> Vec<Adapter> {
    let mut found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    found.sort_by_key(rank);
    found
}

/// What the callbacks saw.
#[derive(Default)]
struct Flags {
    lost: Mutex<Option<String>>,
    error: Mutex<Option<String>>,
}

fn note(place: &Mutex<Option<String>>, what: String) {
    // The first message names the cause; later ones are its consequences.
    place.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(what);
}

fn noted(place: &Mutex<Option<String>>) -> Option<String> {
    place.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// What went to and from a device since it was opened. A difference of two says what a pass did, if no
/// other session used the device meanwhile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Command buffers handed to the queue.
    pub submissions: u64,
    /// Buffers allocated.
    pub allocations: u64,
    /// Bytes written to buffers.
    pub uploaded_bytes: u64,
    /// Bytes mapped for reading.
    pub read_bytes: u64,
}

/// An open device. Meant to be used by one thread at a time; shared by `Arc`.
pub struct Device {
    device: wgpu::Device,
    queue: wgpu::Queue,
    adapter: AdapterSummary,
    pub(super) timeout: Duration,
    memory_bytes: Option<u64>,
    flags: Arc<Flags>,
    meters: Mutex<Traffic>,
    timer: Mutex<Option<Timer>>,
    pub(super) spare: Arc<Spare>,
    /// The last: it closes the device when all else here has let go of it.
    submitter: Submitter,
}

impl std::fmt::Debug for Device {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Device").field("adapter", &self.adapter).finish_non_exhaustive()
    }
}

impl Device {
    /// Opens the best adapter that `options` allow, with all the limits it has.
    ///
    /// # Errors
    /// `NoAdapter`, listing what was found and why it will not do; `Failed` if the driver refuses.
    pub fn open(options: &DeviceOptions) -> Result<Arc<Self>, GpuError> {
        Self::open_up_to(options, 1)?.into_iter().next().ok_or(GpuError::NoAdapter { found: Vec::new() })
    }

    /// Opens up to `most` adapters that `options` allow, the best first. All are reached through the same interface, so that no adapter
    /// comes twice. A software adapter is opened as often as it takes.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_up_to(options: &DeviceOptions, most: usize) -> Result<Vec<Arc<Self>>, GpuError> {
        let begin = Instant::now();
        let instance = instance();
        let mut found = Vec::new();
        let mut opened: Vec<Arc<Self>> = Vec::new();
        let ranked = ranked(&instance);
        tracing::debug!(ms = begin.elapsed().as_millis(), "adapters listed");
        for adapter in ranked {
            if opened.len() >= most {
                break;
            }
            let summary = summarize(&adapter);
            let wanted = options.name.as_ref().is_none_or(|n| summary.name.to_lowercase().contains(&n.to_lowercase()));
            let refusal = if summary.software && !options.software {
                Some("runs on the CPU; allow software adapters to use it".to_owned())
            } else if !wanted {
                Some("another name was asked for".to_owned())
            } else {
                summary.unusable.clone()
            };
            match refusal {
                // Of several interfaces that of the best one, and no software beside hardware.
                None if opened.first().is_some_and(|best| {
                    (&best.adapter.backend, best.adapter.software) != (&summary.backend, summary.software)
                }) => {}
                None if summary.software => {
                    for _ in opened.len()..most.min(MOST_SOFTWARE) {
                        opened.push(Self::request(&adapter, summary.clone(), options)?);
                    }
                }
                None => opened.push(Self::request(&adapter, summary, options)?),
                Some(why) => found.push(format!("{} ({}, {}): {why}", summary.name, summary.backend, summary.kind)),
            }
        }
        if opened.is_empty() { Err(GpuError::NoAdapter { found }) } else { Ok(opened) }
    }

    fn request(adapter: &Adapter, summary: AdapterSummary, options: &DeviceOptions) -> Result<Arc<Self>, GpuError> {
        let mut required_limits = adapter.limits();
        if let Some(most) = options.most_buffer_bytes {
            required_limits.max_buffer_size = required_limits.max_buffer_size.min(most);
            let binding = &mut required_limits.max_storage_buffer_binding_size;
            *binding = (*binding).min(most);
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("tessera"),
            required_limits,
            required_features: adapter.features() & (wgpu::Features::TIMESTAMP_QUERY | WIDE_ATOMICS),
            ..Default::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|e| GpuError::Failed(e.to_string()))?;
        let flags = Arc::new(Flags::default());
        let seen = Arc::clone(&flags);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&seen.error, error.to_string())));
        let seen = Arc::clone(&flags);
        device.set_device_lost_callback(move |reason, message| note(&seen.lost, format!("{reason:?}: {message}")));
        let submitter = Submitter::start(device.clone(), queue.clone(), options.timeout)?;
        Ok(Arc::new(Self {
            device,
            queue,
            adapter: summary,
            timeout: options.timeout,
            memory_bytes: options.memory_bytes,
            flags,
            meters: Mutex::default(),
            timer: Mutex::default(),
            spare: Arc::default(),
            submitter,
        }))
    }

    /// The adapter in use.
    pub fn adapter(&self) -> &AdapterSummary {
        &self.adapter
    }

    /// What is allocated on the device now, bytes, if its driver is asked through an allocator that knows.
    pub fn allocated_bytes(&self) -> Option<u64> {
        Some(self.device.generate_allocator_report()?.total_allocated_bytes)
    }

    /// Memory that a session may take, bytes; none if the driver alone limits it.
    pub fn memory_bytes(&self) -> Option<u64> {
        self.memory_bytes
    }

    /// Limits of the device.
    pub fn limits(&self) -> wgpu::Limits {
        self.device.limits()
    }

    /// Whether shaders may add 64-bit integers atomically.
    pub fn has_wide_atomics(&self) -> bool {
        self.device.features().contains(WIDE_ATOMICS)
    }

    /// The wgpu device, for making pipelines and bind groups.
    pub fn raw(&self) -> &wgpu::Device {
        &self.device
    }

    /// The queue, for writing to buffers.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// What went to and fro so far.
    pub fn traffic(&self) -> Traffic {
        *self.meters()
    }

    pub(super) fn meters(&self) -> MutexGuard<'_, Traffic> {
        self.meters.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the callbacks saw since the device was opened.
    ///
    /// # Errors
    /// `Lost`, `Failed`. Neither goes away again: after them the device is to be replaced.
    pub fn check(&self) -> Result<(), GpuError> {
        if let Some(why) = noted(&self.flags.lost) {
            return Err(GpuError::Lost(why));
        }
        noted(&self.flags.error).map_or(Ok(()), |why| Err(self.fault(why)))
    }

    /// `Lost` if the device is lost, else `Failed` with this reason. The driver reports a loss only when it is polled, and
    /// calls on a lost device may fail before that.
    fn fault(&self, why: String) -> GpuError {
        drop(std::panic::catch_unwind(AssertUnwindSafe(|| self.device.poll(wgpu::PollType::Poll))));
        noted(&self.flags.lost).map_or(GpuError::Failed(why), GpuError::Lost)
    }

    /// Runs `make` and returns what it makes, or the error that the device has with it.
    pub fn scoped<T>(&self, make: impl FnOnce() -> T) -> Result<T, GpuError> {
        self.check()?;
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let made = make();
        // In this order, because scopes are a stack.
        let internal = pollster::block_on(internal.pop());
        let validation = pollster::block_on(validation.pop());
        let memory = pollster::block_on(memory.pop());
        if memory.is_some() {
            return Err(GpuError::OutOfMemory { what: "a buffer".to_owned(), needed_bytes: 0, limit_bytes: 0 });
        }
        let failed = internal.or(validation).map(|error| self.fault(error.to_string()));
        failed.map_or_else(|| self.check().map(|()| made), Err)
    }

    /// A buffer of at least 16 bytes, zeroed: one that a session before has left, or a new one.
    ///
    /// # Errors
    /// `OutOfMemory`, after which smaller buffers can still be had.
    pub fn buffer(&self, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer, GpuError> {
        let size = bytes.max(16).next_multiple_of(4);
        if let Some(buffer) = self.spare.take(size, usage) {
            let mut encoder = self.encoder();
            encoder.clear_buffer(&buffer, 0, None);
            self.hand_over(encoder)?;
            return Ok(buffer);
        }
        let descriptor = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
        self.meters().allocations += 1;
        let make = || self.scoped(|| self.device.create_buffer(&descriptor));
        let made = match make() {
            Err(GpuError::OutOfMemory { .. }) if self.spare.free() => make(),
            made => made,
        };
        made.map_err(|e| match e {
            GpuError::OutOfMemory { .. } => GpuError::OutOfMemory {
                what: label.to_owned(),
                needed_bytes: size,
                // Drivers do not say what is free; the request itself was too much.
                limit_bytes: size.saturating_sub(1).min(self.adapter.max_buffer_bytes),
            },
            other => other,
        })
    }

    /// An encoder for the next submission.
    pub fn encoder(&self) -> wgpu::CommandEncoder {
        self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("tessera") })
    }

    /// Times every compute pass from now on, by the device's own clock. What that takes is not counted as
    /// traffic. Returns whether the device has a clock.
    pub fn keep_time(&self) -> Result<bool, GpuError> {
        if !self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return Ok(false);
        }
        let timer = self.scoped(|| Timer::new(&self.device, &self.queue))?;
        self.timer().get_or_insert(timer);
        Ok(true)
    }

    /// Milliseconds of the passes of each lane since [`Self::keep_time`]; `None` without it.
    pub fn stage_ms(&self) -> Option<[f64; LANES]> {
        self.timer().as_ref().map(|timer| timer.total_ms)
    }

    /// Milliseconds of the longest pass of each lane since [`Self::keep_time`], and so no less than its longest
    /// dispatch took; `None` without it.
    pub fn longest_ms(&self) -> Option<[f64; LANES]> {
        self.timer().as_ref().map(|timer| timer.longest_ms)
    }

    /// Begins a compute pass, timed as one of `lane` if time is kept.
    pub fn pass<'a>(&self, encoder: &'a mut wgpu::CommandEncoder, lane: usize) -> wgpu::ComputePass<'a> {
        match &mut *self.timer() {
            Some(timer) => timer.pass(encoder, lane),
            None => encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()),
        }
    }

    fn timer(&self) -> MutexGuard<'_, Option<Timer>> {
        self.timer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Submits, waits for the end, and checks the flags.
    pub fn run(&self, encoder: wgpu::CommandEncoder) -> Result<(), GpuError> {
        let index = self.submit(encoder)?;
        self.wait(Some(index))
    }

    pub(super) fn submit(&self, mut encoder: wgpu::CommandEncoder) -> Result<wgpu::SubmissionIndex, GpuError> {
        self.check()?;
        self.meters().submissions += 1;
        let mut timer = self.timer();
        let timed = timer.as_mut().map(|timer| timer.finish(&mut encoder));
        let index = self.hand_over(encoder)?;
        if let (Some(timer), Some(true)) = (timer.as_mut(), timed) {
            timer.submitted();
        }
        Ok(index)
    }

    /// Gives the driver what was recorded, and waits until it has taken it.
    fn hand_over(&self, encoder: wgpu::CommandEncoder) -> Result<wgpu::SubmissionIndex, GpuError> {
        self.check()?;
        let answer = self.submitter.submit(encoder.finish());
        match &answer {
            Err(GpuError::Timeout { .. }) => self.hangs(),
            Err(other) => note(&self.flags.lost, other.to_string()),
            Ok(_) => self.check()?,
        }
        answer
    }

    fn hangs(&self) {
        note(&self.flags.lost, format!("no answer within {} s", self.timeout.as_secs()));
        self.submitter.abandon();
    }

    /// Waits for a submission (or for the last one) and runs the callbacks that it made due.
    pub(super) fn wait(&self, submission_index: Option<wgpu::SubmissionIndex>) -> Result<(), GpuError> {
        self.check()?;
        let poll = wgpu::PollType::Wait { submission_index, timeout: Some(self.timeout) };
        let answer = std::panic::catch_unwind(AssertUnwindSafe(|| self.device.poll(poll)));
        self.check()?;
        match answer {
            Ok(Ok(_)) => self.timer().as_mut().map_or(Ok(()), |timer| timer.collect(self.timeout)),
            Ok(Err(wgpu::PollError::Timeout)) => {
                self.hangs();
                Err(GpuError::Timeout { seconds: self.timeout.as_secs() })
            }
            Ok(Err(other)) => Err(self.fault(other.to_string())),
            Err(_) => {
                note(&self.flags.lost, "polling failed".to_owned());
                Err(GpuError::Lost("polling failed".to_owned()))
            }
        }
    }
}
