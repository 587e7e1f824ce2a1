//! The engine: takes what Network Control wants, and runs each instance as a task of one thread.

use std::{
    cell::Cell,
    collections::BTreeMap,
    fs::{File, OpenOptions},
    io::{self, Write as _},
    path::PathBuf,
    process::{self, Stdio},
    rc::Rc,
    sync::{Arc, Weak, mpsc as events},
    thread,
};

use cotorra_engine::{Engine, EngineEvent, InstanceId, Outcome, replica_name};
use cotorra_graph::{EngineKind, ListenPort, NodeId, Vnf};
use tokio::{
    sync::{Mutex, mpsc, oneshot},
    task::{JoinSet, LocalSet},
};

use crate::{
    address::Address,
    daemon::{ANSWER, Daemon},
    daemon_error::DaemonError,
    guard::{Guard, GuardSettings},
    holder::Holders,
    instance::Instance,
    leftovers::{self, Marker},
    ready,
    registries::Registries,
    spec::{Network, RUN, Spec},
};

/// Surroundings of containers that depend on the testbed.
pub trait Surroundings: Send + Sync + 'static {
    /// Returns the network of a node.
    ///
    /// # Errors
    /// The reason for which containers cannot join it, for people.
    fn network(&self, node: &NodeId) -> Result<Network, String>;

    /// Returns variables of an instance beside those of its VNF and `COTORRA_VNF`, `COTORRA_NODE` and `COTORRA_REPLICA`. By
    /// default, none.
    fn environment(&self, _vnf: &Vnf, _replica: u32, _node: &NodeId) -> Vec<(String, String)> {
        Vec::new()
    }

    /// Returns the ports at which a VNF serves, beside those that its image declares. By default, none.
    fn ports(&self, _vnf: &Vnf) -> Vec<ListenPort> {
        Vec::new()
    }

    /// Returns files of this machine that an instance reads, each with its path in the container. By default, none.
    fn files(&self, _vnf: &Vnf) -> Vec<(PathBuf, PathBuf)> {
        Vec::new()
    }

    /// Signals a new event of [`Engine::poll`]. Called from another thread.
    fn wake(&self);
}

/// Settings of an engine.
#[derive(Debug)]
pub struct Settings {
    /// Kind of the engine, podman or Docker.
    pub kind: EngineKind,
    /// Its address.
    pub address: Address,
    /// Folder from which sources of volumes start.
    pub folder: PathBuf,
    /// Folder of the logs: `<vnf>.log`, or `<vnf>@<replica>.log` for replicas from 1.
    pub logs: PathBuf,
    /// The guard of the containers. Without one, a killed process leaves them, and podman must be served at a socket.
    pub guard: Option<GuardSettings>,
}

/// Runs VNFs in containers.
pub struct ContainerEngine {
    /// `None` once it is shut down.
    commands: Option<mpsc::UnboundedSender<Command>>,
    events: events::Receiver<EngineEvent>,
    /// It returns the record, whose lock it holds.
    thread: Option<thread::JoinHandle<Arc<Marker>>>,
    surroundings: Arc<dyn Surroundings>,
    logs: PathBuf,
    label: String,
    /// `None` once the engine is shut down.
    guard: Option<Guard>,
    instances: BTreeMap<InstanceId, Known>,
}

/// State of an instance, as the engine's owner knows it.
struct Known {
    is_stopped: bool,
    /// Upgrades until the instance has ended and is cleaned up.
    alive: Weak<()>,
}

impl std::fmt::Debug for ContainerEngine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ContainerEngine").finish_non_exhaustive()
    }
}

enum Command {
    /// Start an instance. The last part is dropped once it has ended and is cleaned up.
    Start(InstanceId, Box<Wanted>, Arc<()>),
    Stop(InstanceId),
    /// The sender is dropped once nothing is left of stopped instances.
    Settle(events::Sender<()>),
}

/// An instance to start.
struct Wanted {
    vnf: Vnf,
    replica: u32,
    node: NodeId,
    network: Network,
    log: File,
}

