//! Plug-ins in process, where time stands still during their calls: in virtual time, and in a replay.
//!
//! A call needs no other thread, so that virtual time is fast. A plug-in that hangs must not take its caller with it.
//! Therefore the caller ([`Lockstep`]) runs on a thread of [`Guarded`], and is left in a shared slot ([`Slot`]) during each
//! call. If the call lasts too long, the waiting thread takes the caller from the slot and continues it on another thread.
//! The hanging thread finds the slot empty when it returns.

use std::{
    collections::VecDeque,
    ops::{Deref, DerefMut},
    panic::{AssertUnwindSafe, catch_unwind, resume_unwind},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use cotorra_graph::{PluginId, Stamped, Testbed, Timestamp};
use cotorra_plugin::{Actions, Plugin};
use parking_lot::Mutex;

use super::{
    host::{Fault, PluginHost},
    panic::panic_text,
};
use crate::{
    clock::Clock,
    domain::{self, DomainView},
};

/// Longest wait for a silent plug-in where time waits for it. After that it counts as hung.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// Interval at which the length of a call is checked.
const LOOK: Duration = Duration::from_millis(50);

/// A state machine that makes progress only between calls of plug-ins.
pub(crate) trait Lockstep: Send + 'static {
    /// Returns the longest duration of a call.
    fn patience(&self) -> Duration;

    /// Returns the next call that is due.
    fn next_call(&mut self) -> Option<Call>;

    /// Handles the outcome of a call.
    fn returned(&mut self, returned: Returned);

    /// Makes progress after all due calls returned. Returns false at the end.
    fn go_on(&mut self) -> bool;

    /// Runs to the end, making calls on this thread: a plug-in that hangs also hangs its caller.
    fn run(&mut self) {
        loop {
            while let Some(call) = self.next_call() {
                self.returned(call.make());
            }
            if !self.go_on() {
                return;
            }
        }
    }
}

/// A call of a plug-in; owns everything that it needs.
pub(crate) struct Call {
    pub(crate) plugin: Box<dyn Plugin>,
    pub(crate) now: Timestamp,
    pub(crate) occasion: Occasion,
}

/// The reason for a call.
pub(crate) enum Occasion {
    Start(Arc<Testbed>, Option<Arc<DomainView>>),
    Event(Arc<Stamped>),
    Deadline,
}

/// The outcome of a call.
pub(crate) type Returned = Result<Answer, Fault>;

/// A plug-in after a call.
pub(crate) struct Answer {
    pub(crate) plugin: Box<dyn Plugin>,
    pub(crate) actions: Actions,
    /// Time of the plug-in's next call without an event.
    pub(crate) next_deadline: Option<Timestamp>,
}

impl Call {
    /// Makes the call. A panic becomes a fault of the plug-in.
    pub(crate) fn make(mut self) -> Returned {
        let mut actions = Actions::default();
        let (now, plugin) = (self.now, &mut self.plugin);
        let called = catch_unwind(AssertUnwindSafe(|| {
            match self.occasion {
                Occasion::Start(testbed, view) => {
                    plugin.start(now, view.as_ref().map_or(&*testbed, |view| view.testbed()), &mut actions);
                }
                Occasion::Event(event) => plugin.handle(now, &event.event, &mut actions),
                Occasion::Deadline => plugin.expire(now, &mut actions),
            }
            // Called here, where a panic or hang does no harm either.
            plugin.next_deadline()
        }));
        match called {
            Ok(next_deadline) => Ok(Answer { plugin: self.plugin, actions, next_deadline }),
            Err(panic) => Err(Fault::Panicked(panic_text(&*panic).to_owned())),
        }
    }
}

/// Plug-ins in process, in the order of their calls.
#[derive(Default)]
pub(crate) struct Locals {
    all: Vec<Local>,
    /// Due calls, with the index of the plug-in.
    due: VecDeque<(usize, Occasion)>,
    /// Index of the first plug-in whose deadline has not been checked since the last wake.
    unasked: Option<usize>,
    /// Index of the plug-in in a call.
    called: usize,
}

struct Local {
    id: PluginId,
    /// `None` during a call, and after it was cut off.
    plugin: Option<Box<dyn Plugin>>,
    /// The plug-in's view, if it is bound to a domain.
    view: Option<Arc<DomainView>>,
}

