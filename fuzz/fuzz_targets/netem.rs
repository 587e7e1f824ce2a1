//! No answer of the kernel's, nor what pretends to be one, makes the reader of traffic control panic.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| cotorra_netem::read_anything(bytes));
