//! `cotorra calibrate`: fits a testbed to measurements of a real site, and writes the fitted testbed and a report.

use std::{
    collections::BTreeMap,
    fs,
    io::{self, Read as _},
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use cotorra_calibrate::{
    CalibrateError, Calibration, Comparison, Estimate, LinkCalibration, LinkMeasurement, MAX_CAPTURE,
    Measurements, NetworkCalibration, Options, PacketTimes, PathCalibration, Recorded, SurveyComparison,
    calibrated_text, markdown, one_way_of_captures, parse_channel_survey, parse_round_trips, parse_stamp,
    parse_survey, round_trips_of_capture,
};
use cotorra_graph::{Probability, Testbed};
use cotorra_measurements::{Kind, PageRequest};
use cotorra_testbed::{put_all, write_file};
use cotorra_testbed_file::{Carried, CarriedFile, Contents, carry};
use indicatif::ProgressBar;
use miette::{Diagnostic, IntoDiagnostic};

use crate::{
    arguments::parse_seed,
    duration::parse_duration,
    history::{HistoryPlace, Source, SourceError},
    output,
    quantity::parse_share,
    table::Table,
    testbed_file::{self, Loaded},
    words::count,
};

/// Files of a calibration, in its folder.
const TESTBED: &str = "testbed.yaml";
const REPORT: &str = "report.md";
const FIGURES: &str = "report.json";
/// Interval of the spinner's turns.
const TURN: Duration = Duration::from_millis(120);

/// Fit a testbed to measurements of a real site
///
/// A survey of signals along a walk gives path loss, loss by walls, and shadowing of a wireless network. Round trips over a
/// wired link give its delay, jitter, loss and duplication. A capture of a TCP flow gives round trips, too; captures at both ends
/// of a link give each direction. Busy times of a channel give the interference on it. Each value has a 95 % interval. Measurements that do not determine a value are refused, or
/// leave it out.
///
/// Packets and surveys are fitted on their first part, and tested on the rest, beside two baselines: constant delay with normal
/// jitter, and a replay of the first part; the mean signal of each radio unit, and the testbed before.
///
/// It writes a folder with the fitted testbed (testbed.yaml, which runs as it is), report.md and report.json.
/// docs/use/calibrate.md explains formats, formulas and figures.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  ping -D -c 600 10.0.0.2 > edge.txt
  cotorra calibrate testbeds/corridor.yaml --ping lan-edge=edge.txt --target 15ms
  cotorra calibrate office.yaml --survey walk.csv --out office
  cotorra calibrate office.yaml --channels R1=channels.txt
  cotorra calibrate office.yaml --survey-run latest --handover-run latest
  cotorra calibrate office.yaml --pcap lan-edge=sender.pcap
  cotorra calibrate office.yaml --pcap lan-edge=lan.pcap:edge.pcap
  cotorra run office/testbed.yaml --simulate

A survey is CSV:
  time_s,x,y,radio_unit,signal_dbm
  0.0,1.5,2.0,R1,-48")]
pub struct CalibrateArgs {
    /// The testbed file
    pub file: PathBuf,
    /// Survey of signals: CSV with the columns time_s, x, y, radio_unit and signal_dbm, and z if heights matter
    #[arg(long, value_name = "FILE", required_unless_present_any = ["pings", "stamps", "pcaps", "channels", "survey_run", "handover_run"])]
    pub survey: Option<PathBuf>,
    /// Fit fading, too: each reading of the survey is of a single frame, not an average
    #[arg(long, requires = "survey")]
    pub fading: bool,
    /// Take the survey from the history of a run: the signals that its robots heard; RUN is a folder, latest, or a number in
    /// --history
    #[arg(long, value_name = "RUN", conflicts_with = "survey")]
    pub survey_run: Option<String>,
    /// Fit the phases of handovers to those in the history of a run
    #[arg(long, value_name = "RUN")]
    pub handover_run: Option<String>,
    /// Round trips over a wired link: output of ping, or CSV with the columns seq and rtt_ms; can be given several times
    #[arg(long = "ping", value_name = "LINK=FILE", value_parser = parse_measurement)]
    pub pings: Vec<(String, PathBuf)>,
    /// Packets over a wired link that `cotorra stamp send --packets` wrote; can be given several times
    #[arg(long = "stamp", value_name = "LINK=FILE", value_parser = parse_measurement)]
    pub stamps: Vec<(String, PathBuf)>,
    /// Capture of a TCP flow over a wired link at its sender, or captures of any flow at the link's first and second end, as
    /// pcap or pcapng; can be given several times
    #[arg(long = "pcap", value_name = "LINK=FILE[:FILE]", value_parser = parse_pcap)]
    pub pcaps: Vec<(String, Captures)>,
    /// Busy times of a radio unit's channel: outputs of `iw dev wlan0 survey dump` one after another, or CSV with the columns
    /// channel, active_ms and busy_ms; can be given several times
    #[arg(long, value_name = "RADIO_UNIT=FILE", value_parser = parse_channels)]
    pub channels: Vec<(String, PathBuf)>,
    /// Target of round trips, such as 15ms: the share above it is compared, too
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub target: Option<Duration>,
    /// Share of packets, and of a survey's readings, that are fitted, from the first on; the others test the fit
    #[arg(long, value_name = "SHARE", default_value = "60%", value_parser = parse_fitted)]
    pub fit: f64,
    /// Folder of the results; default: one under calibrations/ that is named after the testbed
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Seed of resamples and simulations; the same seed gives the same results
    #[arg(long, value_name = "N", default_value = "1", value_parser = parse_seed)]
    pub seed: u64,
    /// Overwrite the results that the folder has
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

fn parse_channels(text: &str) -> Result<(String, PathBuf), String> {
    parse_measurement(text).map_err(|_| "write a radio unit and a file, as in R1=channels.txt".to_owned())
}

fn parse_measurement(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((link, file)) if !link.is_empty() && !file.is_empty() => Ok((link.to_owned(), file.into())),
        _ => Err("write a link and a file, as in lan-edge=ping.txt".to_owned()),
    }
}

/// Captures of a link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Captures {
    /// At the sender of a TCP flow.
    Sender(PathBuf),
    /// At the first and the second end of the link.
    BothEnds([PathBuf; 2]),
}

