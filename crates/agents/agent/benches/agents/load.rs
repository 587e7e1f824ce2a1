//! A core with 100 agents, and the same with bare Zenoh. Core and agents are processes of their own.
//!
//! Each process follows lines on its standard input. Agents send contexts from their start. They send counted ones from
//! `begin` on, report `done` after the last, and go on with others. The core reports `ready` once it has heard all agents, its
//! usage from `begin` to `end`, and at `count` how many counted contexts it received.

use std::{
    env, fs,
    io::{self, BufRead, BufReader, Write},
    process::{Child, ChildStdout, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::{Duration, Instant},
};

use cotorra_agent_protocol::MachineReading;
use cotorra_graph::{
    BitRate, CpuContext, InterfaceContext, InterfaceTraffic, LoadAverage, MachineContext, MemoryContext,
    NodeId, Probability,
};
use cotorra_graph_testing as base;

use crate::{
    lab::Lab,
    machine::{Others, cpu_seconds},
};

const AGENTS: usize = 100;
/// Counted contexts of each agent.
const CONTEXTS: u64 = 200;
const INTERVAL: Duration = Duration::from_millis(100);
const ROUNDS: usize = 3;
/// Time without counted contexts at both ends of a measurement, in which all are under way.
const MARGIN: Duration = Duration::from_millis(500);
/// Time from the connections to the measurement.
const WARM_UP: Duration = Duration::from_secs(2);
/// Time for contexts that are still under way after a measurement.
const LATE: Duration = Duration::from_secs(2);

/// Nodes of contexts that are not counted, and of those that are.
const WAITING: &str = "waiting";
pub const COUNTED: &str = "counted";

/// Resources that a core used.
struct Usage {
    cpu_percent: f64,
    rss_mb: f64,
    lost: u64,
}

pub fn measure() {
    let context = context(COUNTED);
    let length = MachineReading {
        boot: 1,
        read_ns: 1_000_000_000,
        context,
        links: Default::default(),
        heard: Default::default(),
        addresses: Default::default(),
    }
    .encode()
    .len();
    println!("{AGENTS} agents, contexts of {length} bytes at 10 Hz, {CONTEXTS} of each agent counted");
    println!("core                CPU     memory     lost   others' CPU");
    let mut all = [const { Vec::new() }; 2];
    for _ in 0..ROUNDS {
        for (all, [name, core, agents]) in
            all.iter_mut().zip([["bare Zenoh", "bare-core", "bare-agents"], ["cotorra", "core", "agents"]])
        {
            let others = Others::begin();
            let usage = round(core, agents);
            let Usage { cpu_percent, rss_mb, lost } = usage;
            println!("{name:<12} {cpu_percent:>8.2} % {rss_mb:>7.1} MB {lost:>8} {:>13}", others.share());
            all.push(usage);
        }
    }
    let [bare, ours] = all.map(|rounds| {
        [median(rounds.iter().map(|its| its.cpu_percent)), median(rounds.iter().map(|its| its.rss_mb))]
    });
    println!("medians, cotorra to bare Zenoh: CPU {:.2}, memory {:.2}", ours[0] / bare[0], ours[1] / bare[1]);
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<_> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn round(core: &str, agents: &str) -> Usage {
    let folder = tempfile::tempdir().unwrap();
    let lab = Lab::create(folder.path(), AGENTS);
    let mut core = Part::start(core, &lab);
    let mut agents = Part::start(agents, &lab);
    assert_eq!(core.line(), "ready");
    thread::sleep(WARM_UP);
    core.tell("begin");
    thread::sleep(MARGIN);
    agents.tell("begin");
    assert_eq!(agents.line(), "done");
    thread::sleep(MARGIN);
    core.tell("end");
    let usage = core.line();
    thread::sleep(LATE);
    core.tell("count");
    let received: u64 = core.line().parse().unwrap();
    let [cpu_share, rss_kb] =
        [0, 1].map(|place| usage.split(' ').nth(place).unwrap().parse::<f64>().unwrap());
    let lost = (AGENTS as u64 * CONTEXTS).checked_sub(received).expect("nothing arrives twice");
    Usage { cpu_percent: cpu_share * 100.0, rss_mb: rss_kb / 1e3, lost }
}

/// A process of a round, killed on drop.
struct Part {
    child: Child,
    output: BufReader<ChildStdout>,
}

impl Part {
    fn start(role: &str, lab: &Lab) -> Self {
        let mut command = Command::new(env::current_exe().unwrap());
        command.arg(role).arg(&lab.folder).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        Self { child, output }
    }

    fn tell(&mut self, line: &str) {
        writeln!(self.child.stdin.as_ref().unwrap(), "{line}").unwrap();
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        line.trim_end().to_owned()
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn next_line() -> Option<String> {
    io::stdin().lines().next().map(Result::unwrap)
}

/// Follows the lines for a core. `present` receives a message for each agent that it hears for the first time, and
/// `counted` counts contexts.
pub fn serve_core(present: &mpsc::Receiver<()>, counted: &AtomicU64) {
    (0..AGENTS).for_each(|_| present.recv().unwrap());
    println!("ready");
    assert_eq!(next_line().as_deref(), Some("begin"));
    let (cpu, began) = (cpu_seconds(), Instant::now());
    assert_eq!(next_line().as_deref(), Some("end"));
    let share = (cpu_seconds() - cpu) / began.elapsed().as_secs_f64();
    println!("{share} {}", rss_kb());
    assert_eq!(next_line().as_deref(), Some("count"));
    println!("{}", counted.load(Ordering::Relaxed));
    // Until it is killed.
    next_line();
}

/// Memory of this process.
fn rss_kb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.split_whitespace().next().unwrap().parse().unwrap()
}

/// When an agent sends its contexts, and which.
pub struct Schedule {
    next: Instant,
    counts: Arc<AtomicBool>,
    left: u64,
    done: mpsc::Sender<()>,
}

impl Schedule {
    pub fn next(&self) -> Instant {
        self.next
    }

    /// Returns a context that is due.
    pub fn poll(&mut self) -> Option<MachineContext> {
        if Instant::now() < self.next {
            return None;
        }
        self.next += INTERVAL;
        let is_counted = self.left > 0 && self.counts.load(Ordering::Relaxed);
        if is_counted {
            self.left -= 1;
            if self.left == 0 {
                self.done.send(()).unwrap();
            }
        }
        Some(context(if is_counted { COUNTED } else { WAITING }))
    }
}

/// Follows the lines for the agents. `agent` runs one of them, on a thread of its own.
pub fn serve_agents(lab: &Arc<Lab>, agent: fn(&Lab, usize, Schedule)) {
    let counts = Arc::new(AtomicBool::new(false));
    let (done, all_done) = mpsc::channel();
    let began = Instant::now();
    for number in 0..AGENTS {
        let schedule = Schedule {
            next: began + INTERVAL * number as u32 / AGENTS as u32,
            counts: Arc::clone(&counts),
            left: CONTEXTS,
            done: done.clone(),
        };
        let lab = Arc::clone(lab);
        thread::spawn(move || agent(&lab, number, schedule));
    }
    assert_eq!(next_line().as_deref(), Some("begin"));
    counts.store(true, Ordering::Relaxed);
    (0..AGENTS).for_each(|_| all_done.recv().unwrap());
    println!("done");
    // Until it is killed.
    next_line();
}

/// Returns a machine's context, which is a message of about 600 bytes.
fn context(node: &str) -> MachineContext {
    let traffic = |packets| InterfaceTraffic {
        packets,
        bytes: packets * 700,
        throughput_bps: Some(8_123_456.5),
        ..InterfaceTraffic::default()
    };
    MachineContext {
        node: NodeId::new(node).unwrap(),
        cpu: Some(CpuContext { cpus: 4, busy: Probability::new(0.25) }),
        load_average: Some(LoadAverage { one_minute: 0.51, five_minutes: 0.32, fifteen_minutes: 0.2 }),
        memory: Some(MemoryContext { memory_bytes: 8_123_000_000, available_bytes: 2_123_000_000 }),
        interfaces: vec![InterfaceContext {
            name: "eth0".to_owned(),
            up: true,
            carrier: true,
            speed: BitRate::from_bits_per_second(1_000_000_000),
            mtu_bytes: 1500,
            received: traffic(12_345_678),
            sent: traffic(2_345_678),
        }],
        ..base::machine_context("machine")
    }
}
