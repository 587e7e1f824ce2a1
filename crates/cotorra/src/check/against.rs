//! `cotorra check FILE --against ns3`: the testbed's figures beside those of an independent simulator.

use std::{
    collections::BTreeMap,
    env, fs, io,
    num::NonZero,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use clap::{Args, ValueEnum};
use cotorra_graph::Testbed;
use cotorra_referee::{Compared, Ns3, Ns3Error, Ours, Plain, Row, Run, Verdict, compare, ours, plain};
use cotorra_testbed::RunError;
use parking_lot::Mutex;

use crate::{
    duration::parse_duration, exit::Status, output, progress::Progress, table::Table, testbed_file::Loaded,
    words::count,
};

/// The environment variable that names a Python environment with ns-3.
const ENVIRONMENT: &str = "COTORRA_NS3";

/// An independent simulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Referee {
    /// ns-3 3.44, from the Python package index. It needs python3 and g++
    Ns3,
}

#[derive(Debug, Args)]
pub struct AgainstArgs {
    /// Run the testbed's radio, wires, walks and packets in another simulator, too, and compare
    ///
    /// Both sides run what ns-3 has a part for; the rest is listed. ns-3 is installed once into the user's cache (400 MB), unless
    /// COTORRA_NS3 names a Python environment that has it. The bounds are those of docs/use/referee.md.
    #[arg(long, value_name = "SIMULATOR")]
    pub against: Option<Referee>,
    /// With --against: number of runs on each side; their seeds count up from the file's seed
    #[arg(long, value_name = "N", default_value_t = 3, requires = "against",
          value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// With --against: end each run after this time, such as 30s or 2min, if the walks take longer
    #[arg(long, value_name = "DURATION", default_value = "60s", requires = "against", value_parser = parse_duration)]
    pub until: Duration,
    /// With --against: write comparison.csv and the scenarios of ns-3 into this folder
    #[arg(long, value_name = "DIR", requires = "against")]
    pub out: Option<PathBuf>,
}

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum AgainstError {
    #[error(transparent)]
    Ours(#[from] RunError),
    #[error(transparent)]
    #[diagnostic(help(
        "it needs python3 with venv, g++ and the package index; COTORRA_NS3 names a Python environment that has ns-3"
    ))]
    Ns3(#[from] Ns3Error),
    #[error("{}: {reason}", path.display())]
    File { path: PathBuf, reason: io::Error },
    #[error("nothing of the testbed measures anything that ns-3 can send")]
    #[diagnostic(help(
        "a service of a robot with a bundled VNF does, such as `program: navigation`, and a source of `traffic`"
    ))]
    Nothing,
    #[error("--out takes the comparison of one testbed file, and here are {0}")]
    #[diagnostic(help("name one testbed file, or leave --out out"))]
    ManyFiles(usize),
}

/// Compares a testbed with ns-3, until something comes by `interrupts`.
pub fn against(
    loaded: &Loaded,
    args: &AgainstArgs,
    interrupts: &mpsc::Receiver<()>,
) -> miette::Result<Status> {
    let Plain { testbed, left_out, unlike } = plain(loaded.testbed.clone());
    let (testbed, folder) = (Arc::new(testbed), tempfile::tempdir().map_err(file("a temporary folder"))?);
    let folder = match &args.out {
        Some(out) => {
            fs::create_dir_all(out).map_err(file(out))?;
            out.as_path()
        }
        None => folder.path(),
    };
    let environment = env::var_os(ENVIRONMENT).map(PathBuf::from);
    let ns3 =
        Ns3::prepare(environment.as_deref(), &cache(), |line| note!("{line}")).map_err(AgainstError::from)?;
    let Some(pairs) = run(&testbed, &loaded.text, args, &ns3, folder, interrupts)? else {
        return Ok(Status::Interrupted);
    };
    let targets: BTreeMap<_, _> =
        testbed.services.iter().map(|service| (service.id.to_string(), service.kpis.service_time)).collect();
    if pairs.iter().all(|(ours, _)| ours.run.senders.is_empty() && ours.run.traffic.is_empty()) {
        return Err(AgainstError::Nothing.into());
    }
    let compared = compare(&pairs, &targets);
    if args.out.is_some() {
        let path = folder.join("comparison.csv");
        fs::write(&path, csv(&compared)).map_err(file(&path))?;
    }
    output::print(&described(&compared, args))?;
    let list = |title: &str, lines: &[String]| match lines {
        [] => String::new(),
        lines => format!("\n  {title}\n    {}\n", lines.join("\n    ")),
    };
    output::print(&(list("neither side has", &left_out) + &list("unlike here, in ns-3", &unlike)))?;
    Ok(if compared.agrees() { Status::Done } else { Status::Failed })
}

