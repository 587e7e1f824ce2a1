//! The fabric's thread: waits for frames, commands and the fabric's next deadline, whichever comes first, and lets
//! the fabric say what leaves. It alone touches the fabric, so that nothing in it needs a lock.

use std::{
    io, mem,
    os::fd::AsFd,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    time::Duration,
};

use cotorra_fabric::{Fabric, Frame, PortId};
use cotorra_graph::{Stamped, Timestamp};
use parking_lot::Mutex;

use crate::{
    clock::Clock,
    error::Error,
    port::{self, Port, Sent},
    punctual::{self, BusyPoll, Punctuality},
    sys::{Epoll, Ready, Waker},
};

/// Frames that are read from a port before others get their turn.
const BATCH: usize = 64;
/// One in so many frames is measured as it is sent.
const MEASURED: u64 = 4;
/// What sending takes longer than this is another's doing.
const MOST_HANDOVER: Duration = Duration::from_micros(15);

/// What is done on the fabric's thread for someone else.
type Command = Box<dyn FnOnce(&mut Fabric, Timestamp) + Send>;

/// Gets the fabric's events; runs on the fabric's thread and must not block.
pub type EventSink = Box<dyn FnMut(Stamped) + Send>;

/// What the thread shares with those who hold a [`Handle`].
pub(crate) struct Shared {
    /// `None` once the thread ends.
    commands: Mutex<Option<Vec<Command>>>,
    waker: Waker,
    /// Set when the thread is to end: what is due is not sent any more, however much it is.
    stopping: AtomicBool,
    /// Frames that a port did not take, or could not give.
    dropped: AtomicU64,
}

