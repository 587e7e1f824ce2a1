//! Time from an instruction to its effect: the core wants an instance, and its program runs at an agent. The same program is
//! started in turn by fork and exec alone, and behind a holder, as agents start all VNFs.

use std::{
    fs::{self, File},
    io::Read,
    os::unix::process::CommandExt,
    path::Path,
    process::{self, Child, Stdio},
    sync::mpsc,
    thread,
    time::{Duration, Instant},
};

use cotorra_agent_protocol::{ControllerEvent, WantedInstance};
use cotorra_engine::InstanceId;
use cotorra_graph::{NodeId, Program, Vnf};
use cotorra_graph_testing as base;

use crate::{
    core::{self, Command},
    lab::Lab,
    machine::Others,
};

const STARTS: usize = 400;
const WARM_UP: usize = 20;
/// Time between two starts, in which what the first one left comes to rest.
const PAUSE: Duration = Duration::from_millis(70);
/// Says that it runs, and stays.
const SCRIPT: &str = r#"echo >"$0"; exec sleep 1000"#;
const AGENT: &str = env!("CARGO_BIN_EXE_cotorra-agent");
/// Hides the control groups from an agent. To join one is to wait for the kernel, for longer than all the rest takes.
const WITHOUT_GROUPS: &str = r#"mount -t tmpfs none /sys/fs/cgroup && exec "$0" "$@""#;
const WITH_GROUPS: &str = r#"exec "$0" "$@""#;

pub fn measure() {
    let others = Others::begin();
    let folder = tempfile::tempdir().unwrap();
    let lab = Lab::create(folder.path(), 2);
    let signs = Signs::new(&folder.path().join("signs"));
    let words = ["/bin/sh", "-c", SCRIPT, &signs.path].map(str::to_owned);
    let wanted = wanted(&words);

    let (tell, events) = mpsc::channel();
    let commands = core::start(&lab, move |event| drop(tell.send(event)), |_context| {});
    let running = [WITHOUT_GROUPS, WITH_GROUPS].into_iter().zip(&lab.agents).map(|(script, agent)| {
        let mut command = process::Command::new("unshare");
        command.args(["--mount", "sh", "-c", script, AGENT, "run"]).arg(lab.credentials(agent));
        command.args(["--vnf-user", "0:0", "--state"]).arg(folder.path().join(format!("{agent}-state")));
        Ended(command.stdin(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
    });
    let running: Vec<_> = running.collect();
    for _ in &running {
        while !matches!(events.recv().unwrap(), ControllerEvent::Joined(_)) {}
    }

    let mut instances = (0..).map(InstanceId);
    let mut all = [const { Vec::new() }; 4];
    for start in 0..WARM_UP + STARTS {
        let (bare, child) =
            signs.time(|| process::Command::new(&words[0]).args(&words[1..]).spawn().unwrap());
        drop(Ended(child));
        thread::sleep(PAUSE);

        let (held, child) = signs.time(|| held(&words));
        drop(Ended(child));
        thread::sleep(PAUSE);

        let [without, with] = [0, 1].map(|agent| {
            let instance = instances.next().unwrap();
            let start_it = Command::Start(lab.agents[agent].clone(), instance, Box::new(wanted.clone()));
            let (instructed, ()) = signs.time(|| commands.send(start_it).unwrap());
            commands.send(Command::Stop(instance)).unwrap();
            thread::sleep(PAUSE);
            instructed
        });
        if start >= WARM_UP {
            all.iter_mut().zip([bare, held, without, with]).for_each(|(all, took)| all.push(took));
        }
    }
    drop(running);
    let [bare, held, without, with] = all.map(|mut took| {
        took.sort_unstable();
        [0.5, 0.99].map(|share| took[((took.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e3)
    });
    println!("start of a program, {STARTS} times        p50        p99    p50 and p99 over the first");
    for (name, [p50, p99]) in [
        ("by fork and exec", bare),
        ("behind a holder", held),
        ("by an instruction", without),
        ("... in control groups", with),
    ] {
        println!(
            "{name:<24} {p50:>10.2} ms {p99:>7.2} ms {:>7.2} ms {:>7.2} ms",
            p50 - bare[0],
            p99 - bare[1]
        );
    }
    println!("others used {} of the machine", others.share());
}

/// Starts a program as the agent does.
fn held(words: &[String]) -> Child {
    let mut command = process::Command::new(AGENT);
    command.args(["hold", "--"]).args(words).stdin(Stdio::piped()).process_group(0).spawn().unwrap()
}

fn wanted(words: &[String]) -> WantedInstance {
    let node = NodeId::new("machine").unwrap();
    let vnf = Vnf {
        program: Program::Command(words.to_vec()),
        node: node.clone().into(),
        ..base::vnf("program", "server")
    };
    WantedInstance { vnf, replica: 0, node, environment: Default::default(), keep: false }
}

/// Receives signs of programs that run.
struct Signs {
    path: String,
    arrivals: mpsc::Receiver<Instant>,
}

impl Signs {
    fn new(path: &Path) -> Self {
        assert!(process::Command::new("mkfifo").arg(path).status().unwrap().success());
        // Its own writing end keeps it open.
        let mut pipe = File::options().read(true).write(true).open(path).unwrap();
        let (arrive, arrivals) = mpsc::channel();
        thread::spawn(move || {
            loop {
                pipe.read_exact(&mut [0]).unwrap();
                if arrive.send(Instant::now()).is_err() {
                    return;
                }
            }
        });
        Self { path: fs::canonicalize(path).unwrap().to_str().unwrap().to_owned(), arrivals }
    }

    /// Returns the time from a start until its program runs, and what the start returned.
    fn time<T>(&self, start: impl FnOnce() -> T) -> (Duration, T) {
        let began = Instant::now();
        let started = start();
        let arrived = self.arrivals.recv_timeout(Duration::from_secs(60)).expect("the program runs");
        (arrived - began, started)
    }
}

/// A process that ends with this. A holder ends its program, and itself, when its input ends; others are killed.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        if self.0.stdin.take().is_none() {
            self.0.kill().unwrap();
        }
        self.0.wait().unwrap();
    }
}
