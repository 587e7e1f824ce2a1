//! Time to start and to stop containers in nodes, beside the engine's own time for the same container without a network.
//!
//! `cargo bench -p cotorra-containers`, as root, with podman and Docker installed. Pairs are interleaved.
#![allow(clippy::unwrap_used, reason = "a benchmark")]
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "measures time, and waits")]

use std::{
    io::{Read as _, Write as _},
    os::unix::net::UnixStream,
    path::PathBuf,
    sync::{Arc, mpsc},
    thread,
    time::{Duration, Instant},
};

use cotorra_containers::{Address, ContainerEngine, Network, Settings, Surroundings};
use cotorra_datapath::Namespace;
use cotorra_engine::{Engine as _, InstanceId, Outcome};
use cotorra_graph::{EngineKind, Image, NodeId, Program, Vnf};
use cotorra_graph_testing as base;
use cotorra_testing::containers::{BUSYBOX, Containers};
use serde_json::json;

const PAIRS: usize = 30;
const MANY: usize = 50;
/// Rounds of [`MANY`] containers.
const ROUNDS: usize = 6;
const SCRIPT: [&str; 3] = ["sh", "-c", "trap 'exit 0' TERM; sleep 100000 & wait"];

struct Nodes {
    namespaces: Vec<(NodeId, Namespace)>,
    wake: mpsc::Sender<()>,
}

impl Surroundings for Nodes {
    fn network(&self, node: &NodeId) -> Result<Network, String> {
        let found = self.namespaces.iter().find(|(id, _)| id == node).ok_or("no such node")?;
        Ok(Network::Namespace(found.1.path()))
    }

    fn wake(&self) {
        let _ = self.wake.send(());
    }
}

/// The engine alone.
struct Bare(PathBuf);

impl Bare {
    /// Sends a request, and waits for the end of its answer.
    fn ask(&self, request: &str, content: &str) {
        let mut stream = UnixStream::connect(&self.0).unwrap();
        let length = content.len();
        let head = "Host: localhost\r\nConnection: close\r\nContent-Type: application/json";
        write!(stream, "{request} HTTP/1.1\r\n{head}\r\nContent-Length: {length}\r\n\r\n{content}").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 2"), "{request}: {answer}");
    }

    fn start(&self, name: &str) {
        let limit = |name: &str| json!({ "Name": name, "Soft": 1024, "Hard": 1024 });
        let container = json!({
            "Image": BUSYBOX,
            "Cmd": SCRIPT,
            "HostConfig": {
                "NetworkMode": "none",
                "NanoCpus": 1_000_000_000,
                "Memory": 64 << 20,
                "MemorySwap": 64 << 20,
                "PidsLimit": 512,
                "CapDrop": ["ALL"],
                "SecurityOpt": ["no-new-privileges"],
                "Ulimits": [limit("nofile"), limit("nproc")],
            },
        });
        self.ask(&format!("POST /containers/create?name={name}"), &container.to_string());
        self.ask(&format!("POST /containers/{name}/start"), "");
    }

    fn stop(&self, name: &str) {
        self.ask(&format!("POST /containers/{name}/kill?signal=SIGTERM"), "");
        self.ask(&format!("POST /containers/{name}/wait?condition=not-running"), "");
        self.ask(&format!("DELETE /containers/{name}?force=true"), "");
    }

    /// Does this with all containers at once.
    fn with_all(&self, names: &[String], each: impl Fn(&Self, &str) + Sync) {
        thread::scope(|all| names.iter().for_each(|name| drop(all.spawn(|| each(self, name)))));
    }
}

/// cotorra's engine.
struct Ours {
    engine: ContainerEngine,
    woken: mpsc::Receiver<()>,
    started: u64,
}

impl Ours {
    /// Starts this many containers, each on a node of its own, and waits until all are ready. Returns their numbers.
    fn start(&mut self, count: usize) -> Vec<InstanceId> {
        let ids: Vec<_> = (0..count)
            .map(|place| {
                self.started += 1;
                let id = InstanceId(self.started);
                self.engine.start(id, &vnf(place), 0, &node(place)).unwrap();
                id
            })
            .collect();
        let mut ready = 0;
        while ready < count {
            match self.engine.poll() {
                Some(event) if event.outcome == Outcome::Ready => ready += 1,
                Some(event) => panic!("{event:?}"),
                None => self.woken.recv().unwrap(),
            }
        }
        ids
    }

    fn stop(&mut self, ids: Vec<InstanceId>) {
        ids.into_iter().for_each(|id| self.engine.stop(id));
        self.engine.settle();
    }
}

fn node(place: usize) -> NodeId {
    NodeId::new(&format!("n{place}")).unwrap()
}

