//! No output of ping and no survey panics, and round trips that were read can be split.
#![no_main]

use cotorra_calibrate::{parse_round_trips, parse_survey};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    _ = parse_survey(text);
    if let Ok(round_trips) = parse_round_trips(text) {
        let [fitted, tested] = round_trips.split(0.6);
        assert!(fitted.arrived().len() + tested.arrived().len() == round_trips.arrived().len());
    }
});
