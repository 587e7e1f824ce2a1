//! No trace panics, and what is read as one keeps what a trace promises.
#![no_main]

use cotorra_graph::Trace;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    if let Ok(trace) = Trace::parse(text) {
        assert!(trace.period_ms() > 0);
        assert!(trace.opportunities_ms().is_sorted());
        assert!(trace.mean_bits_per_second().is_finite());
    }
});
