//! Measures links over real interfaces by STAMP (RFC 8762), where a machine at the other end answers: what the medium takes
//! by itself, before anything is emulated there, so that no scale ever meets what emulation added; and for as long as the run
//! goes on what the link then does.

use std::{
    collections::{HashMap, VecDeque},
    io,
    net::{IpAddr, SocketAddr},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use cotorra_fabric::{Histogram, WireProbes};
use cotorra_graph::{Conditions, HardwareGraph, Lateness, LinkId, Probed, Probing};
use cotorra_stamp::{Clock, LinkEstimate, PORT, Sender, SessionConfig, Utc};
use parking_lot::{Mutex, MutexGuard};

/// Error of probing a reflector.
#[derive(Debug, thiserror::Error)]
pub enum ReflectorError {
    /// Nobody tells what the medium takes.
    #[error(
        "{address} answers no probes of STAMP at port 862, so what the medium of `{link}` takes cannot be measured: run \
         `cotorra stamp reflect` there, or leave out `reflector` and declare a `medium_delay`"
    )]
    NoReflector {
        /// The link.
        link: LinkId,
        /// The machine's address.
        address: IpAddr,
    },
    /// It cannot be asked.
    #[error("what the medium of `{link}` takes cannot be measured: {source}")]
    Socket {
        /// The link.
        link: LinkId,
        /// What the system says.
        source: io::Error,
    },
}

/// So many packets, so far apart: a second in all.
const PACKETS: u32 = 20;
const INTERVAL: Duration = Duration::from_millis(50);

/// How soon the end is noticed, and how old what is told may be.
const NOTICE: Duration = Duration::from_millis(100);

/// Measures the media of all real links that have a reflector, and notes them in the graph.
///
/// # Errors
/// [`ReflectorError`].
pub(crate) fn measure_media(graph: &mut HardwareGraph) -> Result<(), ReflectorError> {
    let reflectors = graph.real_links().filter(|real| real.reached.reflector).filter_map(|real| {
        let address = real.reached.address?.address();
        Some((real.link.id.clone(), address))
    });
    for (link, address) in reflectors.collect::<Vec<_>>() {
        let delay = one_way(&link, address)?;
        tracing::info!(
            "the medium of `{link}` takes {:.3} ms, half of a round trip",
            delay.as_secs_f64() * 1e3
        );
        graph.links.iter_mut().filter(|l| l.id == link).for_each(|l| l.medium_delay = delay);
    }
    Ok(())
}

/// Half of the median round trip, the reflector's rest left out: two machines' clocks do not tell one way from the other.
fn one_way(link: &LinkId, address: IpAddr) -> Result<Duration, ReflectorError> {
    let none = || ReflectorError::NoReflector { link: link.clone(), address };
    let measured = round_trip(address).map_err(|source| no_socket(link, source))?;
    Ok(measured.ok_or_else(none)? / 2)
}

fn no_socket(link: &LinkId, source: io::Error) -> ReflectorError {
    ReflectorError::Socket { link: link.clone(), source }
}

fn round_trip(address: IpAddr) -> io::Result<Option<Duration>> {
    let config = SessionConfig { interval: INTERVAL, ..SessionConfig::default() };
    let mut sender = Sender::connect(SocketAddr::new(address, PORT), config)?;
    while sender.session().deadline().is_some() {
        if sender.session().sent() == PACKETS {
            sender.session_mut().stop();
        }
        sender.step(NOTICE)?;
    }
    let measured = sender.session().measurement(sender.clock().now());
    Ok(measured.and_then(|measured| measured.round_trip).map(|delays| delays.p50))
}

/// The probes of real links while a run goes on. They end with this.
pub(crate) struct Reflected {
    links: HashMap<LinkId, Arc<Shared>>,
    /// By how much longer round trips took than both directions were asked to.
    late: Arc<Mutex<Histogram>>,
    threads: Vec<JoinHandle<()>>,
}

/// What a link's thread and the others see.
struct Shared {
    clock: Clock,
    stopping: AtomicBool,
    state: Mutex<State>,
}

struct State {
    /// What the way there and the way back are asked to do, each since a time on; the latest last, and as many before as the
    /// session looks back.
    asked: VecDeque<(Utc, [Conditions; 2])>,
    /// Packets that were sent since then met nothing but the latest.
    since: Utc,
    /// What the probes told, and when.
    told: Option<(Utc, [LinkEstimate; 2])>,
}

