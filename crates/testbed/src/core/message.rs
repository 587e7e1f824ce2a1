//! Messages to the core's thread.

use std::{net::SocketAddrV4, sync::Arc};

use cotorra_graph::{NodeId, PluginId, Stamped, Timestamp};
use cotorra_ledger::tunnel::TunnelId;
use cotorra_network_control::InstructionError;
use cotorra_plugin::Actions;

use crate::{
    events::follower::Follower,
    given::Given,
    plugins::{Datagram as ControlDatagram, host::Fault},
    virtual_time::time_control::{TimeChange, TimeState},
};

/// A message to the core's thread.
#[allow(clippy::large_enum_variant, reason = "messages are sent one at a time and matched at once")]
pub(crate) enum Message {
    /// A robot received a datagram.
    Datagram {
        /// The receiving robot.
        robot: NodeId,
        /// The sender's address.
        from: SocketAddrV4,
        /// Time of arrival.
        at: Timestamp,
        bytes: Vec<u8>,
        /// Held by each datagram of the robot that waits, to bound their number.
        _waiting: Arc<()>,
    },
    /// A plug-in, or a caller of the API, gives an instruction.
    Instruct {
        given: Given,
        /// Receives the outcome.
        reply: Option<Reply>,
    },
    /// A call of a plug-in in process returned.
    Returned {
        plugin: PluginId,
        at: Timestamp,
        /// Whether a plug-in that is away has handled a context.
        handled: bool,
        /// The plug-in's actions, or its failure.
        outcome: Result<Actions, Fault>,
    },
    /// A datagram between the core and a plug-in has arrived at its node.
    Control {
        datagram: ControlDatagram,
        at: Timestamp,
        /// Held by each datagram of the node that waits, to bound their number.
        _waiting: Arc<()>,
    },
    /// An event of the emulated network.
    Network(Stamped),
    /// An agent reported the context of its machine.
    Machine {
        context: Stamped,
        /// Held by each message of the agent that waits, to bound their number.
        _waiting: Arc<()>,
    },
    /// Another core told something over this tunnel.
    Border(TunnelId),
    /// A plug-in that virtual time waits for follows the events. Not sent in real time.
    Follow(Follower),
    /// A plug-in has taken in all events before a mark.
    Done {
        plugin: PluginId,
        /// The mark's number.
        mark: u64,
        /// Time at which it wants to be woken.
        wake_at: Option<Timestamp>,
    },
    /// Time has to stop, step, or pass at another speed. Not sent in real time.
    ControlTime {
        change: TimeChange,
        /// Receives the state of time after it.
        reply: Box<dyn FnOnce(TimeState) + Send>,
    },
    /// The core has to look for changes, as of a VNF's process.
    Wake,
    /// The run has to end.
    Stop,
}

/// Reports the outcome of an instruction.
pub(crate) type Reply = Box<dyn FnOnce(Result<(), InstructionError>) + Send>;