impl Locals {
    /// Adds a plug-in; its first call starts it.
    pub(crate) fn add(
        &mut self,
        id: PluginId,
        plugin: Box<dyn Plugin>,
        testbed: &Arc<Testbed>,
        view: Option<Arc<DomainView>>,
    ) {
        self.due.push_back((self.all.len(), Occasion::Start(Arc::clone(testbed), view.clone())));
        self.all.push(Local { id, plugin: Some(plugin), view });
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Returns the next deadline. Not cached: orchestrators share a ledger, so a call of one may change another's deadline.
    pub(crate) fn next_deadline(&self, host: &PluginHost) -> Option<Timestamp> {
        let deadline =
            |local: &Local| Some(local.plugin.as_ref()?.next_deadline()?.max(host.free_at(&local.id)));
        self.all.iter().filter_map(deadline).min()
    }

    /// Makes calls due for plug-ins whose deadline has come.
    pub(crate) fn wake(&mut self) {
        self.unasked = Some(0);
    }

    /// Makes calls due for plug-ins that see an event, or sends it to those that are away.
    pub(crate) fn publish(&mut self, now: Timestamp, event: &Arc<Stamped>, host: &mut PluginHost) {
        for (place, local) in self.all.iter().enumerate() {
            if local.plugin.is_some()
                && let Some(seen) = domain::seen(local.view.as_deref(), event)
                && let Some(seen) = host.send_context(now, &local.id, seen)
            {
                self.due.push_back((place, Occasion::Event(seen)));
            }
        }
    }

    /// Returns the next due call.
    pub(crate) fn next_call(&mut self, now: Timestamp, host: &mut PluginHost) -> Option<Call> {
        while let Some((place, occasion)) = self.due.pop_front() {
            if let Some(plugin) = self.all[place].plugin.take() {
                self.called = place;
                return Some(Call { plugin, now, occasion });
            }
        }
        for (place, local) in self.all.iter_mut().enumerate() {
            if let Some(event) = host.next_context(now, &local.id)
                && let Some(plugin) = local.plugin.take()
            {
                self.called = place;
                return Some(Call { plugin, now, occasion: Occasion::Event(event) });
            }
        }
        while let Some(place) = self.unasked.take_if(|place| *place < self.all.len()) {
            self.unasked = Some(place + 1);
            let Local { id, plugin, .. } = &mut self.all[place];
            let is_free = host.free_at(id) <= now;
            let has_come =
                |plugin: &mut Box<dyn Plugin>| is_free && plugin.next_deadline().is_some_and(|at| at <= now);
            if let Some(plugin) = plugin.take_if(has_come) {
                self.called = place;
                return Some(Call { plugin, now, occasion: Occasion::Deadline });
            }
        }
        None
    }

    /// Takes the called plug-in back. Returns its actions, or the fault for which to cut it off.
    pub(crate) fn returned(&mut self, returned: Returned) -> (PluginId, Result<Actions, Fault>) {
        let local = &mut self.all[self.called];
        let outcome = returned.map(|answer| {
            local.plugin = Some(answer.plugin);
            answer.actions
        });
        (local.id.clone(), outcome)
    }

    /// Drops plug-ins that were cut off.
    pub(crate) fn end_cut_off(&mut self, host: &PluginHost) {
        self.all.iter_mut().filter(|local| host.is_cut_off(&local.id)).for_each(|local| local.plugin = None);
    }
}

/// Runs a [`Lockstep`] safely with plug-ins that may hang.
pub(crate) struct Guarded<L> {
    /// `None` while it runs.
    inner: Option<Box<L>>,
    worker: Option<Worker<L>>,
    wall: Clock,
}

/// The thread on which the [`Lockstep`] runs.
struct Worker<L> {
    thread: thread::JoinHandle<()>,
    run: mpsc::Sender<Box<L>>,
    ran: mpsc::Receiver<Box<L>>,
    slot: Arc<Slot<L>>,
}

/// Holds the [`Lockstep`] during a call.
struct Slot<L> {
    left: Mutex<Option<Box<L>>>,
    /// Number of calls made.
    calls: AtomicU64,
}

impl<L: Lockstep> Guarded<L> {
    /// Measures calls by the clock `wall`.
    pub(crate) fn new(inner: L, wall: Clock) -> Self {
        Self { inner: Some(Box::new(inner)), worker: None, wall }
    }

