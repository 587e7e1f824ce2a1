//! Outcomes of position packets and scans, which the fabric follows: the parts of service times, and the places at which
//! the packets of samples without an answer ended.

use std::{
    collections::{HashMap, VecDeque},
    sync::mpsc::{Receiver, sync_channel},
};

use cotorra_fabric::{Datagrams, Followed, Progress, RoundTrip};
use cotorra_graph::{LostAt, LostCause, NodeId, ServiceTime};
use cotorra_network_control::Network;
use cotorra_plugin::wire::NONCE_AT;

/// Most news that wait. Further ones are lost, and their samples have neither parts nor a place.
const MOST_NEWS: usize = 8192;
/// Most packets whose samples have not ended. The oldest are forgotten.
const MOST: usize = 4096;

/// Outcomes of packets, by their nonce.
pub(crate) struct Trips {
    /// The fabric reports each piece of news before it hands out the packet that it is about.
    inbox: Receiver<Followed>,
    states: HashMap<u64, State>,
    /// Nonces, the oldest first.
    order: VecDeque<u64>,
}

/// Progress of a packet.
enum State {
    Under(Progress),
    Answered(Box<RoundTrip>),
}

impl Trips {
    /// Follows the packets of robots to these ports from now on.
    pub(crate) fn follow(network: &impl Network, ports: impl IntoIterator<Item = (NodeId, u16)>) -> Self {
        let datagrams = |(from, port)| Datagrams { from, port, id_at: NONCE_AT };
        let followed: Vec<_> = ports.into_iter().map(datagrams).collect();
        let (outbox, inbox) = sync_channel(MOST_NEWS);
        // Fails once the network is gone. A round trip is of no use then.
        let _ = network.with(move |fabric, _| {
            // The fabric must not wait.
            fabric.follow(&followed, Box::new(move |news| drop(outbox.try_send(news))));
        });
        Self { inbox, states: HashMap::new(), order: VecDeque::new() }
    }

    /// Splits the time of a sample that an answer with this nonce has ended.
    pub(crate) fn split(&mut self, nonce: u64, sample: &mut ServiceTime) {
        let Some(State::Answered(trip)) = self.take(nonce) else { return };
        let RoundTrip { from, out, back, .. } = *trip;
        if from == sample.robot {
            sample.parts = sample.took.map(|took| Box::new(out.split(back, sample.emitted, took)));
        }
    }

    /// Explains a sample whose packet had this nonce, and that was given up.
    pub(crate) fn explain(&mut self, nonce: u64, sample: &mut ServiceTime) {
        let at = |back, cause| LostAt { link: None, back, cause };
        let state = self.take(nonce);
        sample.lost_at = state.map(|state| {
            Box::new(match state {
                State::Under(Progress::Sent) => at(false, LostCause::Late),
                State::Under(Progress::Reached) => at(false, LostCause::NoAnswer),
                State::Under(Progress::Returned) => at(true, LostCause::Late),
                State::Under(Progress::Lost(lost)) => lost,
                State::Answered(_) => at(true, LostCause::Rejected),
            })
        });
    }

    fn take(&mut self, nonce: u64) -> Option<State> {
        while let Ok(news) = self.inbox.try_recv() {
            self.learn(news);
        }
        self.states.remove(&nonce)
    }

    fn learn(&mut self, news: Followed) {
        let (id, state) = match news {
            Followed::RoundTrip(trip) => (trip.id, State::Answered(Box::new(trip))),
            Followed::Progress { id, progress: Progress::Sent } => {
                if self.order.len() == MOST {
                    self.order.pop_front().map(|oldest| self.states.remove(&oldest));
                }
                self.order.push_back(id);
                self.states.insert(id, State::Under(Progress::Sent));
                return;
            }
            Followed::Progress { id, progress } => (id, State::Under(progress)),
        };
        // News of samples that ended are too late.
        if let Some(known) = self.states.get_mut(&id).filter(|known| state.rank() >= known.rank()) {
            *known = state;
        }
    }
}

