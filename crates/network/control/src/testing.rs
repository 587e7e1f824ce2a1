//! A network for tests.

use std::cell::RefCell;

use cotorra_fabric::Fabric;
use cotorra_graph::{HardwareGraph, Timestamp};

use crate::{Network, NetworkGone};

/// A network of one fabric, at time zero.
pub(crate) struct Here(pub(crate) RefCell<Fabric>);

impl Here {
    pub(crate) fn new(graph: &HardwareGraph) -> Self {
        Self(RefCell::new(Fabric::new(graph, 1).unwrap()))
    }
}

impl Network for Here {
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone> {
        Ok(action(&mut self.0.borrow_mut(), Timestamp::ZERO))
    }
}
