//! Real Wi-Fi software in a run: starts hostapd in radio units and wpa_supplicant in robots, carries instructions out by them,
//! and reports to the emulated network and the core what they did.
//!
//! [`plan`] writes their configurations, and [`manager`] decides. [`programs`] has the processes and sockets of simulated radios;
//! those of real radios are at agents.

mod at_agents;
mod figures;
mod lifecycle;
mod manager;
mod plan;
mod programs;
mod words;

use std::{
    env, fs, io,
    os::unix::fs::DirBuilderExt,
    path::PathBuf,
    process,
    sync::{Arc, mpsc},
    thread,
    time::Duration,
};

use cotorra_datapath::{Capability, CapabilityState};
use cotorra_graph::{self as graph, HardwareGraph, NodeId};
use cotorra_wifi::{DomainKey, installed};
use parking_lot::Mutex;

pub use self::plan::PlanError;
pub(crate) use self::{
    at_agents::{Message as AtAgentsMessage, News, Outlets, Place, Reading, Wish, Wishes},
    manager::{Change, Rejected},
    plan::Plan,
    programs::Surroundings,
};
use self::{manager::Manager, programs::Programs};
use crate::{clock::Clock, real::radio_figures::RadioFigures};

/// Beginning of the names of folders for Wi-Fi programs, in the folder for temporary files. The process's id follows, and a number.
pub const WIFI_FOLDERS: &str = "cotorra-wifi-";
/// Most folders of processes with one id.
const MOST_FOLDERS: u32 = 100;
/// Longest time of a start.
const START: Duration = Duration::from_secs(60);

/// The Wi-Fi programs of a run. Dropping it stops them.
pub(crate) struct Wifi {
    handle: Handle,
    /// Ends the thread.
    stop: Signal,
    thread: Option<thread::JoinHandle<()>>,
    _folder: Option<Folder>,
}

/// The programs of real radios, and what these report.
pub(crate) type WithFigures = (Wifi, Arc<dyn RadioFigures>);

/// Tells the thread that carries out actions something.
type Signal = Arc<dyn Fn() + Send + Sync>;

/// Gives the programs instructions.
#[derive(Clone)]
pub(crate) struct Handle {
    manager: Arc<Mutex<Manager>>,
    /// There may be actions.
    wake: Signal,
    now: Clock,
}

/// Wi-Fi programs that did not start.
#[derive(Debug, thiserror::Error)]
pub enum WifiError {
    /// A program that is not installed.
    #[error(
        "`wifi: hwsim` needs {0}, which is not installed: on Debian, `apt-get install hostapd wpasupplicant`"
    )]
    NotInstalled(&'static str),
    /// A testbed that they cannot serve.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A program that cannot be started.
    #[error("{0}")]
    Start(String),
    /// Programs that take too long.
    #[error("Wi-Fi is not up after {} s: {missing} are missing", START.as_secs())]
    Slow {
        /// Those that are missing.
        missing: String,
    },
    /// Real radios that no agent reports.
    #[error(
        "no agent reports the radios of {missing} within {} s: is it running there, with `--wifi` and that interface?",
        START.as_secs()
    )]
    Unreported {
        /// The nodes, each with its agent and interface.
        missing: String,
    },
    /// A folder or a thread.
    #[error("cannot {what}: {source}")]
    System {
        /// The failed action.
        what: &'static str,
        /// The system's error.
        source: io::Error,
    },
}

/// The programs, each with its use and with what to do if it is missing.
const PROGRAMS: [(&str, &str, &str); 2] = [
    (
        "hostapd",
        "access points of networks with `wifi: hwsim`",
        "not needed for emulated radio; otherwise install it: `apt-get install hostapd` on Debian",
    ),
    (
        "wpa_supplicant",
        "robots in networks with `wifi: hwsim`",
        "not needed for emulated radio; otherwise install it: `apt-get install wpasupplicant` on Debian",
    ),
];

/// Looks for the programs that networks with real Wi-Fi software need.
pub fn wifi_programs() -> Vec<Capability> {
    let capability = |(name, purpose, remedy)| {
        let state = match installed(name) {
            Some(path) => CapabilityState::Available(path.display().to_string()),
            None => CapabilityState::Missing { reason: "it is not installed".to_owned(), remedy },
        };
        Capability { name, purpose, state }
    };
    PROGRAMS.into_iter().map(capability).collect()
}

/// Checks that the programs are installed.
///
/// # Errors
/// [`WifiError::NotInstalled`].
pub(crate) fn check_programs() -> Result<(), WifiError> {
    for (program, ..) in PROGRAMS {
        installed(program).ok_or(WifiError::NotInstalled(program))?;
    }
    Ok(())
}

