//! `cotorra bench image`: measures how long an image takes to start and to answer, and writes both into a testbed file.

mod bare;
mod node;
mod request;
mod times;
mod write;

use std::{
    path::PathBuf,
    process::ExitCode,
    sync::{Arc, mpsc},
    thread,
    time::Duration,
};

use clap::{Args, ValueEnum};
use cotorra_containers::NoEngine;
use cotorra_datapath::enter_user_namespace_if_needed;
use cotorra_graph::{EngineKind, Image, ListenPort, Nodes, Program, Rights, Transport, Vnf, VnfId};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use miette::Diagnostic;

use crate::{exit::Status, logs, output, signals, table::Table, temporary::TemporaryFolder, words::count};
use node::{Interrupt, Message, Node};
use request::Request;
use times::Times;
pub use times::in_ms;
use write::Target;

/// Requests that are measured.
const REQUESTS: usize = 100;

/// Measure how long an image takes to start and to answer
///
/// Starts the image in a container several times, each time as a run does: in a network namespace without other networks,
/// with the limits of a VNF. It is ready once it listens at all of its ports. A first start, which may pull the image, is
/// not counted. For comparison, the engine's own program starts the image as often.
///
/// With `--udp` or `--http`, the last container gets 100 requests, one after the other, from within its namespace.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra bench image lab/planner:2 --port 8080
  cotorra bench image lab/planner:2 --http 8080/plan --runs 20 --engine docker
  cotorra bench image lab/brain:1 --udp 9000 --payload ping -- brain --fast
  cotorra bench image lab/planner:2 --http 8080/plan --write testbed.yaml --vnf planner

Exit status: 0 done, 1 error, 2 wrong usage, 130 stopped with Ctrl-C; no container is left.")]
pub struct ImageArgs {
    /// The image, such as lab/planner:2
    pub image: String,
    /// Command in the container; default: the image's own
    #[arg(last = true, value_name = "WORD")]
    pub command: Vec<String>,
    /// The engine that runs it
    #[arg(long, value_enum, default_value = "podman")]
    pub engine: EngineWord,
    /// A port at which it listens once it is ready: 8080, 8080/tcp or 9000/udp; repeatable
    #[arg(long = "port", value_name = "PORT", value_parser = parse_port)]
    pub ports: Vec<ListenPort>,
    /// Number of starts, up to 1000
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub runs: u16,
    /// A variable for the container: NAME=VALUE, or NAME with the value that it has here; repeatable
    #[arg(long = "env", value_name = "NAME")]
    pub env: Vec<String>,
    /// CPUs that the container may take
    #[arg(long, value_name = "N", default_value_t = 1.0, value_parser = parse_cpus)]
    pub cpus: f64,
    /// Memory that the container may take, in MB
    #[arg(long, value_name = "MB", default_value_t = 256, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub memory: u64,
    /// Measure the time from a datagram to this UDP port until its answer
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..), conflicts_with = "http")]
    pub udp: Option<u16>,
    /// Content of the datagrams
    #[arg(long, value_name = "TEXT", default_value = "ping", requires = "udp")]
    pub payload: String,
    /// Measure the time of a GET request over HTTP, such as 8080/plan, from its connection to the end of its answer
    #[arg(long, value_name = "PORT[/PATH]", value_parser = request::parse_http)]
    pub http: Option<Request>,
    /// Write the medians into this testbed file, as `start_time` and `processing_delay` of a VNF
    #[arg(long, value_name = "FILE", requires = "vnf")]
    pub write: Option<PathBuf>,
    /// The VNF in the testbed file
    #[arg(long, value_name = "NAME", requires = "write")]
    pub vnf: Option<VnfId>,
}

/// An engine of containers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EngineWord {
    /// podman
    Podman,
    /// Docker
    Docker,
}

impl EngineWord {
    fn kind(self) -> EngineKind {
        match self {
            Self::Podman => EngineKind::Podman,
            Self::Docker => EngineKind::Docker,
        }
    }
}

fn parse_port(text: &str) -> Result<ListenPort, String> {
    let (port, transport) = match text.split_once('/') {
        None | Some((_, "tcp")) => (text.trim_end_matches("/tcp"), Transport::Tcp),
        Some((port, "udp")) => (port, Transport::Udp),
        _ => ("", Transport::Tcp),
    };
    match port.parse() {
        Ok(port @ 1..) => Ok(ListenPort { port, transport }),
        _ => Err("write it like 8080, 8080/tcp or 9000/udp".to_owned()),
    }
}

