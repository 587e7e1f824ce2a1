//! No datagram of hostapd or wpa_supplicant makes the readers of answers and events panic.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| cotorra_wifi::read_anything(bytes));
