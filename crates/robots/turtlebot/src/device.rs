//! Runs a protocol on a port.

use std::{
    io::{self, ErrorKind, Read, Write},
    mem,
    sync::Arc,
    thread,
    time::Duration,
};

use cotorra_graph::Timestamp;
use parking_lot::{Condvar, Mutex};

use crate::port::{Port, PortError, PortSettings, Waiter};

/// Time without data after which a device counts as silent. A base sends every 20 ms, and a lidar more often.
pub const SILENCE: Duration = Duration::from_secs(1);
/// Longest time between two looks at the protocol's deadline, which calls from outside can bring forward.
const LISTEN: Duration = Duration::from_millis(20);
/// Bytes read in one go, so that a flood does not hold up calls.
const AT_ONCE: usize = 16 * 1024;
/// Intervals between attempts to open a port again: the first, and the longest.
const AGAIN: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));
/// Longest wait for a port that takes no bytes at the end.
const FAREWELL: Duration = Duration::from_millis(200);

/// Returns the time since some beginning.
pub type Clock = Arc<dyn Fn() -> Timestamp + Send + Sync>;

/// A protocol as a state machine. The time in calls never falls.
pub trait Session: Send + 'static {
    /// Begins on a port that was opened.
    fn connected(&mut self, now: Timestamp);

    /// Takes bytes that arrived.
    fn receive(&mut self, now: Timestamp, bytes: &[u8]);

    /// Returns the next bytes to send at `now`.
    fn poll_transmit(&mut self, now: Timestamp) -> Option<Vec<u8>>;

    /// Returns the time of the next bytes to send.
    fn next_deadline(&self, now: Timestamp) -> Option<Timestamp>;

    /// Returns the bytes that leave the device at rest.
    fn farewell(&mut self) -> Vec<u8>;
}

/// A port whose calls never block: they fail with [`ErrorKind::WouldBlock`] instead.
pub trait Transport: Read + Write + Send {}

impl<T: Read + Write + Send> Transport for T {}

/// A device at a port.
///
/// A thread reads the port, sends what is due, and opens the port again if the device vanishes. When the device is
/// dropped, or that thread panics, it is left at rest.
pub struct Device<S: Session> {
    shared: Arc<Shared<S>>,
    thread: Option<thread::JoinHandle<()>>,
}

struct Shared<S: Session> {
    state: Mutex<State<S>>,
    changed: Condvar,
}

struct State<S> {
    session: S,
    port: Option<Box<dyn Transport>>,
    /// Bytes that the port did not take yet. Nothing newer is encoded before they are gone.
    unsent: Vec<u8>,
    /// The latest time of any thread: time never falls.
    now: Timestamp,
    has_ended: bool,
}

impl<S: Session> State<S> {
    /// Reads and writes what there is. A port that fails is closed.
    fn go_on(&mut self, now: Timestamp) -> io::Result<()> {
        self.now = self.now.max(now);
        let done = self.read().and_then(|()| self.write());
        if done.is_err() {
            self.port = None;
            self.unsent.clear();
        }
        done
    }

