//! Runs in real time, with real packets: the phases of a run, the thread that drives the core, and what this machine and
//! agents' machines contribute.

pub(crate) mod agents;
pub(crate) mod confined;
pub(crate) mod control_sockets;
pub(crate) mod core_loop;
pub(crate) mod cpus;
pub(crate) mod datagrams;
pub(crate) mod leftovers;
pub(crate) mod links;
pub(crate) mod network;
pub(crate) mod places;
pub(crate) mod radio_figures;
pub(crate) mod reflectors;
pub(crate) mod rehearse;
pub(crate) mod robots;
pub(crate) mod run;
pub(crate) mod traffic;
