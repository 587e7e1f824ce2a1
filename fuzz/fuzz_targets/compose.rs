//! No compose file panics, exhausts memory, or has its mistakes told beside the text.
#![no_main]

use std::path::Path;

use cotorra_graph::NodeId;
use cotorra_testbed_file::compose;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let node = NodeId::new("edge").expect("it is a name");
    match compose::parse("fuzz.yaml", text, Path::new("stack"), &node) {
        Ok(vnfs) => assert!(vnfs.iter().all(|vnf| vnf.image.is_some() && vnf.cpus > 0.0)),
        Err(wrong) => {
            assert!(wrong.list.iter().all(|d| wrong.source_text.get(d.span.clone()).is_some()));
            _ = wrong.to_string();
        }
    }
});