impl Wifi {
    /// Starts all programs of a plan, and waits until radio units serve and robots have joined. One that is out of reach of all
    /// radio units holds nothing up.
    ///
    /// # Errors
    /// [`WifiError`]. No program runs then.
    pub(crate) fn start(plan: Plan, surroundings: Surroundings) -> Result<Self, WifiError> {
        let folder = Folder::new().map_err(system("make a folder for the Wi-Fi programs"))?;
        let now = Arc::clone(&surroundings.now);
        let manager = Arc::new(Mutex::new(Manager::new(now(), plan)));
        let (inbox, messages) = mpsc::channel();
        let (progress, begun) = mpsc::channel();
        let programs =
            Programs::new(Arc::clone(&manager), surroundings, folder.0.clone(), (inbox.clone(), messages));
        let thread = thread::Builder::new()
            .name("wifi".to_owned())
            .spawn(move || programs.run(&progress))
            .map_err(system("start the thread of the Wi-Fi programs"))?;
        let handle = Handle { manager, wake: signal(&inbox, || programs::Message::Wake), now };
        let stop = signal(&inbox, || programs::Message::Stop);
        Self { handle, stop, thread: Some(thread), _folder: Some(folder) }.begun(&begun)
    }

    /// Serves and joins the networks of a graph's real radios by agents, and waits until radio units serve and robots have joined,
    /// as [`Self::start`] does. Returns the radios' figures, too. `None` if the graph has no such radios.
    ///
    /// # Errors
    /// [`WifiError`].
    pub(crate) fn start_at_agents(
        graph: &HardwareGraph,
        key: &DomainKey,
        outlets: Outlets,
        (sender, inbox): (mpsc::Sender<AtAgentsMessage>, mpsc::Receiver<AtAgentsMessage>),
    ) -> Result<Option<WithFigures>, WifiError> {
        let places = at_agents::places(graph)?;
        if places.is_empty() {
            return Ok(None);
        }
        let now = Arc::clone(&outlets.now);
        let addresses = at_agents::await_addresses(&places, &inbox, &now, START).map_err(|missing| {
            let missing: Vec<_> = missing
                .iter()
                .map(|(node, Place { agent, interface })| {
                    format!("`{node}` (`{interface}` at agent `{agent}`)")
                })
                .collect();
            WifiError::Unreported { missing: missing.join(", ") }
        })?;
        let Some(plan) = Plan::of_hardware(graph, &addresses, key)? else { return Ok(None) };
        let figures = Arc::new(figures::Figures::new(addresses));
        let manager = Arc::new(Mutex::new(Manager::new(now(), plan.clone())));
        let programs = at_agents::programs(graph, &places);
        let radios =
            at_agents::AtAgents::new(Arc::clone(&manager), plan, outlets, Arc::clone(&figures), programs);
        let (progress, begun) = mpsc::channel();
        let thread = thread::Builder::new()
            .name("radios".to_owned())
            .spawn(move || radios.run(&inbox, &progress))
            .map_err(system("start the thread of the real radios"))?;
        let handle = Handle { manager, wake: signal(&sender, || AtAgentsMessage::Wake), now };
        let stop = signal(&sender, || AtAgentsMessage::Stop);
        let wifi = Self { handle, stop, thread: Some(thread), _folder: None }.begun(&begun)?;
        let figures: Arc<dyn RadioFigures> = figures;
        Ok(Some((wifi, figures)))
    }

    /// Waits until all is up.
    fn begun(self, begun: &mpsc::Receiver<Result<(), String>>) -> Result<Self, WifiError> {
        match begun.recv_timeout(START) {
            Ok(Ok(())) => Ok(self),
            Ok(Err(reason)) => Err(WifiError::Start(reason)),
            Err(_) => {
                let missing = self.handle.manager.lock().awaited().join(", ");
                Err(WifiError::Slow { missing })
            }
        }
    }

    /// Returns which radio units serve and which robots have joined, in a line for people.
    pub(crate) fn standing(&self) -> String {
        self.handle.manager.lock().standing()
    }

    /// Returns access for the core.
    pub(crate) fn handle(&self) -> Handle {
        self.handle.clone()
    }
}

/// Makes a signal that sends a message to a thread.
fn signal<M: Send + 'static>(inbox: &mpsc::Sender<M>, message: fn() -> M) -> Signal {
    let inbox = inbox.clone();
    // Fails only if the thread has ended.
    Arc::new(move || {
        _ = inbox.send(message());
    })
}

/// Receives that all is up, or why not.
type Begun = mpsc::Sender<Result<(), String>>;