fn vnf(place: usize) -> Vnf {
    Vnf {
        id: format!("v{place}").parse().unwrap(),
        program: Program::Command(SCRIPT.map(str::to_owned).to_vec()),
        node: node(place).into(),
        image: Some(Box::new(Image { reference: BUSYBOX.to_owned(), ..Image::default() })),
        ..base::vnf("vnf", "server")
    }
}

fn time(work: impl FnOnce()) -> Duration {
    let begin = Instant::now();
    work();
    begin.elapsed()
}

/// Waits until nothing is left to do after earlier containers: podman's monitors run a program for each that ended.
fn settle() {
    let works = |entry: std::fs::DirEntry| {
        let words = std::fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let words: Vec<_> = words.split(|byte| *byte == 0).collect();
        // Monitors have the words of that program among their own, as long as their container runs.
        words[0].ends_with(b"podman") && words.contains(&&b"cleanup"[..])
    };
    while std::fs::read_dir("/proc").unwrap().flatten().any(works) {
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Prints medians and 95th percentiles of pairs, ms, and the ratio of the medians.
fn print(what: &str, mut pairs: [Vec<Duration>; 2]) {
    pairs.iter_mut().for_each(|times| times.sort_unstable());
    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    let [bare, ours] = pairs.map(|times| (ms(times[times.len() / 2]), ms(times[times.len() * 95 / 100])));
    println!(
        "{what:<28} engine {:7.1} (p95 {:7.1})   cotorra {:7.1} (p95 {:7.1})   ratio {:.3}",
        bare.0,
        bare.1,
        ours.0,
        ours.1,
        ours.0 / bare.0
    );
}

fn measure(kind: EngineKind) {
    let Some(containers) = Containers::start(kind) else { return };
    let bare = Bare(containers.socket());
    let folder = tempfile::tempdir().unwrap();
    let (wake, woken) = mpsc::channel();
    let namespaces = (0..MANY).map(|place| (node(place), Namespace::new().unwrap())).collect();
    let nodes: Arc<dyn Surroundings> = Arc::new(Nodes { namespaces, wake });
    let settings = Settings {
        kind,
        address: Address::Socket(containers.socket()),
        folder: folder.path().to_owned(),
        logs: folder.path().to_owned(),
        guard: None,
    };
    let mut ours = Ours { engine: ContainerEngine::new(settings, nodes).unwrap(), woken, started: 0 };
    // The first has the connection and, with Docker, the node's holder to make.
    let first = time(|| {
        let ids = ours.start(1);
        ours.stop(ids);
    });
    println!("{} first start and stop: {:.0} ms", kind.name(), first.as_secs_f64() * 1e3);
    let (mut starts, mut stops) = ([const { Vec::new() }; 2], [const { Vec::new() }; 2]);
    for _ in 0..PAIRS {
        starts[0].push(time(|| bare.start("bare")));
        stops[0].push(time(|| bare.stop("bare")));
        let mut ids = Vec::new();
        starts[1].push(time(|| ids = ours.start(1)));
        stops[1].push(time(|| ours.stop(ids)));
    }
    print(&format!("{} start, ms", kind.name()), starts);
    print(&format!("{} stop, ms", kind.name()), stops);
    let (mut up, mut down) = ([const { Vec::new() }; 2], [const { Vec::new() }; 2]);
    let names: Vec<_> = (0..MANY).map(|i| format!("bare{i}")).collect();
    for round in 0..2 * ROUNDS {
        settle();
        // Each is first as often as the other: ABBA.
        if [0, 3].contains(&(round % 4)) {
            up[0].push(time(|| bare.with_all(&names, Bare::start)));
            settle();
            down[0].push(time(|| bare.with_all(&names, Bare::stop)));
        } else {
            let mut ids = Vec::new();
            up[1].push(time(|| ids = ours.start(MANY)));
            settle();
            down[1].push(time(|| ours.stop(ids)));
        }
    }
    print(&format!("{} {MANY} up, ms", kind.name()), up);
    print(&format!("{} {MANY} down, ms", kind.name()), down);
}

fn main() {
    // The machine's speed, to compare figures of several machines.
    let mut sum = 0_u64;
    let speed =
        time(|| (0..200_000_000_u64).for_each(|i| sum = std::hint::black_box(sum ^ i.wrapping_mul(31))));
    println!("2e8 steps of arithmetic: {:.0} ms ({sum})", speed.as_secs_f64() * 1e3);
    // Names of engines select them.
    let wanted: Vec<_> = std::env::args().collect();
    let names = |kind: &EngineKind| wanted.iter().any(|word| word == kind.name());
    let all = [EngineKind::Podman, EngineKind::Docker];
    let is_wanted = |kind: &EngineKind| names(kind) || !all.iter().any(names);
    all.into_iter().filter(is_wanted).for_each(measure);
}
