//! Graphs of testbed files.

mod mean_signal;
mod routing;
