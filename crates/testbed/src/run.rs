//! A run: a testbed brought up on this machine with real packets, kept going, and taken down again.

use std::{
    collections::BTreeMap,
    io,
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    path::{Path, PathBuf},
    process::{ChildStdout, Command, ExitStatus},
    sync::{
        Arc,
        mpsc::{self, Sender},
    },
    thread,
    time::Duration,
};

use cotorra_datapath::{Child, Datapath, SpawnOptions};
use cotorra_fabric::Fabric;
use cotorra_graph::{IpNetwork, Node, NodeId, Program, Testbed, Timestamp, Vnf, VnfId};
use cotorra_measurements::{History, Location, Recorder, RecorderStats, RunId, RunInfo};
use cotorra_netem::Confirmed;
use cotorra_network_control::{
    program_of_others,
    vim::{Cgroups, Launcher, Process, ProcessEngine},
};
use cotorra_plugin::{runs::Runs, wire};
use cotorra_recording::{About, Pace, Recording, RecordingError, RecordingSummary, Wanted};
use cotorra_robot_middleware::{Nonces, SimulatedRobot};
use cotorra_testbed_file::Setting;
use cotorra_wais::types::Epoch;
use tokio::sync::broadcast;

use crate::{
    api::{self, ApiError, Listener, Server, Tokens},
    bundled,
    confined::Confined,
    core::Core,
    core_loop::{CoreLoop, EventSinks, Message, receive},
    images::{self, ImageSender},
    keeping::Keeping,
    live::Live,
    plugins::{Now, PluginError, running::Prepared},
    previous_run::PreviousRun,
    real_links::{RealLinkError, RealLinks, interface_plans},
    real_network::{RealNetwork, kernel_network},
    recorded::Recorded,
    reflected::measure_media,
    report::{End, FolderError, Losses, Place, Report, RunFolder, Summary},
    retaining::Retaining,
    robots::{Masters, RobotError, Robots},
    script::{Script, ScriptError},
};

/// Where the API listens unless it is told.
const DEFAULT_API: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 7700);
/// Events that wait for a reader of the stream; one that is further behind misses the oldest.
const STREAM: usize = 4096;
/// A robot's receiver looks this often whether it is still wanted.
const LOOK: Duration = Duration::from_secs(1);

/// How a run is to go.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// In place of the testbed file's seed.
    pub seed: Option<u64>,
    /// End after so long, walks finished or not.
    pub until: Option<Duration>,
    /// Where the run's folder is made.
    pub folder: Place,
    /// Where the API listens; by default on 127.0.0.1:7700, or the next free port if that is taken.
    pub api: Option<SocketAddr>,
    /// Where tools of this user find the run; `None` where they need not.
    pub runs: Option<Runs>,
    /// What callers of the API must show: the operator, and orchestrators of domains.
    pub tokens: Tokens,
    /// Lets cores sleep that have nothing to do; packets then wait for them to wake, and come later.
    pub save_power: bool,
    /// With which the testbed file was read.
    pub settings: Vec<Setting>,
    /// Networks that the WLAN Access Information Service may send notifications to, beside those of the testbed file.
    pub wais_callbacks: Vec<IpNetwork>,
    /// Where the history is kept, in place of `history.sqlite` in the run's folder.
    pub history: Option<Location>,
    /// What is meant, though it may do harm, of what testbed files ask of interfaces of this machine.
    pub interfaces: Confirmed,
    /// How the run is recorded and watched besides.
    pub recording: Wanted,
    /// What a run noted that this one goes on after, in real time.
    pub after: Option<PreviousRun>,
}

/// What a run came to.
#[derive(Debug)]
pub struct Finished {
    /// Its summary, as in `summary.json`.
    pub summary: Summary,
    /// What the summary is of.
    pub report: Report,
    /// The run's folder; absolute.
    pub folder: PathBuf,
    /// The run's number in its history.
    pub run: RunId,
    /// What the recording came to, if it was recorded or watched.
    pub recording: Option<RecordingSummary>,
    /// What could not be written, as on a full disk, and why.
    pub unrecorded: Vec<String>,
}

impl Finished {
    /// Whether somebody ended it before its time.
    pub fn was_stopped(&self) -> bool {
        self.summary.ended == End::Stopped.as_str()
    }
}

