//! Published experiments, to be repeated in one command and set beside what was published.

pub mod federation;
pub mod okpi;