fn parse_pcap(text: &str) -> Result<(String, Captures), String> {
    let wrong = || "write a link and one or two files, as in lan-edge=lan.pcap:edge.pcap".to_owned();
    let (link, file) = parse_measurement(text).map_err(|_| wrong())?;
    let files = file.to_str().and_then(|files| files.rsplit_once(':'));
    match files {
        Some((first, second)) if first.is_empty() || second.is_empty() => Err(wrong()),
        Some((first, second)) => Ok((link, Captures::BothEnds([first, second].map(PathBuf::from)))),
        None => Ok((link, Captures::Sender(file))),
    }
}

fn parse_fitted(text: &str) -> Result<f64, String> {
    let share = parse_share(text).map(Probability::get)?;
    if (0.1..=0.9).contains(&share) { Ok(share) } else { Err("it is from 10% to 90%".to_owned()) }
}

#[derive(Debug, thiserror::Error, Diagnostic)]
enum Error {
    #[error("cannot read {}: {reason}", path.display())]
    Unreadable { path: PathBuf, reason: io::Error },
    #[error("{}: {reason}", path.display())]
    #[diagnostic(help("docs/use/calibrate.md describes the formats"))]
    Malformed { path: PathBuf, reason: CalibrateError },
    #[error("captures {} and {}: {reason}", paths[0].display(), paths[1].display())]
    #[diagnostic(help("docs/use/calibrate.md says how to capture at both ends"))]
    Unmatched { paths: [PathBuf; 2], reason: CalibrateError },
    #[error(transparent)]
    #[diagnostic(transparent)]
    Run(#[from] SourceError),
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    #[error("run {0} has no signals at known places")]
    #[diagnostic(help(
        "name a run whose robots are located by the simulator or by localization, and whose history was kept"
    ))]
    NoSignals(String),
    #[error("run {0} has no handovers from one radio unit to another")]
    #[diagnostic(help("name a run whose robots change their radio units"))]
    NoHandovers(String),
    #[error("{0} has two measurements")]
    #[diagnostic(help("give one for each"))]
    Twice(String),
    #[error("{} exists already", .0.display())]
    #[diagnostic(help("choose another folder by --out, or overwrite it by --force"))]
    Exists(PathBuf),
    #[error("cannot make {}: {reason}", path.display())]
    Unwritable { path: PathBuf, reason: io::Error },
}

