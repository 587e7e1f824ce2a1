//! The second phase of a run: the emulated network carries packets.

use std::sync::{
    Arc,
    mpsc::{self, Receiver, Sender},
};

use cotorra_datapath::{Datapath, DepartureSink, EventSink, SharedSources};
use cotorra_fabric::{Departure, Fabric};
use cotorra_graph::Timestamp;
use parking_lot::Mutex;

use super::prepared::Prepared;
use crate::{
    clock::Clock,
    core::message::Message,
    error::RunError,
    real::{
        links::RealLinks,
        network::{RealNetwork, kernel_network},
    },
    traffic,
};

/// A run whose network is up. Fields are dropped in order: the latest made first.
pub(super) struct NetworkUp {
    /// Reads the datapath's clock.
    pub(super) now: Clock,
    pub(super) datapath: Arc<Datapath>,
    /// Sources of traffic, if there are any.
    pub(super) traffic: Option<SharedSources>,
    /// Whether only probes measure lateness, because the fabric carries no packets.
    pub(super) is_probed: bool,
    pub(super) inbox: Receiver<Message>,
    pub(super) messages: Sender<Message>,
    /// Packets for other cores, if there is a border.
    pub(super) departures: Option<Receiver<Departure>>,
}

/// Packets for other cores that wait to be sent. Further ones are lost, as with a full queue.
const DEPARTURES: usize = 4096;

impl NetworkUp {
    /// Starts the network's threads, and sets the conditions of interfaces of this machine. Returns the core's access
    /// to the network, too.
    pub(super) fn start(prepared: &Prepared) -> Result<(Self, RealNetwork), RunError> {
        let Prepared { testbed, options, seed, .. } = prepared;
        let (messages, inbox) = mpsc::channel();
        let from_network = messages.clone();
        let events: EventSink = Box::new(move |event| {
            // The core's thread may have ended already.
            let _ = from_network.send(Message::Network(event));
        });
        let mut fabric = Fabric::new(&testbed.graph, *seed)?;
        testbed.without_port_security.iter().for_each(|node| fabric.disable_port_security(node));
        let kernel = kernel_network(testbed, &fabric)?;
        if kernel.is_some() {
            traffic::reject_real(testbed, "the kernel carries all packets, as `emulation: netem` asks for")?;
        }
        if !options.interfaces.interfaces.is_empty() {
            traffic::reject_real(testbed, "links are at interfaces of this machine")?;
        }
        let sources = traffic::sources(testbed, &fabric, *seed).in_real_time();
        let traffic: Option<SharedSources> = (!sources.is_empty()).then(|| Arc::new(Mutex::new(sources)));
        if kernel.is_none()
            && let Some(probing) = testbed.probes
        {
            fabric.probe_links(Timestamp::ZERO, probing);
        }
        fabric.measure_flows(&testbed.services);
        // The last step that can be rejected; from here on the interfaces are put back at the end.
        let real = RealLinks::begin(&testbed.graph, &mut fabric, &options.interfaces, testbed.probes)?;
        let is_probed = kernel.is_some() || real.as_ref().is_some_and(RealLinks::are_alone);
        let (depart, departures) = mpsc::sync_channel(DEPARTURES);
        let departures = testbed.border.is_some().then_some(departures);
        let departure_sink: DepartureSink = Box::new(move |departure| drop(depart.try_send(departure)));
        let datapath_options = cotorra_datapath::Options {
            events: Some(events),
            departures: departures.is_some().then_some(departure_sink),
            let_cores_sleep: options.save_power,
            allowed_interfaces: options.interfaces.interfaces.clone(),
            kernel,
            traffic: traffic.clone(),
            ..Default::default()
        };
        let datapath = Arc::new(Datapath::start(&testbed.graph, fabric, datapath_options)?);
        let clock = datapath.clock();
        let now: Clock = Arc::new(move || clock.now());
        let real_network = RealNetwork::new(&datapath, real);
        Ok((Self { now, datapath, traffic, is_probed, inbox, messages, departures }, real_network))
    }
}
