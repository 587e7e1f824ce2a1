//! Plug-ins in process where time stands still while they are called: in virtual time, and in a replay.
//!
//! A call needs no other thread, so that virtual time is fast; and yet a plug-in that hangs must not take with it what
//! called it. So what goes in lockstep with plug-ins ([`Lockstep`]) runs on a thread of [`Guarded`] and is left at a door
//! during each call. Who waits for that thread takes it from there if the call lasts too long, and goes on with it on
//! another thread; the thread that hangs finds nothing at the door any more.

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

/// Longest wait for a plug-in that says nothing, where time waits for plug-ins; after it the plug-in counts as hung.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// How often who waits for a call looks how long it has lasted.
const LOOK: Duration = Duration::from_millis(50);

/// What goes on only while no plug-in is called.
pub(crate) trait Lockstep: Send + 'static {
    /// How long a call may last.
    fn patience(&self) -> Duration;

    /// The next call that is due.
    fn next_call(&mut self) -> Option<Call>;

    /// What came of the call.
    fn returned(&mut self, returned: Returned);

    /// Goes on, now that all calls that were due were made; false when it is not to.
    fn go_on(&mut self) -> bool;

    /// Goes on for as long as it is to, making calls on this thread: a plug-in that hangs hangs its caller.
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

/// A call of a plug-in, which owns all that it needs.
pub(crate) struct Call {
    pub(crate) plugin: Box<dyn Plugin>,
    pub(crate) now: Timestamp,
    pub(crate) occasion: Occasion,
}

/// What a plug-in is called for.
pub(crate) enum Occasion {
    Start(Arc<Testbed>, Option<Arc<DomainView>>),
    Event(Arc<Stamped>),
    Deadline,
}

/// What came of a call.
pub(crate) type Returned = Result<Answer, Fault>;

/// A plug-in after a call.
pub(crate) struct Answer {
    pub(crate) plugin: Box<dyn Plugin>,
    /// What it wants done.
    pub(crate) actions: Actions,
    /// When it wants to be called next, by itself.
    pub(crate) next_deadline: Option<Timestamp>,
}

impl Call {
    /// Makes it; a panic stays with the plug-in.
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
            // Asked here, where it cannot do harm either.
            plugin.next_deadline()
        }));
        match called {
            Ok(next_deadline) => Ok(Answer { plugin: self.plugin, actions, next_deadline }),
            Err(panic) => Err(Fault::Panicked(panic_text(&*panic).to_owned())),
        }
    }
}

/// Plug-ins in process, in the order in which they are called.
#[derive(Default)]
pub(crate) struct Locals {
    all: Vec<Local>,
    /// Calls to make, by place.
    due: VecDeque<(usize, Occasion)>,
    /// Those from this place on are still to be asked whether their deadline has come.
    unasked: Option<usize>,
    /// The place of the one that is called now.
    called: usize,
}

struct Local {
    id: PluginId,
    /// `None` while it is called, and after it was cut off.
    plugin: Option<Box<dyn Plugin>>,
    /// What it sees, if that is one domain.
    view: Option<Arc<DomainView>>,
}

impl Locals {
    /// Adds a plug-in, which will be started.
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

    /// Whether there is none.
    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// When the next deadline comes. Asked anew each time: orchestrators share a ledger, so that a call of one may change
    /// another's.
    pub(crate) fn next_deadline(&self) -> Option<Timestamp> {
        self.all.iter().filter_map(|local| local.plugin.as_ref()?.next_deadline()).min()
    }

    /// It is a later time: those whose deadline has come will be called.
    pub(crate) fn wake(&mut self) {
        self.unasked = Some(0);
    }

    /// Something happened: those who see it will be called.
    pub(crate) fn publish(&mut self, event: &Arc<Stamped>) {
        for (place, local) in self.all.iter().enumerate() {
            if local.plugin.is_some()
                && let Some(seen) = domain::seen(local.view.as_deref(), event)
            {
                self.due.push_back((place, Occasion::Event(seen)));
            }
        }
    }

