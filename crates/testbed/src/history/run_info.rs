//! Identification of a run in its history and recording.

use cotorra_graph::Testbed;
use cotorra_measurements::RunInfo;
use cotorra_recording::About;
use cotorra_wais::types::Epoch;

/// Describes a run that begins now.
#[allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "the calendar is read once, when a run begins"
)]
pub(crate) fn run_info(testbed: &Testbed, seed: u64, text: &str) -> RunInfo {
    let since_1970 = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
    RunInfo {
        name: testbed.name.clone(),
        seed,
        started_at_unix_ns: i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX),
        testbed: text.to_owned(),
    }
}

/// Returns the description of a run for its recording.
pub fn about(info: &RunInfo) -> About<'_> {
    let RunInfo { name, seed, started_at_unix_ns, testbed } = info;
    About { name, seed: *seed, started_at_unix_ns: *started_at_unix_ns, testbed_file: testbed }
}

/// Returns the calendar time of a run's beginning.
pub(crate) fn epoch(info: &RunInfo) -> Epoch {
    Epoch { unix_ns: u64::try_from(info.started_at_unix_ns).unwrap_or_default() }
}