impl ContainerEngine {
    /// Creates an engine. It connects when the first instance starts.
    ///
    /// # Errors
    /// The error of the system if there can be no thread, no guard or no record of the containers.
    pub fn new(settings: Settings, surroundings: Arc<dyn Surroundings>) -> io::Result<Self> {
        let marker = Marker::create(settings.kind, &settings.address)?;
        let label = format!("{RUN}={}", marker.run());
        let guard = settings.guard.as_ref().map(|guard| Guard::start(guard, &marker));
        let guard = guard.transpose()?;
        let (commands, inbox) = mpsc::unbounded_channel();
        let (report, events) = events::channel();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (logs, around) = (settings.logs.clone(), Arc::clone(&surroundings));
        let thread = thread::Builder::new().name(settings.kind.name().to_owned()).spawn(move || {
            let (daemon, holders, is_last) = (Mutex::default(), Holders::default(), Cell::new(false));
            let marker = Arc::new(marker);
            let tasks = Rc::new(Tasks {
                settings,
                surroundings: around,
                marker: Arc::clone(&marker),
                report,
                daemon,
                holders,
                registries: Registries::from_environment(),
                is_last,
            });
            if LocalSet::new().block_on(&runtime, Rc::clone(&tasks).serve(inbox)) {
                // The guard has nothing to do.
                marker.remove();
            }
            marker
        })?;
        Ok(Self {
            commands: Some(commands),
            events,
            thread: Some(thread),
            surroundings,
            logs,
            label,
            guard,
            instances: BTreeMap::new(),
        })
    }

    /// Returns the label of the run's containers, as `NAME=VALUE`. All containers with it are removed with the run's.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// Returns the standard input for a program that creates containers with [`Self::label`]. If this process is killed, the
    /// guard waits for that program before it removes them.
    ///
    /// # Errors
    /// The error of the system.
    pub fn lifeline(&self) -> io::Result<Stdio> {
        self.guard.as_ref().map_or_else(|| Ok(Stdio::null()), Guard::lifeline)
    }

    /// Returns the number of instances that were stopped and have not ended yet. The owner is woken when one has.
    pub fn stopping(&self) -> usize {
        let is_stopping = |its: &&Known| its.is_stopped && its.alive.strong_count() > 0;
        self.instances.values().filter(is_stopping).count()
    }

    /// Waits until instances that were stopped have ended and are cleaned up.
    pub fn settle(&mut self) {
        let (settled, wait) = events::channel();
        // Fails only if the thread has ended, and all instances with it.
        let _ = self.send(Command::Settle(settled));
        let _ = wait.recv();
    }

    fn send(&self, command: Command) -> Result<(), String> {
        let gone = "the thread of the containers has ended";
        self.commands.as_ref().ok_or(gone)?.send(command).map_err(|_| gone.to_owned())
    }
}

impl Engine for ContainerEngine {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        let network = self.surroundings.network(node)?;
        let path = self.logs.join(format!("{}.log", replica_name(&vnf.id, replica)));
        let in_log = |e: io::Error| format!("cannot write {}: {e}", path.display());
        let mut log = OpenOptions::new().create(true).append(true).open(&path).map_err(in_log)?;
        // A full disk must not keep the VNF from running.
        let _ = writeln!(log, "--- instance {} on {node}", instance.0);
        let wanted = Wanted { vnf: vnf.clone(), replica, node: node.clone(), network, log };
        let lives = Arc::new(());
        let alive = Arc::downgrade(&lives);
        self.send(Command::Start(instance, Box::new(wanted), lives))?;
        self.instances.retain(|_, known| known.alive.strong_count() > 0);
        self.instances.insert(instance, Known { is_stopped: false, alive });
        Ok(())
    }

    fn stop(&mut self, instance: InstanceId) {
        if let Some(known) = self.instances.get_mut(&instance) {
            known.is_stopped = true;
        }
        // Fails only if the thread has ended, and all instances with it.
        let _ = self.send(Command::Stop(instance));
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.events.try_recv().ok()
    }

    fn shut_down(&mut self) {
        self.commands = None;
        let record = self.thread.take().map(thread::JoinHandle::join);
        // It removes what the thread could not.
        self.guard = None;
        drop(record);
    }
}

impl Drop for ContainerEngine {
    fn drop(&mut self) {
        self.shut_down();
    }
}

/// State that the tasks of instances share.
struct Tasks {
    settings: Settings,
    surroundings: Arc<dyn Surroundings>,
    marker: Arc<Marker>,
    report: events::Sender<EngineEvent>,
    /// The engine, once it answered.
    daemon: Mutex<Option<Daemon>>,
    holders: Holders,
    registries: Registries,
    /// Whether the run ends.
    is_last: Cell<bool>,
}