impl Shared {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self {
            commands: Mutex::new(Some(Vec::new())),
            waker: Waker::new()?,
            stopping: AtomicBool::new(false),
            dropped: AtomicU64::new(0),
        })
    }

    /// Ends the thread after what it is about to do; commands that it has not begun are dropped.
    pub(crate) fn stop(&self) {
        *self.commands.lock() = None;
        self.stopping.store(true, Ordering::Relaxed);
        self.waker.wake();
    }

    fn count_drop(&self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
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
        self.0.commands.lock().as_mut().ok_or(Error::Stopped)?.push(Box::new(move |fabric, now| {
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

/// The thread's state.
pub(crate) struct Engine {
    fabric: Fabric,
    clock: Clock,
    ports: Ports,
    shared: Arc<Shared>,
    punctuality: Punctuality,
    /// Where ports put what exceeds an ordinary frame.
    spill: Box<[u8]>,
    events: Option<EventSink>,
}

/// The ports and what sending takes.
struct Ports {
    ports: Vec<Port>,
    /// Frames that left, whose buffers the fabric gets back.
    spent: Vec<Frame>,
    epoll: Epoll,
    shared: Arc<Shared>,
    clock: Clock,
    /// Frames sent so far, and how long it takes to send one: each is sent as much earlier than it is due.
    sent: u64,
    handover: Duration,
}

impl Ports {
    fn send(&mut self, PortId(index): PortId, frame: Frame) {
        if self.shared.stopping.load(Ordering::Relaxed) {
            return;
        }
        let port = &mut self.ports[index];
        self.sent += 1;
        let begin = self.sent.is_multiple_of(MEASURED).then(|| self.clock.now());
        let sent = port.send(frame, &mut self.spent);
        if let Some(begin) = begin {
            let took = self.clock.now().since(begin).min(MOST_HANDOVER);
            self.handover = (self.handover * 7 + took) / 8;
        }
        match sent {
            Sent::Now => {}
            Sent::Dropped => self.shared.count_drop(),
            // Fails for no open descriptor; the frame would wait for the next one to this port.
            Sent::Waits => drop(self.epoll.set_writable(port.as_fd(), index, true)),
        }
    }

    fn flush(&mut self, index: usize) {
        let port = &mut self.ports[index];
        if port.flush(&mut self.spent) {
            drop(self.epoll.set_writable(port.as_fd(), index, false));
        }
    }
}

impl Engine {
    pub(crate) fn new(
        fabric: Fabric,
        clock: Clock,
        ports: Vec<Port>,
        shared: Arc<Shared>,
        busy_poll: BusyPoll,
        events: Option<EventSink>,
    ) -> io::Result<Self> {
        let epoll = Epoll::new()?;
        for (index, port) in ports.iter().enumerate() {
            epoll.add(port.as_fd(), index)?;
        }
        epoll.add(shared.waker.as_fd(), ports.len())?;
        let ports = Ports {
            ports,
            spent: Vec::new(),
            epoll,
            shared: Arc::clone(&shared),
            clock,
            sent: 0,
            handover: Duration::ZERO,
        };
        Ok(Self {
            fabric,
            clock,
            ports,
            shared,
            punctuality: Punctuality::new(busy_poll),
            spill: vec![0; port::LARGEST].into(),
            events,
        })
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
        punctual::be_punctual();
        let mut ready: Vec<Ready> = Vec::new();
        let mut deadline = self.poll();
        loop {
            let before = self.clock.now();
            let timeout = deadline.map(|at| self.punctuality.sleep(before, at - self.ports.handover));
            ready.clear();
            ready.extend(self.ports.epoll.wait(timeout)?);
            let now = self.clock.now();
            self.punctuality.woke(now, ready.is_empty());
            // What is due goes first.
            if deadline.is_some_and(|at| at <= now + self.ports.handover) {
                deadline = self.poll();
            }
            let mut arrived = Some(self.punctuality.event_at(before, now));
            for event in &ready {
                if self.shared.stopping.load(Ordering::Relaxed) {
                    port::close(self.ports.ports);
                    return Ok(self.fabric);
                }
                if event.token == self.ports.ports.len() {
                    self.run_commands();
                } else {
                    if event.writable {
                        self.ports.flush(event.token);
                    }
                    if event.readable {
                        self.receive(event.token, arrived.take());
                    }
                }
                deadline = self.poll();
            }
        }
    }

    /// Lets the fabric deliver what is due, and says when it wants that again.
    fn poll(&mut self) -> Option<Timestamp> {
        let ports = &mut self.ports;
        let out = self.clock.now() + ports.handover;
        let deadline = self.fabric.poll(out, &mut |port, frame| ports.send(port, frame));
        for frame in ports.spent.drain(..) {
            self.fabric.recycle(frame);
        }
        if let Some(sink) = &mut self.events {
            while let Some(event) = self.fabric.next_event() {
                sink(event);
            }
        }
        deadline
    }

    /// Takes what came in at a port, the first frame at the time given, if that is known better than by reading it.
    fn receive(&mut self, index: usize, mut arrived: Option<Timestamp>) {
        let port = &mut self.ports.ports[index];
        for count in 0..port.batch {
            match port.receive(&mut self.fabric, &mut self.spill) {
                Ok(Some(frame)) if is_membership_report(frame.bytes()) => self.fabric.recycle(frame),
                Ok(Some(frame)) => {
                    let at = arrived.take().unwrap_or_else(|| self.clock.now());
                    self.fabric.push(at, PortId(index), frame);
                }
                Ok(None) => {
                    port.batch = count.max(1);
                    return;
                }
                Err(e) => {
                    self.shared.count_drop();
                    // A program in the node removed its interface: the descriptor would be ready for ever.
                    if e.raw_os_error() == Some(libc::EBADFD) {
                        drop(self.ports.epoll.remove(port.as_fd()));
                        return;
                    }
                }
            }
        }
        port.batch = (port.batch * 2).min(BATCH);
    }

    /// Does what others asked for.
    fn run_commands(&mut self) {
        self.shared.waker.clear();
        let commands = self.shared.commands.lock().as_mut().map(mem::take);
        for command in commands.unwrap_or_default() {
            command(&mut self.fabric, self.clock.now());
        }
    }
}

/// Whether a frame tells multicast routers of a group that its sender joined (IGMPv3, RFC 3376, 4.2.14; MLDv2,
/// RFC 3810, 5.2.14). A switch forwards such reports to multicast routers only (RFC 4541, 2.1.1), and there are none:
/// flooded, those of a thousand hosts that come up would be millions of packets.
fn is_membership_report(frame: &[u8]) -> bool {
    const IGMP_V3: [u8; 6] = [0x01, 0x00, 0x5e, 0x00, 0x00, 0x16];
    const MLD_V2: [u8; 6] = [0x33, 0x33, 0x00, 0x00, 0x00, 0x16];
    frame.starts_with(&IGMP_V3) || frame.starts_with(&MLD_V2)
}
