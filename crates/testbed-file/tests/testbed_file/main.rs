//! Testbed files, as users write them.

mod bad;
mod containers;
mod machines;
mod queues;
mod settings;
mod testbeds;