/// Why a testbed cannot be brought up, or its run not be finished.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A file of the run's folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The history.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    /// The emulated network's model.
    #[error(transparent)]
    Fabric(#[from] cotorra_fabric::GraphError),
    /// The emulated network's packets.
    #[error(transparent)]
    Datapath(#[from] cotorra_datapath::Error),
    /// The recording, or who watches.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The API.
    #[error(transparent)]
    Api(#[from] ApiError),
    /// A plug-in.
    #[error(transparent)]
    Plugin(#[from] PluginError),
    /// A link over an interface of this machine.
    #[error(transparent)]
    RealLink(#[from] RealLinkError),
    /// A robot.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The map on which a robot is to be localized.
    #[error(transparent)]
    NotLocalized(#[from] cotorra_robot_middleware::NotLocalized),
    /// What is scripted for links.
    #[error(transparent)]
    Script(Box<ScriptError>),
    /// A socket or a thread.
    #[error("cannot {what}: {source}")]
    System {
        /// What was to be done.
        what: String,
        /// What the system says.
        source: io::Error,
    },
    /// Virtual time would never end.
    #[error("the testbed has no walk that would end the run: say how long it is to be, as in `--until 60s`")]
    Endless,
    /// The core's thread panicked, which is a bug.
    #[error("the run broke off; please report this as a bug, with the run's folder")]
    Panicked,
}

impl From<ScriptError> for RunError {
    fn from(error: ScriptError) -> Self {
        Self::Script(Box::new(error))
    }
}

/// Probes the links of a testbed's fabric, if it wants that.
pub(crate) fn probe_links(fabric: &mut Fabric, testbed: &Testbed) {
    if let Some(probes) = testbed.probes {
        fabric.probe_links(Timestamp::ZERO, probes);
    }
}

pub(crate) fn system(what: impl Into<String>) -> impl FnOnce(io::Error) -> RunError {
    let what = what.into();
    move |source| RunError::System { what, source }
}

/// Ends a run early, in order.
#[derive(Debug, Clone)]
pub struct Stopper(Sender<Message>);

impl Stopper {
    /// The run is to end; does nothing if it has.
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
    tell: Sender<Message>,
    server: Server,
    core: Option<thread::JoinHandle<(Report, Timestamp, End)>>,
    _masters: Masters,
    _retaining: Option<Retaining>,
    datapath: Arc<Datapath>,
    recording: Option<Recording>,
    keeping: Option<Keeping>,
}

impl Run {
    /// Brings a testbed up and sets it going. `text` is the testbed file, found at `file`.
    ///
    /// # Errors
    /// [`RunError`]; then nothing is left but the run's folder, and not even that where the testbed file, a plug-in's settings or
    /// ledger, or an interface of this machine are at fault.
    pub fn start(testbed: Testbed, text: &str, file: &Path, options: Options) -> Result<Self, RunError> {
        for kept in clean().kept {
            tracing::warn!("what a killed run left stays: {kept}");
        }
        let mut testbed = testbed;
        interface_plans(&testbed, &options.interfaces)?;
        measure_media(&mut testbed.graph)?;
        let testbed = Arc::new(testbed);
        let seed = options.seed.unwrap_or(testbed.seed);
        let (script, _) = Script::load(&testbed)?;
        let moved = options.api.is_none();
        let mut plugins = Prepared::of(&testbed, seed)?;
        if let Some(earlier) = &options.after {
            plugins.resume(earlier);
        }
        let listener = Listener::bind(options.api.unwrap_or(DEFAULT_API), moved, &options.tokens)?;
        let folder = RunFolder::create(&options.folder, &testbed.name, text)?;
        let info = run_info(&testbed, seed, text);
        let testbed_file = absolute(file)?;
        let confined = Confined::new(&testbed, &testbed_file, &options, &folder)
            .map_err(system("show VNFs the testbed file's folder"))?;
        let recording =
            Recording::begin(&options.recording, folder.path(), &testbed, about(&info), Pace::Live)?;
        let keeping = Keeping::begin(&testbed, folder.path(), Pace::Live)
            .map_err(system("start the thread that keeps large data"))?;
        let keeper = keeping.as_ref().map(Keeping::keeper);
        let (history, run) = Recorded::begin(&folder, options.history.as_ref(), &info)?;
        let history = Arc::new(history);
        let recorder = history.recorder(run)?;

        let (tell, inbox) = mpsc::channel();
        let from_network = tell.clone();
        let events: cotorra_datapath::EventSink = Box::new(move |event| {
            // The core's thread may have ended already.
            let _ = from_network.send(Message::Network(event));
        });
        let let_cores_sleep = options.save_power;
        let mut fabric = Fabric::new(&testbed.graph, seed)?;
        let kernel = kernel_network(&testbed, &fabric)?;
        if kernel.is_none() {
            probe_links(&mut fabric, &testbed);
        }
        fabric.measure_flows(&testbed.services);
        // Last of what can be refused; from here on the interfaces are put back at the end.
        let real = RealLinks::begin(&testbed.graph, &mut fabric, &options.interfaces, testbed.probes)?;
        let probes_tell = kernel.is_some() || real.as_ref().is_some_and(RealLinks::are_alone);
        let with_events =
            cotorra_datapath::Options { events: Some(events), let_cores_sleep, kernel, ..Default::default() };
        let datapath = Arc::new(Datapath::start(&testbed.graph, fabric, with_events)?);
        let clock = datapath.clock();
        let now: Now = Arc::new(move || clock.now());

        let live = Live::default();
        let (stream, _) = broadcast::channel(STREAM);

        let sockets = open_sockets(&testbed, &datapath, testbed.graph.robots().map(|(node, _)| &node.id))?;
        // Apart from these: images that wait to be sent hold up nothing else.
        let image_sockets = open_sockets(&testbed, &datapath, images::senders(&testbed))?;
        let launcher = NodeLauncher {
            testbed: Arc::clone(&testbed),
            datapath: Arc::clone(&datapath),
            testbed_file,
            confined,
            settings: options.settings.iter().map(|setting| format!("{setting}\n")).collect(),
            robots: robots_by_vnf(&testbed),
            tell: tell.clone(),
        };
        let cgroups = Cgroups::new().inspect_err(|e| tracing::info!("VNFs run without limits: {e}")).ok();
        let engine = ProcessEngine::new(Arc::new(launcher), folder.logs(), cgroups);
        let network = RealNetwork::new(&datapath, real);
        let mut robots = Robots::new(Arc::clone(&testbed), Arc::clone(&datapath), now.clone());
        let drive = |node: &Node, robot: SimulatedRobot| robots.drive(node, robot);
        let mut core =
            Core::new(Arc::clone(&testbed), seed, Nonces::unpredictable(), network, engine, script, drive)?;

        let namespaces = testbed
            .graph
            .hosts()
            .filter_map(|node| Some((node.id.clone(), datapath.namespace(&node.id).ok()?.path())));
        let context = api::Context {
            testbed: Arc::clone(&testbed),
            live: live.clone(),
            history: Arc::clone(&history),
            run,
            events: stream.clone(),
            core: tell.clone(),
            namespaces: Arc::new(namespaces.collect()),
            hosted: Arc::new(testbed.plugins.iter().map(|spec| spec.id.clone()).collect()),
            lockstep: None,
            replay: false,
            keeper: keeper.clone(),
            wais: api::WaisOptions {
                clock: Some(Arc::clone(&now)),
                epoch: epoch(&info),
                callbacks: options.wais_callbacks.clone(),
            },
        };
        let listener = listener.announced(options.runs.as_ref(), &folder.path().to_string_lossy());
        let server = Server::start(listener, context, options.tokens)?;
        let plugins = plugins.start(&testbed, &now, &server, &folder.logs(), &tell)?;

        for (robot, socket) in &sockets {
            let socket = socket.try_clone().map_err(system("share a robot's socket"))?;
            socket.set_read_timeout(Some(LOOK)).map_err(system("set a socket's timeout"))?;
            let (robot, now, tell) = (robot.clone(), Arc::clone(&now), tell.clone());
            thread::Builder::new()
                .name(format!("robot-{robot}"))
                .spawn(move || {
                    // When an answer arrives is measured, and must not depend on what else this machine does.
                    cotorra_datapath::be_punctual();
                    receive(&robot, &socket, &now, &tell);
                })
                .map_err(system("start a robot's thread"))?;
        }
        let tap = recording.as_ref().map(Recording::tap);
        if tap.is_some() {
            core.tap_scans();
        }
        core.start(now());
        let report = Report::new(&testbed, seed).on_disk(folder.path())?;
        let report = if probes_tell { report.by_the_kernel() } else { report };
        let mut sinks = EventSinks {
            live: live.clone(),
            recorder: recorder.clone(),
            report,
            stream,
            plugins,
            tap,
            keeper,
        };
        if let Some(earlier) = &options.after {
            earlier.notes_before(info.started_at_unix_ns).for_each(|note| sinks.publish(note));
        }
        let until = options.until.map(|until| Timestamp::ZERO + until);
        let images = (!image_sockets.is_empty()).then(|| ImageSender::start(image_sockets)).transpose();
        let images = images.map_err(system("start the thread that sends images"))?;
        let core_loop = CoreLoop { core, sinks, inbox, sockets, images, now, until };
        let core = thread::Builder::new()
            .name("core".to_owned())
            .spawn(move || {
                // A robot whose core has to wait for the processor has no commands meanwhile, and stops.
                cotorra_datapath::be_timely();
                core_loop.run()
            })
            .map_err(system("start the core's thread"))?;
        let (core, _masters) = (Some(core), robots.masters());
        let _retaining = Retaining::start(&testbed, &history, run, &live)
            .map_err(system("start the thread that keeps the history short"))?;
        Ok(Self {
            testbed,
            live,
            folder,
            history,
            recorder,
            run,
            tell,
            server,
            core,
            _masters,
            _retaining,
            datapath,
            recording,
            keeping,
        })
    }

    /// The testbed.
    pub fn testbed(&self) -> &Testbed {
        &self.testbed
    }

    /// What is known right now.
    pub fn live(&self) -> &Live {
        &self.live
    }

    /// The run's folder; absolute.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Where the API listens.
    pub fn api_address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Where it serves Foxglove, if it does.
    pub fn foxglove_address(&self) -> Option<SocketAddr> {
        self.recording.as_ref().and_then(Recording::foxglove)
    }

    /// What ends the run early.
    pub fn stopper(&self) -> Stopper {
        Stopper(self.tell.clone())
    }

    /// Whether it has come to its end; [`Run::finish`] then returns soon.
    pub fn is_finished(&self) -> bool {
        self.core.as_ref().is_none_or(thread::JoinHandle::is_finished)
    }

    /// Waits for the run's end, takes everything down, and writes the report.
    ///
    /// # Errors
    /// [`RunError::Panicked`].
    pub fn finish(mut self) -> Result<Finished, RunError> {
        let core = self.core.take().ok_or(RunError::Panicked)?;
        let (report, end, why) = core.join().map_err(|_| RunError::Panicked)?;
        let recording = self.recording.take().map(Recording::finish);
        let mut unrecorded: Vec<_> = self.keeping.take().and_then(Keeping::finish).into_iter().collect();
        if let Err(error) = self.recorder.flush() {
            let RecorderStats { recorded, written, .. } = self.recorder.stats();
            let events = recorded - written;
            unrecorded.push(format!("the last {events} events are not in the history: {error}"));
        }
        let losses = Losses {
            frames_dropped: self.datapath.dropped_frames(),
            history_dropped: self.recorder.stats().dropped,
        };
        let summary = report.summary(end, why.as_str(), losses);
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
            let _ = self.tell.send(Message::Stop);
            let _ = core.join();
        }
    }
}

/// What runs left behind whose process was killed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Leftovers {
    /// Control groups.
    pub control_groups: Vec<PathBuf>,
    /// Interfaces of this machine that still had conditions, by name.
    pub interfaces: Vec<String>,
    /// What could not be removed, and why.
    pub kept: Vec<String>,
}

/// What [`clean`] would remove.
pub fn leftovers() -> Leftovers {
    let interfaces = cotorra_netem::leftovers().into_iter().map(|interface| interface.name).collect();
    Leftovers { control_groups: Cgroups::leftovers(), interfaces, kept: Vec::new() }
}

/// Removes what runs left behind whose process was killed; gives what it removed.
pub fn clean() -> Leftovers {
    let (control_groups, kept) = Cgroups::clean();
    let kept = kept.iter().map(ToString::to_string).collect();
    let mut cleaned = Leftovers { control_groups, kept, ..Leftovers::default() };
    for (interface, done) in cotorra_netem::put_back() {
        match done {
            Ok(()) => cleaned.interfaces.push(interface.name),
            Err(error) => cleaned.kept.push(format!("{} cannot be put back: {error}", interface.name)),
        }
    }
    cleaned
}

#[allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "the calendar is read once, when a run begins"
)]
fn run_info(testbed: &Testbed, seed: u64, text: &str) -> RunInfo {
    let since_1970 = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
    RunInfo {
        name: testbed.name.clone(),
        seed,
        started_at_unix_ns: i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX),
        testbed: text.to_owned(),
    }
}

