//! Makes a localization problem with a known answer from a public lidar data set: a log that GMapping corrected.
//!
//! Such logs (the "corrected" ones of the Radish collection) hold the corrected pose in each `FLASER`, and, in the
//! `ODOM` between two of them, raw odometry set onto the first one's corrected pose. From that follow the raw odometry
//! of the whole run, a map, and where the robot was.
//!
//! `cargo run --release -p cotorra-localization --example corrected_log -- LOG FOLDER [FROM TO]` writes FOLDER/raw.log,
//! FOLDER/map.yaml, FOLDER/map.pgm and FOLDER/reference.csv, of the scans from number FROM up to TO alone where a
//! correction is not right all along. Then it localizes in both modes with several seeds, and tells the errors.

use std::{
    env,
    error::Error,
    fmt::Write as _,
    fs::{self, File},
    io::BufReader,
    path::Path,
    sync::Arc,
};

use cotorra_graph::map_server;
use cotorra_localization::{
    LikelihoodField, Localizer, Parameters, Pose2,
    carmen::{Laser, Log, Message},
    trajectory::{Errors, Trajectory},
};

/// Side of a cell, metres.
const RESOLUTION: f64 = 0.05;
/// Farther readings do not make the map, metres.
const REACH: f64 = 30.0;
/// A cell is a wall if this share of the beams that came to it ended there (GMapping's threshold).
const OCCUPIED: f64 = 0.25;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args().skip(1);
    let usage = "usage: corrected_log LOG FOLDER [FROM TO]";
    let (log, folder) = (arguments.next().ok_or(usage)?, arguments.next().ok_or(usage)?);
    let from: usize = arguments.next().map_or(Ok(0), |text| text.parse())?;
    let to: usize = arguments.next().map_or(Ok(usize::MAX), |text| text.parse())?;
    let folder = Path::new(&folder);
    fs::create_dir_all(folder)?;

    let (mut scans, mut raw) = (Vec::new(), Vec::new());
    let (mut corrected, mut at): (Option<Pose2>, _) = (None, Pose2::default());
    let mut odometry: Option<Pose2> = None;
    for message in Log::new(BufReader::new(File::open(log)?)) {
        match message? {
            Message::Odometry { pose, .. } => odometry = Some(pose),
            Message::Laser(laser) => {
                if let (Some(corrected), Some(odometry)) = (corrected, odometry) {
                    at = at * corrected.step_to(odometry);
                } else {
                    at = laser.robot;
                }
                (corrected, odometry) = (Some(laser.robot), None);
                raw.push(at);
                scans.push(laser);
            }
        }
    }
    let kept = from.min(scans.len())..to.min(scans.len());
    let (scans, raw) = (scans.get(kept.clone()).ok_or(usage)?, raw.get(kept).ok_or(usage)?);
    draw(scans, folder)?;

    let mut log = String::from("# CARMEN Logfile\n");
    let mut reference = String::from("time,x,y,heading\n");
    for (nth, (scan, odometry)) in scans.iter().zip(raw).enumerate() {
        // Their clocks stand, jump, or lack digits.
        let time = nth as f64 * 0.1;
        write!(log, "FLASER {}", scan.ranges.len())?;
        scan.ranges.iter().try_for_each(|range| write!(log, " {range}"))?;
        let Pose2 { x, y, heading } = odometry;
        writeln!(log, " {x} {y} {heading} {x} {y} {heading} {time} host {time}")?;
        let Pose2 { x, y, heading } = scan.robot;
        writeln!(reference, "{time},{x},{y},{heading}")?;
    }
    fs::write(folder.join("raw.log"), log)?;
    fs::write(folder.join("reference.csv"), reference)?;
    evaluate(folder)
}

/// Seeds with which a log is localized.
const SEEDS: std::ops::RangeInclusive<u64> = 1..=3;

/// Localizes what was written, as `cotorra localize` does.
fn evaluate(folder: &Path) -> Result<(), Box<dyn Error>> {
    let map = map_server::load(folder.join("map.yaml")).map_err(|wrong| format!("{wrong:?}"))?;
    let reference = Trajectory::read(BufReader::new(File::open(folder.join("reference.csv"))?))?;
    let mut scans = Vec::new();
    for message in Log::new(BufReader::new(File::open(folder.join("raw.log"))?)) {
        if let Message::Laser(laser) = message? {
            scans.push(laser);
        }
    }
    for (mode, parameters) in [("likelihood", Parameters::default()), ("amcl", Parameters::amcl())] {
        let field = Arc::new(LikelihoodField::new(&map, &parameters));
        for seed in SEEDS {
            let start = reference.first().ok_or("the log has no scan")?;
            let about = [0.25, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.0685];
            let mut localizer = Localizer::at(Arc::clone(&field), parameters, seed, start, &about)?;
            let mut errors = Errors::default();
            for (nth, scan) in scans.iter().enumerate() {
                let estimate = localizer.observe(scan.robot, &scan.scan())?;
                if let Some(truth) = reference.at(nth, scans.len(), scan.at) {
                    errors.push(&estimate.belief(), truth);
                }
            }
            println!("{mode:10}  seed {seed}  {errors}");
        }
    }
    Ok(())
}

/// Writes a map of what the beams met, in map_server's files.
fn draw(scans: &[Laser], folder: &Path) -> Result<(), Box<dyn Error>> {
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
    for (_, (x, y)) in beams() {
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    }
    let origin = (low.0 - 1.0, low.1 - 1.0);
    let size = |low: f64, high: f64| ((high - low + 2.0) / RESOLUTION) as usize;
    let (width, height) = (size(low.0, high.0), size(low.1, high.1));
    // Of each cell: how many beams ended there, and how many went through.
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
    let mut picture = format!("P5\n{width} {height}\n255\n").into_bytes();
    for row in met.chunks(width).rev() {
        picture.extend(row.iter().map(|&(ended, through)| match ended + through {
            0 => 205,
            all if f64::from(ended) > OCCUPIED * f64::from(all) => 0,
            _ => 254_u8,
        }));
    }
    fs::write(folder.join("map.pgm"), picture)?;
    let yaml = format!(
        "image: map.pgm\nresolution: {RESOLUTION}\norigin: [{}, {}, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        origin.0, origin.1
    );
    Ok(fs::write(folder.join("map.yaml"), yaml)?)
}
