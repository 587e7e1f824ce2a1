//! `cotorra localize`: computes a robot's trajectory from a recorded log and a map, and its error against a reference.

use std::{
    fmt::Write as _,
    fs::File,
    io::{BufReader, Read as _},
    path::{Path, PathBuf},
    process::ExitCode,
    sync::Arc,
    time::Duration,
};

use clap::{Args, ValueEnum};
use cotorra_localization::{
    Estimate, LikelihoodField, LocalizationError, Localizer, Parameters, Pose2,
    carmen::{Laser, Log, LogError, Message},
    trajectory::{Errors, LOST, Trajectory},
};
use cotorra_testbed::DataTable;
use indicatif::{ProgressBar, ProgressStyle};

use crate::{arguments::parse_seed, exit::Status, output, signals, testbed_file};

/// Localize a robot in a recorded log, by a map
///
/// Runs the Monte Carlo localization of a testbed on a CARMEN log (ROBOTLASER1 or FLASER), the format of most public lidar
/// data sets. Odometry is taken from the laser messages. The trajectory is written as a table: time, pose, covariance,
/// number of particles, and whether the scan was used.
///
/// With a reference, the error of the trajectory is printed. A reference is a corrected log, or lines of `time,x,y,heading`
/// or in the TUM format.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra localize --map intel.yaml --log intel.log > trajectory.csv
  cotorra localize --map intel.yaml --log intel.log --reference intel.corrected.log --out trajectory.csv
  cotorra localize --map intel.yaml --log intel.log --reference intel.corrected.log --mode amcl --seed 7
  cotorra localize --map intel.yaml --log intel.log --global

Exit status: 0 done, 1 error, 2 wrong usage, 130 stopped with Ctrl-C; the trajectory until then is written.")]
pub struct LocalizeArgs {
    /// The map: a YAML file of map_server
    #[arg(long, value_name = "MAP.yaml")]
    pub map: PathBuf,
    /// The log
    #[arg(long, value_name = "LOG")]
    pub log: PathBuf,
    /// True trajectory of the robot
    #[arg(long, value_name = "FILE")]
    pub reference: Option<PathBuf>,
    /// Weighting of particles
    #[arg(long, value_enum, default_value = "likelihood")]
    pub mode: LocalizeMode,
    /// Pose at the first scan, in metres and degrees; default: that of the reference, or else of the log's odometry
    #[arg(long, value_name = "X,Y,HEADING", value_parser = parse_start, allow_hyphen_values = true, conflicts_with = "global")]
    pub start: Option<[f64; 3]>,
    /// Start without any knowledge of the pose
    #[arg(long)]
    pub global: bool,
    /// Range of the laser; readings beyond it hit nothing; default: the log's range, or else 80
    #[arg(long, value_name = "METRES")]
    pub max_range: Option<f64>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = parse_seed)]
    pub seed: u64,
    /// Write the trajectory to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Show no progress bar
    #[arg(long)]
    pub headless: bool,
}

/// Weighting of particles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LocalizeMode {
    /// By the likelihood of the lidar's readings
    Likelihood,
    /// As ROS AMCL does, with its defaults
    Amcl,
}

/// Parses `1.5,-2,90`. The heading is returned in radians.
fn parse_start(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text.split(',').map_while(|part| part.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y, degrees] if [x, y, degrees].iter().all(|number| number.is_finite()) => {
            Ok([x, y, degrees.to_radians()])
        }
        _ => Err("write x, y and heading, such as 1.5,-2,90".to_owned()),
    }
}

