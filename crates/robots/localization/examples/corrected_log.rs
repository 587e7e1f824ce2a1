//! Evaluates localization on public lidar data sets: logs that GMapping corrected.
//!
//! Each `FLASER` of such a log ("corrected" in the Radish collection) has the corrected pose. The `ODOM` between two of
//! them has raw odometry, continued from the first one's corrected pose. That gives the raw odometry of the whole run, a
//! map, and the true poses. Even scans draw the map and odd ones are localized, so that no scan is compared with itself.
//!
//! `cargo run --release -p cotorra-localization --example corrected_log -- [--amcl] [--seeds N] LOG[:FROM..TO]...`
//! evaluates all logs with several seeds each, and prints one table. FROM..TO restricts a log to these scans, if its
//! correction is wrong elsewhere.
//!
//! Parameters were tuned on every second log in alphabetical order, from the first: acapulco, belgioioso, edmonton,
//! freiburg-079, freiburg-campus, intel and seattle. The others are for testing: aces, csail, fhw, freiburg-101,
//! infinite-corridor and orebro. Three of these revealed defects that were fixed; docs/use/localization.md names them.

use std::{env, error::Error, fmt, fs::File, io::BufReader, ops::Range, path::Path, sync::Arc, thread};

use cotorra_graph::{Cell, OccupancyGrid, Position};
use cotorra_localization::{
    Belief, LikelihoodField, Localizer, Parameters, Pose2,
    carmen::{Laser, Log, Message},
    trajectory::{best_correlation, rank_correlation},
};
use cotorra_numbers::Draws;

/// Side of a cell, metres.
const RESOLUTION: f64 = 0.05;
/// Longest range that is used for the map, metres.
const REACH: f64 = 30.0;
/// Share of the beams reaching a cell that must end there to make it a wall (GMapping's threshold).
const OCCUPIED: f64 = 0.25;
/// Covariance of the first pose: AMCL's initial variances, m² and rad² (15°).
const ABOUT: [f64; 9] = [0.25, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.0685];
/// 95 % quantile of χ² with three degrees of freedom: x, y and heading.
const INSIDE: f64 = 7.815;
/// Kidnappings for each log and seed.
const KIDNAPPINGS: usize = 10;
/// Distances that a robot is followed before and after it is carried away, metres.
const BEFORE: f64 = 10.0;
const AFTER: f64 = 30.0;
/// Smallest distance that it is carried, metres.
const CARRIED: f64 = 5.0;
/// Error below which a robot has recovered, if it stays so until the end, metres.
const RECOVERED: f64 = 0.5;
/// Smallest honest deviation, √(var x + var y), of a robot that has not recovered, metres.
const WIDE: f64 = 0.3;

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Result<()> {
    let (mut parameters, mut seeds, mut logs) = (Parameters::default(), 3, Vec::new());
    let mut arguments = env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--amcl" => parameters = Parameters::amcl(),
            "--seeds" => seeds = arguments.next().ok_or("--seeds needs a number")?.parse()?,
            _ => logs.push(argument),
        }
    }
    if logs.is_empty() {
        return Err("usage: corrected_log [--amcl] [--seeds N] LOG[:FROM..TO]...".into());
    }
    println!("{HEAD}");
    thread::scope(|scope| {
        let evaluate = |log| scope.spawn(move || Problem::read(log)?.evaluate(&parameters, seeds));
        let results: Vec<_> = logs.iter().map(|log| (log, evaluate(log))).collect();
        let mut all = Outcome::default();
        for (log, result) in results {
            let outcome = result.join().expect("no log panics")?;
            let name = Path::new(log).file_name().unwrap_or_default().to_string_lossy();
            println!("| {} | {outcome} |", name.replace("-corrected.log", ""));
            all.add(outcome);
        }
        println!("| all | {all} |");
        Ok(())
    })
}

/// A scan with the raw odometry at its time.
struct Seen {
    laser: Laser,
    odometry: Pose2,
}

/// A problem made from a log: a map of the even scans, and the odd ones to localize.
struct Problem {
    map: OccupancyGrid,
    scans: Vec<Seen>,
    /// Distance gone up to each scan, metres.
    gone: Vec<f64>,
}

impl Problem {
    fn read(argument: &str) -> Result<Self> {
        let (path, range) = match argument.rsplit_once(':') {
            Some((path, range)) => {
                let (from, to) = range.split_once("..").ok_or("write LOG:FROM..TO")?;
                (path, from.parse()?..to.parse()?)
            }
            None => (argument, 0..usize::MAX),
        };
        let mut scans = read(path)?;
        scans.truncate(range.end);
        let mut even = Vec::new();
        let mut odd = Vec::new();
        for (nth, seen) in scans.into_iter().enumerate().skip(range.start) {
            if nth % 2 == 0 { even.push(seen.laser) } else { odd.push(seen) }
        }
        let first = odd.first().ok_or("there are too few scans")?.laser.robot;
        let mut gone = vec![0.0];
        let mut last = first;
        for seen in &odd[1..] {
            gone.push(gone[gone.len() - 1] + last.distance(seen.laser.robot));
            last = seen.laser.robot;
        }
        Ok(Self { map: draw(&even).ok_or("the map is empty")?, scans: odd, gone })
    }

