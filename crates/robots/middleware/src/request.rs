//! Requests of a robot: the servers that they go to, and which of these have answered.
//!
//! A request can go to several instances of a VNF. Each copy has its own nonce, so that no instance can answer for another.

use std::net::SocketAddrV4;

use cotorra_graph::NodeId;

use crate::{answer_error::AnswerError, nonce::Nonces};

/// Servers that a robot's requests go to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Servers {
    /// Nodes that a position packet goes to, and the sockets there; at least one node. A node without an address gets no
    /// copy.
    pub navigation: Vec<(NodeId, Option<SocketAddrV4>)>,
    /// The same for scans.
    pub localization: Vec<(NodeId, Option<SocketAddrV4>)>,
}

/// A datagram that a robot sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagram {
    /// The sender.
    pub robot: NodeId,
    /// The receiver's socket.
    pub to: SocketAddrV4,
    /// The payload.
    pub bytes: Vec<u8>,
}

/// A packet and the sockets that its copies go to, each with its nonce. The packet itself has the first nonce.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Request<P> {
    pub packet: P,
    /// Empty where no server can be reached.
    pub copies: Vec<(SocketAddrV4, u64)>,
}

impl<P> Request<P> {
    /// Returns a datagram for each copy. `encode` writes the packet with a copy's nonce.
    pub fn datagrams(
        self,
        robot: &NodeId,
        encode: impl Fn(&mut P, u64, &mut Vec<u8>),
    ) -> impl Iterator<Item = Datagram> {
        let Self { mut packet, copies } = self;
        copies.into_iter().map(move |(to, nonce)| {
            let mut bytes = Vec::with_capacity(1024);
            encode(&mut packet, nonce, &mut bytes);
            Datagram { robot: robot.clone(), to, bytes }
        })
    }
}

/// Recipients of one request.
#[derive(Debug, Clone)]
pub(crate) struct Recipients(Vec<Recipient>);

#[derive(Debug, Clone, Copy)]
struct Recipient {
    address: Option<SocketAddrV4>,
    nonce: u64,
    has_answered: bool,
}

impl Recipients {
    /// Draws a nonce for each address; `None` is a recipient that cannot be reached.
    pub fn new(addresses: impl Iterator<Item = Option<SocketAddrV4>>, nonces: &mut Nonces) -> Self {
        let recipient = |address| Recipient { address, nonce: nonces.draw(), has_answered: false };
        Self(addresses.map(recipient).collect())
    }

    /// Returns the first nonce; 0 without recipients.
    pub fn nonce(&self) -> u64 {
        self.0.first().map_or(0, |recipient| recipient.nonce)
    }

    /// Returns the addresses of all recipients that can be reached, with their nonces.
    pub fn copies(&self) -> Vec<(SocketAddrV4, u64)> {
        self.0.iter().filter_map(|recipient| Some((recipient.address?, recipient.nonce))).collect()
    }

    /// Returns the index of the recipient with this address and nonce.
    pub fn find(&self, from: SocketAddrV4, nonce: u64) -> Option<usize> {
        self.0.iter().position(|recipient| (recipient.address, recipient.nonce) == (Some(from), nonce))
    }

    /// Whether a copy had this nonce.
    pub fn has_nonce(&self, nonce: u64) -> bool {
        self.0.iter().any(|recipient| recipient.nonce == nonce)
    }

    /// Marks the recipient at this index as having answered.
    pub fn accept(&mut self, index: usize) {
        self.0[index].has_answered = true;
    }

    /// Returns why an answer is rejected that arrives after another was accepted.
    pub fn reject_further(&mut self, from: SocketAddrV4, nonce: u64) -> AnswerError {
        match self.find(from, nonce).map(|index| &mut self.0[index]) {
            // From elsewhere, or the recipient has answered before.
            None | Some(Recipient { has_answered: true, .. }) => AnswerError::Repeated,
            Some(recipient) => {
                recipient.has_answered = true;
                AnswerError::Redundant
            }
        }
    }
}
