//! The emulated network in virtual time: the fabric itself, within reach.

use std::{
    cell::{Cell, RefCell},
    rc::Rc,
};

use cotorra_fabric::Fabric;
use cotorra_graph::{Stamped, Timestamp};
use cotorra_network_control::{Network, NetworkGone};

/// The emulated network in virtual time.
#[derive(Clone)]
pub(super) struct VirtualNetwork {
    pub(super) fabric: Rc<RefCell<Fabric>>,
    pub(super) now: Rc<Cell<Timestamp>>,
}

impl VirtualNetwork {
    /// At time zero.
    pub(super) fn new(fabric: Fabric) -> Self {
        Self { fabric: Rc::new(RefCell::new(fabric)), now: Rc::new(Cell::new(Timestamp::ZERO)) }
    }

    pub(super) fn next_event(&self) -> Option<Stamped> {
        self.fabric.borrow_mut().next_event()
    }
}

impl Network for VirtualNetwork {
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone> {
        Ok(action(&mut self.fabric.borrow_mut(), self.now.get()))
    }
}
