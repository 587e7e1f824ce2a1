//! A run in real time: brings a testbed up on this machine with real packets, and takes it down again.
//!
//! [`Run::start`] goes through phases. Each has a type that holds what it made; dropping that undoes the phase.

mod containers;
mod engines;
mod launcher;
mod network;
mod nodes;
mod prepared;
mod services;
mod wifi;
mod wifi_plan;

use std::{
    collections::BTreeMap,
    net::{SocketAddr, UdpSocket},
    num::NonZero,
    path::Path,
    sync::{Arc, mpsc::Sender},
    thread,
    time::Duration,
};

use cotorra_datapath::{Datapath, SharedSources, StampedSocket};
use cotorra_fabric::Histogram;
use cotorra_graph::{Event, NodeId, Stamped, Testbed, Timestamp};
use cotorra_measurements::{History, Recorder, RecorderStats, RunId};
use cotorra_recording::Recording;
use parking_lot::Mutex;

use self::{
    network::NetworkUp,
    nodes::NodesUp,
    prepared::{Prepared, Unstarted},
    services::ServicesUp,
};
use crate::{
    api::{Dashboard, Server},
    core::{images::ImageSender, message::Message},
    error::{RunError, system},
    events::{fanout::Fanout, live::Live},
    finished::Finished,
    history::{bound::HistoryBound, keeping::Keeping, pruner::Pruner},
    options::Options,
    real::{
        core_loop::{CoreLoop, receive},
        cpus::unmet,
        leftovers::clean,
        robots::Masters,
    },
    report::{End, Losses, Report, RunFolder},
    traffic,
    wifi::Wifi,
};

/// Interval at which a robot's receiver checks whether the run goes on.
const RECEIVER_CHECK: Duration = Duration::from_secs(1);

/// Ends a run early, in order.
#[derive(Debug, Clone)]
pub struct Stopper(Sender<Message>);

impl Stopper {
    /// Ends the run. Does nothing if it has ended.
    pub fn stop(&self) {
        let _ = self.0.send(Message::Stop);
    }
}

/// A testbed that runs.
pub struct Run {
    testbed: Arc<Testbed>,
    live: Live,
    folder: RunFolder,
    history: Arc<History>,
    recorder: Recorder,
    run: RunId,
    messages: Sender<Message>,
    server: Server,
    core: Option<thread::JoinHandle<(Report, Timestamp, End)>>,
    _masters: Masters,
    _pruner: Option<Pruner>,
    /// Real Wi-Fi software. Before the datapath: it is stopped while packets still pass.
    wifi: Vec<Wifi>,
    datapath: Arc<Datapath>,
    traffic: Option<SharedSources>,
    /// Waits of datagrams in robots' sockets.
    receptions: Receptions,
    recording: Option<Recording>,
    keeping: Option<Keeping>,
    history_bound: HistoryBound,
}

/// Waits of datagrams in robots' sockets.
type Receptions = Arc<Mutex<Histogram>>;

impl Run {
    /// Brings a testbed up and starts the run. `text` is that of the testbed file.
    ///
    /// # Errors
    /// [`RunError`]. Nothing is left then but the run's folder. There is no folder if the testbed file, a plug-in's
    /// settings or ledger, or an interface of this machine are at fault.
    pub fn start(testbed: Testbed, text: &str, options: Options) -> Result<Self, RunError> {
        traffic::check_real(&testbed)?;
        if let Some(vnf) = testbed.vnfs().find(|vnf| vnf.policy_server().is_some()) {
            return Err(RunError::RealPolicyServer(vnf.id.clone()));
        }
        for kept in clean().kept {
            tracing::warn!("leftovers of a killed run stay: {kept}");
        }
        let (prepared, unstarted) = Prepared::new(testbed, text, options)?;
        let Unstarted { confined, listener, plugins, script } = unstarted;
        let (mut network, mut real_network) = NetworkUp::start(&prepared)?;
        let wifi = wifi::start(&prepared, &network)?;
        if let Some(wifi) = &wifi {
            real_network.add_wifi(wifi.handle());
        }
        let mut nodes = NodesUp::start(&prepared, &mut network, real_network, script, confined)?;
        let listener = listener.on_node(nodes.platform.take(), nodes.applications.clone());
        let services = ServicesUp::start(&prepared, &network, listener, plugins)?;
        Self::start_core(prepared, (network, wifi), nodes, services)
    }

