//! The tunnels of a core to others: one UDP socket of this machine, and threads that carry frames between the sockets and
//! the emulated network. Decisions are [`super::Border`]'s.
//!
//! In the visited core, frames cross the emulated network in UDP datagrams between the visitor's node and the border's, each
//! in its own namespace.

use std::{
    collections::HashMap,
    net::{SocketAddr, SocketAddrV4, UdpSocket},
    sync::{
        Arc,
        mpsc::{Receiver, Sender},
    },
    thread,
    time::Duration,
};

use cotorra_datapath::{Allowance, Clock, Datapath, Handle};
use cotorra_fabric::Departure;
use cotorra_graph::{Border, Direction, FtKey, NodeId, Testbed};
use cotorra_ledger::tunnel::{End, Received, Share, Tunnel, TunnelId};
use parking_lot::Mutex;

use super::message::{self, Message, State};
use crate::{
    core::message::Message as CoreMessage,
    error::{RunError, system},
    real::datagrams,
};

/// First UDP port of visitors in their nodes, and in the border's node; each visitor has its own.
const FIRST_PORT: u16 = 7451;
/// Most datagrams a second of one tunnel. More are lost before they are opened.
const MOST_DATAGRAMS: f64 = 10_000.0;
/// Most states a second of one tunnel. Cores send ten.
const MOST_STATES: f64 = 50.0;
const _: () = assert!(message::LONGEST + Tunnel::OVERHEAD <= datagrams::LARGEST);

/// The tunnels.
#[derive(Clone)]
pub(crate) struct Tunnels {
    socket: Arc<UdpSocket>,
    open: Arc<Mutex<Open>>,
}

#[derive(Default)]
struct Open {
    tunnels: HashMap<TunnelId, Carried>,
    /// The tunnel that carries the frames of a robot, or of a visitor.
    of_robot: HashMap<NodeId, TunnelId>,
}

struct Carried {
    tunnel: Tunnel,
    /// Address of the other core; unknown in a visited core until the first datagram.
    peer: Option<SocketAddr>,
    /// The robot or visitor whose frames it carries.
    robot: Option<NodeId>,
    /// The other core's last state that was not taken.
    state: Option<State>,
    datagrams: Allowance,
    states: Allowance,
}

/// The emulated network, into which frames of other cores go.
struct Inside {
    handle: Handle,
    clock: Clock,
    /// By visitor.
    ends: HashMap<NodeId, Ends>,
}

/// Sockets of a visitor and of the border for it.
struct Ends {
    visitor: Arc<UdpSocket>,
    border: Arc<UdpSocket>,
    addresses: [SocketAddrV4; 2],
}

impl Tunnels {
    /// Opens the sockets, and starts the threads.
    pub(crate) fn start(
        testbed: &Testbed,
        border: &Border,
        datapath: &Datapath,
        departures: Receiver<Departure>,
        core: &Sender<CoreMessage>,
    ) -> Result<Self, RunError> {
        let socket = datagrams::open(|| UdpSocket::bind(border.address))
            .map_err(system(format!("listen for other cores at {}", border.address)))?;
        let tunnels = Self { socket: Arc::new(socket), open: Arc::default() };
        let mut ends = HashMap::new();
        for (visitor, port) in border.visitors.iter().zip(FIRST_PORT..) {
            let open = |node: &NodeId| -> Result<_, RunError> {
                let address = testbed.graph.ipv4(node).expect("a host has an address");
                let address = SocketAddrV4::new(address, port);
                let socket = datapath.namespace(node)?;
                let socket = datagrams::open(|| socket.udp_socket(address))
                    .map_err(system(format!("open a socket in `{node}` for visitors")))?;
                Ok((Arc::new(socket), address))
            };
            let ((visiting, at), (bordering, by)) = (open(visitor)?, open(&border.node)?);
            let [up, down] = [(&bordering, at, Direction::Forward), (&visiting, by, Direction::Backward)];
            for (socket, from, direction) in [up, down] {
                let (carrier, socket, visitor) = (tunnels.clone(), Arc::clone(socket), visitor.clone());
                let from = SocketAddr::V4(from);
                let each = move |bytes: &[u8], sender: SocketAddr| {
                    // Nothing else in the emulated network speaks for a visitor.
                    if sender == from {
                        carrier.send_frame(&visitor, direction, bytes);
                    }
                };
                datagrams::spawn("visitor".to_owned(), socket, core.clone(), each)?;
            }
            ends.insert(visitor.clone(), Ends { visitor: visiting, border: bordering, addresses: [at, by] });
        }
        let (tunnels_too, tell) = (tunnels.clone(), core.clone());
        let inside = Inside { handle: datapath.handle(), clock: datapath.clock(), ends };
        let each = move |bytes: &[u8], from: SocketAddr| tunnels_too.receive(bytes, from, &inside, &tell);
        datagrams::spawn("border".to_owned(), Arc::clone(&tunnels.socket), core.clone(), each)?;
        let sender = tunnels.clone();
        let depart = move || {
            cotorra_datapath::be_timely();
            for Departure { robot, direction, bytes } in departures {
                sender.send_frame(&robot, direction, &bytes);
            }
        };
        thread::Builder::new()
            .name("departures".to_owned())
            .spawn(depart)
            .map_err(system("start the thread of departures"))?;
        Ok(tunnels)
    }

    /// Opens the robot's end of a tunnel.
    pub(super) fn open_home(&self, key: &FtKey, core: SocketAddr) -> TunnelId {
        self.open(Tunnel::new(End::Home, key.0, share()), Some(core))
    }

