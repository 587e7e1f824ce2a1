//! `cotorra stamp`: measures a path of any network by STAMP (RFC 8762), and reflects such measurements.
//!
//! `cotorra_stamp` implements the protocol.

use std::{
    fs,
    io::{ErrorKind, Write as _},
    net::{SocketAddr, ToSocketAddrs, UdpSocket},
    num::NonZero,
    path::PathBuf,
    time::Duration,
};

use clap::{Args, Subcommand};
use cotorra_stamp::{
    Answer, Clock, Delays, ErrorEstimate, Measurement, PORT, Reflector, Sender, SessionConfig, receive,
};
use cotorra_testbed::DataTable;
use indicatif::{ProgressBar, ProgressStyle};
use miette::{IntoDiagnostic, WrapErr, miette};

use crate::{duration::parse_duration, output, signals};

/// Size of the receive buffer in octets, larger than any datagram.
const LARGEST: usize = 65_536;

/// Poll interval for Ctrl-C.
const NOTICE: Duration = Duration::from_millis(100);

/// Error estimate of this process's timestamps: the clock is read some microseconds after a packet arrived.
const CLOCK_ERROR: Duration = Duration::from_micros(100);

/// The two sides of a measurement.
#[derive(Debug, Subcommand)]
pub enum Stamp {
    Send(SendArgs),
    Reflect(ReflectArgs),
}

/// Measure delay, jitter and loss to a reflector
///
/// The reflector can be any that speaks STAMP or TWAMP Light. The time that a packet spends in it is not counted. If both
/// clocks are synchronised to UTC, and both sides say so by --synchronized, each direction is measured separately.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra stamp send 192.0.2.7
  cotorra stamp send robot.lab:8620 --count 1000 --interval 10ms --length 256
  cotorra stamp send 192.0.2.7 --synchronized --json
  cotorra stamp send 192.0.2.7 --count 1200 --packets edge.csv    # for cotorra calibrate

Exit status: 0 measured, 1 no answer or another error, 2 wrong usage.")]
pub struct SendArgs {
    /// The reflector; default port: 862
    #[arg(value_name = "HOST[:PORT]")]
    reflector: String,
    /// Number of packets to send
    #[arg(short, long, value_name = "N", default_value = "100")]
    count: NonZero<u32>,
    /// Interval between packets
    #[arg(short, long, value_name = "DURATION", default_value = "100ms", value_parser = parse_duration)]
    interval: Duration,
    /// Length of a packet in octets, without headers
    #[arg(short, long, value_name = "N", default_value_t = 44, value_parser = clap::value_parser!(u16).range(44..=65_507))]
    length: u16,
    /// Deadline of a reply
    #[arg(long, value_name = "DURATION", default_value = "1s", value_parser = parse_duration)]
    patience: Duration,
    /// Declare that this machine's clock is synchronised to UTC
    #[arg(long)]
    synchronized: bool,
    /// Declare that the reflector is stateless: it does not count packets, so the direction of a loss is unknown
    #[arg(long)]
    stateless: bool,
    /// Print one JSON object, with times in milliseconds
    #[arg(long)]
    json: bool,
    /// Write the times of each packet to a new file, as CSV
    #[arg(long, value_name = "FILE")]
    packets: Option<PathBuf>,
}

/// Reflect packets of measurements until Ctrl-C
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra stamp reflect
  cotorra stamp reflect --listen 127.0.0.1:8620 --synchronized")]
pub struct ReflectArgs {
    /// Address to listen on
    #[arg(long, value_name = "ADDR:PORT", default_value = "0.0.0.0:862")]
    listen: SocketAddr,
    /// Declare that this machine's clock is synchronised to UTC
    #[arg(long)]
    synchronized: bool,
}

/// Runs one side of a measurement.
pub fn stamp(stamp: &Stamp) -> miette::Result<()> {
    match stamp {
        Stamp::Send(args) => send(args),
        Stamp::Reflect(args) => reflect(args),
    }
}

