//! `cotorra bench`: measures images and VNFs. Benchmarks of the emulated network are commands of `cotorra-lab`.

mod image;
mod vnf;

use std::process::ExitCode;

use clap::{Args, Subcommand};

use crate::moved::Moved;

/// Measure how long an image takes to start and to answer, or the CPU time of a VNF
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, disable_help_subcommand = true)]
pub struct BenchArgs {
    #[command(subcommand)]
    of: Option<BenchOf>,
    #[command(flatten)]
    moved: Moved,
}

/// Subjects of measurements.
#[derive(Debug, Subcommand)]
enum BenchOf {
    Image(image::ImageArgs),
    Vnf(vnf::VnfArgs),
}

/// Measures an image or a VNF.
pub fn bench(args: &BenchArgs) -> miette::Result<ExitCode> {
    match &args.of {
        Some(BenchOf::Image(args)) => image::image(args),
        Some(BenchOf::Vnf(args)) => vnf::vnf(args),
        None => Err(args.moved.error("bench").into()),
    }
}
