//! No testbed file, and no setting on top of one, panics, exhausts memory, or has its mistakes told beside the text.
#![no_main]

use std::path::Path;

use cotorra_testbed_file::Setting;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: (Option<String>, String)| {
    let (setting, text) = input;
    let settings: Vec<Setting> = setting.iter().filter_map(|setting| setting.parse().ok()).collect();
    if let Err(wrong) =
        cotorra_testbed_file::parse_with("fuzz.yaml", &text, Path::new("/nonexistent"), &settings)
    {
        assert!(wrong.list.iter().all(|d| wrong.source_text.get(d.span.clone()).is_some()));
        _ = wrong.to_string();
    }
});
