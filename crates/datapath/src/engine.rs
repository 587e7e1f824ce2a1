//! The fabric's thread: waits for frames, commands and the fabric's next deadline, whichever comes first, and lets
//! the fabric say what leaves. It alone touches the fabric, so that nothing in it needs a lock.

use std::{
    io, mem,
    os::fd::AsFd,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use cotorra_fabric::{Fabric, PortId};
use cotorra_graph::{Stamped, Timestamp};

use crate::{
    clock::Clock,
    error::Error,
    port::{Buffers, Port, Sent},
    sys::{self, Epoll, Ready, Waker},
};

/// Frames that are read from a port before others get their turn.
const BATCH: usize = 64;
/// How long before a deadline the thread stops sleeping, where a core can be spared: about what a sleeping core
/// takes to wake.
const SPIN: Duration = Duration::from_micros(70);
/// Above everything that is not real-time, below what the kernel itself runs so.
const PRIORITY: i32 = 10;

/// What is done on the fabric's thread for someone else.
type Command = Box<dyn FnOnce(&mut Fabric, Timestamp) + Send>;

/// Gets the fabric's events; runs on the fabric's thread and must not block.
pub type EventSink = Box<dyn FnMut(Stamped) + Send>;

/// What the thread shares with those who hold a [`Handle`].
pub(crate) struct Shared {
    /// `None` once the thread ends.
    commands: Mutex<Option<Vec<Command>>>,
    waker: Waker,
    /// Frames that a port did not take, or could not give.
    dropped: AtomicU64,
}

impl Shared {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self { commands: Mutex::new(Some(Vec::new())), waker: Waker::new()?, dropped: AtomicU64::new(0) })
    }

    fn commands(&self) -> MutexGuard<'_, Option<Vec<Command>>> {
        self.commands.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the thread after what it is about to do; commands that it has not begun are dropped.
    pub(crate) fn stop(&self) {
        *self.commands() = None;
        self.waker.wake();
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

/// A way to the fabric from any thread.
#[derive(Clone)]
pub struct Handle(pub(crate) Arc<Shared>);

impl Handle {
    /// Runs a closure on the fabric's thread at once, and returns what it returns. `now` is the time at which it
    /// runs. It should take microseconds: packets wait meanwhile.
    ///
    /// # Errors
    /// [`Error::Stopped`] once the datapath has stopped.
    pub fn with<R: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, Error> {
        let (result, wait) = mpsc::sync_channel(1);
        self.0.commands().as_mut().ok_or(Error::Stopped)?.push(Box::new(move |fabric, now| {
            // Whoever asked is waiting below.
            let _ = result.send(work(fabric, now));
        }));
        self.0.waker.wake();
        wait.recv().map_err(|_| Error::Stopped)
    }
}

impl std::fmt::Debug for Handle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Handle").finish()
    }
}

/// Whether a core may spin without taking it from those whose packets it carries.
pub(crate) fn can_spare_a_core() -> bool {
    thread::available_parallelism().is_ok_and(|cores| cores.get() > 2)
}

/// The thread's state.
pub(crate) struct Engine {
    fabric: Fabric,
    clock: Clock,
    ports: Ports,
    shared: Arc<Shared>,
    spin: Duration,
    events: Option<EventSink>,
}

/// The ports and what sending takes.
struct Ports {
    ports: Vec<Port>,
    buffers: Buffers,
    epoll: Epoll,
    shared: Arc<Shared>,
}

impl Ports {
    fn send(&mut self, PortId(index): PortId, frame: cotorra_fabric::Frame) {
        let port = &mut self.ports[index];
        match port.send(frame, &mut self.buffers) {
            Sent::Now => {}
            Sent::Dropped => self.count_drop(),
            // Fails for no open descriptor; the frame would wait for the next one to this port.
            Sent::Waits => drop(self.epoll.set_writable(port.as_fd(), index, true)),
        }
    }

    fn flush(&mut self, index: usize) {
        let port = &mut self.ports[index];
        if port.flush(&mut self.buffers) {
            drop(self.epoll.set_writable(port.as_fd(), index, false));
        }
    }