    /// Opens the end of a tunnel at a radio unit.
    pub(super) fn open_visited(&self, key: &FtKey) -> TunnelId {
        self.open(Tunnel::new(End::Visited, key.0, share()), None)
    }

    fn open(&self, tunnel: Tunnel, peer: Option<SocketAddr>) -> TunnelId {
        let id = tunnel.id();
        self.close(id);
        let (datagrams, states) = (Allowance::new(MOST_DATAGRAMS), Allowance::new(MOST_STATES));
        let carried = Carried { tunnel, peer, robot: None, state: None, datagrams, states };
        self.open.lock().tunnels.insert(id, carried);
        id
    }

    /// Greets the other core anew.
    pub(super) fn renew(&self, id: TunnelId) {
        if let Some(carried) = self.open.lock().tunnels.get_mut(&id) {
            carried.tunnel.restart(share());
            carried.state = None;
        }
    }

    /// Closes a tunnel.
    pub(super) fn close(&self, id: TunnelId) {
        let mut open = self.open.lock();
        open.tunnels.remove(&id);
        open.of_robot.retain(|_, other| *other != id);
    }

    /// Lets a tunnel carry the frames of a robot, or of a visitor.
    pub(super) fn carry(&self, id: TunnelId, robot: &NodeId) {
        let mut open = self.open.lock();
        if let Some(carried) = open.tunnels.get_mut(&id) {
            carried.robot = Some(robot.clone());
            open.of_robot.insert(robot.clone(), id);
        }
    }

    /// Lets a tunnel carry no more frames.
    pub(super) fn release(&self, id: TunnelId) {
        let mut open = self.open.lock();
        if let Some(carried) = open.tunnels.get_mut(&id) {
            carried.robot = None;
        }
        open.of_robot.retain(|_, other| *other != id);
    }

    /// Tells the other core a state, or greets it first.
    pub(super) fn tell(&self, id: TunnelId, state: State) {
        let mut open = self.open.lock();
        let Some(Carried { tunnel, peer: Some(peer), .. }) = open.tunnels.get_mut(&id) else { return };
        let sealed = tunnel.seal(&Message::State(state).encode());
        let (datagram, peer) = (sealed.unwrap_or_else(|| tunnel.hello()), *peer);
        drop(open);
        self.send(&datagram, peer);
    }

    /// Takes the other core's last state, if it was not taken.
    pub(super) fn take(&self, id: TunnelId) -> Option<State> {
        self.open.lock().tunnels.get_mut(&id)?.state.take()
    }

    fn send(&self, datagram: &[u8], peer: SocketAddr) {
        // A datagram that cannot be sent is lost, as on any network.
        if let Err(error) = self.socket.send_to(datagram, peer) {
            tracing::debug!("cannot send to the core at {peer}: {error}");
        }
    }

    fn send_frame(&self, robot: &NodeId, direction: Direction, bytes: &[u8]) {
        let mut open = self.open.lock();
        let Some(id) = open.of_robot.get(robot).copied() else { return };
        let Some(Carried { tunnel, peer: Some(peer), .. }) = open.tunnels.get_mut(&id) else { return };
        let Some(datagram) = tunnel.seal(&Message::Frame(direction, bytes.to_vec()).encode()) else { return };
        let peer = *peer;
        drop(open);
        self.send(&datagram, peer);
    }

    fn receive(
        &self,
        datagram: &[u8],
        from: SocketAddr,
        Inside { handle, clock, ends }: &Inside,
        core: &Sender<CoreMessage>,
    ) {
        let mut open = self.open.lock();
        let Some(id) = Tunnel::id_of(datagram) else { return };
        let Some(carried) = open.tunnels.get_mut(&id) else { return };
        let now = clock.now();
        if !carried.datagrams.take(now) {
            return;
        }
        let message = match carried.tunnel.receive(datagram, share) {
            Received::Message(message) => message,
            Received::Hello(answer) => {
                drop(open);
                return self.send(&answer, from);
            }
            Received::Opened | Received::Rejected => return,
        };
        match Message::decode(&message) {
            Some(Message::State(state)) => {
                match (&state, carried.tunnel.end()) {
                    (State::Home(_), End::Visited) => carried.peer = Some(from),
                    (State::Visited(_), End::Home) => {}
                    _ => return,
                }
                // One message is under way at most, however fast the other core talks.
                if carried.states.take(now) && carried.state.replace(state).is_none() {
                    let _ = core.send(CoreMessage::Border(id));
                }
            }
            Some(Message::Frame(direction, bytes)) => {
                let Some(robot) = carried.robot.clone() else { return };
                drop(open);
                match ends.get(&robot) {
                    Some(ends) => ends.send(direction, &bytes),
                    None => {
                        let departure = Departure { robot, direction, bytes };
                        // The run may be over.
                        let _ = handle.with(move |fabric, now| fabric.arrive(now, departure));
                    }
                }
            }
            None => {}
        }
    }
}

impl Ends {
    /// Sends a frame into the emulated network.
    fn send(&self, direction: Direction, bytes: &[u8]) {
        let [at, by] = self.addresses;
        let sent = match direction {
            Direction::Forward => self.visitor.send_to(bytes, by),
            Direction::Backward => self.border.send_to(bytes, at),
        };
        if let Err(error) = sent {
            tracing::debug!("a visitor's frame is lost: {error}");
        }
    }
}

/// Makes a share that is greater than all before, unless the calendar clock was set back.
fn share() -> Share {
    let mut random = [0; 8];
    getrandom::fill(&mut random).expect("the system has random numbers");
    Share::new(Duration::from_micros(chrono::Utc::now().timestamp_micros().unsigned_abs()), random)
}