fn file(path: impl AsRef<Path>) -> impl FnOnce(io::Error) -> AgainstError {
    let path = path.as_ref().to_owned();
    move |reason| AgainstError::File { path, reason }
}

/// Returns the folder of what is installed and compiled once.
fn cache() -> PathBuf {
    let home = || env::var_os("HOME").map(|home| PathBuf::from(home).join(".cache"));
    let cache = env::var_os("XDG_CACHE_HOME").map(PathBuf::from).or_else(home);
    cache.unwrap_or_else(env::temp_dir).join("cotorra")
}

/// Runs all seeds on both sides, on all processors.
fn run(
    testbed: &Arc<Testbed>,
    text: &str,
    args: &AgainstArgs,
    ns3: &Ns3,
    folder: &Path,
    interrupts: &mpsc::Receiver<()>,
) -> miette::Result<Option<Vec<(Ours, Run)>>> {
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let all = args.seeds as usize;
    let pairs: Mutex<BTreeMap<usize, (Ours, Run)>> = Mutex::default();
    let (done, finished) = mpsc::channel();
    let one = |number: usize| -> Result<(), AgainstError> {
        let seed = testbed.seed + number as u64;
        let go_on = || !stop.load(Ordering::Relaxed);
        let Some(ours) = ours(testbed, text, seed, args.until, go_on)? else { return Ok(()) };
        let theirs = ns3.run(&ours, seed, folder)?;
        pairs.lock().insert(number, (ours, theirs));
        Ok(())
    };
    let workers = thread::available_parallelism().map_or(1, NonZero::get).min(all);
    let outcome = thread::scope(|scope| {
        for _ in 0..workers {
            let (done, one, next, stop) = (done.clone(), &one, &next, &stop);
            scope.spawn(move || {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= all || stop.load(Ordering::Relaxed) || done.send(one(number)).is_err() {
                        return;
                    }
                }
            });
        }
        drop(done);
        let mut progress = Progress::new(false);
        let mut count = 0;
        let outcome = loop {
            let received = finished.recv_timeout(Duration::from_millis(100));
            if interrupts.try_recv().is_ok() {
                stop.store(true, Ordering::Relaxed);
            }
            match received {
                Ok(Ok(())) => {
                    count += 1;
                    progress.show(count, all);
                }
                // Ctrl-C ends ns-3, too.
                Ok(Err(_)) if stop.load(Ordering::Relaxed) => {}
                Ok(Err(error)) => {
                    stop.store(true, Ordering::Relaxed);
                    break Err(error);
                }
                Err(mpsc::RecvTimeoutError::Timeout) => {}
                Err(mpsc::RecvTimeoutError::Disconnected) => break Ok(()),
            }
        };
        progress.close();
        outcome
    });
    outcome?;
    let pairs = pairs.into_inner();
    Ok((pairs.len() == all).then(|| pairs.into_values().collect()))
}

fn described(compared: &Compared, args: &AgainstArgs) -> String {
    let mut table = Table::new("<<>>>>");
    table.row(["", "", "cotorra", "ns-3", "distance", ""]);
    for Row { of, figure, ours, theirs, distance, verdict } in &compared.rows {
        let half = distance.interval.map_or(String::new(), |i| format!(" ± {:.2}", (i.high - i.low) / 2.0));
        let number = |value: &f64| format!("{value:.2}");
        let verdict = match verdict {
            Verdict::Agrees => "agrees",
            Verdict::Undecided => "undecided: add seeds",
            Verdict::Differs => "DIFFERS",
        };
        let distance = format!("{:+.2}{half}", distance.mean);
        table.row([
            of.clone(),
            figure.title().to_owned(),
            number(ours),
            number(theirs),
            distance,
            verdict.to_owned(),
        ]);
    }
    let seeds = count(args.seeds as usize, "seed");
    format!(
        "  {seeds} of {} s; ± is the 95 % interval of the mean distance\n{}",
        args.until.as_secs_f64(),
        table.render("  ")
    )
}

fn csv(compared: &Compared) -> String {
    let mut text = "of,figure,cotorra,ns3,distance,distance_low,distance_high,verdict\n".to_owned();
    for Row { of, figure, ours, theirs, distance, verdict } in &compared.rows {
        let [low, high] = distance
            .interval
            .map_or([String::new(), String::new()], |i| [i.low, i.high].map(|n| n.to_string()));
        let verdict = match verdict {
            Verdict::Agrees => "agrees",
            Verdict::Undecided => "undecided",
            Verdict::Differs => "differs",
        };
        let title = figure.title();
        text += &format!("{of},\"{title}\",{ours},{theirs},{},{low},{high},{verdict}\n", distance.mean);
    }
    text
}
