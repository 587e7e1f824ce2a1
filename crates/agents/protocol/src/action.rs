//! Actions of the agent's shell.

use std::collections::BTreeMap;

use cotorra_engine::InstanceId;
use cotorra_graph::LinkId;
use cotorra_wifi::InterfaceName;

use crate::{
    link::WantedLink,
    message::{Report, Wanted, WantedInstance},
    wifi::{WantedRadio, WantedRequest},
};

/// Something that the agent's shell has to do, in this order.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Save the wanted state, for [`Agent::new`](crate::Agent::new) after the next start. Everything before it must be done, and it must be saved
    /// before anything after it is done. If that fails, [`Agent::cannot_save`](crate::Agent::cannot_save) cancels what it starts.
    Save(Box<Wanted>),
    /// Start an instance. The files of the wanted state must be there first.
    Start(InstanceId, Box<WantedInstance>),
    /// Stop an instance.
    Stop(InstanceId),
    /// Give these links their conditions, and restore all other interfaces. [`Agent::set_link_states`](crate::Agent::set_link_states) takes what became of
    /// it, before the next action.
    Emulate(BTreeMap<LinkId, WantedLink>),
    /// Make these Wi-Fi interfaces so, and put all others back. [`Agent::set_radio_states`](crate::Agent::set_radio_states) takes what becomes of it.
    UseRadios(BTreeMap<InterfaceName, WantedRadio>),
    /// Carry out a request to the program of a Wi-Fi interface. [`Agent::answered`](crate::Agent::answered) takes what becomes of it.
    Request(u64, WantedRequest),
    /// Send a report.
    Report(Report),
}