impl Tasks {
    /// Runs instances until the last sender of commands is gone, and then ends them. Returns whether nothing is left.
    async fn serve(self: Rc<Self>, mut inbox: mpsc::UnboundedReceiver<Command>) -> bool {
        let mut running = JoinSet::new();
        let mut stops = BTreeMap::new();
        let mut settling = Vec::new();
        loop {
            // Instances that run and were not stopped have an entry in each.
            if running.len() == stops.len() {
                settling.clear();
            }
            tokio::select! {
                command = inbox.recv() => match command {
                    Some(Command::Start(instance, wanted, lives)) => {
                        let (stop, stopped) = oneshot::channel::<()>();
                        stops.insert(instance, stop);
                        let tasks = Rc::clone(&self);
                        running.spawn_local(async move {
                            tasks.run(instance, *wanted, stopped).await;
                            drop(lives);
                            tasks.surroundings.wake();
                            instance
                        });
                    }
                    // A sender that is gone stops the instance.
                    Some(Command::Stop(instance)) => drop(stops.remove(&instance)),
                    Some(Command::Settle(settled)) => settling.push(settled),
                    None => break,
                },
                Some(Ok(instance)) = running.join_next() => drop(stops.remove(&instance)),
            }
        }
        self.is_last.set(true);
        drop(stops);
        while running.join_next().await.is_some() {}
        // Without an engine there was no container.
        let Some(daemon) = self.daemon.lock().await.take() else { return true };
        let run = self.marker.run();
        let removed = if daemon.is_silent() {
            Err(DaemonError::Silent(ANSWER))
        } else {
            leftovers::remove_all(&daemon, run).await
        };
        if let Err(error) = &removed {
            tracing::warn!("containers of {run} may be left, which `cotorra clean` removes: {error}");
        }
        removed.is_ok()
    }

    /// Runs an instance until it ends or is stopped.
    async fn run(&self, instance: InstanceId, wanted: Wanted, mut stop: oneshot::Receiver<()>) {
        let report = |outcome| {
            // Fails only while the engine is dropped.
            let _ = self.report.send(EngineEvent { instance, outcome });
            self.surroundings.wake();
        };
        let prepared = tokio::select! {
            biased;
            _ = &mut stop => return,
            prepared = self.prepare(instance, wanted) => prepared,
        };
        match prepared {
            Ok((daemon, prepared)) => prepared.run(&daemon, stop, &self.is_last, &report).await,
            Err(error) => report(Outcome::Failed(error)),
        }
    }

    async fn prepare(&self, instance: InstanceId, wanted: Wanted) -> Result<(Daemon, Instance), String> {
        let Wanted { vnf, replica, node, network, log } = wanted;
        let image = vnf.image.as_deref().ok_or("it has no image")?;
        let (pull, mut ports) = (image.pull, image.ports.clone());
        ports.extend(self.surroundings.ports(&vnf));
        let is_taken = |port: &&ListenPort| ready::are_served(process::id(), std::slice::from_ref(port));
        // That listener would be taken for the container's.
        if network == Network::Machine
            && let Some(port) = ports.iter().find(is_taken)
        {
            return Err(format!("another program of the machine listens at port {port}"));
        }
        let daemon = self.daemon().await?;
        let run = self.marker.run();
        let (network, hostname) = match (network, self.settings.kind) {
            (Network::Machine, _) => ("host".to_owned(), None),
            (Network::Namespace(path), EngineKind::Docker) => {
                let held = self.holders.hold(&daemon, &node, &path, run).await;
                let holder = held.map_err(|e| format!("cannot join the network of `{node}`: {e}"))?;
                (format!("container:{holder}"), None)
            }
            (Network::Namespace(path), _) => (format!("ns:{}", path.display()), Some(node.to_string())),
        };
        let environment = self.surroundings.environment(&vnf, replica, &node);
        let (files, folder) = (self.surroundings.files(&vnf), self.settings.folder.as_path());
        let spec =
            Spec { vnf: &vnf, replica, node: &node, network, hostname, environment, files, folder, run };
        let container = spec.container()?;
        let name = format!("cotorra-{run}-{}", instance.0);
        let (memory_bytes, registries) = (vnf.memory_bytes, self.registries.clone());
        Ok((daemon, Instance { name, container, pull, ports, memory_bytes, log, registries }))
    }

    /// Returns the engine, to which this connects first if necessary.
    async fn daemon(&self) -> Result<Daemon, String> {
        let mut known = self.daemon.lock().await;
        if let Some(daemon) = &*known {
            return Ok(daemon.clone());
        }
        let daemon =
            leftovers::connect(&self.settings.address, &self.marker).await.map_err(|e| e.to_string())?;
        Ok(known.insert(daemon).clone())
    }
}

#[cfg(test)]
mod tests;