/// What a recording says of its run.
pub fn about(info: &RunInfo) -> About<'_> {
    let RunInfo { name, seed, started_at_unix_ns, testbed } = info;
    About { name, seed: *seed, started_at_unix_ns: *started_at_unix_ns, testbed_file: testbed }
}

/// When a run began, on the calendar.
pub(crate) fn epoch(info: &RunInfo) -> Epoch {
    Epoch { unix_ns: u64::try_from(info.started_at_unix_ns).unwrap_or_default() }
}

fn absolute(file: &Path) -> Result<PathBuf, RunError> {
    file.canonicalize().map_err(system(format!("find {}", file.display())))
}

/// Opens a socket in each of these robots.
fn open_sockets<'a>(
    testbed: &Testbed,
    datapath: &Datapath,
    robots: impl IntoIterator<Item = &'a NodeId>,
) -> Result<BTreeMap<NodeId, UdpSocket>, RunError> {
    let open = |id: &NodeId| {
        let address = testbed.graph.address(id).expect("a robot is a host");
        let namespace = datapath.namespace(id)?;
        namespace.udp_socket((address.ipv4, 0)).map_err(system(format!("open the socket of `{id}`")))
    };
    robots.into_iter().map(|robot| Ok((robot.clone(), open(robot)?))).collect()
}

