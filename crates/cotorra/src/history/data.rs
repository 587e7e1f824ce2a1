//! `cotorra history data`: writes a large reading of a sensor, which is kept in the run's folder beside the history.

use std::{fs, io, path::PathBuf};

use cotorra_graph::SensorId;
use cotorra_measurements::{WantedData, read_large_data};

use super::{answer::seconds, args::DataArgs, source};
use crate::output;

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum DataError {
    #[error("{} has no such reading of sensor `{sensor}`", folder.display())]
    #[diagnostic(help(
        "the oldest readings are removed first; `cotorra history events {} --kinds sensor` lists all",
        folder.display()
    ))]
    None { sensor: SensorId, folder: PathBuf },
    #[error("cannot {what}: {source}")]
    System { what: String, source: io::Error },
}

/// Writes the reading to a file.
pub fn data(args: &DataArgs) -> miette::Result<()> {
    let DataArgs { run, robot, sensor, sequence, out, runs } = args;
    let folder = source::folder(run, runs)?;
    let wanted = sequence.map_or(WantedData::UpTo(u64::MAX), WantedData::Number);
    let system = |what: String| move |source| DataError::System { what, source };
    let stored = read_large_data(&folder, robot, sensor, wanted)
        .map_err(system(format!("read the data of sensor `{sensor}` in {}", folder.display())))?;
    let stored = stored.ok_or_else(|| DataError::None { sensor: sensor.clone(), folder })?;
    fs::write(out, &stored.bytes).map_err(system(format!("write {}", out.display())))?;
    let (what, at) = (stored.data.text(), seconds(stored.measured));
    output::print(&format!("{what}, measured at {at} s: {}\n", out.display()))
}
