//! Round trips of position packets and scans, which the fabric follows, and the parts of service times that they give.

use std::{
    collections::VecDeque,
    sync::mpsc::{Receiver, sync_channel},
};

use cotorra_fabric::{Datagrams, RoundTrip};
use cotorra_graph::{NodeId, ServiceTime};
use cotorra_network_control::Network;
use cotorra_plugin::wire::NONCE_AT;

/// Most round trips that wait for their sample. Further ones are lost, and their samples have no parts.
const MOST: usize = 1024;

/// Round trips by the nonce of their packets.
pub(crate) struct Trips {
    /// The fabric sends a round trip before it hands out the answer.
    inbox: Receiver<RoundTrip>,
    waiting: VecDeque<RoundTrip>,
}

impl Trips {
    /// Follows the packets of robots to these ports from now on.
    pub(crate) fn follow(network: &impl Network, ports: impl IntoIterator<Item = (NodeId, u16)>) -> Self {
        let datagrams = |(from, port)| Datagrams { from, port, id_at: NONCE_AT };
        let followed: Vec<_> = ports.into_iter().map(datagrams).collect();
        let (outbox, inbox) = sync_channel(MOST);
        // Fails once the network is gone. Nobody waits for a round trip then.
        let _ = network.with(move |fabric, _| {
            // The fabric must not wait.
            fabric.follow(&followed, Box::new(move |trip| drop(outbox.try_send(trip))));
        });
        Self { inbox, waiting: VecDeque::new() }
    }

    /// Splits the time of a sample that an answer with this nonce has ended.
    pub(crate) fn split(&mut self, nonce: u64, sample: &mut ServiceTime) {
        self.waiting.extend(self.inbox.try_iter());
        self.waiting.drain(..self.waiting.len().saturating_sub(MOST));
        let is_its = |trip: &RoundTrip| trip.id == nonce && trip.from == sample.robot;
        let place = self.waiting.iter().position(is_its);
        let trip = place.and_then(|place| self.waiting.remove(place));
        sample.parts = trip
            .zip(sample.took)
            .map(|(RoundTrip { out, back, .. }, took)| Box::new(out.split(back, sample.emitted, took)));
    }
}