/// Waits for the next message of a thread that carries out a manager's actions, up to the manager's deadline. Takes `begun` and
/// reports there once that all is up, or why not.
fn next_message<M>(
    manager: &Mutex<Manager>,
    now: &Clock,
    inbox: &mpsc::Receiver<M>,
    begun: &mut Option<&Begun>,
) -> Result<M, mpsc::RecvTimeoutError> {
    let (outcome, deadline) = {
        let manager = manager.lock();
        let failed = manager.failure().map(|reason| Err(reason.to_owned()));
        (failed.or_else(|| manager.is_up().then_some(Ok(()))), manager.deadline())
    };
    if let Some(outcome) = outcome
        && let Some(begun) = begun.take()
    {
        // The caller gives up after a time.
        _ = begun.send(outcome);
    }
    match deadline {
        Some(deadline) => inbox.recv_timeout(deadline.since(now())),
        None => inbox.recv().map_err(|_| mpsc::RecvTimeoutError::Disconnected),
    }
}

impl Drop for Wifi {
    fn drop(&mut self) {
        (self.stop)();
        if let Some(thread) = self.thread.take() {
            _ = thread.join();
        }
    }
}

impl Handle {
    /// Whether a robot or a radio unit has a program.
    pub(crate) fn has(&self, node: &NodeId) -> bool {
        self.manager.lock().has(node)
    }

    /// Makes a robot's radio scan. An event reports the end.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn scan(&self, robot: &NodeId) -> Result<(), Rejected> {
        self.instruct(|manager| manager.scan((self.now)(), robot))
    }

    /// Sends a robot to a radio unit. Events report how it comes there, or why not.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn attach(&self, robot: &NodeId, radio_unit: &NodeId) -> Result<(), Rejected> {
        self.instruct(|manager| manager.attach((self.now)(), robot, radio_unit))
    }

    /// Lets a robot's radio unit suggest another one. An event reports the robot's answer.
    ///
    /// # Errors
    /// [`Rejected`]. No station was asked then.
    pub(crate) fn suggest(&self, robot: &NodeId, radio_unit: &NodeId) -> Result<(), Rejected> {
        self.instruct(|manager| manager.suggest((self.now)(), robot, radio_unit))
    }

    /// Gives a robot the settings and the key of a radio unit. Without a key, takes them back.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn provision(
        &self,
        robot: &NodeId,
        radio_unit: &NodeId,
        access_point: graph::AccessPoint,
    ) -> Result<(), Rejected> {
        self.instruct(|manager| manager.provision(robot, radio_unit, access_point))
    }

    /// Checks whether [`Self::switch_on`] would succeed now.
    ///
    /// # Errors
    /// [`Rejected`].
    pub(crate) fn check_switch_on(
        &self,
        radio_unit: &NodeId,
        access_point: &graph::AccessPoint,
    ) -> Result<(), Rejected> {
        self.manager.lock().check_switch_on(radio_unit, access_point)
    }

    /// Starts a radio unit that is off. An event reports when it serves.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn switch_on(
        &self,
        radio_unit: &NodeId,
        access_point: graph::AccessPoint,
    ) -> Result<(), Rejected> {
        self.instruct(|manager| manager.switch_on(radio_unit, access_point))
    }

    /// Stops a radio unit. Its stations lose it.
    ///
    /// # Errors
    /// [`Rejected`]. Nothing has changed then.
    pub(crate) fn switch_off(&self, radio_unit: &NodeId) -> Result<(), Rejected> {
        self.instruct(|manager| manager.switch_off(radio_unit))
    }

    fn instruct(
        &self,
        instruction: impl FnOnce(&mut Manager) -> Result<(), Rejected>,
    ) -> Result<(), Rejected> {
        instruction(&mut self.manager.lock())?;
        (self.wake)();
        Ok(())
    }
}

/// A private folder of this process, which is removed with it.
struct Folder(PathBuf);

impl Folder {
    fn new() -> io::Result<Self> {
        // An earlier process may have had this number, and left its folder.
        let paths = (0..MOST_FOLDERS)
            .map(|number| env::temp_dir().join(format!("{WIFI_FOLDERS}{}-{number}", process::id())));
        let make = |path: PathBuf| match fs::DirBuilder::new().mode(0o700).create(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => None,
            made => Some(made.map(|()| Self(path))),
        };
        paths.into_iter().find_map(make).unwrap_or_else(|| Err(io::ErrorKind::AlreadyExists.into()))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        _ = fs::remove_dir_all(&self.0);
    }
}

fn system(what: &'static str) -> impl FnOnce(io::Error) -> WifiError {
    move |source| WifiError::System { what, source }
}
