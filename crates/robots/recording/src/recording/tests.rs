use cotorra_graph::{Event, NodeId, Timestamp};
use cotorra_robot_middleware::Scan;

use super::*;

const TESTBED: &str = "
name: hall
wireless: { hall: { standard: n, delay: 1 ms } }
nodes:
  tb2: { kind: robot, cpus: 2, memory: 8 GB, position: [1, 2], network: hall }
  R1: { kind: radio_unit, position: [3, 4], channel: 1, network: hall }
links: []
";

fn testbed() -> Arc<Testbed> {
    let read = cotorra_testbed_file::parse("hall.yaml", TESTBED, Path::new("."));
    Arc::new(read.unwrap_or_else(|error| panic!("{error}")))
}

fn about() -> About<'static> {
    About { name: "hall", seed: 7, started_at_unix_ns: 0, testbed_file: TESTBED }
}

fn notice(second: u64) -> Arc<Stamped> {
    let at = Timestamp::from_nanos(second * 1_000_000_000);
    Arc::new(Stamped { at, event: Event::Notice { message: format!("second {second}") } })
}

fn begin(place: &Path, pace: Pace) -> Recording {
    let wanted = Wanted { file: Some(RecordingPlace::Folder), foxglove: None };
    Recording::begin(&wanted, place, &testbed(), about(), pace).unwrap().unwrap()
}

/// Records a notice each second for a minute.
fn minute(place: &Path) -> Vec<u8> {
    let recording = begin(place, Pace::Waiting);
    let tap = recording.tap();
    (0..60).for_each(|second| tap.event(notice(second)));
    let summary = recording.finish();
    assert_eq!((summary.dropped, &summary.failed), (0, &None));
    // And once, the fixed parts of the testbed.
    assert_eq!(summary.messages, 61);
    std::fs::read(summary.file.unwrap()).unwrap()
}

/// Returns the messages up to the truncation, as `mcap recover` finds them.
fn readable(bytes: &[u8]) -> usize {
    let lenient = mcap::read::Options::IgnoreEndMagic.into();
    mcap::MessageStream::new_with_options(bytes, lenient).unwrap().map_while(Result::ok).count()
}

#[test]
fn same_events_give_the_same_bytes() {
    let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    assert_eq!(minute(one.path()), minute(other.path()));
}

#[test]
fn truncated_file_has_every_chunk_before() {
    let place = tempfile::tempdir().unwrap();
    let whole = minute(place.path());
    let summary = mcap::Summary::read(&whole).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 61);
    let mut ends: Vec<_> =
        summary.chunk_indexes.iter().map(|c| (c.chunk_start_offset + c.chunk_length) as usize).collect();
    ends.sort_unstable();
    assert_eq!(ends.len(), 30, "a chunk has two seconds");
    for cut in (0..whole.len()).step_by(97).chain(ends.clone()) {
        let chunks = ends.iter().filter(|end| **end <= cut).count();
        // The first chunk has the fixed parts, too.
        let expected = if chunks == 0 { 0 } else { 1 + 2 * chunks };
        // A reader may get a part of the truncated chunk.
        let read = if cut < 8 { 0 } else { readable(&whole[..cut]) };
        assert!((expected..expected + 4).contains(&read), "{read} when cut off at {cut} of {}", whole.len());
    }
}

#[test]
fn dropped_recording_is_complete() {
    let place = tempfile::tempdir().unwrap();
    let recording = begin(place.path(), Pace::Live);
    recording.tap().event(notice(1));
    drop(recording);
    let bytes = std::fs::read(place.path().join("recording.mcap")).unwrap();
    assert_eq!(mcap::Summary::read(&bytes).unwrap().unwrap().stats.unwrap().message_count, 2);
}

#[test]
fn existing_file_is_not_touched() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("mine.mcap");
    std::fs::write(&path, "mine").unwrap();
    let wanted = Wanted { file: Some(RecordingPlace::File(path.clone())), foxglove: None };
    let refused = Recording::begin(&wanted, place.path(), &testbed(), about(), Pace::Live);
    assert!(matches!(refused, Err(RecordingError::Taken(_))));
    assert_eq!(std::fs::read(path).unwrap(), b"mine");
}

#[test]
fn full_disk_is_reported() {
    let full = Path::new("/dev/full");
    let file = std::fs::OpenOptions::new().write(true).open(full).unwrap();
    let refused = McapFile::on(file, full, about()).err().unwrap();
    assert!(refused.to_string().starts_with("cannot write /dev/full: No space left"), "{refused}");
}

/// A sink that blocks until it is released.
struct Slow(Arc<AtomicBool>);

impl Sink for Slow {
    fn write(&mut self, _: &crate::Encoded<'_>) -> Result<(), RecordingError> {
        while !self.0.load(Ordering::Acquire) {
            thread::yield_now();
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), RecordingError> {
        Ok(())
    }
}

#[test]
fn live_run_never_waits_and_counts_losses() {
    let let_go = Arc::new(AtomicBool::new(false));
    let sinks: Vec<Box<dyn Sink>> = vec![Box::new(Slow(Arc::clone(&let_go)))];
    let recording = Recording::into_sinks(sinks, &testbed(), Pace::Live).unwrap();
    let tap = recording.tap();
    let told = 2 * QUEUE as u64;
    (0..told).for_each(|second| tap.event(notice(second)));
    let_go.store(true, Ordering::Release);
    let summary = recording.finish();
    assert_eq!(summary.messages - 1 + summary.dropped, told);
    assert!(summary.dropped >= told - QUEUE as u64 - 1, "{summary:?}");
}

fn scan() -> Scan {
    Scan {
        at: Timestamp::ZERO,
        first_angle: 0.0,
        angle_step: 0.1,
        ray_interval: Duration::ZERO,
        turn: PERIOD,
        range_min: 0.1,
        range_max: 9.0,
        ranges: vec![1.0; 3],
    }
}

#[test]
fn scans_of_unknown_robots_are_ignored() {
    let place = tempfile::tempdir().unwrap();
    let recording = begin(place.path(), Pace::Waiting);
    for robot in ["tb2", "nobody"] {
        let scan = scan();
        recording.tap().scan(SensedScan { robot: NodeId::new(robot).unwrap(), at: Timestamp::ZERO, scan });
    }
    assert_eq!(recording.finish().messages, 2);
}

#[cfg(not(feature = "foxglove"))]
#[test]
fn missing_feature_is_reported_with_its_remedy() {
    let wanted = Wanted { file: None, foxglove: Some(([127, 0, 0, 1], 0).into()) };
    let refused = Recording::begin(&wanted, Path::new("."), &testbed(), about(), Pace::Live).unwrap_err();
    assert!(refused.to_string().contains("--features foxglove"), "{refused}");
}