    /// Runs to the end. Calls `is_wanted` repeatedly while that takes long. Returns false if `is_wanted` did.
    pub(crate) fn run(&mut self, is_wanted: &mut dyn FnMut() -> bool) -> bool {
        // Once it returned false it may not be called again.
        let mut wanted = true;
        let mut ask = || {
            wanted = wanted && is_wanted();
            wanted
        };
        loop {
            let inner = self.inner.take().expect("present between runs");
            let patience = inner.patience();
            let worker = self.worker.get_or_insert_with(Worker::start);
            // If the thread is gone, `wait` returns `Panicked`.
            let _ = worker.run.send(inner);
            match worker.wait(patience, &self.wall, &mut ask) {
                Waited::Ran(inner) => {
                    self.inner = Some(inner);
                    return wanted;
                }
                Waited::Hung(mut inner) => {
                    self.worker = None;
                    inner.returned(Err(Fault::Hung(patience)));
                    self.inner = Some(inner);
                }
                Waited::Unwanted(inner) => {
                    self.worker = None;
                    self.inner = Some(inner);
                    return false;
                }
                Waited::Panicked => {
                    let panic = self.worker.take().and_then(|worker| worker.thread.join().err());
                    resume_unwind(panic.unwrap_or_else(|| Box::new("its thread ended")));
                }
            }
        }
    }
}

impl<L> Deref for Guarded<L> {
    type Target = L;

    fn deref(&self) -> &L {
        self.inner.as_ref().expect("present between runs")
    }
}

impl<L> DerefMut for Guarded<L> {
    fn deref_mut(&mut self) -> &mut L {
        self.inner.as_mut().expect("present between runs")
    }
}

/// The result of waiting.
enum Waited<L> {
    Ran(Box<L>),
    /// A call lasts too long.
    Hung(Box<L>),
    /// `is_wanted` returned false during a call.
    Unwanted(Box<L>),
    Panicked,
}

impl<L: Lockstep> Worker<L> {
    fn start() -> Self {
        let (run, jobs) = mpsc::channel::<Box<L>>();
        let (tell, ran) = mpsc::channel();
        let slot = Arc::new(Slot { left: Mutex::new(None), calls: AtomicU64::new(0) });
        let inside = Arc::clone(&slot);
        let work = move || {
            for job in jobs {
                let Some(done) = inside.run(job) else { return };
                if tell.send(done).is_err() {
                    return;
                }
            }
        };
        let thread = thread::Builder::new().name("lockstep".to_owned()).spawn(work);
        Self { thread: thread.expect("a thread can be started"), run, ran, slot }
    }

    /// Waits until the run ends, or a call hangs.
    fn wait(&self, patience: Duration, wall: &Clock, is_wanted: &mut dyn FnMut() -> bool) -> Waited<L> {
        let mut seen = None;
        loop {
            match self.ran.recv_timeout(LOOK) {
                Ok(inner) => return Waited::Ran(inner),
                Err(mpsc::RecvTimeoutError::Disconnected) => return Waited::Panicked,
                Err(mpsc::RecvTimeoutError::Timeout) => {}
            }
            let (calls, now) = (self.slot.calls.load(Ordering::Acquire), wall());
            match seen {
                // Still the same call, if it is in one.
                Some((same, since)) if same == calls && now.since(since) > patience => {
                    if let Some(inner) = self.slot.left.lock().take() {
                        return Waited::Hung(inner);
                    }
                }
                Some((same, _)) if same == calls => {}
                _ => seen = Some((calls, now)),
            }
            if !is_wanted()
                && let Some(inner) = self.slot.left.lock().take()
            {
                return Waited::Unwanted(inner);
            }
        }
    }
}

impl<L: Lockstep> Slot<L> {
    /// Runs to the end; returns `None` if the inner value was taken from the slot during a call.
    fn run(&self, mut inner: Box<L>) -> Option<Box<L>> {
        loop {
            while let Some(call) = inner.next_call() {
                self.calls.fetch_add(1, Ordering::Release);
                *self.left.lock() = Some(inner);
                let returned = call.make();
                inner = self.left.lock().take()?;
                inner.returned(returned);
            }
            if !inner.go_on() {
                return Some(inner);
            }
        }
    }
}
