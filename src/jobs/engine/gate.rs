//! One device for several jobs.
//!
//! Purpose: [`Gate`] lets one pass at a time on the device, in the order in which they came; [`Gated`] is a backend whose
//! sessions go through it. So a job's passes run while another fits or measures on the host, and a tiny job waits for one
//! pass of a huge one and not for its end. A CPU backend needs no gate; its passes are counted and traced in the same way.
//! Invariant: what is gated does what its inner session does, with the same bits; only when it does so differs. A waiter
//! checks its token. A panic inside gives the gate back. Must not know: which backend it is, what a job does.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use crate::lock;
use crate::observe::activity::Activity;
use geometry::knn::{Lifted, Point};
use geometry::rvd::{
    Backend, BackendKind, CellSums, DeviceFacts, DeviceWork, Evaluation, PassStats, PhasesMs, PieceBatch, Resident,
    RvdError, Session, SessionOptions, Surface,
};
use geometry::token::Token;

/// How often the token of work that waits is checked.
pub(crate) const TOKEN_POLL: Duration = Duration::from_millis(20);

#[derive(Debug, Default)]
pub(crate) struct Gate {
    queue: Mutex<WaitQueue>,
    moved: Condvar,
}

#[derive(Debug, Default)]
struct WaitQueue {
    busy: bool,
    waiting: VecDeque<u64>,
    last: u64,
}

/// The right to use the device, until it is dropped.
struct Permit<'a>(&'a Gate);

impl Drop for Permit<'_> {
    fn drop(&mut self) {
        let mut queue = lock(&self.0.queue);
        queue.busy = false;
        let any = !queue.waiting.is_empty();
        drop(queue);
        if any {
            self.0.moved.notify_all();
        }
    }
}

/// An entry of the queue, removed when dropped: after a cancel, or once it has its turn.
struct Waiter<'a> {
    gate: &'a Gate,
    number: u64,
}

impl Drop for Waiter<'_> {
    fn drop(&mut self) {
        lock(&self.gate.queue).waiting.retain(|number| *number != self.number);
        self.gate.moved.notify_all();
    }
}

impl Gate {
    fn enter(&self, token: Option<&Token>) -> Result<Permit<'_>, RvdError> {
        let mut queue = lock(&self.queue);
        if !queue.busy && queue.waiting.is_empty() {
            queue.busy = true;
            return Ok(Permit(self));
        }
        queue.last += 1;
        let number = queue.last;
        queue.waiting.push_back(number);
        drop(queue);
        let waiter = Waiter { gate: self, number };
        let mut queue = lock(&self.queue);
        while queue.busy || queue.waiting.front() != Some(&number) {
            if let Some(token) = token {
                drop(queue);
                token.check()?;
                queue = lock(&self.queue);
                if !queue.busy && queue.waiting.front() == Some(&number) {
                    break;
                }
            }
            queue = self.moved.wait_timeout(queue, TOKEN_POLL).unwrap_or_else(PoisonError::into_inner).0;
        }
        queue.busy = true;
        drop(queue);
        drop(waiter);
        Ok(Permit(self))
    }
}

/// A backend as one job sees it: its passes are counted and traced, and a device is shared. See the module's head.
pub(crate) struct Gated {
    pub(crate) backend: Arc<dyn Backend>,
    /// For a device: the gate, and the job's own threads for all that is no pass.
    pub(crate) shared: Option<(Arc<Gate>, Arc<dyn Backend>)>,
    pub activity: Arc<Activity>,
}

impl Gated {
    fn open<P: Point>(
        &self,
        session: impl FnOnce(&dyn Backend) -> Result<Box<dyn Session<P>>, RvdError>,
    ) -> Result<Box<dyn Session<P>>, RvdError> {
        let Some((gate, _)) = &self.shared else {
            return Ok(self.session_of(session(&*self.backend)?));
        };
        // Planning and allocating are the device's too: two at once could both find that they fit.
        let _pass = gate.enter(None)?;
        let opening = self.activity.pass("open", self.backend.kind());
        let session = session(&*self.backend)?;
        drop(opening);
        Ok(self.session_of(session))
    }

    fn session_of<P: Point>(&self, session: Box<dyn Session<P>>) -> Box<dyn Session<P>> {
        let gate = self.shared.as_ref().map(|(gate, _)| Arc::clone(gate));
        Box::new(GatedSession::new(session, gate, self.backend.kind(), Arc::clone(&self.activity)))
    }
}