fn parse_cpus(text: &str) -> Result<f64, String> {
    let cpus = text.parse().ok().filter(|cpus| *cpus > 0.0 && *cpus <= 1024.0);
    cpus.ok_or_else(|| "write a number above 0, such as 0.5 or 2".to_owned())
}

#[derive(Debug, thiserror::Error, Diagnostic)]
enum Error {
    #[error("no engine for the image: {0}")]
    #[diagnostic(help("choose one with `--engine podman` or `--engine docker`"))]
    NoEngine(#[from] NoEngine),
    #[error(transparent)]
    #[diagnostic(help("`cotorra doctor` says what this machine can do, and what to do about the rest"))]
    Datapath(#[from] cotorra_datapath::Error),
    #[error("cannot prepare containers: {0}")]
    System(#[from] std::io::Error),
    #[error(transparent)]
    Signals(#[from] signals::SignalsError),
    #[error(transparent)]
    Folder(#[from] cotorra_testbed::FolderError),
    /// A container did not serve; with the end of its output.
    #[error("`{image}` does not serve: {reason}{output}")]
    Failed { image: String, reason: String, output: String },
    #[error("{request} failed: {reason}")]
    Request { request: Request, reason: String },
}

/// Figures of an image.
struct Measured {
    start: Times,
    bare: Result<Times, String>,
    processing: Option<Times>,
}

/// Measures an image, and prints the table.
pub fn image(args: &ImageArgs) -> miette::Result<ExitCode> {
    let target = match (&args.write, &args.vnf) {
        (Some(file), Some(vnf)) => Some(Target::open(file, vnf)?),
        _ => None,
    };
    let address = cotorra_containers::Address::find(args.engine.kind()).map_err(Error::from)?;
    // Before the first thread starts.
    enter_user_namespace_if_needed().map_err(Error::from)?;
    let (messages, inbox) = mpsc::channel();
    let interrupt = Arc::new(Interrupt::default());
    listen(&interrupt, messages.clone())?;
    let terminal = MultiProgress::new();
    let _log = logs::begin(0, &terminal);
    let style = ProgressStyle::with_template("{spinner} {wide_msg}").expect("a template that is right");
    let progress = terminal.add(ProgressBar::new_spinner().with_style(style));
    progress.enable_steady_tick(Duration::from_millis(120));
    let measured = TemporaryFolder::new().map_err(Error::from).and_then(|folder| {
        let node = Node::new(args.engine.kind(), address, folder.path(), messages)?;
        measure(args, node, inbox, &interrupt, &progress)
    });
    progress.finish_and_clear();
    let Some(measured) = measured? else {
        note!("stopped; no container is left");
        return Ok(Status::Interrupted.into());
    };
    output::print(&describe(args, &measured))?;
    if let Some(target) = target {
        let written = target.write(&measured.start, measured.processing.as_ref())?;
        output::print(&format!("\n{written}\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Notes the first Ctrl-C, and wakes whoever waits for a message.
fn listen(interrupt: &Arc<Interrupt>, messages: mpsc::Sender<Message>) -> Result<(), Error> {
    let signals = signals::listen()?;
    let interrupt = Arc::clone(interrupt);
    thread::spawn(move || {
        if signals.recv().is_ok() {
            interrupt.raise();
            // The measurement may be over.
            let _ = messages.send(Message::Interrupted);
        }
    });
    Ok(())
}

/// Measures an image; `None` if Ctrl-C stopped it.
fn measure(
    args: &ImageArgs,
    mut node: Node,
    inbox: mpsc::Receiver<Message>,
    interrupt: &Interrupt,
    progress: &ProgressBar,
) -> Result<Option<Measured>, Error> {
    let (vnf, request) = (vnf(args), request(args));
    let fail = |reason: String, output| Error::Failed { image: args.image.clone(), reason, output };
    let mut start = Vec::new();
    let mut processing = None;
    for run in 0..=args.runs {
        let what = match run {
            0 => "the first start, which is not counted".to_owned(),
            run => format!("start {run} of {}", args.runs),
        };
        progress.set_message(what.clone());
        let wait = || {
            let waits = format!("{what}: waits for {}; Ctrl-C ends this", ports(&vnf));
            if progress.is_hidden() {
                note!("{waits}");
            }
            progress.set_message(waits);
        };
        let Some(started) = node.start(&vnf, &inbox, &wait).map_err(|reason| fail(reason, node.output()))?
        else {
            return Ok(None);
        };
        if run > 0 {
            start.push(started);
        }
        if let Some(request) = request.as_ref().filter(|_| run == args.runs) {
            progress.set_message(format!("{REQUESTS} requests, {request}"));
            let answered = node.namespace().run(|| request.repeat(REQUESTS, &|| !interrupt.is_raised()));
            let failed = |reason: std::io::Error| Error::Request {
                request: request.clone(),
                reason: reason.to_string(),
            };
            processing = Times::of(answered.map_err(failed)?);
        }
        node.stop();
        if interrupt.is_raised() {
            return Ok(None);
        }
    }
    let bare = bare::starts(args, node.engine(), |run| {
        progress.set_message(format!("start {run} of {} without cotorra", args.runs));
        !interrupt.is_raised()
    });
    if interrupt.is_raised() {
        return Ok(None);
    }
    let start = Times::of(start).expect("at least one start was measured");
    Ok(Some(Measured { start, bare, processing }))
}

/// Returns the VNF that the image is.
fn vnf(args: &ImageArgs) -> Vnf {
    let mut ports = args.ports.clone();
    ports.extend(request(args).map(|request| request.port()));
    ports.sort();
    ports.dedup();
    Vnf {
        id: VnfId::new("image").expect("a name that is right"),
        program: Program::Command(args.command.clone()),
        cpus: args.cpus,
        memory_bytes: args.memory * 1_000_000,
        pinned_to: None,
        node: Nodes::from(node::id()),
        env: args.env.clone(),
        rights: Rights::default(),
        keep: false,
        image: Some(Box::new(Image { reference: args.image.clone(), ports, ..Image::default() })),
        cpu_limit: None,
        start: Duration::ZERO,
        computing: None,
        state: None,
    }
}

fn request(args: &ImageArgs) -> Option<Request> {
    let udp = args.udp.map(|port| Request::Udp { port, payload: args.payload.clone() });
    udp.or_else(|| args.http.clone())
}

/// Lists the ports of a VNF.
fn ports(vnf: &Vnf) -> String {
    let ports =
        vnf.image.iter().flat_map(|image| &image.ports).map(ListenPort::to_string).collect::<Vec<_>>();
    if ports.is_empty() { "its container".to_owned() } else { format!("a listener at {}", ports.join(", ")) }
}

/// Describes what was measured, as a table.
fn describe(args: &ImageArgs, measured: &Measured) -> String {
    let mut table = Table::new("<>>>");
    table.row(["", "median", "min", "max"]);
    let mut row = |what: String, times: &Times| {
        let Times { median, min, max } = *times;
        table.row([vec![what], [median, min, max].map(times::in_ms).to_vec()].concat());
    };
    let vnf = vnf(args);
    let has_ports = vnf.image.iter().any(|image| !image.ports.is_empty());
    let until = if has_ports { ports(&vnf) } else { "its container runs (no --port)".to_owned() };
    row(format!("from its start until {}", until.replace("a listener at", "it listens at")), &measured.start);
    let mut notes = String::new();
    match &measured.bare {
        Ok(times) => row(format!("`{} run -d` alone", args.engine.kind().name()), times),
        Err(reason) => notes = format!("without `{} run -d`: {reason}\n", args.engine.kind().name()),
    }
    if let (Some(times), Some(request)) = (&measured.processing, request(args)) {
        row(format!("answer to {request}, {REQUESTS} times"), times);
    }
    let starts = count(args.runs.into(), "start");
    format!("{}, {}, {starts}\n\n{}{notes}", args.image, args.engine.kind().name(), table.render(""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_of_tcp_unless_they_say_udp() {
        let port = |port, transport| Ok(ListenPort { port, transport });
        assert_eq!(parse_port("8080"), port(8080, Transport::Tcp));
        assert_eq!(parse_port("8080/tcp"), port(8080, Transport::Tcp));
        assert_eq!(parse_port("9000/udp"), port(9000, Transport::Udp));
        for wrong in ["", "0", "65536", "80/sctp", "80/", "80/tcp/tcp", "/udp", "80:80", "udp/80"] {
            assert!(parse_port(wrong).is_err(), "{wrong}");
        }
    }
}
