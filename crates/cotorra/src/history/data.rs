//! `cotorra history data`: large data of sensors, which is beside the history, in the run's folder.

use std::{fs, io, path::PathBuf};

use cotorra_graph::SensorId;
use cotorra_measurements::{WantedData, read_large_data};

use super::{answer::seconds, args::DataArgs, events, source};
use crate::output;

/// Why there is nothing to be written.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum DataError {
    #[error("no such reading of sensor `{sensor}` is kept in {}", folder.display())]
    #[diagnostic(help(
        "the oldest go first; `cotorra history events {} --kinds sensor` lists all",
        folder.display()
    ))]
    None { sensor: SensorId, folder: PathBuf },
    #[error("cannot {what}: {source}")]
    System { what: String, source: io::Error },
}

/// Writes a reading to a file.
pub fn data(args: &DataArgs) -> miette::Result<()> {
    let DataArgs { run, robot, sensor, sequence, out, runs } = args;
    let folder = source::folder(run, runs)?;
    let wanted = sequence.map_or(WantedData::UpTo(u64::MAX), WantedData::Number);
    let system = |what: String| move |source| DataError::System { what, source };
    let stored = read_large_data(&folder, robot, sensor, wanted)
        .map_err(system(format!("read what {} has of sensor `{sensor}`", folder.display())))?;
    let stored = stored.ok_or_else(|| DataError::None { sensor: sensor.clone(), folder })?;
    fs::write(out, &stored.bytes).map_err(system(format!("write {}", out.display())))?;
    let (what, at) = (events::large_data(&stored.data), seconds(stored.measured));
    output::print(&format!("{what}, measured at {at} s: {}\n", out.display()))
}
