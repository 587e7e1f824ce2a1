//! Measures links over this machine's interfaces by STAMP (RFC 8762), where a machine at the other end reflects probes. The
//! medium's own delay is measured before anything is emulated, so that scales never apply to emulated delay. During the run,
//! probes measure the links.

use std::{
    collections::HashMap,
    io,
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use cotorra_fabric::Histogram;
use cotorra_graph::{Conditions, HardwareGraph, Lateness, LinkId, Probed, Probing};
use cotorra_probes::LinkProbe;
use cotorra_stamp::{PORT, Sender, SessionConfig};
use parking_lot::Mutex;

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

/// Longest wait for an answer.
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
    links: HashMap<LinkId, LinkProbe>,
    /// By how much round trips took longer than configured.
    late: Arc<Mutex<Histogram>>,
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
        let late = Arc::<Mutex<Histogram>>::default();
        let begin = |(link, address, configured): (LinkId, IpAddr, _)| {
            let its = Arc::clone(&late);
            let on_late = move |by| its.lock().record(by);
            let probe = LinkProbe::begin(link.clone(), address, configured, probing, on_late);
            Ok((link.clone(), probe.map_err(|source| no_socket(&link, source))?))
        };
        let links = links.map(begin).collect::<Result<_, _>>()?;
        Ok(Self { links, late })
    }

    /// Runs `change`, which changes the conditions of the way there (0) or back (1) of a link.
    pub(crate) fn change<E>(
        &self,
        link: &LinkId,
        way: usize,
        conditions: &Conditions,
        change: impl FnOnce() -> Result<(), E>,
    ) -> Result<(), E> {
        match self.links.get(link) {
            Some(probe) => probe.change(way, conditions, change),
            None => change(),
        }
    }

    /// Returns the measurements of the way there and back of a link; `None` if it is not probed, or not yet.
    pub(crate) fn probed(&self, link: &LinkId) -> Option<[Probed; 2]> {
        self.links.get(link)?.probed()
    }

    /// Returns by how much round trips took longer than configured, of links and their media. Links with jitter or
    /// reordering are left out, because their delay is random.
    pub(crate) fn lateness(&self) -> Lateness {
        self.late.lock().summary()
    }
}
