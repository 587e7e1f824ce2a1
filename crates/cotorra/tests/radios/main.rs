//! Runs of the real program with real Wi-Fi software (`wifi: hwsim`), in the kernel with radios and in its virtual time.
//!
//! `COTORRA_RADIOS` promises such a kernel; the tests do nothing elsewhere. All share its radios: run them with
//! `--test-threads 1`. From the project's folder, with the path of this test program:
//!
//! ```console
//! $ COTORRA_RADIOS=1 scripts/uml --radios 0 PROGRAM --test-threads 1
//! ```
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

mod air;
mod attacks;
mod handover;
mod hardware;
#[allow(dead_code, reason = "the end-to-end tests use the rest")]
#[path = "../end_to_end/harness.rs"]
mod harness;
mod killed;
mod machines;
mod packets;
mod repeats;
mod rig;
mod roams;
mod vaps;
