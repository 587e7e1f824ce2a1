//! No testbed file panics, exhausts memory, or has its mistakes told beside the text.
#![no_main]

use std::path::Path;

use cotorra_graph::testbed_file;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    if let Err(wrong) = testbed_file::parse("fuzz.yaml", text, Path::new("/nonexistent")) {
        assert!(wrong.list.iter().all(|d| text.get(d.span.clone()).is_some()));
        _ = wrong.to_string();
    }
});