impl Backend for Gated {
    fn pool(&self) -> Option<Arc<rayon::ThreadPool>> {
        self.shared.as_ref().map_or(&self.backend, |(_, host)| host).pool()
    }

    fn kind(&self) -> BackendKind {
        self.backend.kind()
    }

    fn adapter(&self) -> Option<String> {
        self.backend.adapter()
    }

    fn device_facts(&self) -> Option<DeviceFacts> {
        self.backend.device_facts()
    }

    fn threads(&self) -> usize {
        self.backend.threads()
    }

    fn exact_session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        match &self.shared {
            Some((_, host)) => host.session(surface, options),
            None => Ok(self.session_of(self.backend.exact_session(surface, options)?)),
        }
    }

    fn lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>, RvdError> {
        self.open(|backend| backend.lifted_session(surface, options))
    }

    fn exact_lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>, RvdError> {
        match &self.shared {
            Some((_, host)) => host.lifted_session(surface, options),
            None => Ok(self.session_of(self.backend.exact_lifted_session(surface, options)?)),
        }
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        self.open(|backend| backend.session(surface, options))
    }
}

/// A session whose passes are counted and traced, and wait for their turn if there is a gate.
struct GatedSession<P: Point> {
    session: Box<dyn Session<P>>,
    gate: Option<Arc<Gate>>,
    kind: BackendKind,
    activity: Arc<Activity>,
    /// Bytes on the device that were reported.
    planned: u64,
    /// What the device did for it: a device counts what it does for all, and only within the gate is all for one.
    work: DeviceWork,
}

impl<P: Point> GatedSession<P> {
    fn new(session: Box<dyn Session<P>>, gate: Option<Arc<Gate>>, kind: BackendKind, activity: Arc<Activity>) -> Self {
        let work = session.device_work();
        let mut session = Self { session, gate, kind, activity, planned: 0, work };
        session.report_planned();
        session
    }

    /// Does `work` when it is this session's turn.
    fn pass<R>(
        &mut self,
        name: &'static str,
        token: Option<&Token>,
        work: impl FnOnce(&mut dyn Session<P>) -> Result<R, RvdError>,
    ) -> Result<R, RvdError> {
        let gate = self.gate.clone();
        // Others wait for the device meanwhile.
        let _whole = token.filter(|_| gate.is_some()).map(Token::uninterrupted);
        let pass = gate.as_ref().map(|gate| gate.enter(token)).transpose()?;
        let activity = Arc::clone(&self.activity);
        let timed = activity.pass(name, self.kind);
        let before = self.session.device_work();
        let done = work(self.session.as_mut());
        self.work = self.work.with(&self.session.device_work().since(&before), |a, b| a + b);
        drop(timed);
        self.report_planned();
        drop(pass);
        done
    }

    /// What lies on the device grows with what is done there.
    fn report_planned(&mut self) {
        let now = self.session.device_bytes();
        let before = std::mem::replace(&mut self.planned, now);
        if now != before {
            self.activity.planned(signed(now) - signed(before));
        }
    }

    /// As [`Self::pass`], on the seeds of the device. A session without them is never handed out as [`Resident`].
    fn move_seeds<R>(
        &mut self,
        name: &'static str,
        token: Option<&Token>,
        work: impl FnOnce(&mut dyn Resident<P>) -> Result<R, RvdError>,
    ) -> Result<R, RvdError> {
        self.pass(name, token, |session| match session.resident() {
            Some(resident) => work(resident),
            None => Err(RvdError::Internal("a session took back its seeds".to_owned())),
        })
    }
}

impl<P: Point> Drop for GatedSession<P> {
    fn drop(&mut self) {
        self.activity.planned(-signed(self.planned));
    }
}

fn signed(bytes: u64) -> i64 {
    i64::try_from(bytes).unwrap_or(i64::MAX)
}

impl<P: Point> Session<P> for GatedSession<P> {
    fn set_seeds(&mut self, seeds: &[P]) -> Result<(), RvdError> {
        self.pass("set_seeds", None, |session| session.set_seeds(seeds))
    }

    fn sums(&mut self, out: &mut CellSums<P>, token: &Token) -> Result<PassStats, RvdError> {
        self.pass("sums", Some(token), |session| session.sums(out, token))
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        self.pass("pieces", Some(token), |session| session.pieces(facets, out, token))
    }

    fn device_bytes(&self) -> u64 {
        self.session.device_bytes()
    }