    /// The next call that is due.
    pub(crate) fn next_call(&mut self, now: Timestamp) -> Option<Call> {
        while let Some((place, occasion)) = self.due.pop_front() {
            if let Some(plugin) = self.all[place].plugin.take() {
                self.called = place;
                return Some(Call { plugin, now, occasion });
            }
        }
        while let Some(place) = self.unasked.take_if(|place| *place < self.all.len()) {
            self.unasked = Some(place + 1);
            let plugin = &mut self.all[place].plugin;
            let has_come = |plugin: &mut Box<dyn Plugin>| plugin.next_deadline().is_some_and(|at| at <= now);
            if let Some(plugin) = plugin.take_if(has_come) {
                self.called = place;
                return Some(Call { plugin, now, occasion: Occasion::Deadline });
            }
        }
        None
    }

    /// Takes the plug-in back that was called; gives what it wants, or why it is to be cut off.
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

/// What goes in lockstep with plug-ins, safe from those that hang.
pub(crate) struct Guarded<L> {
    /// `None` while it runs.
    inner: Option<Box<L>>,
    worker: Option<Worker<L>>,
    wall: Clock,
}

/// The thread that it runs on.
struct Worker<L> {
    thread: thread::JoinHandle<()>,
    run: mpsc::Sender<Box<L>>,
    ran: mpsc::Receiver<Box<L>>,
    door: Arc<Door<L>>,
}

/// Where what runs is left during a call.
struct Door<L> {
    left: Mutex<Option<Box<L>>>,
    /// How many calls were made.
    calls: AtomicU64,
}

impl<L: Lockstep> Guarded<L> {
    /// Calls last as long as the clock `wall` says.
    pub(crate) fn new(inner: L, wall: Clock) -> Self {
        Self { inner: Some(Box::new(inner)), worker: None, wall }
    }

    /// Goes on for as long as it is to. Asks `is_wanted` now and then while that takes long; gives false when that does.
    pub(crate) fn run(&mut self, is_wanted: &mut dyn FnMut() -> bool) -> bool {
        // Who once did not want it may not be asked again.
        let mut wanted = true;
        let mut ask = || {
            wanted = wanted && is_wanted();
            wanted
        };
        loop {
            let inner = self.inner.take().expect("it is here while nothing runs");
            let patience = inner.patience();
            let worker = self.worker.get_or_insert_with(Worker::start);
            // Should it be gone, that shows below.
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
        self.inner.as_ref().expect("it is here while nothing runs")
    }
}

impl<L> DerefMut for Guarded<L> {
    fn deref_mut(&mut self) -> &mut L {
        self.inner.as_mut().expect("it is here while nothing runs")
    }
}

/// How waiting ended.
enum Waited<L> {
    Ran(Box<L>),
    /// It is in a call that lasts too long.
    Hung(Box<L>),
    /// Nobody wants it to go on; it was in a call.
    Unwanted(Box<L>),
    Panicked,
}

impl<L: Lockstep> Worker<L> {
    fn start() -> Self {
        let (run, jobs) = mpsc::channel::<Box<L>>();
        let (tell, ran) = mpsc::channel();
        let door = Arc::new(Door { left: Mutex::new(None), calls: AtomicU64::new(0) });
        let inside = Arc::clone(&door);
        let work = move || {
            for job in jobs {
                let Some(done) = inside.run(job) else { return };
                if tell.send(done).is_err() {
                    return;
                }
            }
        };
        let thread = thread::Builder::new().name("lockstep".to_owned()).spawn(work);
        Self { thread: thread.expect("the system has room for a thread"), run, ran, door }
    }

    /// Waits until it ran, or is stuck.
    fn wait(&self, patience: Duration, wall: &Clock, is_wanted: &mut dyn FnMut() -> bool) -> Waited<L> {
        let mut seen = None;
        loop {
            match self.ran.recv_timeout(LOOK) {
                Ok(inner) => return Waited::Ran(inner),
                Err(mpsc::RecvTimeoutError::Disconnected) => return Waited::Panicked,
                Err(mpsc::RecvTimeoutError::Timeout) => {}
            }
            let (calls, now) = (self.door.calls.load(Ordering::Acquire), wall());
            match seen {
                // The very same call as then, if it is in one.
                Some((same, since)) if same == calls && now.since(since) > patience => {
                    if let Some(inner) = self.door.left.lock().take() {
                        return Waited::Hung(inner);
                    }
                }
                Some((same, _)) if same == calls => {}
                _ => seen = Some((calls, now)),
            }
            if !is_wanted()
                && let Some(inner) = self.door.left.lock().take()
            {
                return Waited::Unwanted(inner);
            }
        }
    }
}

impl<L: Lockstep> Door<L> {
    /// Runs it for as long as it is to; `None` if it was taken away in a call.
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