/// Variances of the start pose, as AMCL begins with: m² for x and y, and rad² for the heading (15°).
const START_VARIANCE: [f64; 2] = [0.25, 0.0685];

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error("cannot read {}: {reason}", path.display())]
    Unreadable { path: PathBuf, reason: std::io::Error },
    #[error("cannot write {}: {reason}", path.display())]
    Unwritable { path: PathBuf, reason: std::io::Error },
    #[error("{}, {wrong}", path.display())]
    #[diagnostic(help(
        "a log has one FLASER or ROBOTLASER1 message of CARMEN on each line; a reference may also have \
        lines of time,x,y,heading or of time x y z qx qy qz qw"
    ))]
    Malformed { path: PathBuf, wrong: LogError },
    #[error("{} has no laser message", .0.display())]
    #[diagnostic(help("scans of a CARMEN log are on lines that begin with FLASER or ROBOTLASER1"))]
    NoScan(PathBuf),
    #[error("no scan of {} has a beam that hit anything within {reach} m", path.display())]
    #[diagnostic(help("the range is the log's, or else 80 m; set another one with --max-range"))]
    Blind { path: PathBuf, reach: f64 },
    #[error("{} cannot be used: {reason}", path.display())]
    #[diagnostic(help(
        "check occupied_thresh, free_thresh and negate in its YAML file: walls and free space follow from them"
    ))]
    Map { path: PathBuf, reason: LocalizationError },
    #[error("{} has no pose at the times of the log's scans", .0.display())]
    #[diagnostic(help(
        "its times must match the log's; a corrected log may have other times if it has as many scans"
    ))]
    NoReference(PathBuf),
    #[error("a laser cannot have a range of {0} m")]
    #[diagnostic(help("write a range in metres, above zero"))]
    Reach(f64),
    #[error(transparent)]
    Localization(#[from] LocalizationError),
}