impl State {
    /// A packet that was duplicated counts by the copy that came farthest.
    fn rank(&self) -> u8 {
        match self {
            Self::Under(Progress::Sent) => 0,
            Self::Under(Progress::Lost(LostAt { back: false, .. })) => 1,
            Self::Under(Progress::Reached) => 2,
            Self::Under(Progress::Lost(LostAt { back: true, .. })) => 3,
            Self::Under(Progress::Returned) => 3,
            Self::Answered(_) => 4,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{sync::mpsc::SyncSender, time::Duration};

    use cotorra_graph::Timestamp;
    use cotorra_graph_testing as base;

    use super::*;

    fn trips() -> (SyncSender<Followed>, Trips) {
        let (outbox, inbox) = sync_channel(MOST_NEWS);
        (outbox, Trips { inbox, states: HashMap::new(), order: VecDeque::new() })
    }

    fn given_up() -> ServiceTime {
        ServiceTime {
            service: "s".parse().unwrap(),
            robot: "r".parse().unwrap(),
            ..base::service_time("edge", Timestamp::ZERO, None)
        }
    }

    #[test]
    fn a_packet_counts_by_how_far_its_best_copy_came() {
        use Progress::{Lost, Reached, Returned, Sent};
        let lost = |back| LostAt { link: Some("r~A".parse().unwrap()), back, cause: LostCause::Loss };
        let at = |back, cause| LostAt { link: None, back, cause };
        let cases = [
            (vec![Sent], at(false, LostCause::Late)),
            (vec![Sent, Lost(lost(false))], lost(false)),
            (vec![Sent, Lost(lost(false)), Reached], at(false, LostCause::NoAnswer)),
            (vec![Sent, Reached, Lost(lost(false))], at(false, LostCause::NoAnswer)),
            (vec![Sent, Reached, Returned], at(true, LostCause::Late)),
            (vec![Sent, Reached, Returned, Lost(lost(true))], lost(true)),
        ];
        for (progress, expected) in cases {
            let (outbox, mut trips) = trips();
            progress
                .into_iter()
                .for_each(|progress| outbox.send(Followed::Progress { id: 7, progress }).unwrap());
            let mut sample = given_up();
            trips.explain(7, &mut sample);
            assert_eq!(sample.lost_at.as_deref(), Some(&expected));
            assert!(trips.states.is_empty());
        }
    }

    #[test]
    fn nothing_is_said_of_packets_that_nobody_followed_and_memory_is_bounded() {
        let (outbox, mut trips) = trips();
        let mut sample = given_up();
        trips.explain(7, &mut sample);
        assert_eq!(sample.lost_at, None);
        for id in 0..3 * MOST as u64 {
            outbox.send(Followed::Progress { id, progress: Progress::Sent }).unwrap();
            trips.explain(u64::MAX, &mut sample);
        }
        assert_eq!((trips.states.len(), trips.order.len()), (MOST, MOST));
    }

    #[test]
    fn an_answer_that_the_robot_rejected_is_told_from_a_lost_one() {
        let (outbox, mut trips) = trips();
        outbox.send(Followed::Progress { id: 7, progress: Progress::Sent }).unwrap();
        let trip = cotorra_fabric::Trip {
            entered: Timestamp::ZERO,
            due: Timestamp::ZERO,
            delivered: Timestamp::ZERO + Duration::from_millis(1),
            links: Vec::new(),
        };
        let trip = RoundTrip { from: "r".parse().unwrap(), id: 7, out: trip.clone(), back: trip };
        outbox.send(Followed::RoundTrip(trip)).unwrap();
        let mut sample = given_up();
        trips.explain(7, &mut sample);
        assert_eq!(sample.lost_at.unwrap().cause, LostCause::Rejected);
    }
}
