//! `cotorra bench vnf`: measures the CPU time of a VNF's requests, and writes it as a demand.

use std::{
    fs,
    io::{self, BufRead as _, BufReader},
    net::{Ipv4Addr, UdpSocket},
    path::PathBuf,
    process::{Child, Command, ExitCode, Stdio},
    sync::mpsc,
    thread,
    time::Duration,
};

use clap::Args;
use cotorra_datapath::cpu_time_of;
use cotorra_engine::program_of;
use cotorra_graph::{NodeId, Program, Testbed, Vnf, VnfId};
use cotorra_numbers::quantile_of_times;
use cotorra_testbed::{Machine, first_requests};
use indicatif::{ProgressBar, ProgressStyle};
use miette::Diagnostic;

use super::image::in_ms;
use crate::{exit::Status, output, signals, table::Table, testbed_file, words::count};

/// Wait for an answer to the first request, before it is sent once more.
const FIRST_WAIT: Duration = Duration::from_millis(50);
/// Longest wait for the answer to another one.
const LONGEST_WAIT: Duration = Duration::from_secs(1);
/// Pause after an answer, until the program has done what it does after it.
const PAUSE: Duration = Duration::from_millis(1);

/// Measure the CPU time of a VNF's requests
///
/// Starts the program of a bundled VNF alone, without limits and without its demand. It gets the requests that its robot sends
/// on its walk in virtual time, one after the other. The CPU time of each that is answered goes into a file for
/// `demand: { samples: FILE }`. The times are those of this machine, whose CPUs therefore have `speed: 1`.
///
/// A COMMAND takes the place of the program. It gets its UDP port as COTORRA_PORT, the testbed file as COTORRA_TESTBED, and its
/// robot as COTORRA_ROBOT.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra bench vnf testbeds/corridor.yaml --vnf navigation
  cotorra bench vnf testbeds/corridor.yaml --vnf localization --requests 200 --out demand.csv
  cotorra bench vnf testbeds/corridor.yaml --vnf navigation -- python3 brain.py

Exit status: 0 done, 1 error, 2 wrong usage, 130 stopped with Ctrl-C; nothing is written.")]
pub struct VnfArgs {
    /// The testbed file
    pub file: PathBuf,
    /// The VNF
    #[arg(long, value_name = "NAME")]
    pub vnf: VnfId,
    /// Number of requests, up to 100000; fewer if the walk ends before
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub requests: u32,
    /// File for the times, as CSV
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Command in place of the program
    #[arg(last = true, value_name = "COMMAND")]
    pub command: Vec<String>,
}