    /// Starts the threads that receive for robots, and the core's.
    fn start_core(
        prepared: Prepared,
        (network, wifi): (NetworkUp, Option<Wifi>),
        nodes: NodesUp,
        services: ServicesUp,
    ) -> Result<Self, RunError> {
        let receptions = start_receivers(&nodes.sockets, &network)?;
        nodes.control.receive(&network.now, &network.messages)?;
        let Prepared { testbed, folder, history, run, recorder, recording, keeping, .. } = prepared;
        let NetworkUp { datapath, now, traffic, inbox, messages, is_probed, .. } = network;
        let NodesUp { mut core, masters, sockets, control, image_sockets, radios, .. } = nodes;
        let ServicesUp { live, stream, mut server, plugins } = services;
        let tap = recording.as_ref().map(Recording::tap);
        if tap.is_some() {
            core.tap_scans();
        }
        core.start(now());
        let have = thread::available_parallelism().map_or(1, NonZero::get);
        for message in unmet(&testbed, have) {
            tracing::warn!("{message}");
            core.observe(Stamped { at: now(), event: Event::Notice { message } });
        }
        let report = Report::new(&testbed, prepared.seed).on_disk(folder.path())?;
        let report = if is_probed { report.by_the_kernel() } else { report };
        let records = recorder.clone();
        let fanout = Fanout {
            api: Some((live.clone(), stream)),
            tap,
            keeper: keeping.as_ref().map(Keeping::keeper),
            history: Some(Box::new(move |event| records.record(event))),
        };
        let until = prepared.options.until.map(|until| Timestamp::ZERO + until);
        let images = (!image_sockets.is_empty()).then(|| ImageSender::start(image_sockets)).transpose();
        let images = images.map_err(system("start the thread that sends images"))?;
        let history_bound = HistoryBound::new(&prepared.options, &folder);
        let bound = history_bound.clone();
        let mut core_loop = CoreLoop {
            core,
            report,
            plugins,
            fanout,
            inbox,
            sockets,
            control,
            images,
            now,
            until,
            history: bound,
        };
        if let Some(previous) = &prepared.options.after {
            let notes = previous.notes_before(prepared.info.started_at_unix_ns);
            notes.for_each(|note| core_loop.publish_event(note));
        }
        core_loop.observe();
        server.open();
        let core = thread::Builder::new()
            .name("core".to_owned())
            .spawn(move || {
                // Robots have no commands while their core waits for the processor, and stop.
                cotorra_datapath::be_timely();
                core_loop.run()
            })
            .map_err(system("start the core's thread"))?;
        let pruner = Pruner::start(&testbed, &history, run, &live)
            .map_err(system("start the thread that keeps the history short"))?;
        Ok(Self {
            testbed,
            live,
            folder,
            history,
            recorder,
            run,
            messages,
            server,
            core: Some(core),
            _masters: masters,
            _pruner: pruner,
            wifi: wifi.into_iter().chain(radios).collect(),
            datapath,
            traffic,
            receptions,
            recording,
            keeping,
            history_bound,
        })
    }

    pub fn testbed(&self) -> &Testbed {
        &self.testbed
    }

    /// Returns the current state.
    pub fn live(&self) -> &Live {
        &self.live
    }

    /// Returns the absolute path of the run's folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Returns the API's address.
    pub fn api_address(&self) -> SocketAddr {
        self.dashboard().address()
    }

    /// Returns the dashboard.
    pub fn dashboard(&self) -> &Dashboard {
        self.server.dashboard()
    }

    /// Returns the address for Foxglove, if it is served.
    pub fn foxglove_address(&self) -> Option<SocketAddr> {
        self.recording.as_ref().and_then(Recording::foxglove)
    }