fn robots_by_vnf(testbed: &Testbed) -> BTreeMap<VnfId, NodeId> {
    let of_service = |service: &cotorra_graph::Service| {
        let robot = service.robot.clone();
        service.vnfs.iter().map(move |vnf| (vnf.id.clone(), robot.clone())).collect::<Vec<_>>()
    };
    testbed.services.iter().flat_map(of_service).collect()
}

/// Starts VNFs in the nodes of a datapath.
struct NodeLauncher {
    testbed: Arc<Testbed>,
    datapath: Arc<Datapath>,
    testbed_file: PathBuf,
    confined: Confined,
    /// One a line.
    settings: String,
    robots: BTreeMap<VnfId, NodeId>,
    tell: Sender<Message>,
}

impl Launcher for NodeLauncher {
    fn launch(
        &self,
        vnf: &Vnf,
        replica: u32,
        node: &NodeId,
        mut command: Command,
        cgroups: Vec<PathBuf>,
    ) -> io::Result<Box<dyn Process>> {
        command.envs(self.testbed.graph.ros1_environment(node));
        if matches!(vnf.program, Program::Command(_)) {
            command.current_dir(self.confined.folder());
            // Where images come to.
            command.envs(wire::port(&self.testbed, &vnf.id).map(|port| (bundled::PORT, port.to_string())));
        }
        let confinement = self.confined.of(vnf, replica)?;
        let options = SpawnOptions { cgroups, confinement: confinement.as_ref(), ..SpawnOptions::default() };
        let child = self.datapath.spawn(node, command, options).map_err(io::Error::other)?;
        Ok(Box::new(NodeProcess(child)))
    }

