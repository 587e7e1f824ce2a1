//! `cotorra-lab bench`: measures the performance of the emulated network on this machine, beside installed peers.

mod emulator;
mod figures;
mod load;
mod netem;
mod peers;
mod probe;
mod report;

use std::{collections::BTreeSet, path::PathBuf, process::ExitCode, time::Duration};

use clap::Args;
use cotorra::{Status, Table, print};
use cotorra_datapath::{Privilege, enter_user_namespace_if_needed};
use indicatif::{ProgressBar, ProgressStyle};
use miette::Diagnostic;

use figures::{ALL, Benchmark};
use load::Load;
use report::{Bench, Row};

pub use probe::{Probe, probe};

/// Measure the performance of the emulated network on this machine
///
/// Prints the median and the tail of each figure. Peers are measured for comparison if they are installed: rattan (from
/// PATH or --rattan) and Mininet (`mn`).
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// The benchmarks; default: all
    #[arg(value_name = "NAME")]
    pub names: Vec<String>,
    /// List the benchmarks
    #[arg(long, conflicts_with = "names")]
    pub list: bool,
    /// The program rattan, for comparison
    #[arg(long, value_name = "PATH", default_value = "rattan")]
    pub rattan: PathBuf,
}

#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum Error {
    #[error("there is no benchmark `{name}`")]
    #[diagnostic(help("there are: {}", names()))]
    Unknown { name: String },
    #[error(transparent)]
    #[diagnostic(help("`cotorra doctor` says what this machine can do, and what to do about the rest"))]
    Datapath(#[from] cotorra_datapath::Error),
}

fn names() -> String {
    ALL.iter().map(|benchmark| benchmark.name).collect::<Vec<_>>().join(", ")
}

/// Runs the benchmarks and prints the table. It is an error if nothing could be measured, or a benchmark that the arguments
/// name.
pub fn bench(args: &BenchArgs) -> miette::Result<ExitCode> {
    if args.list {
        let mut table = Table::new("<<");
        ALL.iter().for_each(|benchmark| table.row([benchmark.name, benchmark.about]));
        print(&table.render(""))?;
        return Ok(Status::Done.into());
    }
    let chosen = choose(&args.names)?;
    let root = enter_user_namespace_if_needed().map_err(Error::from)? == Privilege::Root;
    print(&format!("{}\n\n", load::machine(root)))?;

    let style = ProgressStyle::with_template("{spinner} {prefix:.bold}  {wide_msg}")
        .expect("a template that is right");
    let progress = ProgressBar::new_spinner().with_style(style);
    progress.enable_steady_tick(Duration::from_millis(120));
    let bench = Bench { progress, rattan: args.rattan.clone(), root };
    let mut table = Table::new("<><<>");
    let (mut notes, mut measured) = (BTreeSet::new(), 0);
    table.row(["figure", "median", "tail", "to reach", "others' CPU"]);
    for (i, benchmark) in chosen.iter().enumerate() {
        bench.progress.set_prefix(format!("{} of {}, {}", i + 1, chosen.len(), benchmark.name));
        let load = Load::begin();
        let rows = (benchmark.measure)(&bench)
            .unwrap_or_else(|error| vec![Row::missing(benchmark.about, error.to_string())]);
        let others = load.others();
        measured += usize::from(rows.iter().any(|row| row.missing.is_none()));
        for (i, row) in rows.into_iter().enumerate() {
            let others = if i == 0 { others.clone() } else { String::new() };
            notes.extend(row.missing.map(|why| format!("{}: {why}\n", row.figure.trim())));
            table.row([row.figure, row.median, row.tail, row.goal.to_owned(), others]);
        }
    }
    bench.progress.finish_and_clear();
    let notes = notes.into_iter().collect::<String>();
    let gap = if notes.is_empty() { "" } else { "\n" };
    print(&format!("{}{gap}{notes}", table.render("")))?;
    let needed = if args.names.is_empty() { 1 } else { chosen.len() };
    Ok(if measured >= needed { Status::Done } else { Status::Error }.into())
}

fn choose(names: &[String]) -> Result<Vec<&'static Benchmark>, Error> {
    if names.is_empty() {
        return Ok(ALL.iter().collect());
    }
    let find = |name: &String| {
        ALL.iter()
            .find(|benchmark| benchmark.name == name)
            .ok_or_else(|| Error::Unknown { name: name.clone() })
    };
    names.iter().map(find).collect()
}
