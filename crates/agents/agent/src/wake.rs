//! Wakes the agent's loop from threads.

use std::sync::Arc;

/// Wakes the agent's loop.
pub(crate) type Wake = Arc<dyn Fn() + Send + Sync>;