    fn bundled(&self, vnf: &Vnf, _node: &NodeId) -> Command {
        let word = if vnf.program == Program::Localization { "localization" } else { "navigation" };
        // The very file that runs, even if another was put in its place since.
        let mut command = program_of_others("/proc/self/exe", &[]);
        command.args(["vnf", word]).env(bundled::TESTBED, &self.testbed_file);
        command.env(bundled::SETTINGS, &self.settings);
        if let Some(robot) = self.robots.get(&vnf.id) {
            command.env(bundled::ROBOT, robot.as_str());
        }
        if let Some(port) = wire::port(&self.testbed, &vnf.id) {
            command.env(bundled::PORT, port.to_string());
        }
        command
    }

    fn wake(&self) {
        let _ = self.tell.send(Message::Wake);
    }
}

struct NodeProcess(Child);

impl Process for NodeProcess {
    fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        self.0.try_wait()
    }

    fn terminate(&mut self) {
        if let Err(error) = self.0.terminate() {
            tracing::warn!("{error}");
        }
    }

    fn kill(&mut self) {
        if let Err(error) = self.0.kill() {
            tracing::warn!("cannot kill a VNF: {error}");
        }
    }

    fn stdout(&mut self) -> Option<ChildStdout> {
        self.0.pipes().1
    }
}
