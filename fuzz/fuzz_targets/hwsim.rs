//! No message of the kernel's simulated radios, nor a frame that they carry, makes their medium panic.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| cotorra_hwsim::read_anything(bytes));