    fn evaluate(&self, parameters: &Parameters, seeds: u64) -> Result<Outcome> {
        let field = Arc::new(LikelihoodField::new(&self.map, parameters));
        let mut outcome = Outcome::default();
        for seed in 1..=seeds {
            let start = self.scans[0].laser.robot;
            let mut localizer = Localizer::at(Arc::clone(&field), *parameters, seed, start, &ABOUT)?;
            self.follow(&mut localizer, 0..self.scans.len(), Pose2::default(), |_, belief, truth| {
                outcome.followed(belief, truth);
            })?;
            let mut random = Draws::from_seed(seed);
            for nth in 0..KIDNAPPINGS as u64 {
                let seed = seed * KIDNAPPINGS as u64 + nth;
                let Some([before, after]) = self.kidnapping(&mut random) else { continue };
                let start = self.scans[before.start].laser.robot;
                let mut localizer = Localizer::at(Arc::clone(&field), *parameters, seed, start, &ABOUT)?;
                self.follow(&mut localizer, before.clone(), Pose2::default(), |_, _, _| {})?;
                // The wheels do not turn while the robot is carried.
                let (from, to) = (&self.scans[before.end - 1], &self.scans[after.start]);
                let carried = from.odometry * to.odometry.inverse();
                let mut trial = Vec::new();
                let begin = self.gone[after.start];
                self.follow(&mut localizer, after, carried, |gone, belief, truth| {
                    trial.push((gone - begin, *belief, truth));
                })?;
                outcome.kidnapped(&trial);
            }
        }
        Ok(outcome)
    }

    /// Draws the scans before and after a kidnapping.
    fn kidnapping(&self, random: &mut Draws) -> Option<[Range<usize>; 2]> {
        let reach = |begin: usize, way: f64| {
            let end = self.gone.partition_point(|gone| *gone < self.gone[begin] + way) + 1;
            (end <= self.gone.len()).then_some(begin..end)
        };
        let mut any = || (random.bits() % self.scans.len() as u64) as usize;
        let at = |nth: usize| self.scans[nth].laser.robot;
        (0..10_000).find_map(|_| {
            let (before, after) = (reach(any(), BEFORE)?, reach(any(), AFTER)?);
            (at(before.end - 1).distance(at(after.start)) >= CARRIED).then_some([before, after])
        })
    }

    fn follow(
        &self,
        localizer: &mut Localizer,
        scans: Range<usize>,
        carried: Pose2,
        mut told: impl FnMut(f64, &Belief, Pose2),
    ) -> Result<()> {
        for nth in scans {
            let Seen { laser, odometry } = &self.scans[nth];
            let estimate = localizer.observe(carried * *odometry, &laser.scan())?;
            told(self.gone[nth], &estimate.belief(), laser.robot);
        }
        Ok(())
    }
}

/// Results of a log.
#[derive(Default)]
struct Outcome {
    positions: Vec<f64>,
    /// Reported deviations, √(var x + var y), in the same order.
    deviations: Vec<f64>,
    squares: f64,
    inside: usize,
    nees: f64,
    /// Scans of robots that have not recovered, and those among them with too small a deviation.
    lost: usize,
    claimed: usize,
    /// Distance that each kidnapped robot went until it was found; infinite if it was not.
    recovery: Vec<f64>,
}

const HEAD: &str = "\
| log | scans × seeds | median | RMSE | inside 95 % | NEES | rank | at most | kidnapped | claims < 0.3 m | recovery median | max |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|";

impl Outcome {
    fn followed(&mut self, belief: &Belief, truth: Pose2) {
        let error = belief.pose.distance(truth);
        let nees = belief.nees(truth).unwrap_or(f64::INFINITY);
        self.positions.push(error);
        self.deviations.push(deviation(belief));
        self.squares += error * error;
        self.inside += usize::from(nees <= INSIDE);
        self.nees += nees;
    }

    fn kidnapped(&mut self, trial: &[(f64, Belief, Pose2)]) {
        let off = |(_, belief, truth): &(f64, Belief, Pose2)| belief.pose.distance(*truth);
        let found = trial.iter().rposition(|scan| off(scan) >= RECOVERED).map_or(0, |last| last + 1);
        self.recovery.push(trial.get(found).map_or(f64::INFINITY, |(gone, ..)| *gone));
        for (_, belief, _) in trial[..found].iter().filter(|scan| off(scan) >= RECOVERED) {
            self.lost += 1;
            self.claimed += usize::from(deviation(belief) < WIDE);
        }
    }