#[derive(Debug, thiserror::Error, Diagnostic)]
enum Error {
    #[error("the testbed has no VNF `{0}`")]
    NoVnf(VnfId),
    #[error("VNF `{0}` is no bundled VNF, navigation or localization")]
    #[diagnostic(help(
        "name one with `program: navigation` or `program: localization`; with `-- COMMAND`, yours takes its place"
    ))]
    NotBundled(VnfId),
    #[error(transparent)]
    Run(#[from] cotorra_testbed::RunError),
    #[error("VNF `{0}` gets no requests")]
    #[diagnostic(help("its robot needs a walk"))]
    NoRequests(VnfId),
    #[error("cannot start the program: {0}")]
    Start(String),
    #[error("the program {0} before it answered all requests")]
    Ended(String),
    #[error("no request was answered")]
    NoAnswers,
    #[error("cannot measure: {0}")]
    System(#[from] io::Error),
    #[error("cannot write {}: {source}", file.display())]
    Write { file: PathBuf, source: io::Error },
    #[error(transparent)]
    Signals(#[from] signals::SignalsError),
}

/// Measures a VNF, and prints the table.
pub fn vnf(args: &VnfArgs) -> miette::Result<ExitCode> {
    let loaded = testbed_file::load(&args.file, &[])?;
    let (vnf, robot) = find(&loaded.testbed, &args.vnf)?;
    let seed = loaded.testbed.seed;
    let requests = first_requests(loaded.testbed.clone(), seed, &args.vnf, args.requests as usize)
        .map_err(Error::from)?;
    if requests.is_empty() {
        return Err(Error::NoRequests(args.vnf.clone()).into());
    }
    let interrupts = signals::listen().map_err(Error::from)?;
    let mut program = Started::start(args, &vnf, &robot)?;
    let style =
        ProgressStyle::with_template("{bar:30} {pos} of {len} requests").expect("a template that is right");
    let progress = ProgressBar::new(requests.len() as u64).with_style(style);
    let times = program.measure(&requests, &interrupts, &progress);
    progress.finish_and_clear();
    let Some(times) = times? else {
        note!("stopped; nothing is written");
        return Ok(Status::Interrupted.into());
    };
    if times.is_empty() {
        return Err(Error::NoAnswers.into());
    }
    if let Some(file) = &args.out {
        let lines = times.iter().map(|time| format!("{:.6}\n", time.as_secs_f64() * 1e3));
        let text: String = ["cpu_time_ms\n".to_owned()].into_iter().chain(lines).collect();
        fs::write(file, text).map_err(|source| Error::Write { file: file.clone(), source })?;
    }
    output::print(&describe(args, requests.len(), times))?;
    Ok(ExitCode::SUCCESS)
}

/// Finds a bundled VNF and the robot that it serves.
fn find(testbed: &Testbed, id: &VnfId) -> Result<(Vnf, NodeId), Error> {
    let of_service = |service: &cotorra_graph::Service| {
        service.vnfs.iter().find(|vnf| vnf.id == *id).map(|vnf| (vnf.clone(), service.robot.clone()))
    };
    let found = testbed.services.iter().find_map(of_service);
    let found = found.ok_or_else(|| Error::NoVnf(id.clone()))?;
    matches!(found.0.program, Program::Navigation | Program::Localization)
        .then_some(found)
        .ok_or_else(|| Error::NotBundled(id.clone()))
}

/// A program that answers requests. It is killed on drop.
struct Started {
    child: Child,
    socket: UdpSocket,
}

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Started {
    fn start(args: &VnfArgs, vnf: &Vnf, robot: &NodeId) -> Result<Self, Error> {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        let port = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?.port();
        socket.connect((Ipv4Addr::LOCALHOST, port))?;
        let mut command = match &args.command[..] {
            [] => bundled(&vnf.program),
            words => program_of(words, &vnf.env).map_err(Error::Start)?,
        };
        command
            .env(cotorra_vnfs::TESTBED, args.file.canonicalize()?)
            .env(cotorra_vnfs::ROBOT, robot.as_str());
        command.env(cotorra_vnfs::PORT, port.to_string());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let mut child = command.spawn().map_err(|error| Error::Start(error.to_string()))?;
        if let Some(stdout) = child.stdout.take() {
            // A pipe that nobody reads would block the program.
            thread::spawn(move || BufReader::new(stdout).lines().map_while(Result::ok).for_each(drop));
        }
        Ok(Self { child, socket })
    }

    /// Sends requests, and returns the CPU times of those that are answered; `None` if Ctrl-C stopped it.
    fn measure(
        &mut self,
        requests: &[Vec<u8>],
        interrupts: &mpsc::Receiver<()>,
        progress: &ProgressBar,
    ) -> Result<Option<Vec<Duration>>, Error> {
        let goes_on = || interrupts.try_recv().is_err();
        self.socket.set_read_timeout(Some(FIRST_WAIT))?;
        // It answers as soon as it serves. Its first answer can take longer than others, and does not count.
        while !self.is_answered(&requests[0])? {
            if !goes_on() {
                return Ok(None);
            }
        }
        while self.socket.recv(&mut [0; 1]).is_ok() {}
        self.socket.set_read_timeout(Some(LONGEST_WAIT))?;
        let mut times = Vec::new();
        for request in &requests[1..] {
            if !goes_on() {
                return Ok(None);
            }
            let before = self.cpu_time()?;
            let answered = self.is_answered(request)?;
            pause();
            if answered {
                times.push(self.cpu_time()?.saturating_sub(before));
            }
            progress.inc(1);
        }
        Ok(Some(times))
    }

    fn cpu_time(&self) -> Result<Duration, Error> {
        Ok(cpu_time_of(self.child.id())?)
    }

    /// Sends a request. Returns whether an answer comes in time.
    fn is_answered(&mut self, request: &[u8]) -> Result<bool, Error> {
        if let Some(status) = self.child.try_wait()? {
            return Err(Error::Ended(format!("ended with {status}")));
        }
        // Nobody listens at its port before it serves, which the system says.
        if self.socket.send(request).is_err() {
            pause();
            return Ok(false);
        }
        match self.socket.recv(&mut [0; 2048]) {
            Ok(_) => Ok(true),
            Err(_) => {
                pause();
                Ok(false)
            }
        }
    }
}

/// Returns the command of a bundled VNF. Without the name of its VNF, it has no demand.
fn bundled(program: &Program) -> Command {
    let mut command = Command::new("/proc/self/exe");
    let word = if *program == Program::Localization { "localization" } else { "navigation" };
    command.args(["vnf", word]);
    command
}

#[allow(clippy::disallowed_methods, reason = "a program works in real time")]
fn pause() {
    thread::sleep(PAUSE);
}

fn describe(args: &VnfArgs, requests: usize, mut times: Vec<Duration>) -> String {
    times.sort_unstable();
    let of = |share| quantile_of_times(&times, share).map(in_ms).unwrap_or_default();
    let mut table = Table::new("<>>>>");
    table.row(["", "median", "p95", "min", "max"]);
    table.row(["CPU time of a request".to_owned(), of(0.5), of(0.95), of(0.0), of(1.0)]);
    let mean = times.iter().sum::<Duration>().div_f64(times.len() as f64);
    let written = args.out.as_ref().map_or_else(String::new, |file| {
        format!("\nwritten to {0}: demand: {{ samples: {0} }}\n", file.display())
    });
    // The first request counts neither as answered nor as unanswered.
    let unanswered = (requests - 1).saturating_sub(times.len());
    let unanswered =
        if unanswered == 0 { String::new() } else { format!(", {unanswered} without an answer") };
    format!(
        "{}, {}{unanswered}, mean {}, on {}\n\n{}{written}",
        args.vnf,
        count(times.len(), "request"),
        in_ms(mean),
        Machine::this().cpu,
        table.render("")
    )
}
