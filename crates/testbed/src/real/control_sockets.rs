//! The sockets of the core and of plug-ins on nodes, between which contexts and instructions cross the emulated network.
//!
//! They carry datagrams of [`crate::plugins::Travel`], which has all rules. Its port is that of virtual time.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::{SocketAddr, SocketAddrV4, UdpSocket},
    sync::{Arc, mpsc::Sender},
};

use cotorra_datapath::Datapath;
use cotorra_graph::{NodeId, Testbed, Way};

use crate::{
    clock::Clock,
    core::message::Message,
    error::{RunError, system},
    plugins::{CONTROL_PORT, Datagram},
    real::datagrams,
};

/// Datagrams that have arrived at a node and wait for the core. Further ones are lost, as with a full socket buffer.
const MAX_WAITING: usize = 1024;

/// A socket in each node of the core and of a plug-in.
#[derive(Default)]
pub(crate) struct ControlSockets(BTreeMap<NodeId, Socket>);

struct Socket {
    socket: Arc<UdpSocket>,
    address: SocketAddrV4,
}

impl ControlSockets {
    /// Opens the sockets in their nodes.
    pub(crate) fn open(testbed: &Testbed, datapath: &Datapath) -> Result<Self, RunError> {
        let ends = testbed.plugins.iter().filter_map(|spec| match &spec.distance.way {
            Way::Nodes { core, plugin } => Some([core, plugin]),
            Way::None | Way::Delay { .. } => None,
        });
        let open = |node: &NodeId| {
            let address = testbed.graph.ipv4(node).expect("plug-ins with a node are on emulated hosts");
            let address = SocketAddrV4::new(address, CONTROL_PORT);
            let namespace = datapath.namespace(node)?;
            let failed =
                system(format!("open port {CONTROL_PORT} of `{node}` for contexts and instructions"));
            Ok((node.clone(), Socket::open(address, |at| namespace.udp_socket(at)).map_err(failed)?))
        };
        ends.flatten().collect::<BTreeSet<_>>().into_iter().map(open).collect::<Result<_, _>>().map(Self)
    }

    /// Starts a thread for each socket that passes its datagrams on to the core.
    pub(crate) fn receive(&self, now: &Clock, messages: &Sender<Message>) -> Result<(), RunError> {
        let senders = self.0.iter().map(|(node, its)| (SocketAddr::V4(its.address), node.clone()));
        let senders = Arc::new(senders.collect());
        for (node, Socket { socket, .. }) in &self.0 {
            let each = pass_on(node.clone(), Arc::clone(&senders), Arc::clone(now), messages.clone());
            datagrams::spawn(format!("control-{node}"), Arc::clone(socket), messages.clone(), each)?;
        }
        Ok(())
    }

    /// Sends a datagram. One that cannot be sent is lost, as on any network.
    pub(crate) fn send(&self, Datagram { from, to, payload }: &Datagram) {
        let (Some(sender), Some(receiver)) = (self.0.get(from), self.0.get(to)) else { return };
        if let Err(error) = sender.socket.send_to(payload, receiver.address) {
            tracing::debug!("{from} cannot send to {}: {error}", receiver.address);
        }
    }
}

impl Socket {
    fn open(
        address: SocketAddrV4,
        bind: impl FnOnce(SocketAddrV4) -> std::io::Result<UdpSocket>,
    ) -> std::io::Result<Self> {
        let socket = datagrams::open(|| bind(address))?;
        Ok(Self { socket: Arc::new(socket), address })
    }
}

/// Returns a function that passes datagrams of a node on to the core, up to a number that wait.
fn pass_on(
    node: NodeId,
    senders: Arc<BTreeMap<SocketAddr, NodeId>>,
    now: Clock,
    messages: Sender<Message>,
) -> impl FnMut(&[u8], SocketAddr) {
    let waiting = Arc::new(());
    move |payload, from| {
        // Nothing else in the emulated network speaks for the core or a plug-in.
        let Some(from) = senders.get(&from) else { return };
        if Arc::strong_count(&waiting) > MAX_WAITING {
            return;
        }
        let datagram = Datagram { from: from.clone(), to: node.clone(), payload: payload.to_vec() };
        let message = Message::Control { datagram, at: now(), _waiting: Arc::clone(&waiting) };
        // The run may be over.
        let _ = messages.send(message);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use cotorra_graph::Timestamp;

    use super::*;

    #[test]
    fn datagrams_pass_between_the_sockets_and_those_of_others_do_not() {
        let open = || {
            let mut its = Socket::open("127.0.0.1:0".parse().unwrap(), UdpSocket::bind).unwrap();
            let SocketAddr::V4(address) = its.socket.local_addr().unwrap() else { unreachable!() };
            its.address = address;
            its
        };
        let [core, plugin]: [NodeId; 2] = ["edge", "cloud"].map(|node| node.parse().unwrap());
        let sockets = ControlSockets([(core.clone(), open()), (plugin.clone(), open())].into());
        let (messages, inbox) = mpsc::channel();
        let now: Clock = Arc::new(|| Timestamp::from_nanos(7));
        sockets.receive(&now, &messages).unwrap();
        let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
        for (from, to) in [(&core, &plugin), (&plugin, &core)] {
            stranger.send_to(b"forged", sockets.0[to].address).unwrap();
            let sent = Datagram { from: from.clone(), to: to.clone(), payload: b"genuine".to_vec() };
            sockets.send(&sent);
            let arrived = inbox.iter().find_map(|message| match message {
                Message::Control { datagram, at, .. } => Some((datagram, at)),
                _ => None,
            });
            assert_eq!(arrived, Some((sent, now())));
        }
    }

    #[test]
    fn datagrams_wait_up_to_a_limit_and_further_ones_are_lost() {
        let sender: SocketAddr = "10.77.0.1:40002".parse().unwrap();
        let senders = Arc::new(BTreeMap::from([(sender, "edge".parse().unwrap())]));
        let (messages, inbox) = mpsc::channel();
        let mut pass_on = pass_on("cloud".parse().unwrap(), senders, Arc::new(|| Timestamp::ZERO), messages);
        let mut flood = || (0..MAX_WAITING + 10).for_each(|_| pass_on(b"x", sender));
        flood();
        assert_eq!(inbox.try_iter().count(), MAX_WAITING);
        flood();
        assert_eq!(inbox.try_iter().count(), MAX_WAITING, "those before were handled");
    }
}
