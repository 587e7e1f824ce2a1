//! Measures links over real interfaces by STAMP (RFC 8762), where a machine at the other end reflects probes. The medium's
//! own delay is measured before anything is emulated, so that scales never apply to emulated delay. During the run, probes
//! measure the links.

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
    /// The reflector does not answer.
    #[error(
        "{address} answers no probes of STAMP at port 862, so the medium's delay of `{link}` cannot be measured: run \
         `cotorra stamp reflect` there, or leave out `reflector` and declare a `medium_delay`"
    )]
    NoReflector {
        link: LinkId,
        /// Address of the machine.
        address: IpAddr,
    },
    /// The reflector cannot be probed.
    #[error("cannot measure the medium's delay of `{link}`: {source}")]
    Socket {
        link: LinkId,
        /// The system's error.
        source: io::Error,
    },
}

/// Number of packets and interval between them: a second in all.
const PACKETS: u32 = 20;
const INTERVAL: Duration = Duration::from_millis(50);

/// Longest time to notice the end; also the longest age of measurements.
const NOTICE: Duration = Duration::from_millis(100);

/// Measures the media of all links over this machine's interfaces that have a reflector, and sets their delays in the graph.
///
/// # Errors
/// [`ReflectorError`].
pub(crate) fn measure_media(graph: &mut HardwareGraph) -> Result<(), ReflectorError> {
    let here = graph.real_links().filter(|real| real.reached.reflector && real.reached.via.is_none());
    let reflectors = here.filter_map(|real| {
        let address = real.reached.address?.address();
        Some((real.link.id.clone(), address))
    });
    for (link, address) in reflectors.collect::<Vec<_>>() {
        let delay = one_way(&link, address)?;
        tracing::info!(
            "the medium's delay of `{link}` is {:.3} ms, half of a round trip",
            delay.as_secs_f64() * 1e3
        );
        graph.links.iter_mut().filter(|l| l.id == link).for_each(|l| l.medium_delay = delay);
    }
    Ok(())
}

/// Returns half of the median round trip, without the time in the reflector. The two machines' clocks cannot separate the
/// directions.
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

/// The probes of real links during a run. They end when this is dropped.
pub(crate) struct LinkProbes {
    links: HashMap<LinkId, Arc<Shared>>,
    /// By how much round trips took longer than configured.
    late: Arc<Mutex<Histogram>>,
    threads: Vec<JoinHandle<()>>,
}

/// The state that a link's thread shares.
struct Shared {
    clock: Clock,
    stopping: AtomicBool,
    state: Mutex<State>,
}

struct State {
    /// Configured conditions of the way there and back, each with the time since which they apply. The latest is last.
    /// Older ones are kept as long as the session looks back.
    configured: VecDeque<(Utc, [Conditions; 2])>,
    /// Packets sent after this time only met the latest conditions.
    since: Utc,
    /// The last measurements, and their time.
    measured: Option<(Utc, [LinkEstimate; 2])>,
}

impl LinkProbes {
    /// Begins to probe links with reflectors at these addresses. The conditions are those of the way there and back.
    ///
    /// # Errors
    /// [`ReflectorError::Socket`].
    pub(crate) fn begin(
        links: impl Iterator<Item = (LinkId, IpAddr, [Conditions; 2])>,
        probing: Probing,
    ) -> Result<Self, ReflectorError> {
        let mut reflected = Self { links: HashMap::new(), late: Arc::default(), threads: Vec::new() };
        for (link, address, configured) in links {
            let mut config = WireProbes::session(&probing, configured.each_ref());
            // Another run may probe the same reflector from the same address.
            config.identifier = std::process::id() as u16;
            let sender = Sender::connect(SocketAddr::new(address, PORT), config);
            let sender = sender.map_err(|source| no_socket(&link, source))?;
            let clock = sender.clock();
            let since = clock.now();
            let state = State { configured: [(since, configured)].into(), since, measured: None };
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

    /// Runs `set`, which changes the conditions of the way there (0) or back (1) of a link.
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

    /// Returns the measurements of the way there and back of a link; `None` if it is not probed, or not yet.
    pub(crate) fn probed(&self, link: &LinkId) -> Option<[Probed; 2]> {
        let shared = self.links.get(link)?;
        let (at, measured) = shared.lock().measured?;
        let since = shared.clock.now().since(at);
        Some(measured.map(|measured| {
            let delays = measured.delays.map(|(delays, age)| (delays, age + since));
            WireProbes::estimate(LinkEstimate {
                delays,
                loss: measured.loss,
                loss_age: measured.loss_age + since,
            })
        }))
    }

    /// Returns by how much round trips took longer than configured, of links and their media. Links with jitter or
    /// reordering are left out, because their delay is random.
    pub(crate) fn lateness(&self) -> Lateness {
        self.late.lock().summary()
    }
}

impl Drop for LinkProbes {
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
                late.lock().record(took.saturating_sub(configured));
            }
            let (_, configured) = state.configured.back().expect("never empty");
            let config = WireProbes::session(&probing, configured.each_ref());
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
        configured.each_ref().map(|way| way.alone(WireProbes::BYTES).unwrap_or(way.delay))
    }

    /// Returns the configured delay of a round trip; `None` if it is random.
    fn alone(&self) -> Option<Duration> {
        let (_, [there, back]) = self.configured.back()?;
        Some(there.alone(WireProbes::BYTES)? + back.alone(WireProbes::BYTES)?)
    }

    /// Drops conditions that the session does not look back to.
    fn forget(&mut self, from: Utc) {
        while self.configured.get(1).is_some_and(|(since, _)| *since <= from) {
            self.configured.pop_front();
        }
    }
}
