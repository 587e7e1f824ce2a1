//! No output of ping, no survey and no capture panics, and times that were read can be split.
#![no_main]

use cotorra_calibrate::{
    PacketTimes, one_way_of_captures, parse_channel_survey, parse_round_trips, parse_stamp, parse_survey,
    round_trips_of_capture,
};
use libfuzzer_sys::fuzz_target;

/// Both parts have all packets together.
fn split(times: &PacketTimes) {
    let parts = times.split(0.6);
    let sum = |of: fn(&PacketTimes) -> usize| parts.iter().map(of).sum::<usize>();
    assert!(sum(|part| part.arrived().len()) == times.arrived().len());
    assert!(sum(|part| part.duplicated.len()) == times.duplicated.len());
}

fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        _ = parse_survey(text);
        _ = parse_channel_survey(text);
        _ = parse_stamp(text);
        parse_round_trips(text).iter().for_each(split);
    }
    round_trips_of_capture(bytes).iter().for_each(split);
    // Two captures of the same packets, of which the first one ends somewhere.
    for end in [bytes.len() / 2, bytes.len()] {
        if let Ok(one_way) = one_way_of_captures(&bytes[..end], bytes) {
            one_way.ways.iter().flatten().for_each(split);
        }
    }
});
