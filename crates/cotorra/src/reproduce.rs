//! `cotorra reproduce`: makes results again from their folder alone, and compares.

use std::{
    env, fs, io,
    path::{Path, PathBuf},
    process::{self, ExitCode, Stdio},
};

use clap::Args;
use cotorra_experiments::repeat::{Compared, Outcome, RepeatError, Service, compare, each};
use cotorra_testbed::{FolderError, Manifest, ManifestError, Repeat, Time};

use crate::{
    approval::{TRUST_VARIABLE, TrustArgs},
    exit::Status,
    history::HISTORY_VARIABLE,
    origin, output, signals,
    table::Table,
    temporary::TemporaryFolder,
    words::count,
};

/// Outcomes of runs whose results are complete.
const COMPLETE: [Status; 4] = [Status::Done, Status::NotValid, Status::NoProgress, Status::Failed];
/// Maximum number of files that differ which are listed.
const LISTED: usize = 10;

/// Make results again from their folder alone, and compare
///
/// FOLDER is that of a run, a sweep or a margin, or with cotorra-lab that of an experiment. Its manifest.json says how it came to be. Everything that the
/// runs need is taken from the folder, and must have the digests in the manifest; programs of the machine, such as python3,
/// are not in it.
///
/// Results in virtual time must be the same to the byte. Service times in real time are compared by distribution: for each
/// service by a two-sample Kolmogorov-Smirnov test and by a test of equal shares within the target. Neither counts a
/// difference below the lateness of packets, which the runs themselves report.
///
/// The programs of the folder run as you. If you did not approve the same ones before, it asks.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra reproduce runs/corridor-20260101-120000
  cotorra reproduce runs/corridor-20260101-120000 --dry-run
  cotorra reproduce sweeps/corridor-1a2b3c4d --out again
  cotorra reproduce runs/lab-20260101-120000 --level 0.001    with real packets: let the tests reject more rarely

Exit status:
  0    the repeat has the same results
  1    the folder is not complete, was changed, or cannot be repeated
  2    wrong usage
  3    the repeat has other results
  130  stopped with Ctrl-C")]
pub struct ReproduceArgs {
    /// The folder of results
    pub folder: PathBuf,
    /// New folder that the repeat stays in; by default, it is removed after the comparison
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Level of the tests in real time: the share of repeats that are taken to differ though only chance does. It is
    /// divided by the number of tests of a run
    #[arg(long, value_name = "LEVEL", default_value = "0.01", value_parser = parse_level)]
    pub level: f64,
    /// Only check the folder, and print what would run
    #[arg(long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub trust: TrustArgs,
}

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    #[diagnostic(help(
        "a repeat needs a folder that is as its runs left it; results of older versions have no manifest: repeat their \
         testbed file with `cotorra run`"
    ))]
    Manifest(#[from] ManifestError),
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Repeat(#[from] RepeatError),
    #[error("{} cannot be repeated from its folder alone: {why}", folder.display())]
    Not { folder: PathBuf, why: String },
    #[error("the manifest of {} names another command: {word}", folder.display())]
    #[diagnostic(help(
        "`cotorra reproduce` repeats runs, sweeps and margins, and `cotorra-lab reproduce` experiments (cargo run --release \
         -p cotorra-lab -- reproduce)"
    ))]
    Command { folder: PathBuf, word: String },
    #[error("{} has no results to compare with: its runs did not end, or were stopped", .0.display())]
    NoResults(PathBuf),
    #[error("cannot start cotorra again: {0}")]
    Start(io::Error),
    #[error("the repeat failed: {0}")]
    Failed(process::ExitStatus),
    #[error("the repeat left no folder in {}", .0.display())]
    NoRepeat(PathBuf),
}

/// Makes results of these commands of this program again, and compares.
pub fn reproduce(args: &ReproduceArgs, commands: &[&str]) -> miette::Result<ExitCode> {
    let folder = &args.folder;
    let manifest = Manifest::read(folder).map_err(Error::from)?;
    let words = words(&manifest, folder, commands)?;
    if manifest.produced.is_empty() {
        return Err(Error::NoResults(folder.clone()).into());
    }
    let from = TemporaryFolder::new().map_err(Error::from)?;
    let changed = manifest.copy(folder, from.path()).map_err(Error::from)?;
    changed.iter().for_each(|path| note!("warning: {} is not the file that ran", path.display()));
    warn_of_changes(&manifest, folder);
    if args.dry_run {
        output::print(&plan(&manifest, folder, words))?;
        return Ok(ExitCode::SUCCESS);
    }
    let temporary = TemporaryFolder::new().map_err(Error::from)?;
    let kept = match &args.out {
        Some(out) => create(out)?,
        None => temporary.path().to_owned(),
    };
    let interrupts = signals::listen()?;
    let mut command = process::Command::new(env::current_exe().map_err(Error::Start)?);
    command.args(words).arg("--out").arg(kept.join("repeat")).current_dir(from.path());
    if args.trust.trust {
        command.env(TRUST_VARIABLE, "1");
    }
    // The repeat keeps its own history.
    command.env_remove(HISTORY_VARIABLE).stdout(Stdio::null());
    let status = command.status().map_err(Error::Start)?;
    if interrupts.try_recv().is_ok() {
        return Ok(Status::Interrupted.into());
    }
    if COMPLETE.iter().all(|complete| status.code() != Some(complete.number().into())) {
        return Err(Error::Failed(status).into());
    }
    let repeat = repeat_in(&kept.join("repeat"))?;
    let compared = compare(folder, &repeat).map_err(Error::from)?;
    let is_same = !compared.is_empty() && compared.iter().all(|its| its.is_same(args.level));
    let mut text: String = compared.iter().map(|its| describe(its, args.level)).collect();
    text += if is_same { "\nREPRODUCED\n" } else { "\nNOT REPRODUCED\n" };
    if args.out.is_some() {
        text += &format!("\n{}/\n", repeat.display());
    }
    output::print(&text)?;
    Ok(if is_same { ExitCode::SUCCESS } else { Status::NotValid.into() })
}