impl Reflected {
    /// Begins to probe links with reflectors at these addresses, whose ways there and back are asked to do this.
    ///
    /// # Errors
    /// [`ReflectorError::Socket`].
    pub(crate) fn begin(
        links: impl Iterator<Item = (LinkId, IpAddr, [Conditions; 2])>,
        probing: Probing,
    ) -> Result<Self, ReflectorError> {
        let mut reflected = Self { links: HashMap::new(), late: Arc::default(), threads: Vec::new() };
        for (link, address, asked) in links {
            let mut config = WireProbes::session(&probing, asked.each_ref());
            // Another run may ask the same reflector from the same address.
            config.identifier = std::process::id() as u16;
            let sender = Sender::connect(SocketAddr::new(address, PORT), config);
            let sender = sender.map_err(|source| no_socket(&link, source))?;
            let clock = sender.clock();
            let since = clock.now();
            let state = State { asked: [(since, asked)].into(), since, told: None };
            let shared =
                Arc::new(Shared { clock, stopping: AtomicBool::new(false), state: Mutex::new(state) });
            let (its, late, name) = (Arc::clone(&shared), Arc::clone(&reflected.late), link.clone());
            let thread = thread::Builder::new().name("probes".into());
            let thread = thread.spawn(move || its.probe(sender, &name, probing, &late));
            reflected.threads.push(thread.map_err(|source| no_socket(&link, source))?);
            reflected.links.insert(link, shared);
        }
        Ok(reflected)
    }

    /// Does what gives the way there (0) or back (1) of a link other conditions.
    pub(crate) fn change<E>(
        &self,
        link: &LinkId,
        way: usize,
        conditions: &Conditions,
        change: impl FnOnce() -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(shared) = self.links.get(link) else { return change() };
        let began = shared.clock.now();
        change()?;
        let mut state = shared.lock();
        let now = shared.clock.now();
        let mut asked = state.asked.back().expect("there is always one").1.clone();
        // What is sent sooner than that may have to wait for what was sent before, because order is kept.
        state.since = now + asked.iter().map(|before| before.delay).sum();
        // What was sent meanwhile met the one or the other.
        let before = std::mem::replace(&mut asked[way], conditions.clone());
        let mut meanwhile = asked.clone();
        meanwhile[way].delay = before.delay.min(conditions.delay);
        state.asked.extend([(began, meanwhile), (now, asked)]);
        Ok(())
    }

    /// What is known of the way there and the way back of a link; `None` if it is not probed, or not yet.
    pub(crate) fn probed(&self, link: &LinkId) -> Option<[Probed; 2]> {
        let shared = self.links.get(link)?;
        let (at, told) = shared.lock().told?;
        let since = shared.clock.now().since(at);
        Some(told.map(|told| {
            let delays = told.delays.map(|(delays, age)| (delays, age + since));
            WireProbes::told(LinkEstimate { delays, loss: told.loss, loss_age: told.loss_age + since })
        }))
    }

    /// By how much longer round trips took than links and their media were asked to, on those where no jitter and no
    /// reordering leaves that to chance.
    pub(crate) fn lateness(&self) -> Lateness {
        self.late.lock().summary()
    }
}

impl Drop for Reflected {
    fn drop(&mut self) {
        self.links.values().for_each(|shared| shared.stopping.store(true, Ordering::Relaxed));
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    fn probe(&self, mut sender: Sender, link: &LinkId, probing: Probing, late: &Mutex<Histogram>) {
        let mut fails = false;
        while !self.stopping.load(Ordering::Relaxed) {
            let round_trip = match sender.step(NOTICE) {
                Ok(round_trip) => round_trip,
                // A packet that was not sent is lost like any other.
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
                && let Some(asked) = state.alone()
            {
                late.lock().record(took.saturating_sub(asked));
            }
            let (_, asked) = state.asked.back().expect("there is always one");
            let config = WireProbes::session(&probing, asked.each_ref());
            sender.session_mut().pace(config);
            state.forget(now - config.window);
            if state.told.is_none_or(|(at, _)| now.since(at) >= NOTICE) {
                state.told = sender.session().apart(now, |at| state.least(at)).map(|told| (now, told));
            }
        }
    }
}

impl State {
    /// How long both ways take at least, for what was sent then.
    fn least(&self, at: Utc) -> [Duration; 2] {
        let until = self.asked.partition_point(|(since, _)| *since <= at);
        let (_, asked) = &self.asked[until.saturating_sub(1)];
        asked.each_ref().map(|way| way.alone(WireProbes::BYTES).unwrap_or(way.delay))
    }

    /// How long a round trip takes now; `None` where chance decides.
    fn alone(&self) -> Option<Duration> {
        let (_, [there, back]) = self.asked.back()?;
        Some(there.alone(WireProbes::BYTES)? + back.alone(WireProbes::BYTES)?)
    }

    /// Nobody looks back further than that.
    fn forget(&mut self, from: Utc) {
        while self.asked.get(1).is_some_and(|(since, _)| *since <= from) {
            self.asked.pop_front();
        }
    }
}
