//! Measurements of peers: rattan between two sockets of our own, and Mininet by the time that it prints.

use std::{
    env, io,
    net::{Ipv4Addr, TcpListener, UdpSocket},
    process::{Command, Output, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use cotorra_datapath::Namespace;

use super::{
    emulator::{Percentiles, echo, receive},
    probe::PORT,
    report::Bench,
};

/// Reason why a peer was not measured.
#[derive(Debug, thiserror::Error)]
pub enum Missing {
    #[error("not installed ({0})")]
    NotInstalled(&'static str),
    #[error("needs root")]
    NeedsRoot,
    #[error("{0}")]
    Failed(String),
}

impl From<io::Error> for Missing {
    fn from(error: io::Error) -> Self {
        Self::Failed(error.to_string())
    }
}

/// Measures round trips through rattan with a delay in each direction.
pub fn rattan_round_trips(bench: &Bench, one_way: Duration, count: usize) -> Result<Percentiles, Missing> {
    // rattan's interfaces are removed with the namespace.
    namespace()?.run(|| {
        let server = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, PORT))?;
        server.set_read_timeout(Some(Duration::from_secs(1)))?;
        let done = AtomicBool::new(false);
        let one_way_us = one_way.as_micros().to_string();
        let printed = thread::scope(|scope| {
            scope.spawn(|| echo(&server, &done));
            let delay = format!("{one_way_us}us");
            let link = ["--uplink-delay", &delay, "--downlink-delay", &delay];
            let printed = rattan(bench, &link, &["round-trips", &one_way_us, &count.to_string()]);
            done.store(true, Ordering::Relaxed);
            printed
        })?;
        // rattan writes its log to standard output, too.
        let last = printed.lines().next_back().unwrap_or_default();
        let nanos = last.split_whitespace().map(|word| word.parse().map(Duration::from_nanos));
        match nanos.collect::<Result<Vec<_>, _>>().as_deref() {
            Ok(&[p50, p99, max]) => Ok(Percentiles { p50, p99, max }),
            _ => Err(Missing::Failed(format!("our probe inside it errors {last:?}"))),
        }
    })
}

/// Measures the throughput of TCP through rattan in bit/s.
pub fn rattan_throughput(bench: &Bench, length: Duration) -> Result<f64, Missing> {
    namespace()?.run(|| {
        let listener = TcpListener::bind((Ipv4Addr::UNSPECIFIED, PORT))?;
        thread::scope(|scope| {
            let received = scope.spawn(|| receive(&listener, length));
            rattan(bench, &["--uplink-delay", "0us", "--downlink-delay", "0us"], &["send"])?;
            Ok(received.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?)
        })
    })
}

fn namespace() -> Result<Namespace, Missing> {
    Namespace::new().map_err(|error| Missing::Failed(error.to_string()))
}

/// Fails if rattan cannot be measured. Called before its measurements.
pub fn check_rattan(bench: &Bench) -> Result<(), Missing> {
    let version =
        Command::new(&bench.rattan).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    match version {
        Err(_) => Err(Missing::NotInstalled("cargo install rattan, or --rattan PATH")),
        Ok(_) if !bench.root => Err(Missing::NeedsRoot),
        Ok(_) => Ok(()),
    }
}

/// Runs our probe at the far side of a rattan link. Returns what it printed.
fn rattan(bench: &Bench, link: &[&str], probe: &[&str]) -> Result<String, Missing> {
    let mut command = Command::new(&bench.rattan);
    command.arg("link").args(link).arg("--").arg(env::current_exe()?).arg("probe").args(probe);
    succeed(command.output()?).map(|(printed, _)| printed)
}

/// Measures how long Mininet takes to bring hosts in a line of switches up and down, by its own clock.
pub fn mininet(bench: &Bench, hosts: usize) -> Result<Duration, Missing> {
    let topology = format!("linear,{hosts}");
    let mut command = Command::new("mn");
    // Linux bridges and no controller are its fastest configuration.
    command.args(["--topo", &topology, "--switch", "lxbr", "--controller", "none", "--test", "none"]);
    let output = match command.output() {
        Err(_) => return Err(Missing::NotInstalled("apt-get install mininet bridge-utils")),
        Ok(_) if !bench.root => return Err(Missing::NeedsRoot),
        Ok(output) => output,
    };
    let (printed, errors) = succeed(output)?;
    // Its last line is "completed in 6.543 seconds".
    let text = printed + &errors;
    let seconds =
        text.rsplit_once("completed in ").and_then(|(_, rest)| rest.split_whitespace().next()?.parse().ok());
    let seconds = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    seconds.ok_or_else(|| Missing::Failed("it did not say how long it took".to_owned()))
}

fn succeed(output: Output) -> Result<(String, String), Missing> {
    let [printed, errors] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    if output.status.success() {
        return Ok((printed, errors));
    }
    let lines = || errors.lines().map(str::trim).filter(|line| !line.is_empty());
    let why =
        lines().find(|line| line.contains("annot") || line.contains("rror")).or_else(|| lines().next_back());
    Err(Missing::Failed(format!("{}: {}", output.status, why.unwrap_or("no message"))))
}