/// Fits, and writes the results.
pub fn calibrate(args: &CalibrateArgs) -> miette::Result<()> {
    let Loaded { testbed, text, .. } = testbed_file::load(&args.file, &[])?;
    let folder = args.out.clone().unwrap_or_else(|| Path::new("calibrations").join(&testbed.name));
    let results = [TESTBED, REPORT, FIGURES];
    let exists = |name: &&str| folder.join(name).symlink_metadata().is_ok();
    if let Some(name) = results.iter().find(|name| !args.force && exists(name)) {
        return Err(Error::Exists(folder.join(name)).into());
    }
    let measurements = read(args)?;
    let options =
        Options { target: args.target, fitted_share: args.fit, fading: args.fading, seed: args.seed };
    let progress = ProgressBar::new_spinner().with_message("fitting");
    progress.enable_steady_tick(TURN);
    let calibration = Calibration::new(&testbed, &measurements, options);
    progress.finish_and_clear();
    let calibration = calibration.into_diagnostic()?;
    write(&calibration, &text, &testbed, &folder)?;
    output::print(&(describe(&calibration) + &format!("\n{}/\n  {}\n", folder.display(), results.join("  "))))
}

/// Reads all measurements.
fn read(args: &CalibrateArgs) -> Result<Measurements, Error> {
    let mut measurements = Measurements::default();
    if let Some(path) = &args.survey {
        measurements.survey = parsed(path, parse_survey)?;
        note!("{}: {}", path.display(), count(measurements.survey.len(), "reading"));
    }
    if let Some(run) = &args.survey_run {
        let recorded = read_run(run, &args.place, &[Kind::Robot])?;
        measurements.survey = recorded.survey().to_vec();
        note!("{run}: {}", count(measurements.survey.len(), "reading"));
        if measurements.survey.is_empty() {
            return Err(Error::NoSignals(run.clone()));
        }
    }
    if let Some(run) = &args.handover_run {
        let recorded = read_run(run, &args.place, &[Kind::Handover, Kind::Scanned])?;
        measurements.handovers = recorded.handovers().to_vec();
        note!("{run}: {}", count(measurements.handovers.len(), "handover"));
        if measurements.handovers.is_empty() {
            return Err(Error::NoHandovers(run.clone()));
        }
    }
    for (radio_unit, path) in &args.channels {
        let channels = parsed(path, parse_channel_survey)?;
        note!("{}: {}", path.display(), count(channels.0.len(), "channel"));
        if measurements.channels.insert(radio_unit.clone(), channels).is_some() {
            return Err(Error::Twice(format!("radio unit `{radio_unit}`")));
        }
    }
    let links = &mut measurements.links;
    for (link, path) in &args.pings {
        let trips = parsed(path, parse_round_trips)?;
        note!("{}: {}", path.display(), packets(&trips));
        add(links, link, LinkMeasurement::RoundTrips(trips))?;
    }
    for (link, path) in &args.stamps {
        add(links, link, parsed(path, parse_stamp)?)?;
    }
    for (link, captures) in &args.pcaps {
        add(links, link, read_captures(captures)?)?;
    }
    Ok(measurements)
}

fn add(
    links: &mut BTreeMap<String, LinkMeasurement>,
    link: &str,
    measured: LinkMeasurement,
) -> Result<(), Error> {
    match links.insert(link.to_owned(), measured) {
        Some(_) => Err(Error::Twice(format!("link `{link}`"))),
        None => Ok(()),
    }
}

