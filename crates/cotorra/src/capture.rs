//! `cotorra capture`: writes the packets that cross a link of the running testbed to a pcapng file.

use std::{
    io::{self, BufWriter, Read, Write},
    path::{Path, PathBuf},
    sync::mpsc::{self, Receiver, RecvTimeoutError},
    thread,
    time::Duration,
};

use clap::Args;
use cotorra_graph::LinkId;
use cotorra_pcap::Blocks;
use cotorra_plugin::runs::Runs;
use cotorra_testbed::create_capture;
use indicatif::ProgressBar;
use miette::{IntoDiagnostic, WrapErr};

use crate::{
    duration::parse_duration,
    running::{WhichRun, explained, token_text},
    signals,
};

/// Interval of looks at the clock and for Ctrl-C.
const TICK: Duration = Duration::from_millis(100);
/// Bytes that are read at once.
const CHUNK: usize = 64 << 10;
/// Chunks that wait to be written. The run misses packets while they do.
const CHUNKS: usize = 64;

/// Write the packets that cross a link of the running testbed to a file for Wireshark
///
/// The file is in the format pcapng. Each packet has a comment with the times at which it entered the link, was due, and was
/// delivered. The capture ends with Ctrl-C, with a limit, or with the run. See docs/use/capture.md.
///
/// EXPR is made of `ip`, `ip6`, `arp`, `icmp`, `icmp6`, `tcp`, `udp`, `[tcp|udp] [src|dst] port N` and `[src|dst] host
/// NODE-OR-ADDRESS`, with `not`, `and`, `or` and parentheses. It is a subset of pcap-filter(7).
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra capture lan-cloud -o cloud.pcapng
  cotorra capture robot -o robot.pcapng --filter 'udp and host edge' --duration 30s
  cotorra capture robot~R1 -o - | wireshark -k -i -                live
  tshark -r cloud.pcapng -T fields -e frame.time_epoch -e frame.comment")]
pub struct CaptureArgs {
    /// The link, or the node whose links are captured
    #[arg(value_name = "LINK|NODE")]
    pub of: LinkId,
    /// The file, which must not exist; `-` for standard output
    #[arg(long, short, value_name = "FILE")]
    pub output: PathBuf,
    /// Capture only packets of this kind, such as 'tcp port 80'
    #[arg(long, value_name = "EXPR")]
    pub filter: Option<String>,
    /// Keep only this many bytes of each packet
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u32).range(1..=262_144))]
    pub snap: Option<u32>,
    /// End after this time, such as 30s
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub duration: Option<Duration>,
    /// End after this number of packets
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub packets: Option<u64>,
    /// End before the file is larger
    #[arg(long, value_name = "MEGABYTES", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub size: u64,
    #[command(flatten)]
    pub run: WhichRun,
}

/// Captures until a limit is reached, the run ends, or Ctrl-C.
pub fn capture(args: &CaptureArgs) -> miette::Result<()> {
    let interrupts = signals::listen()?;
    let (run, client) = args.run.find(&Runs::of_user(), token_text())?;
    let stream = client
        .capture(&args.of, args.filter.as_deref(), args.snap)
        .map_err(|error| explained(run.api, error))?;
    let is_stdout = args.output == Path::new("-");
    let mut file: Box<dyn Write> = match is_stdout {
        true => Box::new(io::stdout().lock()),
        false => Box::new(BufWriter::new(create_capture(&args.output).into_diagnostic()?)),
    };
    let mut blocks = Blocks::new(args.packets.unwrap_or(u64::MAX), args.size * 1_000_000);
    let progress = ProgressBar::new_spinner();
    let written = copy(read(stream), &interrupts, args.duration, &mut blocks, &mut file, &progress);
    progress.finish_and_clear();
    match written {
        // The reader of standard output has seen enough.
        Err(error) if is_stdout && error.kind() == io::ErrorKind::BrokenPipe => {}
        written => {
            written.into_diagnostic().wrap_err_with(|| format!("cannot write {}", args.output.display()))?
        }
    }
    let place = if is_stdout { "standard output".to_owned() } else { args.output.display().to_string() };
    note!("{} packets in {place}{}", blocks.packets(), missed(blocks.missed()));
    if blocks.are_full() && args.packets != Some(blocks.packets()) {
        note!("the capture ended because more than {} MB would be too large: see --size", args.size);
    }
    Ok(())
}

/// Reads a stream on a thread of its own, because reading waits for packets. A stream that breaks off has ended.
fn read(mut stream: impl Read + Send + 'static) -> Receiver<Vec<u8>> {
    let (sender, chunks) = mpsc::sync_channel(CHUNKS);
    thread::spawn(move || {
        let mut buffer = vec![0; CHUNK];
        while let Ok(length @ 1..) = stream.read(&mut buffer) {
            if sender.send(buffer[..length].to_vec()).is_err() {
                return;
            }
        }
    });
    chunks
}

/// Writes whole blocks until one of the ends.
#[allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "the user chooses how long a capture lasts"
)]
fn copy(
    chunks: Receiver<Vec<u8>>,
    interrupts: &Receiver<()>,
    duration: Option<Duration>,
    blocks: &mut Blocks,
    file: &mut dyn Write,
    progress: &ProgressBar,
) -> io::Result<()> {
    let began = std::time::Instant::now();
    let goes_on = || duration.is_none_or(|duration| began.elapsed() < duration);
    while !blocks.are_full() && goes_on() && interrupts.try_recv().is_err() {
        match chunks.recv_timeout(TICK) {
            Ok(chunk) => file.write_all(blocks.take(&chunk))?,
            // Readers of a pipe, and of a growing file, see packets at once.
            Err(RecvTimeoutError::Timeout) => file.flush()?,
            Err(RecvTimeoutError::Disconnected) => break,
        }
        progress.set_message(format!("{} packets{}", blocks.packets(), missed(blocks.missed())));
        progress.tick();
    }
    file.flush()
}

/// Says how many packets were missed, if any.
fn missed(packets: u64) -> String {
    match packets {
        0 => String::new(),
        missed => format!(", {missed} missed"),
    }
}
