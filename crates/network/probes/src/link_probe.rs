//! Probes of a link whose other end has a reflector, on a thread of its own.

use std::{
    collections::VecDeque,
    io,
    net::{IpAddr, SocketAddr},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use cotorra_graph::{Conditions, LinkId, Probed, Probing};
use cotorra_stamp::{Clock, LinkEstimate, PORT, Sender, Utc};
use parking_lot::{Mutex, MutexGuard};

use crate::pace::{FRAME_BYTES, estimate, on_wire};

/// Longest time to notice the end; also the longest age of measurements.
const NOTICE: Duration = Duration::from_millis(100);

/// The probes of a link over a real interface, by a reflector of STAMP. They end soon after this is dropped.
#[derive(Debug)]
pub struct LinkProbe(Arc<Shared>);

/// The state that the thread shares.
#[derive(Debug)]
struct Shared {
    clock: Clock,
    stopping: AtomicBool,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// Configured conditions of the way there and back, each with the time since which they apply. The latest is last.
    /// Older ones are kept as long as the session looks back.
    configured: VecDeque<(Utc, [Conditions; 2])>,
    /// Packets sent after this time only met the latest conditions.
    since: Utc,
    /// The last measurements, and their time.
    measured: Option<(Utc, [LinkEstimate; 2])>,
}

impl LinkProbe {
    /// Begins to probe a link with a reflector at this address. The conditions are those of the way there and back. Each
    /// round trip calls `on_late` with the time that it took longer than configured. Links with jitter or reordering do not,
    /// because their delay is random.
    ///
    /// # Errors
    /// The error of the system if there is no socket, thread, or route to the reflector.
    pub fn begin(
        link: LinkId,
        reflector: IpAddr,
        configured: [Conditions; 2],
        probing: Probing,
        on_late: impl Fn(Duration) + Send + 'static,
    ) -> io::Result<Self> {
        let mut config = on_wire(&probing, configured.each_ref());
        // Another process may probe the same reflector from the same address.
        config.identifier = std::process::id() as u16;
        let sender = Sender::connect(SocketAddr::new(reflector, PORT), config)?;
        let clock = sender.clock();
        let since = clock.now();
        let state = State { configured: [(since, configured)].into(), since, measured: None };
        let shared = Arc::new(Shared { clock, stopping: AtomicBool::new(false), state: Mutex::new(state) });
        let its = Arc::clone(&shared);
        let thread = thread::Builder::new().name("probes".into());
        thread.spawn(move || its.probe(sender, &link, probing, on_late))?;
        Ok(Self(shared))
    }

    /// Runs `change`, which changes the conditions of the way there (0) or back (1).
    ///
    /// # Errors
    /// That of `change`.
    pub fn change<E>(
        &self,
        way: usize,
        conditions: &Conditions,
        change: impl FnOnce() -> Result<(), E>,
    ) -> Result<(), E> {
        let began = self.0.clock.now();
        change()?;
        let mut state = self.0.lock();
        let now = self.0.clock.now();
        let mut configured = state.configured.back().expect("never empty").1.clone();
        // Packets sent before that time may have to wait for earlier ones, because order is kept.
        state.since = now + configured.iter().map(|before| before.delay).sum();
        // Packets sent during the change may have met either conditions.
        let before = std::mem::replace(&mut configured[way], conditions.clone());
        let mut meanwhile = configured.clone();
        meanwhile[way].delay = before.delay.min(conditions.delay);
        state.configured.extend([(began, meanwhile), (now, configured)]);
        Ok(())
    }

    /// Returns the measurements of the way there and back; `None` until there are some.
    pub fn probed(&self) -> Option<[Probed; 2]> {
        let (at, measured) = self.0.lock().measured?;
        let since = self.0.clock.now().since(at);
        Some(measured.map(|measured| {
            let delays = measured.delays.map(|(delays, age)| (delays, age + since));
            estimate(LinkEstimate { delays, loss: measured.loss, loss_age: measured.loss_age + since })
        }))
    }
}

impl Drop for LinkProbe {
    fn drop(&mut self) {
        self.0.stopping.store(true, Ordering::Relaxed);
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    fn probe(&self, mut sender: Sender, link: &LinkId, probing: Probing, on_late: impl Fn(Duration)) {
        let mut fails = false;
        while !self.stopping.load(Ordering::Relaxed) {
            let round_trip = match sender.step(NOTICE) {
                Ok(round_trip) => round_trip,
                // A packet that could not be sent counts as lost.
                Err(error) => {
                    if !std::mem::replace(&mut fails, true) {
                        tracing::warn!("`{link}` cannot be probed: {error}");
                    }
                    None
                }
            };
            fails &= round_trip.is_none();
            let now = self.clock.now();
            let mut state = self.lock();
            if let Some(took) = round_trip
                && now - took >= state.since
                && let Some(configured) = state.alone()
            {
                on_late(took.saturating_sub(configured));
            }
            let (_, configured) = state.configured.back().expect("never empty");
            let config = on_wire(&probing, configured.each_ref());
            sender.session_mut().pace(config);
            state.forget(now - config.window);
            if state.measured.is_none_or(|(at, _)| now.since(at) >= NOTICE) {
                state.measured =
                    sender.session().one_way(now, |at| state.least(at)).map(|measured| (now, measured));
            }
        }
    }
}

impl State {
    /// Returns the shortest delay of both ways for packets sent at that time.
    fn least(&self, at: Utc) -> [Duration; 2] {
        let until = self.configured.partition_point(|(since, _)| *since <= at);
        let (_, configured) = &self.configured[until.saturating_sub(1)];
        configured.each_ref().map(|way| way.alone(FRAME_BYTES).unwrap_or(way.delay))
    }

    /// Returns the configured delay of a round trip; `None` if it is random.
    fn alone(&self) -> Option<Duration> {
        let (_, [there, back]) = self.configured.back()?;
        Some(there.alone(FRAME_BYTES)? + back.alone(FRAME_BYTES)?)
    }

    /// Drops conditions that the session does not look back to.
    fn forget(&mut self, from: Utc) {
        while self.configured.get(1).is_some_and(|(since, _)| *since <= from) {
            self.configured.pop_front();
        }
    }
}