fn send(args: &SendArgs) -> miette::Result<()> {
    if let Some(path) = args.packets.as_ref().filter(|path| path.symlink_metadata().is_ok()) {
        return Err(miette!(help = "choose another file by --packets", "{} exists already", path.display()));
    }
    let config = SessionConfig {
        identifier: std::process::id() as u16,
        interval: args.interval,
        length: args.length.into(),
        patience: args.patience,
        window: Duration::MAX,
        error: ErrorEstimate::new(args.synchronized, CLOCK_ERROR),
        reflector_counts: !args.stateless,
    };
    let address = resolve(&args.reflector)?;
    let reached = || format!("cannot send to {address}");
    let mut sender = Sender::connect(address, config).into_diagnostic().wrap_err_with(reached)?;
    let stopped = signals::listen()?;
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} packets to {msg}")
        .expect("the template is well-formed");
    let progress =
        ProgressBar::new(args.count.get().into()).with_style(style).with_message(address.to_string());
    while sender.session().deadline().is_some() {
        if sender.session().sent() == args.count.get() || stopped.try_recv().is_ok() {
            sender.session_mut().stop();
        }
        sender.step(NOTICE).into_diagnostic().wrap_err_with(reached)?;
        progress.set_position(sender.session().sent().into());
    }
    let now = sender.clock().now();
    let measured = sender.session().measurement(now);
    let packets = args.packets.as_ref().map(|_| csv(sender.session().answers(now), args.length));
    progress.finish_and_clear();
    let measured = measured.filter(|measured| measured.round_trip.is_some()).ok_or_else(|| {
        miette!(
            help = "check that a reflector listens there, such as `cotorra stamp reflect`",
            "no answer from {address}"
        )
    })?;
    if let Some((path, text)) = args.packets.as_ref().zip(packets) {
        let unwritten = || format!("cannot write {}", path.display());
        let mut file = fs::File::create_new(path).into_diagnostic().wrap_err_with(unwritten)?;
        file.write_all(text.as_bytes()).into_diagnostic().wrap_err_with(unwritten)?;
    }
    output::print_either(args.json, &if args.json { json(&measured) } else { text(address, &measured) })
}

fn resolve(reflector: &str) -> miette::Result<SocketAddr> {
    let found = reflector.to_socket_addrs().or_else(|_| (reflector, PORT).to_socket_addrs());
    let mut found = found.into_diagnostic().wrap_err_with(|| format!("cannot find `{reflector}`"))?;
    found.next().ok_or_else(|| miette!("`{reflector}` has no address"))
}

fn reflect(args: &ReflectArgs) -> miette::Result<()> {
    let socket = UdpSocket::bind(args.listen).map_err(|error| match error.kind() {
        ErrorKind::PermissionDenied => miette!(
            help = "a port below 1024 needs root; use another one: --listen 0.0.0.0:8620",
            "cannot listen on {}: {error}",
            args.listen
        ),
        _ => miette!("cannot listen on {}: {error}", args.listen),
    })?;
    let stopped = signals::listen()?;
    let address = socket.local_addr().into_diagnostic()?;
    output::print(&format!("reflecting on {address}; Ctrl-C ends it\n"))?;
    let clock = Clock::start();
    let mut reflector = Reflector::new(ErrorEstimate::new(args.synchronized, CLOCK_ERROR));
    let mut buffer = vec![0; LARGEST];
    while stopped.try_recv().is_err() {
        let received = receive(&socket, &mut buffer, NOTICE).into_diagnostic().wrap_err("cannot receive")?;
        let Some((length, from)) = received else { continue };
        let Ok(reflection) = reflector.reflect(from, &buffer[..length], clock.now(), None) else { continue };
        // A reply that cannot be sent is lost, as on any network.
        let _ = socket.send_to(&reflection.sent_at(clock.now()), from);
    }
    Ok(())
}