/// Returns the words of the command line that makes a folder's results again.
fn words<'a>(manifest: &'a Manifest, folder: &Path, commands: &[&str]) -> Result<&'a [String], Error> {
    match &manifest.repeat {
        Repeat::Not(why) => Err(Error::Not { folder: folder.to_owned(), why: why.clone() }),
        Repeat::Words(words) => match words.first() {
            Some(first) if commands.contains(&first.as_str()) => Ok(words),
            first => {
                let word = first.cloned().unwrap_or_default();
                Err(Error::Command { folder: folder.to_owned(), word })
            }
        },
    }
}

/// Warns of what may change results, but for their inputs.
fn warn_of_changes(manifest: &Manifest, folder: &Path) {
    let (then, now) =
        ((manifest.version.as_str(), manifest.commit.as_str()), (env!("CARGO_PKG_VERSION"), origin::COMMIT));
    if then != now {
        let name = |(version, commit): (&str, &str)| format!("cotorra {version} ({commit})");
        note!("warning: {} made it, and this is {}", name(then), name(now));
    }
    for name in manifest.changed_results(folder) {
        note!("warning: {} was changed after the runs, or removed", folder.join(name).display());
    }
}

/// Creates a new folder, and returns its absolute path.
fn create(out: &Path) -> Result<PathBuf, Error> {
    let fail = |source| FolderError::new(out, source);
    if let Some(parent) = out.parent() {
        fs::create_dir_all(parent).map_err(fail)?;
    }
    fs::create_dir(out).and_then(|()| out.canonicalize()).map_err(|source| fail(source).into())
}

/// Returns the folder of the results that a command left at or in a folder.
fn repeat_in(kept: &Path) -> Result<PathBuf, Error> {
    let has_manifest = |path: &PathBuf| path.join(Manifest::NAME).is_file();
    let below = fs::read_dir(kept).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found = std::iter::once(kept.to_owned()).chain(below).filter(has_manifest);
    found.next().ok_or_else(|| Error::NoRepeat(kept.to_owned()))
}

/// Describes what would run.
fn plan(manifest: &Manifest, folder: &Path, words: &[String]) -> String {
    let how = match manifest.time {
        Time::Virtual => "in virtual time, and compared to the byte",
        Time::Real => "in real time, and compared by distribution",
    };
    let mut table = Table::new("<<");
    let mut row = |name: &str, value: String| table.row([name.to_owned(), value]);
    row("made by", manifest.command.join(" "));
    row("version", format!("cotorra {} ({})", manifest.version, manifest.commit));
    row(
        "on",
        format!(
            "{}, {}, Linux {}",
            manifest.machine.cpu,
            count(manifest.machine.cores, "core"),
            manifest.machine.kernel
        ),
    );
    row("at", manifest.started_at.clone());
    row("files", format!("{}, as they were", count(manifest.carried.len(), "file")));
    row("results", count(manifest.produced.len(), "file"));
    format!(
        "{}: would run {how}\n\n  {} {}\n\n{}",
        folder.display(),
        origin::program(),
        words.join(" "),
        table.render("  ")
    )
}

/// Describes a run beside its repeat.
fn describe(Compared { of, outcome }: &Compared, level: f64) -> String {
    let name = if of.as_os_str().is_empty() { String::new() } else { format!("{}: ", of.display()) };
    match outcome {
        Outcome::Missing => format!("{name}the repeat does not have it\n"),
        Outcome::Bytes { same, different } if different.is_empty() => {
            format!(
                "{name}{} the same to the byte\n",
                if *same == 1 { "the file is" } else { "all files are" }
            )
        }
        Outcome::Bytes { same, different } => {
            let listed: Vec<_> =
                different.iter().take(LISTED).map(|path| path.display().to_string()).collect();
            let more = different.len().saturating_sub(LISTED);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            let all = count(same + different.len(), "file");
            format!("{name}{} of {all} differ: {}{more}\n", different.len(), listed.join(", "))
        }
        Outcome::Distributions { services, .. } if services.is_empty() => {
            format!("{name}no service has samples to compare\n")
        }
        Outcome::Distributions { services, tolerance_ms, valid } => {
            let mut text = format!(
                "{name}{} of {}; {tolerance_ms:.2} ms are within the lateness of packets; each test at {}\n\n",
                count(2 * services.len(), "test"),
                count(services.len(), "service"),
                Significant(each(level, services)),
            );
            text += &distributions(services, each(level, services));
            for (which, valid) in ["the run", "the repeat"].iter().zip(valid) {
                if !valid {
                    text += &format!("\nthe figures of {which} are NOT VALID\n");
                }
            }
            text
        }
    }
}

