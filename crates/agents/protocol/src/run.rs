//! The number of a run.

use serde::{Deserialize, Serialize};

/// A run: the time of its start, nanoseconds since 1970. A later run replaces an earlier one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Run(pub u64);
