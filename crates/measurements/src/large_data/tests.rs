use proptest::{collection::vec, prelude::*};

use super::*;

fn robot() -> NodeId {
    "r".parse().unwrap()
}

fn sensor() -> SensorId {
    "front".parse().unwrap()
}

/// Returns reading `n` with this number of bytes.
fn reading(n: u64, bytes: usize) -> StoredData {
    let data = LargeData {
        sequence: n,
        format: DataFormat::ALL[n as usize % DataFormat::ALL.len()],
        width: n as u32 + 1,
        height: 7,
        bytes: bytes as u64,
    };
    let bytes = (0..bytes).map(|place| (place as u64 * 31 + n) as u8).collect();
    StoredData { measured: Timestamp::from_nanos(n * 1000), data, bytes }
}

fn append(writer: &mut LargeDataWriter, reading: &StoredData) -> io::Result<()> {
    writer.append(&StoredData { measured: reading.measured, data: reading.data, bytes: &reading.bytes })
}

fn read(run: &Path, wanted: WantedData) -> Option<StoredData> {
    read_large_data(run, &robot(), &sensor(), wanted).unwrap()
}

/// Returns the numbers of the readings that are kept, and checks that each is unchanged.
fn kept(run: &Path, all: &[StoredData]) -> Vec<u64> {
    let is_there = |reading: &&StoredData| match read(run, WantedData::Number(reading.data.sequence)) {
        Some(stored) => {
            assert_eq!(stored, **reading);
            true
        }
        None => false,
    };
    all.iter().filter(is_there).map(|reading| reading.data.sequence).collect()
}

fn on_disk(run: &Path) -> u64 {
    let files = fs::read_dir(folder_of(run, &robot(), &sensor())).into_iter().flatten();
    files.map(|file| file.unwrap().metadata().unwrap().len()).sum()
}

#[test]
fn readings_are_found_by_number_and_as_the_last_up_to_one() {
    let run = tempfile::tempdir().unwrap();
    let run = run.path();
    assert_eq!(read(run, WantedData::UpTo(9)), None);
    let mut writer = LargeDataWriter::new(run, &robot(), &sensor(), 10_000);
    // Readings 1 and 4 were lost on the way.
    let all: Vec<_> = [0, 2, 3, 5].map(|n| reading(n, 100 * n as usize)).into();
    for reading in &all {
        append(&mut writer, reading).unwrap();
    }
    assert_eq!(kept(run, &all), [0, 2, 3, 5]);
    for (number, last) in [(0, 0), (1, 0), (2, 2), (4, 3), (5, 5), (u64::MAX, 5)] {
        assert_eq!(read(run, WantedData::UpTo(number)).unwrap().data.sequence, last);
    }
    for number in [1, 4, 6, u64::MAX] {
        assert_eq!(read(run, WantedData::Number(number)), None);
    }
    let other = read_large_data(run, &robot(), &"rear".parse().unwrap(), WantedData::UpTo(5));
    assert_eq!(other.unwrap(), None);
}

#[test]
fn the_oldest_readings_are_removed_and_seven_eighths_stay() {
    let run = tempfile::tempdir().unwrap();
    let keep = 100_000;
    let mut writer = LargeDataWriter::new(run.path(), &robot(), &sensor(), keep);
    let all: Vec<_> = (0..500).map(|n| reading(n, 1500)).collect();
    for reading in &all {
        append(&mut writer, reading).unwrap();
        assert!(on_disk(run.path()) <= keep);
    }
    let kept = kept(run.path(), &all);
    assert_eq!(kept.last(), Some(&499));
    assert!(kept.is_sorted_by(|a, b| a + 1 == *b), "{kept:?}");
    assert!(kept.len() as u64 * 1552 > keep / 8 * 7 - 1552, "{} are left", kept.len());
    assert_eq!(read(run.path(), WantedData::UpTo(100)), None, "it is gone");
}

