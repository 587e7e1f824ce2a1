//! No log and no trajectory panics or exhausts memory, and what was read can be used.
#![no_main]

use cotorra_localization::{
    carmen::{Log, Message},
    trajectory::Trajectory,
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    for message in Log::new(bytes) {
        if let Ok(Message::Laser(laser)) = message {
            _ = laser.scan();
        }
    }
    if let Ok(trajectory) = Trajectory::read(bytes) {
        _ = trajectory.at(0, trajectory.len(), 1.0);
    }
});