fn distributions(services: &[Service], level: f64) -> String {
    let mut table = Table::new("<<>>>>>>");
    let heads =
        ["service", "", "samples", "median, ms", "p99, ms", "kept, %", "p", "p of shares"].map(str::to_owned);
    table.row(heads);
    let ms = |figure: Option<f64>| match figure {
        None => "-".to_owned(),
        Some(ms) if ms.is_infinite() => "no answer".to_owned(),
        Some(ms) => format!("{ms:.2}"),
    };
    let p = |p: f64| format!("{}{}", Significant(p), if p < level { " *" } else { "" });
    for Service { robot, service, two } in services {
        for (place, which) in ["run", "repeat"].into_iter().enumerate() {
            let kept = two.kept[place].map_or_else(|| "-".to_owned(), |kept| format!("{:.2}", kept * 100.0));
            let (name, tests) = match place {
                0 => (format!("{service} of {robot}"), [String::new(), String::new()]),
                _ => (String::new(), [p(two.p), p(two.p_kept)]),
            };
            let figures =
                [two.samples[place].to_string(), ms(two.p50_ms[place]), ms(two.p99_ms[place]), kept];
            table.row([name, which.to_owned()].into_iter().chain(figures).chain(tests));
        }
    }
    table.render("  ")
}

/// A probability with two significant digits.
struct Significant(f64);

impl std::fmt::Display for Significant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            p if p >= 0.1 => write!(f, "{p:.2}"),
            p if p >= 0.001 => write!(f, "{p:.4}"),
            p if p > 0.0 => write!(f, "{p:.1e}"),
            _ => f.write_str("0"),
        }
    }
}

fn parse_level(text: &str) -> Result<f64, String> {
    let level: Option<f64> = text.parse().ok();
    let level = level.filter(|level| *level > 0.0 && *level < 1.0);
    level.ok_or_else(|| "write a probability above 0 and below 1, as in 0.01".to_owned())
}

#[cfg(test)]
mod tests {
    use cotorra_experiments::repeat::{Sample, Two};

    use super::*;

    fn service(least_ms: f64) -> Service {
        let times = |least_ms: f64| Sample::new((0..100).map(|i| least_ms + f64::from(i) / 10.0).collect());
        let two = Two::of(&times(10.0), &times(least_ms), 15.0, 0.1);
        Service { robot: "robot".to_owned(), service: "navigation".to_owned(), two }
    }

    #[test]
    fn distributions_are_shown_with_their_tests() {
        let services = vec![service(10.0), service(16.0)];
        let outcome = Outcome::Distributions { services, tolerance_ms: 0.1, valid: [true, false] };
        let text = describe(&Compared { of: PathBuf::from("walk"), outcome }, 0.01);
        let head = "walk: 4 tests of 2 services; 0.10 ms are within the lateness of packets; each test at 0.0025\n\n";
        assert!(text.starts_with(head), "{text}");
        let rows: Vec<Vec<_>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows[3], ["navigation", "of", "robot", "run", "100", "14.95", "19.80", "51.00"]);
        assert_eq!(rows[4], ["repeat", "100", "14.95", "19.80", "51.00", "1.00", "1.00"]);
        assert_eq!(rows[6][..5], ["repeat", "100", "20.95", "25.80", "0.00"]);
        assert_eq!(rows[6].iter().filter(|cell| **cell == "*").count(), 2, "{text}");
        assert!(text.ends_with("\nthe figures of the repeat are NOT VALID\n"), "{text}");
    }

    #[test]
    fn files_that_differ_are_named() {
        let of = |same, different: &[&str]| {
            let different = different.iter().map(PathBuf::from).collect();
            describe(&Compared { of: PathBuf::new(), outcome: Outcome::Bytes { same, different } }, 0.01)
        };
        assert_eq!(of(3, &[]), "all files are the same to the byte\n");
        assert_eq!(of(2, &["summary.json"]), "1 of 3 files differ: summary.json\n");
        let many: Vec<_> = (0..12).map(|i| i.to_string()).collect();
        let many: Vec<_> = many.iter().map(String::as_str).collect();
        assert!(of(0, &many).ends_with("8, 9 and 2 more\n"));
    }

    #[test]
    fn a_level_is_between_0_and_1() {
        assert_eq!(parse_level("0.05"), Ok(0.05));
        for wrong in ["0", "1", "5%", "nan", ""] {
            assert!(parse_level(wrong).is_err(), "{wrong}");
        }
    }
}