/// Reads the events of some kinds of a run.
fn read_run(run: &str, place: &HistoryPlace, kinds: &[Kind]) -> Result<Recorded, Error> {
    let Source { history, run, .. } = Source::find(run, place)?;
    let mut recorded = Recorded::default();
    let mut request = PageRequest::first(PageRequest::MAX);
    loop {
        let page = history.events(run.id, kinds, .., request)?;
        page.items.iter().for_each(|event| recorded.take(event));
        let Some(next) = page.next else { return Ok(recorded) };
        request = PageRequest::after(next, PageRequest::MAX);
    }
}

/// Describes how many packets were measured.
fn packets(times: &PacketTimes) -> String {
    let lost = times.times_ms.iter().filter(|time| time.is_none()).count();
    format!("{}, {lost} lost", count(times.times_ms.len(), "packet"))
}

fn read_captures(captures: &Captures) -> Result<LinkMeasurement, Error> {
    match captures {
        Captures::Sender(path) => {
            let trips = round_trips_of_capture(&read_bytes(path)?)
                .map_err(|reason| Error::Malformed { path: path.clone(), reason })?;
            note!("{}: {}", path.display(), count(trips.times_ms.len(), "round trip"));
            Ok(LinkMeasurement::RoundTrips(trips))
        }
        Captures::BothEnds(paths) => {
            let [first, second] = paths.each_ref().map(|path| read_bytes(path));
            let one_way = one_way_of_captures(&first?, &second?)
                .map_err(|reason| Error::Unmatched { paths: paths.clone(), reason })?;
            for (way, name) in one_way.ways.iter().zip(["forward", "backward"]) {
                let packets = way.as_ref().map_or_else(|| "too few packets".to_owned(), packets);
                note!("{} to {}, {name}: {packets}", paths[0].display(), paths[1].display());
            }
            Ok(LinkMeasurement::OneWay(one_way))
        }
    }
}

/// Reads a capture, which may be a pipe. A larger one is cut off behind the bound, and refused by its reader.
fn read_bytes(path: &Path) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    let read =
        fs::File::open(path).and_then(|file| file.take(MAX_CAPTURE as u64 + 1).read_to_end(&mut bytes));
    read.map_err(|reason| Error::Unreadable { path: path.to_owned(), reason })?;
    Ok(bytes)
}

fn parsed<T>(path: &Path, parse: fn(&str) -> Result<T, CalibrateError>) -> Result<T, Error> {
    let text = cotorra_testbed_file::read(path)
        .map_err(|reason| Error::Unreadable { path: path.to_owned(), reason })?;
    parse(&text).map_err(|reason| Error::Malformed { path: path.to_owned(), reason })
}

/// Writes the fitted testbed, with what it names, and the report.
fn write(calibration: &Calibration, text: &str, testbed: &Testbed, folder: &Path) -> miette::Result<()> {
    let text = calibrated_text(text, &calibration.settings);
    let Carried { text, files } = carry(&text, &testbed.folder, &[TESTBED, REPORT, FIGURES]);
    fs::create_dir_all(folder).map_err(|reason| Error::Unwritable { path: folder.to_owned(), reason })?;
    for file in &files {
        remove_earlier(file, folder)?;
    }
    put_all(&files, folder).into_diagnostic()?;
    let figures = serde_json::to_string_pretty(calibration).into_diagnostic()? + "\n";
    for (name, content) in [(TESTBED, &text), (REPORT, &markdown(calibration)), (FIGURES, &figures)] {
        write_file(folder, name, content).into_diagnostic()?;
    }
    Ok(())
}

/// Removes what an earlier calibration carried into the folder, which may be another version of it.
fn remove_earlier(file: &CarriedFile, folder: &Path) -> Result<(), Error> {
    let to = folder.join(&file.to);
    let pairs: Vec<_> = match &file.contents {
        Contents::Copy(from) => vec![(from.clone(), to)],
        Contents::Folder(from, names) => names.iter().map(|name| (from.join(name), to.join(name))).collect(),
        Contents::Text(_) | Contents::Conditions(_) => Vec::new(),
    };
    let canonical = |path: &Path| path.canonicalize().ok();
    let is_other = |(from, to): &(PathBuf, PathBuf)| to.is_file() && canonical(from) != canonical(to);
    for (_, to) in pairs.into_iter().filter(is_other) {
        fs::remove_file(&to).map_err(|reason| Error::Unwritable { path: to, reason })?;
    }
    Ok(())
}