#[test]
fn readings_that_cannot_be_written_are_skipped_and_the_next_is_kept() {
    let run = tempfile::tempdir().unwrap();
    let folder = folder_of(run.path(), &robot(), &sensor());
    let mut writer = LargeDataWriter::new(run.path(), &robot(), &sensor(), 2000);
    let all: Vec<_> = (0..6).map(|n| reading(n, if n == 1 { 1949 } else { 500 })).collect();
    append(&mut writer, &all[0]).unwrap();
    let error = append(&mut writer, &all[1]).unwrap_err();
    assert_eq!(error.to_string(), "a reading has 2001 bytes, more than the 2000 bytes kept in all");
    // A folder stands where its index is to be.
    fs::create_dir(folder.join("2.index")).unwrap();
    append(&mut writer, &all[2]).unwrap_err();
    fs::remove_dir(folder.join("2.index")).unwrap();
    append(&mut writer, &all[3]).unwrap();
    assert_eq!(kept(run.path(), &all), [0, 3]);
    append(&mut writer, &all[4]).unwrap();
    append(&mut writer, &all[5]).unwrap();
    assert!(on_disk(run.path()) <= 2000, "what was left of the failure counts, and goes");
    assert_eq!(kept(run.path(), &all), [3, 4, 5]);
}

#[test]
fn zeros_left_by_a_power_failure_are_ignored() {
    let run = tempfile::tempdir().unwrap();
    let folder = folder_of(run.path(), &robot(), &sensor());
    let mut writer = LargeDataWriter::new(run.path(), &robot(), &sensor(), 100_000);
    let all: Vec<_> = (0..3).map(|n| reading(n, 40)).collect();
    for reading in &all {
        append(&mut writer, reading).unwrap();
    }
    write_at(&folder.join("0.data"), &[0; 40], 80).unwrap();
    write_at(&folder.join("0.index"), &[0; ENTRY], 3 * ENTRY as u64).unwrap();
    assert_eq!(kept(run.path(), &all), [0, 1]);
    assert_eq!(read(run.path(), WantedData::UpTo(9)), Some(all[1].clone()));
}

proptest! {
    #[test]
    fn the_bound_is_kept_and_what_is_kept_is_the_end(
        keep in 0..5000_u64, sizes in vec((0..600_usize, 0..3_u64), 0..60),
    ) {
        let run = tempfile::tempdir().unwrap();
        let mut writer = LargeDataWriter::new(run.path(), &robot(), &sensor(), keep);
        let (mut all, mut number) = (Vec::new(), 0);
        for (size, lost) in sizes {
            number += lost;
            let reading = reading(number, size);
            number += 1;
            let fits = (size + ENTRY) as u64 <= keep;
            prop_assert_eq!(append(&mut writer, &reading).is_ok(), fits);
            all.extend(fits.then_some(reading));
            prop_assert!(on_disk(run.path()) <= keep);
        }
        let kept = kept(run.path(), &all);
        let end: Vec<_> = all.iter().map(|reading| reading.data.sequence).collect();
        prop_assert!(end.ends_with(&kept), "{:?} of {:?}", kept, end);
        prop_assert_eq!(kept.is_empty(), all.is_empty());
        let size: usize = all.iter().map(|reading| reading.bytes.len() + ENTRY).sum();
        prop_assert!(size as u64 > keep || kept.len() == all.len(), "there was room for all");
        let last = read(run.path(), WantedData::UpTo(u64::MAX));
        prop_assert_eq!(last.as_ref(), all.last());
    }

    #[test]
    fn any_beginning_of_the_files_is_a_beginning_of_the_readings(
        sizes in vec(0..90_usize, 1..12), data in any::<prop::sample::Index>(), index in any::<prop::sample::Index>(),
    ) {
        let run = tempfile::tempdir().unwrap();
        let folder = folder_of(run.path(), &robot(), &sensor());
        let mut writer = LargeDataWriter::new(run.path(), &robot(), &sensor(), 1_000_000);
        let all: Vec<_> = sizes.iter().enumerate().map(|(n, size)| reading(n as u64, *size)).collect();
        for reading in &all {
            append(&mut writer, reading).unwrap();
        }
        for (file, left) in [("0.data", data), ("0.index", index)] {
            let file = OpenOptions::new().write(true).open(folder.join(file)).unwrap();
            let length = file.metadata().unwrap().len();
            file.set_len(left.index(length as usize + 1) as u64).unwrap();
        }
        let kept = kept(run.path(), &all);
        let whole: Vec<_> = (0..kept.len() as u64).collect();
        prop_assert_eq!(&kept, &whole);
        let last = read(run.path(), WantedData::UpTo(u64::MAX)).map(|last| last.data.sequence);
        prop_assert_eq!(last, kept.last().copied());
    }
}
