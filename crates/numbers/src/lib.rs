//! Random streams and distributions, and statistics of samples and of runs: quantiles, intervals, resampling and comparisons.
//!
//! There is one definition of each figure. A quantile is that of type 7 of Hyndman and Fan, "Sample Quantiles in Statistical
//! Packages" (The American Statistician 50(4), 1996): linear interpolation between closest ranks, as in NumPy, R and
//! spreadsheets. All intervals have 95 %.
//!
//! The crate has no clock and reads nothing. Random numbers come from a seed.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod bootstrap;
mod counted;
mod distribution;
mod draws;
mod gathered;
mod interval;
mod mean;
mod quantile;
mod resampler;
pub mod seed;
mod share;

pub use self::{
    bootstrap::{Blocks, RESAMPLES, bootstrap, percentile_interval, resample},
    counted::Counted,
    distribution::{Distribution, distance},
    draws::Draws,
    gathered::{Approximate, Gathered, Sorted},
    interval::Interval,
    mean::{FEWEST, Mean, holm},
    quantile::{Quantiles, median, quantile, quantile_of_times},
    resampler::{Resampler, block_length},
    share::{share_over_runs, wilson, wilson_at},
};