    fn add(&mut self, other: Self) {
        self.positions.extend(other.positions);
        self.deviations.extend(other.deviations);
        self.squares += other.squares;
        self.inside += other.inside;
        self.nees += other.nees;
        self.lost += other.lost;
        self.claimed += other.claimed;
        self.recovery.extend(other.recovery);
    }
}

/// Returns the reported deviation of the position, metres.
fn deviation(belief: &Belief) -> f64 {
    (belief.covariance[0] + belief.covariance[4]).sqrt()
}

/// Formats a row of the table, without its ends.
impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.positions.len() as f64;
        let median = |values: &[f64]| {
            let mut sorted = values.to_vec();
            sorted.sort_by(f64::total_cmp);
            sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
        };
        write!(f, "{} | {:.3} m | ", self.positions.len(), median(&self.positions))?;
        write!(f, "{:.3} m | ", (self.squares / count).sqrt())?;
        write!(f, "{:.1} % | {:.1} | ", 100.0 * self.inside as f64 / count, self.nees / count)?;
        write!(f, "{:.2} | ", rank_correlation(&self.deviations, &self.positions))?;
        write!(f, "{:.2} | ", best_correlation(&self.positions))?;
        let claimed = 100.0 * self.claimed as f64 / (self.lost as f64).max(1.0);
        let farthest = self.recovery.iter().copied().fold(0.0, f64::max);
        write!(f, "{} | {claimed:.1} % of {} | ", self.recovery.len(), self.lost)?;
        write!(f, "{:.1} m | {farthest:.1} m", median(&self.recovery))
    }
}

/// Reads the scans of a log with their odometry before the correction.
fn read(path: &str) -> Result<Vec<Seen>> {
    let mut scans: Vec<Seen> = Vec::new();
    let mut after: Option<Pose2> = None;
    let file = File::open(path).map_err(|error| format!("{path}: {error}"))?;
    for message in Log::new(BufReader::new(file)) {
        match message? {
            Message::Odometry { pose, .. } => after = Some(pose),
            Message::Laser(laser) => {
                let odometry = match (scans.last(), after.take()) {
                    (None, _) => laser.robot,
                    (Some(last), after) => {
                        last.odometry * last.laser.robot.step_to(after.unwrap_or(laser.robot))
                    }
                };
                scans.push(Seen { laser, odometry });
            }
        }
    }
    Ok(scans)
}

/// Draws a map of the places that beams hit; `None` if they hit nothing.
fn draw(scans: &[Laser]) -> Option<OccupancyGrid> {
    let beams = || {
        scans.iter().flat_map(|scan| {
            scan.ranges.iter().enumerate().filter_map(move |(beam, &range)| {
                let range = f64::from(range);
                let angle = scan.laser.heading + scan.angle_min + beam as f64 * scan.angle_increment;
                let end = (scan.laser.x + range * angle.cos(), scan.laser.y + range * angle.sin());
                (range > 0.0 && range < REACH).then_some(((scan.laser.x, scan.laser.y), end))
            })
        })
    };
    let (mut low, mut high) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
    for (begin, end) in beams() {
        for (x, y) in [begin, end] {
            low = (low.0.min(x), low.1.min(y));
            high = (high.0.max(x), high.1.max(y));
        }
    }
    let origin = (low.0 - 1.0, low.1 - 1.0);
    let size = |low: f64, high: f64| ((high - low + 2.0) / RESOLUTION) as usize;
    let (width, height) = (size(low.0, high.0), size(low.1, high.1));
    // For each cell, the beams that ended there and those that went through.
    let mut met = vec![(0_u32, 0_u32); width * height];
    let cell = |(x, y): (f64, f64)| {
        ((y - origin.1) / RESOLUTION) as usize * width + ((x - origin.0) / RESOLUTION) as usize
    };
    for (begin, end) in beams() {
        let way = (end.0 - begin.0, end.1 - begin.1);
        let steps = (way.0.hypot(way.1) / (0.5 * RESOLUTION)) as usize;
        let last = cell(end);
        let mut passed = usize::MAX;
        for step in 0..steps {
            let share = step as f64 / steps as f64;
            let place = cell((begin.0 + share * way.0, begin.1 + share * way.1));
            if place != passed && place != last {
                met[place].1 += 1;
            }
            passed = place;
        }
        met[last].0 += 1;
    }
    let cells = met
        .iter()
        .map(|&(ended, through)| match ended + through {
            0 => Cell::Unknown,
            all if f64::from(ended) > OCCUPIED * f64::from(all) => Cell::Occupied,
            _ => Cell::Free,
        })
        .collect();
    OccupancyGrid::new(width, height, RESOLUTION, Position::new(origin.0, origin.1), cells)
}