/// Localizes the robot at every scan of the log.
pub fn localize(args: &LocalizeArgs) -> miette::Result<ExitCode> {
    if let Some(reach) = args.max_range
        && !(reach > 0.0 && reach.is_finite())
    {
        return Err(Error::Reach(reach).into());
    }
    let map = testbed_file::load_map(&args.map)?;
    let scans = scans(&args.log)?;
    let Some(first) = scans.first() else { return Err(Error::NoScan(args.log.clone()).into()) };
    let reference = args.reference.as_deref().map(trajectory).transpose()?;
    let mut parameters = match args.mode {
        LocalizeMode::Likelihood => Parameters::default(),
        LocalizeMode::Amcl => Parameters::amcl(),
    };
    let reach = args.max_range.or(first.range_max);
    parameters.beams.range_max = reach.unwrap_or(parameters.beams.range_max);
    let reach = parameters.beams.range_max;
    let blind = scans.iter().filter(|scan| !scan.scan().is_usable(reach)).count();
    if blind == scans.len() {
        return Err(Error::Blind { path: args.log.clone(), reach }.into());
    }
    let field = Arc::new(LikelihoodField::new(&map, &parameters));
    field.check().map_err(|reason| Error::Map { path: args.map.clone(), reason })?;
    let truth = |nth: usize| reference.as_ref().and_then(|r| r.at(nth, scans.len(), scans[nth].at));
    let localizer = if args.global {
        Localizer::anywhere(field, parameters, args.seed)
    } else {
        let given = args.start.map(|[x, y, heading]| Pose2::new(x, y, heading));
        let start = given.or_else(|| truth(0)).unwrap_or(first.robot);
        let [position, heading] = START_VARIANCE;
        let covariance = [position, 0.0, 0.0, 0.0, position, 0.0, 0.0, 0.0, heading];
        Localizer::at(field, parameters, args.seed, start, &covariance)
    };
    let mut localizer = localizer.map_err(Error::from)?;

    let interrupts = signals::listen()?;
    let bar = progress(scans.len(), args.headless);
    let mut table = DataTable::new(HEADS);
    let mut found: Vec<Estimate> = Vec::with_capacity(scans.len());
    for scan in &scans {
        if interrupts.try_recv().is_ok() {
            break;
        }
        let estimate = localizer.observe(scan.robot, &scan.scan()).map_err(Error::from)?;
        table.row(row(scan.at, &estimate));
        found.push(estimate);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let mut summary = summary(&found, scans.len(), args.reference.as_ref().map(|path| (path, truth)))?;
    if blind > 0 {
        writeln!(
            summary,
            "warning: {blind} scans have no beam that hit anything within {reach} m; they are skipped"
        )
        .expect("writing into a string cannot fail");
    }
    let table = table.to_csv();
    match &args.out {
        Some(path) => {
            let unwritable = |reason| Error::Unwritable { path: path.clone(), reason };
            std::fs::write(path, table).map_err(unwritable)?;
            output::print(&summary)?;
        }
        None => {
            output::print_exact(&table)?;
            output::write_note(format_args!("{summary}"));
        }
    }
    Ok(if found.len() == scans.len() { ExitCode::SUCCESS } else { Status::Interrupted.into() })
}

fn open(path: &Path) -> Result<BufReader<File>, Error> {
    let unreadable = |reason| Error::Unreadable { path: path.to_owned(), reason };
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    // A folder can be opened, too; only reading it fails.
    file.read_exact(&mut []).and_then(|()| file.get_ref().metadata()).map_err(unreadable)?;
    Ok(file)
}

fn scans(path: &Path) -> Result<Vec<Laser>, Error> {
    let mut scans = Vec::new();
    for message in Log::new(open(path)?) {
        if let Message::Laser(laser) =
            message.map_err(|wrong| Error::Malformed { path: path.to_owned(), wrong })?
        {
            scans.push(laser);
        }
    }
    Ok(scans)
}

fn trajectory(path: &Path) -> Result<Trajectory, Error> {
    Trajectory::read(open(path)?).map_err(|wrong| Error::Malformed { path: path.to_owned(), wrong })
}

fn progress(scans: usize, headless: bool) -> ProgressBar {
    if headless {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{wide_bar:.cyan/dim}  {pos} of {len} scans, {eta} to go")
        .expect("a template that is right")
        .progress_chars("━╸─");
    let bar = ProgressBar::new(scans as u64).with_style(style);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

const HEADS: [&str; 12] = [
    "time",
    "x",
    "y",
    "heading",
    "var_x",
    "cov_xy",
    "cov_xh",
    "var_y",
    "cov_yh",
    "var_h",
    "particles",
    "updated",
];

/// Returns the row of a scan, under [`HEADS`].
fn row(at: f64, estimate: &Estimate) -> impl Iterator<Item = String> + use<> {
    let Estimate { pose, covariance: c, particles, updated } = estimate;
    let Pose2 { x, y, heading } = pose;
    let pose = [at.to_string(), format!("{x:.4}"), format!("{y:.4}"), format!("{heading:.5}")];
    let upper = [c[0], c[1], c[2], c[4], c[5], c[8]].map(|entry| format!("{entry:.3e}"));
    let used = [particles.to_string(), u8::from(*updated).to_string()];
    pose.into_iter().chain(upper).chain(used)
}

/// Summarises the result. Errors count from the first scan whose estimate is near the reference.
fn summary(
    found: &[Estimate],
    scans: usize,
    reference: Option<(&PathBuf, impl Fn(usize) -> Option<Pose2>)>,
) -> Result<String, Error> {
    let updates = found.iter().filter(|estimate| estimate.updated).count();
    let particles = found.iter().map(|estimate| estimate.particles).sum::<usize>() / found.len().max(1);
    let mut text =
        format!("{} of {scans} scans, {updates} of them used; {particles} particles\n", found.len());
    let Some((path, truth)) = reference else { return Ok(text) };
    let pairs: Vec<_> = found.iter().enumerate().filter_map(|(nth, e)| Some((nth, e, truth(nth)?))).collect();
    if pairs.is_empty() && !found.is_empty() {
        return Err(Error::NoReference(path.clone()));
    }
    let Some(begin) = pairs.iter().position(|(_, e, truth)| e.pose.distance(*truth) <= LOST) else {
        return Ok(text + "the robot was never localized\n");
    };
    if begin > 0 {
        writeln!(text, "localized at scan {}", pairs[begin].0 + 1)
            .expect("writing into a string cannot fail");
    }
    let mut errors = Errors::default();
    pairs[begin..].iter().for_each(|(_, estimate, truth)| errors.push(&estimate.belief(), *truth));
    Ok(text + &format!("{errors}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_is_x_y_and_a_heading_in_degrees() {
        assert_eq!(parse_start("1.5, -2,0"), Ok([1.5, -2.0, 0.0]));
        assert_eq!(parse_start("0,0,180"), Ok([0.0, 0.0, std::f64::consts::PI]));
        for wrong in ["", "1,2", "1,2,3,4", "1,2,nan", "a,b,c"] {
            assert!(parse_start(wrong).is_err(), "{wrong}");
        }
    }
}
