//! No file makes the reader of a history panic, hang or exhaust memory.
#![no_main]

use std::{fs, ops::Bound, process};

use cotorra_graph::Timestamp;
use cotorra_measurements::{History, Location, PageRequest};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let folder = std::env::temp_dir().join(format!("cotorra-fuzz-{}", process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir(&folder).expect("there is room for a folder");
    let file = folder.join("history.sqlite");
    fs::write(&file, bytes).expect("there is room for a file");
    let Ok(history) = History::connect_to_read(&Location::File(file)) else { return };
    let Ok(runs) = history.runs(None, 100) else { return };
    for run in runs {
        let all = (Bound::<Timestamp>::Unbounded, Bound::Unbounded);
        let _ = history.events(run.id, &[], all, PageRequest::default());
        let _ = history.state_at(run.id, Timestamp::MAX);
        let _ = history.gaps(run.id, all, PageRequest::default());
        let _ = history.retained(run.id);
    }
});