    fn count_drop(&self) {
        self.shared.dropped.fetch_add(1, Ordering::Relaxed);
    }
}

impl Engine {
    pub(crate) fn new(
        fabric: Fabric,
        clock: Clock,
        ports: Vec<Port>,
        shared: Arc<Shared>,
        spin: bool,
        events: Option<EventSink>,
    ) -> io::Result<Self> {
        let epoll = Epoll::new()?;
        for (index, port) in ports.iter().enumerate() {
            epoll.add(port.as_fd(), index)?;
        }
        epoll.add(shared.waker.as_fd(), ports.len())?;
        let ports = Ports { ports, buffers: Buffers::new(), epoll, shared: Arc::clone(&shared) };
        Ok(Self { fabric, clock, ports, shared, spin: if spin { SPIN } else { Duration::ZERO }, events })
    }

    /// Runs until it is told to stop.
    pub(crate) fn run(mut self) -> io::Result<Fabric> {
        // Whatever ends this thread, nobody waits for it.
        struct Closing(Arc<Shared>);
        impl Drop for Closing {
            fn drop(&mut self) {
                self.0.stop();
            }
        }
        let _closing = Closing(Arc::clone(&self.shared));
        be_punctual();
        let mut ready: Vec<Ready> = Vec::new();
        let mut deadline = self.poll();
        loop {
            let timeout = self.sleep_until(deadline);
            ready.clear();
            ready.extend(self.ports.epoll.wait(timeout)?);
            deadline = self.poll();
            for event in &ready {
                if event.token == self.ports.ports.len() {
                    if !self.obey() {
                        return Ok(self.fabric);
                    }
                } else {
                    if event.writable {
                        self.ports.flush(event.token);
                    }
                    if event.readable {
                        self.receive(event.token);
                    }
                }
                deadline = self.poll();
            }
        }
    }

    /// How long the thread may sleep.
    fn sleep_until(&self, deadline: Option<Timestamp>) -> Option<Duration> {
        deadline.map(|deadline| deadline.since(self.clock.now()).saturating_sub(self.spin))
    }

    /// Lets the fabric deliver what is due, and says when it wants that again.
    fn poll(&mut self) -> Option<Timestamp> {
        let ports = &mut self.ports;
        let deadline = self.fabric.poll(self.clock.now(), &mut |port, frame| ports.send(port, frame));
        if let Some(sink) = &mut self.events {
            while let Some(event) = self.fabric.next_event() {
                sink(event);
            }
        }
        deadline
    }

    fn receive(&mut self, index: usize) {
        for _ in 0..BATCH {
            match self.ports.ports[index].receive(&mut self.ports.buffers) {
                Ok(Some(frame)) => self.fabric.push(self.clock.now(), PortId(index), frame),
                Ok(None) => return,
                Err(e) => {
                    self.ports.count_drop();
                    // A program in the node removed its interface: the descriptor would be ready for ever.
                    if e.raw_os_error() == Some(libc::EBADFD) {
                        drop(self.ports.epoll.remove(self.ports.ports[index].as_fd()));
                        return;
                    }
                }
            }
        }
    }

    /// Does what others asked for; `false` when the thread is to end.
    fn obey(&mut self) -> bool {
        self.shared.waker.clear();
        let Some(commands) = self.shared.commands().as_mut().map(mem::take) else { return false };
        for command in commands {
            command(&mut self.fabric, self.clock.now());
        }
        true
    }
}

/// Asks the kernel to run this thread as soon as it wakes, and to wake it on time.
fn be_punctual() {
    // Each of these may be forbidden; the run report's lateness shows what it cost, and `doctor` what to do.
    if sys::set_least_timer_slack().is_err() {
        tracing::debug!("timers keep their slack");
    }
    if sys::set_fifo(PRIORITY).is_err() && sys::set_short_slice().is_err() {
        tracing::debug!("the fabric's thread is scheduled like any other");
    }
}
