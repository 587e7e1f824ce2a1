//! `cotorra-lab bench`: measures images. Benchmarks of the emulated network are commands of `cotorra-lab`.

#[cfg(feature = "containers")]
mod image;

use std::process::ExitCode;

use clap::{Args, Subcommand};

use crate::moved::Moved;

/// Measure how long an image takes to start and to answer
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
    #[cfg(feature = "containers")]
    Image(image::ImageArgs),
    /// Measure how long an image takes to start and to answer (needs a build with `--features containers`)
    #[cfg(not(feature = "containers"))]
    #[command(disable_help_flag = true)]
    Image {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        _arguments: Vec<std::ffi::OsString>,
    },
}

/// Measures an image.
pub fn bench(args: &BenchArgs) -> miette::Result<ExitCode> {
    match &args.of {
        #[cfg(feature = "containers")]
        Some(BenchOf::Image(args)) => image::image(args),
        #[cfg(not(feature = "containers"))]
        Some(BenchOf::Image { .. }) => Err(miette::miette!(
            help = "build it with `--features containers`",
            "this cotorra was built without containers"
        )),
        None => Err(args.moved.error("bench").into()),
    }
}
