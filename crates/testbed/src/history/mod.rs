//! The history of a run: its place, its bounds, large data of sensors, and what the next run takes from it.

pub(crate) mod bound;
pub(crate) mod keeping;
pub(crate) mod links;
pub(crate) mod previous_run;
pub(crate) mod pruner;
pub(crate) mod recorded;
pub(crate) mod run_info;