/// Describes the fitted values, and how well they predict the round trips that were not fitted.
fn describe(calibration: &Calibration) -> String {
    let mut table = Table::new("<<>>");
    table.row(["of", "fitted", "value", "95 % interval"]);
    let mut row = |of: &str, what: &str, estimate: Estimate| {
        let Estimate { value, low, high } = estimate;
        table.row([of.to_owned(), what.to_owned(), format!("{value:.2}"), format!("{low:.2} to {high:.2}")]);
    };
    let mut notes = Vec::new();
    for (name, NetworkCalibration { fit, fading, .. }) in &calibration.networks {
        row(name, "reference loss, dB", fit.reference_loss_db);
        row(name, "exponent", fit.exponent);
        fit.wall_loss_db.into_iter().for_each(|wall| row(name, "loss of a wall, dB", wall));
        row(name, "shadowing, dB", fit.deviation_db);
        fit.correlation_m.into_iter().for_each(|metres| row(name, "correlation, m", metres));
        fading.iter().for_each(|fading| row(name, "K-factor of fading, dB", fading.k_factor_db));
        notes.extend(fit.notes.iter().map(|note| format!("{name}: {note}")));
    }
    for (name, fit) in &calibration.handovers {
        fit.scan_ms.into_iter().for_each(|scan| row(name, "scan before a handover, ms", scan));
        fit.fast_ms.into_iter().for_each(|fast| row(name, "fast transition, ms", fast));
        fit.full_ms.into_iter().for_each(|full| row(name, "handover with handshakes, ms", full));
        row(name, "variation of phases, %", percent(fit.variation));
        notes.extend(fit.notes.iter().map(|note| format!("{name}: {note}")));
    }
    for (name, fit) in &calibration.interference {
        row(name, "load by others, %", percent(fit.load));
        if let Some(presence) = &fit.presence {
            row(name, "they are there for, s", presence.on_s);
            row(name, "they are away for, s", presence.off_s);
        }
        notes.extend(fit.notes.iter().map(|note| format!("{name}: {note}")));
    }
    for (name, link) in &calibration.links {
        notes.extend(link.notes().iter().map(|note| format!("{name}: {note}")));
        for (way, path) in link.paths() {
            let (fit, of) = (&path.fit, named(name, link, way));
            let mean = match link {
                LinkCalibration::RoundTrips(_) => "mean round trip, ms",
                LinkCalibration::OneWay { .. } => "mean, ms",
            };
            if link.mean_is_known() {
                row(&of, mean, fit.mean_ms);
            }
            row(&of, "deviation, ms", fit.deviation_ms);
            if let Some(loss) = &fit.loss {
                row(&of, "loss, %", percent(loss.share));
                loss.mean_burst.into_iter().for_each(|burst| row(&of, "mean burst, packets", burst));
            }
            notes.extend(fit.notes.iter().map(|note| format!("{of}: {note}")));
        }
    }
    let mut text = table.render("  ");
    for (name, NetworkCalibration { comparison, .. }) in &calibration.networks {
        text += &format!("\nThe other part of {name}, {}:\n\n", count(comparison.test_readings, "reading"));
        text += &predicted(comparison).render("  ");
    }
    for (name, link) in &calibration.links {
        for (way, PathCalibration { comparison, .. }) in link.paths() {
            let of = named(name, link, way);
            text += &format!("\nThe other part of {of}, {}:\n\n", count(comparison.test_packets, "packet"));
            text += &compared(comparison).render("  ");
        }
    }
    notes.iter().for_each(|of| text += &format!("\nnote: {of}\n"));
    text
}

/// Names a link, with the direction if it was measured one way.
fn named(name: &str, link: &LinkCalibration, way: &str) -> String {
    match link {
        LinkCalibration::RoundTrips(_) => name.to_owned(),
        LinkCalibration::OneWay { .. } => format!("{name}, {way}"),
    }
}

