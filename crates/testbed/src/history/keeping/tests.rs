use cotorra_graph::{DataFormat, LargeData, Timestamp};
use cotorra_robot_middleware::Content;

use super::*;

fn sensed(sequence: u64, bytes: usize) -> SensedData {
    let content: Arc<[u8]> = vec![sequence as u8; bytes].into();
    let at = Timestamp::from_nanos(sequence);
    SensedData {
        robot: "r".parse().unwrap(),
        sensor: "front".parse().unwrap(),
        measured: at,
        at,
        data: LargeData { sequence, format: DataFormat::Mono8, width: 1, height: 1, bytes: bytes as u64 },
        content: Content::Bytes(content),
    }
}

fn keep(bytes: u64) -> Keep {
    let SensedData { robot, sensor, .. } = sensed(0, 0);
    [((robot, sensor), bytes)].into()
}

/// Numbers of those up to `last` that can be read.
fn kept(keeper: &Keeper, last: u64) -> Vec<u64> {
    let of = sensed(0, 0);
    let read = |wanted| keeper.read(&of.robot, &of.sensor, wanted).unwrap();
    let kept: Vec<_> = (0..=last).filter(|n| read(WantedData::Number(*n)).is_some()).collect();
    let newest = read(WantedData::UpTo(last)).map(|stored| stored.data.sequence);
    assert_eq!(newest, kept.last().copied());
    kept
}

/// Writes what waits, and nothing after it.
fn write_all(keeper: &Keeper, bytes: u64) {
    keeper.0.queue.lock().is_closing = true;
    keeper.write(&keep(bytes));
    keeper.0.queue.lock().is_closing = false;
}

#[test]
fn queued_events_are_readable_and_overflow_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let keeper = Keeper::of_folder(folder.path(), Pace::Live);
    let half = WAITING_BYTES as usize / 2;
    // The second fills the queue; there is no room for a third, but for one without bytes.
    for (sequence, bytes) in [(0, half), (1, half), (2, 1), (3, 0)] {
        keeper.keep(sensed(sequence, bytes));
    }
    assert_eq!(kept(&keeper, 3), [0, 1, 3]);
    assert!(!folder.path().join("sensors").exists(), "nothing is written yet");
    write_all(&keeper, u64::MAX);
    assert_eq!(kept(&keeper, 3), [0, 1, 3]);
    keeper.keep(sensed(4, 5));
    assert_eq!(kept(&keeper, 4), [0, 1, 3, 4]);
    let told = Keeping { keeper, thread: None }.finish().unwrap();
    assert_eq!(
        told,
        "1 readings of sensors with large data are not kept: they came faster than they could be written"
    );
}

#[test]
fn so_many_readings_wait_however_small_and_one_that_is_too_large_waits_alone() {
    let folder = tempfile::tempdir().unwrap();
    let keeper = Keeper::of_folder(folder.path(), Pace::Live);
    for sequence in 0..WAITING as u64 + 5 {
        keeper.keep(sensed(sequence, 0));
    }
    let waiting = |queue: &Queue| (queue.waiting.len(), queue.lost);
    assert_eq!(waiting(&keeper.0.queue.lock()), (WAITING, 5));
    write_all(&keeper, 1_000_000);
    let queue = Queue::default();
    assert!(queue.has_room(u64::MAX));
    let queue = Queue { waiting: [Arc::new(sensed(0, 1))].into(), bytes: 1, ..queue };
    assert!(!queue.has_room(u64::MAX) && queue.has_room(1));
}

#[test]
fn write_errors_are_reported_and_the_rest_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let keeper = Keeper::of_folder(folder.path(), Pace::Live);
    for (sequence, bytes) in [(0, 10), (1, 100), (2, 10)] {
        keeper.keep(sensed(sequence, bytes));
    }
    write_all(&keeper, 130);
    assert_eq!(kept(&keeper, 2), [0, 2]);
    let told = Keeping { keeper, thread: None }.finish().unwrap();
    let why = "sensor front of robot r: a reading has 152 bytes, more than the 130 bytes kept in all";
    assert_eq!(told, format!("1 readings of sensors with large data are not kept: {why}"));
}

#[test]
fn virtual_time_waits_for_room_and_for_what_is_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let keeper = Keeper::of_folder(folder.path(), Pace::Waiting);
    let writing = keeper.clone();
    let thread = thread::spawn(move || writing.write(&keep(2 * (100 + 52))));
    for sequence in 0..3 * WAITING as u64 {
        keeper.keep(sensed(sequence, 100));
    }
    let last = 3 * WAITING as u64 - 1;
    assert_eq!(kept(&keeper, last), [last - 1, last]);
    keeper.0.queue.lock().is_closing = true;
    keeper.0.changed.notify_all();
    thread.join().unwrap();
    assert_eq!(keeper.0.queue.lock().lost, 0);
}
