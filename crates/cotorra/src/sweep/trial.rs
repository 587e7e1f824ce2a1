//! Runs that are tried out to find how long shards take.

use std::{num::NonZero, path::Path, time::Duration};

use cotorra_experiments::sweep::{Point, Sweep, SweepError};

use crate::words::count;

/// Time after which the trial ends.
const LONGEST: Duration = Duration::from_secs(60);
/// Schedulers need seconds to start a shard.
const SHORT: f64 = 60.0;
/// The number of shards is chosen so that each takes at least this long, in seconds. Other machines may be faster.
const AIM: f64 = 120.0;
/// Maximum number of shards that is chosen. Slurm's arrays have no more tasks, as it is configured by default.
const MOST: usize = 1000;

/// Measured durations of a few runs of a sweep.
pub struct Trial {
    runs: usize,
    /// Number of runs of a shard at a time.
    jobs: NonZero<usize>,
    /// Mean duration of a run in seconds; `None` if none ended before the trial did.
    run_s: Option<f64>,
}

impl Trial {
    /// Tries out the first run, one in the middle, and the last. `folder` may be needed meanwhile.
    #[allow(clippy::disallowed_types, reason = "the machine's own time is measured")]
    pub fn new(
        sweep: &Sweep,
        points: &[Point],
        jobs: NonZero<usize>,
        folder: &Path,
    ) -> Result<Self, SweepError> {
        let mut places = vec![0, points.len() / 2, points.len() - 1];
        places.dedup();
        let began = std::time::Instant::now();
        let (mut ended, mut run_s) = (0_u32, None);
        for place in places {
            if !sweep.try_out(&points[place], folder, || began.elapsed() < LONGEST)? {
                break;
            }
            ended += 1;
            run_s = Some((began.elapsed() / ended).as_secs_f64());
        }
        Ok(Self { runs: points.len(), jobs, run_s })
    }

    /// Returns a number of shards that take neither less than two minutes nor, if that can be, much longer.
    pub fn shards(&self) -> NonZero<usize> {
        let shards = self.shard_s(NonZero::<usize>::MIN).map_or(self.runs, |all_s| (all_s / AIM) as usize);
        NonZero::new(shards.min(self.runs).min(MOST)).unwrap_or(NonZero::<usize>::MIN)
    }

    /// Returns the duration of a shard in seconds, if it is known.
    fn shard_s(&self, shards: NonZero<usize>) -> Option<f64> {
        Some(self.run_s? * self.runs as f64 / shards.get() as f64 / self.jobs.get() as f64)
    }

    /// Describes the shards in a line.
    pub fn summary(&self, shards: NonZero<usize>) -> String {
        let (least, most) = (self.runs / shards, self.runs.div_ceil(shards.get()));
        let each = if least == most { least.to_string() } else { format!("{least} or {most}") };
        let time = match self.shard_s(shards) {
            Some(seconds) => format!("about {}", rounded(seconds)),
            None => "more than a minute for each run".to_owned(),
        };
        format!("{} in {} of {each} ({time})", count(self.runs, "run"), count(shards.get(), "shard"))
    }

    /// Returns a warning if shards are too short.
    pub fn warning(&self, shards: NonZero<usize>) -> Option<String> {
        let is_short = self.shard_s(shards)? < SHORT;
        let better = self.shards();
        let remedy = if better < shards {
            format!("use --shards {better}, or more seeds")
        } else {
            "one machine alone may be as fast".to_owned()
        };
        is_short.then(|| {
            format!("warning: shards are short, but a scheduler needs seconds to start each: {remedy}")
        })
    }
}

/// `8 s`, `3 min` or `2.5 h`.
fn rounded(seconds: f64) -> String {
    match seconds {
        ..1.0 => "a second".to_owned(),
        ..90.0 => format!("{seconds:.0} s"),
        ..5400.0 => format!("{:.0} min", seconds / 60.0),
        _ => format!("{:.1} h", seconds / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(runs: usize, jobs: usize, run_s: Option<f64>) -> Trial {
        Trial { runs, jobs: NonZero::new(jobs).unwrap(), run_s }
    }

    #[test]
    fn shards_take_two_minutes_where_there_are_enough_runs() {
        for (runs, jobs, run_s, shards) in [
            (280, 1, Some(0.2), 1),
            (6000, 1, Some(0.2), 10),
            (6000, 4, Some(0.2), 2),
            (40, 1, Some(300.0), 40),
            (40, 1, None, 40),
            (100_000, 1, Some(10.0), 1000),
        ] {
            assert_eq!(trial(runs, jobs, run_s).shards().get(), shards, "{runs} {jobs} {run_s:?}");
        }
    }

    #[test]
    fn short_shards_are_warned_of_with_a_better_number() {
        let warning = |run_s, shards| trial(6000, 1, run_s).warning(NonZero::new(shards).unwrap());
        assert!(warning(Some(0.2), 40).unwrap().contains("use --shards 10"));
        assert!(warning(Some(0.005), 1).unwrap().contains("one machine alone"));
        assert_eq!((warning(Some(0.2), 20), warning(None, 6000)), (None, None));
    }

    #[test]
    fn the_summary_has_the_runs_of_a_shard() {
        let summary = |runs, run_s| trial(runs, 1, run_s).summary(NonZero::new(4).unwrap());
        assert_eq!(summary(280, Some(3.0)), "280 runs in 4 shards of 70 (about 4 min)");
        assert_eq!(summary(10, Some(0.1)), "10 runs in 4 shards of 2 or 3 (about a second)");
        assert_eq!(summary(4, None), "4 runs in 4 shards of 1 (more than a minute for each run)");
    }
}
