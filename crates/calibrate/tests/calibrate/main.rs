//! Calibrations, and what their intervals hold.

mod coverage;
mod emulated;
mod whole;
