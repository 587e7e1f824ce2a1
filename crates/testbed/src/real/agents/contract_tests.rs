//! Agents keep the contract of all engines, with processes of their machine and with containers of podman and Docker. The
//! agent's real program runs there, and everything crosses the real transport.

use std::{
    env, fs, io,
    net::{SocketAddr, TcpListener},
    os::unix::fs::symlink,
    path::PathBuf,
    process::{Child, Command},
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

use cotorra_engine::{
    Cgroups,
    contract::{self, Promise, Subject},
};
use cotorra_graph::{EngineKind, Image, Pull};
use cotorra_graph_testing as base;
use cotorra_testing::containers::{BUSYBOX, Containers};
use parking_lot::Mutex;
use tempfile::TempDir;

use super::*;
use crate::{clock::wall_clock, report::Place};

/// Two servers. Each has an agent of its own name.
const TESTBED: &str = "\
name: contract
wireless: { lab: {} }
nodes:
  robot: { kind: robot, position: [0, 0] }
  R1: { kind: radio_unit, position: [0, 2], channel: 1 }
  lan: { kind: switch }
  left: { kind: server, tier: fog, cpus: 8, memory: 8 GB, agent: left, interface: eth1, address: 10.9.1.2 }
  right: { kind: server, tier: fog, cpus: 8, memory: 8 GB, agent: right, interface: eth1, address: 10.9.1.3 }
links:
  - { ends: [lan, [R1, left, right]] }
";
const SERVERS: [&str; 2] = ["left", "right"];

/// Two agents on this machine, and the core that they connect to.
struct Lab {
    agents: Vec<Child>,
    testbed: Arc<Testbed>,
    options: AgentOptions,
    authority: Authority,
    messages: mpsc::Sender<Message>,
    inbox: Mutex<mpsc::Receiver<Message>>,
    /// Number of the last run. Each engine is that of a run.
    run: AtomicU64,
    image: Option<Image>,
    folder: TempDir,
    // Ends after the agents.
    containers: Option<Containers>,
}

/// Returns the agent's program, which is built beside the tests.
fn program() -> PathBuf {
    let test = env::current_exe().unwrap();
    let program = test.parent().and_then(|folder| folder.parent()).unwrap().join("cotorra-agent");
    assert!(program.exists(), "{} is missing: build the workspace", program.display());
    program
}

impl Lab {
    /// Starts agents, with an engine of containers if there is one.
    fn start(kind: EngineKind, containers: Option<Containers>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::create_or_open(folder.path().join("authority"), today()).unwrap();
        // The port is opened again later. At a loopback address of its own, no other process takes it meanwhile.
        let [_, a, b, c] = std::process::id().to_be_bytes();
        let listen = TcpListener::bind(SocketAddr::from(([127, a | 0x80, b, c], 0))).unwrap();
        let listen = listen.local_addr().unwrap();
        let testbed = cotorra_testbed_file::parse("contract", TESTBED, folder.path()).unwrap();
        let (messages, inbox) = mpsc::channel();
        let image = Image { reference: BUSYBOX.to_owned(), pull: Pull::Never, ..Image::default() };
        let mut lab = Self {
            agents: Vec::new(),
            testbed: Arc::new(testbed),
            options: AgentOptions { listen, authority: None },
            authority,
            messages,
            inbox: Mutex::new(inbox),
            run: AtomicU64::new(0),
            image: containers.is_some().then_some(image),
            folder,
            containers: None,
        };
        for server in SERVERS {
            let mut agent = lab.agent(server);
            if let Some(containers) = &containers {
                agent.args(["--images", kind.name()]).envs([containers.variable()]);
            }
            lab.agents.push(agent.spawn().unwrap());
        }
        lab.containers = containers;
        lab
    }

    /// Enrols an agent. Returns its command.
    fn agent(&self, server: &str) -> Command {
        let (core, path) = (self.options.listen.to_string().parse().unwrap(), self.path(server));
        let name = AgentId::new(server).unwrap();
        let bundle = self.authority.enrol(&name, &core, Duration::from_secs(86400), today()).unwrap();
        bundle.write(&path.with_extension("agent")).unwrap();
        let mut agent = Command::new(program());
        agent.arg("run").arg(path.with_extension("agent")).arg("--state").arg(&path);
        agent.args(["--vnf-user", "0:0"]).env("XDG_RUNTIME_DIR", self.folder.path());
        agent.stderr(fs::File::create(path.with_extension("txt")).unwrap());
        agent
    }

    /// Returns the folder of an agent's state.
    fn path(&self, server: &str) -> PathBuf {
        self.folder.path().join(server)
    }

    /// Returns the paths of a log of the current run, on each machine.
    fn logs(&self, name: &str) -> [PathBuf; 2] {
        let run = self.run.load(Ordering::Relaxed).to_string();
        SERVERS.map(|server| {
            self.path(server).join("runs").join(&run).join("logs/vnfs").join(format!("{name}.log"))
        })
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        for agent in &mut self.agents {
            // They fail only if it has ended.
            let _ = Command::new("kill").arg(agent.id().to_string()).status();
            let _ = agent.wait();
        }
    }
}

impl Subject for Lab {
    type Engine = AgentEngine;

    fn engine(&self) -> AgentEngine {
        let run = self.run.fetch_add(1, Ordering::Relaxed) + 1;
        let place = Place::At(self.folder.path().join(format!("run-{run}")));
        let folder = RunFolder::create(&place, "contract", TESTBED).unwrap();
        let (authority, now) = (self.authority.clone(), wall_clock());
        AgentEngine::start(&self.testbed, &self.options, authority, Run(run), &folder, &now, &self.messages)
            .unwrap()
    }

    fn wait(&self) {
        self.inbox.lock().recv().unwrap();
    }

    fn nodes(&self) -> [NodeId; 2] {
        SERVERS.map(|server| NodeId::new(server).unwrap())
    }

    fn image(&self) -> Option<Image> {
        self.image.clone()
    }

    fn log(&self, name: &str) -> String {
        self.logs(name).into_iter().filter_map(|path| fs::read_to_string(path).ok()).collect()
    }

    fn fill_disk(&self, log: &str) -> bool {
        let fill = |path: PathBuf| -> io::Result<()> {
            fs::create_dir_all(path.parent().unwrap())?;
            symlink("/dev/full", path)
        };
        self.logs(log).into_iter().try_for_each(fill).is_ok()
    }

    fn omitted(&self) -> Vec<(Promise, String)> {
        if self.image.is_some() {
            return Vec::new();
        }
        let daemons = (Promise::Daemons, "a process at an agent can leave its group".to_owned());
        let cannot = |error| (Promise::MemoryLimit, format!("agents limit no memory here: {error}"));
        let limits = Cgroups::new().err().map(cannot);
        std::iter::once(daemons).chain(limits).collect()
    }
}

#[test]
fn agents_with_processes_keep_the_contract_of_engines() {
    contract::check(&Lab::start(EngineKind::Process, None));
}

#[test]
fn agents_with_podman_keep_the_contract_of_engines() {
    let Some(podman) = Containers::start(EngineKind::Podman) else { return };
    contract::check(&Lab::start(EngineKind::Podman, Some(podman)));
}

#[test]
fn agents_with_docker_keep_the_contract_of_engines() {
    // Docker's own engine and agents with podman are always tested.
    if env::var_os("COTORRA_FULL").is_none() {
        return eprintln!("skipped: only with COTORRA_FULL");
    }
    let Some(docker) = Containers::start(EngineKind::Docker) else { return };
    contract::check(&Lab::start(EngineKind::Docker, Some(docker)));
}

#[test]
fn nothing_is_left_of_a_killed_agents_containers() {
    let Some(podman) = Containers::start(EngineKind::Podman) else { return };
    let mut lab = Lab::start(EngineKind::Podman, Some(podman));
    let mut engine = lab.engine();
    let [left, _] = lab.nodes();
    let vnf = Vnf {
        program: cotorra_graph::Program::Command(["sleep", "1000000"].map(str::to_owned).to_vec()),
        node: left.clone().into(),
        rights: cotorra_graph::Rights::default(),
        image: lab.image().map(Box::new),
        ..base::vnf("service", "server")
    };
    engine.start(InstanceId(1), &vnf, 0, &left).unwrap();
    let ready = loop {
        if let Some(event) = engine.poll() {
            break event;
        }
        lab.wait();
    };
    assert_eq!(ready.outcome, cotorra_engine::Outcome::Ready);
    lab.agents[0].kill().unwrap();
    lab.agents[0].wait().unwrap();
    // Its guard removes them.
    while !lab.containers.as_ref().unwrap().names().is_empty() {}
}
