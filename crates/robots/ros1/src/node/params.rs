//! Watches of parameters.

use std::{sync::Arc, time::Duration};

use cotorra_ros_messages::queue::RecvError;

use super::{
    shared::{Errand, NodeError, Shared},
    watch::Watch,
};
use crate::xmlrpc::Value;

/// Watches a parameter until it is dropped.
#[derive(Debug)]
pub struct ParamWatch {
    shared: Arc<Shared>,
    id: u64,
    watch: Arc<Watch>,
}

impl ParamWatch {
    /// Watches the parameter of a global name.
    pub(super) fn start(shared: &Arc<Shared>, name: String) -> Result<Self, NodeError> {
        let watch = Arc::new(Watch::new(name));
        let id = shared.next_id();
        let value = shared.register(
            |state| {
                state.watches.insert(id, Arc::clone(&watch));
                Ok(())
            },
            |master| master.subscribe_param(&watch.name, &shared.api),
            |state| drop(state.watches.remove(&id)),
        )?;
        watch.begin(&value);
        Ok(Self { shared: Arc::clone(shared), id, watch })
    }

    /// Returns the value; `None` if it is not set.
    pub fn value(&self) -> Option<Value> {
        self.watch.value()
    }

    /// Waits for the next change, and returns the new value. A change since the last call counts.
    ///
    /// # Errors
    /// [`RecvError`] if it does not change in time.
    pub fn changed(&self, timeout: Duration) -> Result<Option<Value>, RecvError> {
        self.watch.changed(timeout)
    }
}

impl Drop for ParamWatch {
    fn drop(&mut self) {
        self.shared.state.lock().watches.remove(&self.id);
        self.shared.errand(Errand::Unwatched(self.watch.name.clone()));
    }
}