    fn device_work(&self) -> DeviceWork {
        self.work
    }

    fn device_phases(&self) -> Option<PhasesMs> {
        self.session.device_phases()
    }

    fn resident(&mut self) -> Option<&mut dyn Resident<P>> {
        match self.session.resident() {
            Some(_) => Some(self),
            None => None,
        }
    }
}

impl<P: Point> Resident<P> for GatedSession<P> {
    fn hold(&mut self, held: &[bool]) -> Result<(), RvdError> {
        self.move_seeds("hold", None, |seeds| seeds.hold(held))
    }

    fn evaluate(&mut self, token: &Token) -> Result<Evaluation, RvdError> {
        self.move_seeds("evaluate", Some(token), |seeds| seeds.evaluate(token))
    }

    fn to_centroids(&mut self) -> Result<(), RvdError> {
        self.move_seeds("to_centroids", None, |seeds| seeds.to_centroids())
    }

    fn relax(&mut self, steps: usize, evaluations: &mut Vec<Evaluation>, token: &Token) -> Result<(), RvdError> {
        self.move_seeds("relax", Some(token), |seeds| seeds.relax(steps, evaluations, token))
    }

    fn search_direction(&mut self) -> Result<f64, RvdError> {
        self.move_seeds("search_direction", None, |seeds| seeds.search_direction())
    }

    fn probe(&mut self, step: f64, token: &Token) -> Result<Evaluation, RvdError> {
        self.move_seeds("probe", Some(token), |seeds| seeds.probe(step, token))
    }

    fn accept(&mut self) -> Result<(), RvdError> {
        self.move_seeds("accept", None, |seeds| seeds.accept())
    }

    fn clear_history(&mut self) {
        if let Some(resident) = self.session.resident() {
            resident.clear_history();
        }
    }

    fn read(&mut self, out: &mut Vec<P>) -> Result<(), RvdError> {
        self.move_seeds("read", None, |seeds| seeds.read(out))
    }

    fn read_sums(&mut self, out: &mut CellSums<P>) -> Result<(), RvdError> {
        self.move_seeds("read_sums", None, |seeds| seeds.read_sums(out))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use geometry::token::Stopped;

    #[test]
    fn one_at_a_time_and_in_order() {
        let gate = Arc::new(Gate::default());
        let inside = AtomicUsize::new(0);
        let order = Mutex::new(Vec::new());
        let first = gate.enter(None).unwrap();
        std::thread::scope(|scope| {
            for number in 0..8 {
                let (gate, inside, order) = (&gate, &inside, &order);
                scope.spawn(move || {
                    let _pass = gate.enter(Some(&Token::default())).unwrap();
                    assert_eq!(inside.fetch_add(1, Ordering::SeqCst), 0);
                    order.lock().unwrap().push(number);
                    std::thread::sleep(Duration::from_millis(2));
                    inside.fetch_sub(1, Ordering::SeqCst);
                });
                while lock(&gate.queue).waiting.len() <= number {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
            drop(first);
        });
        assert_eq!(*order.lock().unwrap(), (0..8).collect::<Vec<_>>());
        assert!(!lock(&gate.queue).busy && lock(&gate.queue).waiting.is_empty());
    }

    #[test]
    #[ignore = "a program that prints figures"]
    fn figures_of_a_free_gate() {
        const TIMES: u32 = 1_000_000;
        let (gate, token) = (Gate::default(), Token::default());
        let begin = std::time::Instant::now();
        (0..TIMES).for_each(|_| drop(gate.enter(Some(&token)).unwrap()));
        println!("{{\"free_gate_ns\": {}}}", begin.elapsed().as_nanos() / u128::from(TIMES));
    }

    #[test]
    fn who_waits_hears_its_token_and_leaves_the_line() {
        let gate = Gate::default();
        let first = gate.enter(None).unwrap();
        let token = Token::default();
        token.cancel();
        assert!(matches!(gate.enter(Some(&token)).err(), Some(RvdError::Stopped(Stopped::Cancelled))));
        assert!(lock(&gate.queue).waiting.is_empty());
        drop(first);
        drop(gate.enter(None).unwrap());
    }

    #[test]
    fn a_panic_gives_the_gate_back() {
        let gate = Gate::default();
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let _pass = gate.enter(None).unwrap();
            panic!("on purpose");
        }));
        assert!(panicked.is_err());
        drop(gate.enter(None).unwrap());
    }
}