/// Compares predictions of the signals of the test part with it.
fn predicted(comparison: &SurveyComparison) -> Table {
    let mut table = Table::new("<>>>>>>");
    let [p5, p50, p95] = ["error p5, dB", "p50, dB", "p95, dB"];
    table.row(["", p5, p50, p95, "root mean square, dB", "within 90 % interval, %", "Wasserstein, dB"]);
    for prediction in &comparison.predictions {
        // A figure that does not agree with the test part has a mark.
        let mark = |agrees: bool| if agrees { "" } else { "! " };
        table.row([
            prediction.by.name().to_owned(),
            format!("{:.1}", prediction.p5_db.value),
            format!("{}{:.1}", mark(prediction.median_agrees), prediction.p50_db.value),
            format!("{:.1}", prediction.p95_db.value),
            format!("{:.1}", prediction.root_mean_square_db.value),
            format!("{}{:.0}", mark(prediction.within_agrees), percent(prediction.within).value),
            format!("{:.1}", prediction.wasserstein_db.value),
        ]);
    }
    table
}

/// Compares predictions of the test part with it.
fn compared(comparison: &Comparison) -> Table {
    let mut table = Table::new("<>>>>>>");
    let measured = &comparison.measured;
    table.row(["", "p50, ms", "p95, ms", "p99, ms", "change, ms", "above target, %", "Wasserstein, ms"]);
    let interval = |of: &Estimate| format!("{:.2} to {:.2}", of.low, of.high);
    let above = measured.above.as_ref().map(|share| interval(&percent(*share))).unwrap_or_default();
    table.row([
        "measured".to_owned(),
        interval(&measured.p50_ms),
        interval(&measured.p95_ms),
        interval(&measured.p99_ms),
        interval(&measured.change_ms),
        above,
        String::new(),
    ]);
    for prediction in &comparison.predictions {
        let agrees = &prediction.agrees;
        let figures = &prediction.figures;
        // A figure that does not agree with the test part has a mark.
        let cell = |value: f64, agrees: bool| format!("{}{value:.2}", if agrees { "" } else { "! " });
        let above = figures.above.zip(agrees.above).map(|(share, agrees)| cell(share * 100.0, agrees));
        table.row([
            prediction.by.name().to_owned(),
            cell(figures.p50_ms, agrees.p50_ms),
            cell(figures.p95_ms, agrees.p95_ms),
            cell(figures.p99_ms, agrees.p99_ms),
            cell(figures.change_ms, agrees.change_ms),
            above.unwrap_or_default(),
            format!("{:.2}", prediction.wasserstein_ms.value),
        ]);
    }
    table
}

/// Returns a share in percent.
fn percent(share: Estimate) -> Estimate {
    Estimate { value: share.value * 100.0, low: share.low * 100.0, high: share.high * 100.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_trips_are_of_a_link_and_in_a_file() {
        let file = |name: &str| Ok(("lan-edge".to_owned(), PathBuf::from(name)));
        assert_eq!(parse_measurement("lan-edge=a=b.txt"), file("a=b.txt"));
        for wrong in ["lan-edge", "=ping.txt", "lan-edge=", ""] {
            assert!(parse_measurement(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn captures_are_at_the_sender_or_at_both_ends() {
        let of = |captures| Ok(("lan-edge".to_owned(), captures));
        assert_eq!(parse_pcap("lan-edge=a.pcap"), of(Captures::Sender("a.pcap".into())));
        let both = Captures::BothEnds(["a.pcap".into(), "b.pcap".into()]);
        assert_eq!(parse_pcap("lan-edge=a.pcap:b.pcap"), of(both));
        for wrong in ["lan-edge", "lan-edge=", "lan-edge=a:", "lan-edge=:b", "=a:b"] {
            assert!(parse_pcap(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn both_parts_have_round_trips() {
        assert_eq!(parse_fitted("50%"), Ok(0.5));
        for wrong in ["0%", "100%", "95%", "0.5"] {
            assert!(parse_fitted(wrong).is_err(), "{wrong}");
        }
    }
}
