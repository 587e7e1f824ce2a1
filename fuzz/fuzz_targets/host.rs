//! No text or message of the kernel's makes the reader of a machine's context panic.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| cotorra_host::read_anything(bytes));
