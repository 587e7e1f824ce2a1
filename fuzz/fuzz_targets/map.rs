//! No map panics or exhausts memory, be it its picture or the YAML file that says how to read it.
#![no_main]

use cotorra_testbed_file::map_server;
use libfuzzer_sys::fuzz_target;

const YAML: &str = "image: x.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n";

fuzz_target!(|bytes: &[u8]| {
    _ = map_server::parse("fuzz.yaml", YAML, |_| Ok(bytes.to_vec()));
    if let Ok(text) = std::str::from_utf8(bytes) {
        _ = map_server::parse("fuzz.yaml", text, |_| Ok(b"P2 1 1 1 0".to_vec()));
    }
});