    /// Returns which radio units of real Wi-Fi software serve now and which robots have joined, in a line for people; `None`
    /// without such software.
    pub fn wifi(&self) -> Option<String> {
        let standing: Vec<_> = self.wifi.iter().map(Wifi::standing).collect();
        (!standing.is_empty()).then(|| standing.join("; "))
    }

    /// Returns a handle that ends the run early.
    pub fn stopper(&self) -> Stopper {
        Stopper(self.messages.clone())
    }

    /// Whether the run has ended. [`Run::finish`] then returns soon.
    pub fn is_finished(&self) -> bool {
        self.core.as_ref().is_none_or(thread::JoinHandle::is_finished)
    }

    /// Waits for the run's end, takes the testbed down, and writes the report.
    ///
    /// # Errors
    /// [`RunError::Panicked`].
    pub fn finish(mut self) -> Result<Finished, RunError> {
        let core = self.core.take().ok_or(RunError::Panicked)?;
        let (mut report, end, why) = core.join().map_err(|_| RunError::Panicked)?;
        self.wifi.clear();
        let recording = self.recording.take().map(Recording::finish);
        let mut unrecorded: Vec<_> = self.keeping.take().and_then(Keeping::finish).into_iter().collect();
        if why == End::HistoryFull {
            unrecorded.push(self.history_bound.what());
        }
        report.passed(self.datapath.gateways());
        report.forged(self.datapath.handle().with(|fabric, _| fabric.forged_sources()).unwrap_or_default());
        report.sent(self.datapath.handle().with(|fabric, _| fabric.airtimes()).unwrap_or_default());
        if let Some(traffic) = &self.traffic {
            report.carried(traffic.lock().measured(end));
        }
        report.received(self.receptions.lock().summary());
        report.stood_still(self.datapath.handle().port_waits().absence);
        let losses = Losses {
            frames_dropped: self.datapath.dropped_frames(),
            neighbour_overflows: self.datapath.neighbour_overflows(),
            history_dropped: self.recorder.stats().dropped,
        };
        let summary = report.summary(end, why.as_str(), losses);
        summary.last_words(end).for_each(|notice| self.recorder.record(notice));
        if let Err(error) = self.recorder.flush() {
            let RecorderStats { recorded, written, .. } = self.recorder.stats();
            let events = recorded - written;
            unrecorded.push(format!("the last {events} events are not in the history: {error}"));
        }
        if let Err(error) = self.folder.write_report(&report, &summary) {
            unrecorded.push(format!("the report is not complete: {error}"));
        }
        if let Err(error) = self.history.end_run(self.run, end) {
            unrecorded.push(format!("the history does not say that the run ended: {error}"));
        }
        unrecorded.iter().for_each(|what| tracing::error!("not recorded: {what}"));
        let folder = self.folder.path().to_owned();
        Ok(Finished { summary, report, folder, run: self.run, recording, unrecorded })
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        if let Some(core) = self.core.take() {
            let _ = self.messages.send(Message::Stop);
            let _ = core.join();
        }
    }
}

/// Starts a thread for each robot that passes its datagrams to the core. Returns how long these waited before, from then on.
fn start_receivers(
    sockets: &BTreeMap<NodeId, UdpSocket>,
    network: &NetworkUp,
) -> Result<Receptions, RunError> {
    let receptions = Receptions::default();
    for (robot, socket) in sockets {
        let socket = socket.try_clone().map_err(system("share a robot's socket"))?;
        socket.set_read_timeout(Some(RECEIVER_CHECK)).map_err(system("set a socket's timeout"))?;
        let socket =
            StampedSocket::new(socket).map_err(system("let the kernel stamp what robots receive"))?;
        let waits = Arc::clone(&receptions);
        let (robot, now, messages) = (robot.clone(), Arc::clone(&network.now), network.messages.clone());
        thread::Builder::new()
            .name(format!("robot-{robot}"))
            .spawn(move || {
                // Times of arrival are measured, and must not depend on other work of this machine.
                cotorra_datapath::be_punctual();
                receive(&robot, &socket, &now, &waits, &messages);
            })
            .map_err(system("start a robot's thread"))?;
    }
    Ok(receptions)
}
