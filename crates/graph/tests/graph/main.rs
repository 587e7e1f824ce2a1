//! Graphs of testbed files.

mod candidates;
mod mean_signal;
mod routing;
