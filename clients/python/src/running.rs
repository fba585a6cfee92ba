//! Work beside the interpreter.
//!
//! Purpose: [`run`] does work on a thread of its own, without the interpreter's lock, and brings progress and Ctrl-C across.
//! Invariant: the work is cancelled as soon as a callback raises or a signal's handler does; that exception is what the caller
//! sees. Must not know: what the work is.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use tessera::cvt::Iteration;
use tessera::{Observer, Token};

/// How often Python may handle signals while the engine works.
const POLL: Duration = Duration::from_millis(20);

/// What happened, for a callback.
pub(crate) enum Event {
    /// A stage began.
    Stage(&'static str),
    /// A step was taken, of so many.
    Step(Box<Iteration>, usize),
}

/// Sends what happens to the thread that asked.
pub(crate) struct Events(Sender<Event>);

impl Events {
    fn send(&self, event: Event) {
        // Who asked may have gone, and does not hear the rest.
        let _ = self.0.send(event);
    }
}

impl Observer for Events {
    fn stage(&mut self, name: &'static str) {
        self.send(Event::Stage(name));
    }

    fn iteration(&mut self, iteration: &Iteration, total: usize) {
        self.send(Event::Step(Box::new(*iteration), total));
    }
}

/// Does `work`; `progress` is called as `progress(stage, step, steps, energy)`, the last three `None` where a stage begins.
///
/// # Errors
/// What `progress` or a signal's handler raised; RuntimeError if there is no thread to be had or the work panicked.
pub(crate) fn run<R: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&mut Events, &Token) -> R + Send,
) -> PyResult<R> {
    let token = Token::default();
    let (sender, receiver) = channel();
    let receiver = Mutex::new(receiver);
    std::thread::scope(|scope| {
        let (mut events, of) = (Events(sender), &token);
        let working = std::thread::Builder::new().name("tessera".to_owned()).spawn_scoped(scope, move || {
            let result = work(&mut events, of);
            // The channel's end says that the work has ended, whether or not anybody hears of progress.
            drop(events);
            result
        });
        let working = working.map_err(|error| PyRuntimeError::new_err(format!("no thread for the work: {error}")))?;
        let raised = listen(py, progress, &receiver).inspect_err(|_| token.cancel());
        let result = py.detach(|| working.join());
        raised?;
        result.map_err(|_| PyRuntimeError::new_err("the engine failed; please report it with the input"))
    })
}

/// Until the work has ended.
fn listen(py: Python<'_>, progress: Option<&Bound<'_, PyAny>>, events: &Mutex<Receiver<Event>>) -> PyResult<()> {
    loop {
        let event = py.detach(|| events.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(POLL));
        py.check_signals()?;
        match (event, progress) {
            (Err(RecvTimeoutError::Disconnected), _) => return Ok(()),
            (Ok(Event::Stage(name)), Some(call)) => {
                call.call1((name, py.None(), py.None(), py.None()))?;
            }
            (Ok(Event::Step(step, total)), Some(call)) => {
                call.call1(("iterations", step.index + 1, total, step.energy))?;
            }
            (Ok(_), None) | (Err(RecvTimeoutError::Timeout), _) => {}
        }
    }
}
