//! A run's folder as a whole: all that the testbed file names, and how the folder came to be.

pub(crate) mod manifest;
pub(crate) mod whole;