fn text(address: SocketAddr, measured: &Measurement) -> String {
    let ms = |duration: Duration| format!("{:.3}", duration.as_secs_f64() * 1e3);
    let row = |name: &str, delays: Option<Delays>| {
        let row = |delays: Delays| {
            let [min, mean, p50, p99, max] =
                [delays.min, delays.mean, delays.p50, delays.p99, delays.max].map(ms);
            let jitter = delays.jitter.map(|jitter| format!("  jitter {}", ms(jitter))).unwrap_or_default();
            format!("  {name:10}  min {min}  mean {mean}  p50 {p50}  p99 {p99}  max {max}{jitter} ms\n")
        };
        delays.map(row).unwrap_or_default()
    };
    let percent = |share: f64| format!("{:.2} %", share * 100.0);
    let ways = measured.forward_loss.zip(measured.backward_loss);
    let ways = ways.map(|(there, back)| format!("; there {}, back {}", percent(there), percent(back)));
    format!(
        "{address}: {} packets\n{}{}{}  loss        {} packets, {}{}\n",
        measured.sent,
        row("round trip", measured.round_trip),
        row("there", measured.forward),
        row("back", measured.backward),
        measured.lost,
        percent(measured.loss()),
        ways.unwrap_or_default(),
    )
}

/// Returns the times of each packet as CSV, with both ways if all answers have them.
fn csv(answers: impl Iterator<Item = Option<Answer>>, length: u16) -> String {
    /// Octets of the headers of UDP, IPv4 and Ethernet.
    const HEADERS: u32 = 8 + 20 + 14;
    let answers: Vec<_> = answers.collect();
    let are_one_way = answers.iter().flatten().all(|answer| answer.ways.is_some());
    let columns = ["seq", "rtt_ms", "there_ms", "back_ms"];
    let columns = if are_one_way { &columns[..] } else { &columns[..2] };
    let mut table = DataTable::new(columns.iter().copied());
    let cell = |time: Option<Duration>| {
        time.map(|time| format!("{:.6}", time.as_secs_f64() * 1e3)).unwrap_or_default()
    };
    for (number, answer) in answers.iter().enumerate() {
        let [there, back] = answer.and_then(|answer| answer.ways).map_or([None; 2], |ways| ways.map(Some));
        let times = [answer.map(|answer| answer.round_trip), there, back].map(cell);
        table.row([number.to_string()].into_iter().chain(times).take(columns.len()));
    }
    format!("# frame_bytes: {}\n{}", u32::from(length) + HEADERS, table.to_csv())
}

fn json(measured: &Measurement) -> String {
    let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
    let delays = |delays: Option<Delays>| {
        delays.map(|delays| {
            serde_json::json!({
                "min": ms(delays.min), "mean": ms(delays.mean), "p50": ms(delays.p50), "p99": ms(delays.p99),
                "max": ms(delays.max), "jitter": delays.jitter.map(ms),
            })
        })
    };
    let object = serde_json::json!({
        "sent": measured.sent,
        "lost": measured.lost,
        "forward_loss": measured.forward_loss,
        "backward_loss": measured.backward_loss,
        "round_trip_ms": delays(measured.round_trip),
        "forward_ms": delays(measured.forward),
        "backward_ms": delays(measured.backward),
    });
    format!("{object}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_are_a_table_with_both_ways_only_between_synchronised_clocks() {
        let ms = Duration::from_millis;
        let answer = |ways| Some(Answer { round_trip: ms(12), ways });
        let apart = csv([answer(None), None].into_iter(), 44);
        assert_eq!(apart, "# frame_bytes: 86\nseq,rtt_ms\n0,12.000000\n1,\n");
        let synchronised = csv([None, answer(Some([ms(5), ms(7)]))].into_iter(), 44);
        assert_eq!(
            synchronised,
            "# frame_bytes: 86\nseq,rtt_ms,there_ms,back_ms\n0,,,\n1,12.000000,5.000000,7.000000\n"
        );
        assert!(cotorra_calibrate::parse_stamp(&synchronised).is_ok());
    }
}