    fn read(&mut self) -> io::Result<()> {
        let Some(port) = &mut self.port else { return Ok(()) };
        let (mut piece, mut taken) = ([0; 1024], 0);
        while taken < AT_ONCE {
            match port.read(&mut piece) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(read) => {
                    self.session.receive(self.now, &piece[..read]);
                    taken += read;
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn write(&mut self) -> io::Result<()> {
        let Some(port) = &mut self.port else { return Ok(()) };
        loop {
            if self.unsent.is_empty() {
                let Some(bytes) = self.session.poll_transmit(self.now) else { return Ok(()) };
                self.unsent = bytes;
            }
            match port.write(&self.unsent) {
                Ok(written) => {
                    self.unsent.drain(..written);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Sends the bytes that leave the device at rest, behind those of a frame that was begun. `wait` waits for the port.
    fn farewell(&mut self, mut wait: impl FnMut() -> bool) {
        let mut bytes = mem::take(&mut self.unsent);
        bytes.extend(self.session.farewell());
        let Some(mut port) = self.port.take() else { return };
        let mut rest = &bytes[..];
        while !rest.is_empty() {
            match port.write(rest) {
                Ok(written) => rest = &rest[written..],
                Err(error) if error.kind() == ErrorKind::WouldBlock && wait() => {}
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    }
}

impl<S: Session> Device<S> {
    /// Opens a port, and runs the protocol on it from a new thread of this name.
    ///
    /// # Errors
    /// [`PortError`] if the port cannot be opened, or the thread not be started.
    pub fn open(name: &str, settings: PortSettings, session: S, clock: Clock) -> Result<Self, PortError> {
        let (port, waiter) = Port::open(&settings)?;
        let mut device = Self::on(Box::new(port), session, clock());
        let shared = Arc::clone(&device.shared);
        let described = settings.clone();
        let run = move || run(&shared, waiter, &settings, &clock);
        let thread = thread::Builder::new().name(name.to_owned()).spawn(run);
        device.thread = Some(thread.map_err(|source| PortError::System { path: described.path, source })?);
        Ok(device)
    }

    /// Runs the protocol on a port without a thread: only calls with the time read and write it.
    pub fn on(port: Box<dyn Transport>, mut session: S, now: Timestamp) -> Self {
        session.connected(now);
        let state = State { session, port: Some(port), unsent: Vec::new(), now, has_ended: false };
        let shared = Shared { state: Mutex::new(state), changed: Condvar::new() };
        Self { shared: Arc::new(shared), thread: None }
    }

    /// Reads what has arrived by `now`, calls the protocol, and sends what is due.
    pub fn with<R>(&self, now: Timestamp, call: impl FnOnce(&mut S, Timestamp) -> R) -> R {
        let mut state = self.shared.state.lock();
        // The thread opens a port that failed again.
        let _ = state.go_on(now);
        let now = state.now;
        let result = call(&mut state.session, now);
        let _ = state.go_on(now);
        result
    }

    /// Looks at the protocol as it was after the last call or byte.
    pub fn peek<R>(&self, look: impl FnOnce(&S) -> R) -> R {
        look(&self.shared.state.lock().session)
    }

    /// Whether the port is open.
    pub fn is_connected(&self) -> bool {
        self.shared.state.lock().port.is_some()
    }
}

impl<S: Session> Drop for Device<S> {
    fn drop(&mut self) {
        self.shared.state.lock().has_ended = true;
        self.shared.changed.notify_all();
        match self.thread.take() {
            // A panic of the thread ends it, too, and left the device at rest.
            Some(thread) => drop(thread.join()),
            None => self.shared.state.lock().farewell(|| false),
        }
    }
}

/// Leaves a device at rest when its thread ends, also by a panic.
struct AtRest<'a, S: Session> {
    shared: &'a Shared<S>,
    waiter: Option<Waiter>,
}

impl<S: Session> Drop for AtRest<'_, S> {
    fn drop(&mut self) {
        let waiter = self.waiter.take();
        let wait = || waiter.as_ref().is_some_and(|waiter| waiter.wait(false, true, FAREWELL));
        self.shared.state.lock().farewell(wait);
    }
}

/// Runs the device's thread.
fn run<S: Session>(shared: &Shared<S>, waiter: Waiter, settings: &PortSettings, clock: &Clock) {
    let mut rest = AtRest { shared, waiter: Some(waiter) };
    loop {
        let mut state = shared.state.lock();
        if state.has_ended {
            return;
        }
        let done = state.go_on(clock());
        if let (Some(waiter), true) = (&rest.waiter, state.port.is_some()) {
            let (now, has_unsent) = (state.now, !state.unsent.is_empty());
            let due = state.session.next_deadline(now).map_or(LISTEN, |at| at.since(now).min(LISTEN));
            drop(state);
            waiter.wait(true, has_unsent, due);
            continue;
        }
        let path = settings.path.display();
        match done {
            Err(error) => tracing::warn!("{path} failed: {error}; opening it again"),
            Ok(()) => tracing::warn!("{path} failed; opening it again"),
        }
        drop(state);
        rest.waiter = None;
        let Some((port, waiter)) = again(shared, settings) else { return };
        tracing::info!("{path} is open again");
        rest.waiter = Some(waiter);
        let mut state = shared.state.lock();
        let now = state.now.max(clock());
        state.port = Some(Box::new(port));
        state.session.connected(now);
    }
}

/// Opens a port again, at growing intervals; `None` if the device is dropped before.
fn again<S: Session>(shared: &Shared<S>, settings: &PortSettings) -> Option<(Port, Waiter)> {
    let (mut pause, longest) = AGAIN;
    loop {
        let mut state = shared.state.lock();
        shared.changed.wait_while_for(&mut state, |state| !state.has_ended, pause);
        if state.has_ended {
            return None;
        }
        drop(state);
        if let Ok(opened) = Port::open(settings) {
            return Some(opened);
        }
        pause = (pause * 2).min(longest);
    }
}
