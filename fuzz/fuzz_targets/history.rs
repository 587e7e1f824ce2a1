//! No chunk of a history and no entry of a spool panics or exhausts memory.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| cotorra_measurements::read_anything(bytes));
