//! The thread that makes the calls after which a driver may never return.
//!
//! Purpose: hand command buffers to the queue, and at last close queue and device. A driver may hold up either until all
//! earlier work has ended, which is never if that hangs; a caller waits no longer than a submission may take. Invariant: one
//! call at a time, in the order in which they were asked for. A thread that a driver keeps goes on to hold the device, and
//! closes it when the driver lets go. Must not know: what is computed, what a lost device means for a job.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use super::GpuError;

struct Request {
    commands: wgpu::CommandBuffer,
    answer: SyncSender<wgpu::SubmissionIndex>,
}

pub(super) struct Submitter {
    requests: Option<Sender<Request>>,
    /// Behind a lock only so that this can be shared.
    closed: Mutex<Receiver<()>>,
    timeout: Duration,
    hangs: AtomicBool,
}

impl Submitter {
    /// Starts the thread. It holds `device` and `queue` until this is dropped. No call waits for longer than `timeout`.
    pub(super) fn start(device: wgpu::Device, queue: wgpu::Queue, timeout: Duration) -> Result<Self, GpuError> {
        let (requests, asked) = channel::<Request>();
        let (close, closed) = sync_channel(1);
        let work = move || {
            for Request { commands, answer } in asked {
                // The caller may be gone. A panic drops the reply channel.
                let _ = catch_unwind(AssertUnwindSafe(|| answer.send(queue.submit([commands]))));
            }
            // The queue waits here for what was submitted. wgpu panics if the driver refuses to.
            let _ = catch_unwind(AssertUnwindSafe(move || drop((queue, device))));
            let _ = close.send(());
        };
        let builder = std::thread::Builder::new().name("device".to_owned());
        builder.spawn(work).map_err(|error| GpuError::Failed(format!("no thread for the device: {error}")))?;
        Ok(Self { requests: Some(requests), closed: Mutex::new(closed), timeout, hangs: AtomicBool::new(false) })
    }

    /// Submits, and waits for that, but not for the work.
    pub(super) fn submit(&self, commands: wgpu::CommandBuffer) -> Result<wgpu::SubmissionIndex, GpuError> {
        let (answer, answered) = sync_channel(1);
        let failed = || GpuError::Lost("submitting failed".to_owned());
        let requests = self.requests.as_ref().ok_or_else(failed)?;
        requests.send(Request { commands, answer }).map_err(|_| failed())?;
        answered.recv_timeout(self.timeout).map_err(|error| match error {
            RecvTimeoutError::Timeout => GpuError::Timeout { seconds: self.timeout.as_secs() },
            RecvTimeoutError::Disconnected => failed(),
        })
    }

    /// The driver does not answer: it is not waited for any more.
    pub(super) fn abandon(&self) {
        self.hangs.store(true, Ordering::Relaxed);
    }
}

impl Drop for Submitter {
    /// Waits until the thread has closed the device: the process may end right after, which a driver at work takes badly.
    fn drop(&mut self) {
        self.requests = None;
        if !self.hangs.load(Ordering::Relaxed) {
            let closed = self.closed.get_mut().unwrap_or_else(PoisonError::into_inner);
            let _ = closed.recv_timeout(self.timeout);
        }
    }
}
