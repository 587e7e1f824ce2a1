//! The medium: frames of hwsim's radios on one side, the fabric's air on the other.

use std::{collections::BTreeMap, sync::Arc};

use cotorra_fabric::{
    Antenna, Category, Fabric, FabricError, PhyRate, RateTries, Receiver, Report, Transmission,
};
use cotorra_graph::{Dbm, NodeId, Timestamp};

use crate::{
    address::MacAddress,
    header::{FrameType, Header},
    message::{Alias, DELIVERABLE, Delivery, Frame, Message, Rates, Status, Tries},
    rate::{legacy_index, phy_rate, wants_rts},
};

/// Bytes of the check sequence, which frames on the air have.
const CHECK_SEQUENCE: usize = 4;
/// Addresses of all radios together, at most. Those of further interfaces are unknown.
const MOST_ADDRESSES: usize = 4096;

/// Makes the fabric's air the medium of hwsim's radios. Each radio has the antenna of a robot or a radio unit.
///
/// It is a state machine without sockets and clocks. Give it what the kernel sends ([`Self::handle`]), and send the kernel
/// what it returns. After each poll of the fabric, call [`Self::poll`] until there is nothing more to send. Tell it what the
/// kernel [refuses](Self::refused) before the fabric's next poll, so that frames to radios that do not listen stay
/// unacknowledged.
#[derive(Debug, Default)]
pub struct Medium {
    radios: Vec<Member>,
    by_hardware: BTreeMap<MacAddress, usize>,
    by_antenna: BTreeMap<Antenna, usize>,
    /// Who receives frames to an address.
    by_address: BTreeMap<MacAddress, usize>,
    /// Frames that the air has not settled, by their number.
    under_way: BTreeMap<u64, UnderWay>,
    sent: u64,
    /// Frames to one radio that the kernel may refuse: their numbers and that of the transmission.
    delivered: BTreeMap<u32, u64>,
    numbered: u32,
}

#[derive(Debug)]
struct Member {
    hardware: MacAddress,
    antenna: Antenna,
}

#[derive(Debug)]
struct UnderWay {
    radio: usize,
    frame: Arc<[u8]>,
    frequency_mhz: u16,
    cookie: u64,
    no_ack: bool,
    rates: Rates,
    to: Receiver,
    /// The number of its delivery to one radio, and whether the kernel refused it.
    delivery: Option<u32>,
    refused: bool,
}

/// A message to the kernel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outgoing {
    /// The number to send it with. Refusals have it.
    pub number: u32,
    /// The message.
    pub message: Message,
}

impl Medium {
    /// Returns a medium without radios.
    pub fn new() -> Self {
        Self::default()
    }

    /// Gives a radio the antenna of a robot or a radio unit. `hardware` is the address that the kernel names it by: its
    /// permanent address, if it was created with one.
    ///
    /// # Errors
    /// Those of [`Fabric::lend_antenna`].
    pub fn join(
        &mut self,
        now: Timestamp,
        fabric: &mut Fabric,
        node: &NodeId,
        hardware: MacAddress,
    ) -> Result<(), FabricError> {
        let antenna = fabric.lend_antenna(now, node)?;
        let radio = self.radios.len();
        self.radios.push(Member { hardware, antenna });
        self.by_hardware.insert(hardware, radio);
        self.by_antenna.insert(antenna, radio);
        Ok(())
    }

    /// Takes a message of the kernel's. Returns the answer if there is one at once: the status of a frame that cannot be
    /// sent.
    pub fn handle(&mut self, now: Timestamp, fabric: &mut Fabric, message: &Message) -> Option<Outgoing> {
        match message {
            Message::Frame(frame) => return self.transmit(now, fabric, frame),
            Message::AddAddress(Alias { radio, address }) => {
                if let Some(&radio) = self.by_hardware.get(radio) {
                    self.learn(*address, radio);
                }
            }
            Message::RemoveAddress(Alias { radio, address }) => {
                let radio = self.by_hardware.get(radio);
                if radio.is_some() && self.by_address.get(address) == radio {
                    self.by_address.remove(address);
                }
            }
            _ => {}
        }
        None
    }

    /// Records that the kernel refused the message of this number: the receiver is off, or on another channel.
    pub fn refused(&mut self, now: Timestamp, fabric: &mut Fabric, number: u32) {
        let Some(id) = self.delivered.remove(&number) else { return };
        let Some(under_way) = self.under_way.get_mut(&id) else { return };
        under_way.refused = true;
        if let Receiver::One(antenna) | Receiver::OneWithoutAnswer(antenna) = under_way.to {
            fabric.stop_listening(now, antenna);
        }
    }

    /// Returns the next message to the kernel: a frame that a radio receives now, or the status of one that is settled.
    pub fn poll(&mut self, fabric: &mut Fabric) -> Option<Outgoing> {
        while let Some(report) = fabric.next_report() {
            let outgoing = match report {
                Report::Received { id, by, signal, rate, .. } => self.deliver(id, by, signal, rate),
                Report::Settled { id, tries, acknowledged, .. } => self.settle(id, &tries, acknowledged),
            };
            if outgoing.is_some() {
                return outgoing;
            }
        }
        None
    }

    /// Returns the number of frames that the air has not settled.
    pub fn under_way(&self) -> usize {
        self.under_way.len()
    }

    fn transmit(&mut self, now: Timestamp, fabric: &mut Fabric, sent: &Frame) -> Option<Outgoing> {
        let Frame { radio, frame, frequency_mhz, no_ack, rates, cookie, .. } = sent;
        let known = self.by_hardware.get(radio).copied();
        let frequency_mhz = frequency_mhz.and_then(|mhz| u16::try_from(mhz).ok());
        let (Some(radio), Some(frequency_mhz), Some(header)) = (known, frequency_mhz, Header::parse(frame))
        else {
            // The kernel keeps each frame until it gets its status, and drops others if there are many.
            return Some(self.number(Message::Status(Status {
                radio: *radio,
                cookie: *cookie,
                acknowledged: false,
                no_ack: *no_ack,
                rates: Rates::default(),
                signal_dbm: 0,
            })));
        };
        if let Some(transmitter) = header.transmitter {
            // Interfaces that were there before the medium are not announced.
            if !self.by_address.contains_key(&transmitter) {
                self.learn(transmitter, radio);
            }
        }
        let (rates, tried) = usable(rates, frequency_mhz);
        let to = self.receiver(radio, &header, *no_ack);
        self.sent += 1;
        let transmission = Transmission {
            id: self.sent,
            frequency_mhz,
            psdu_bytes: (frame.len() + CHECK_SEQUENCE) as u32,
            category: category(&header),
            to,
            rates: tried,
        };
        self.under_way.insert(
            self.sent,
            UnderWay {
                radio,
                frame: Arc::clone(frame),
                frequency_mhz,
                cookie: *cookie,
                no_ack: *no_ack,
                rates,
                to,
                delivery: None,
                refused: false,
            },
        );
        fabric.transmit(now, self.radios[radio].antenna, transmission);
        None
    }

    /// Returns who a frame is for.
    fn receiver(&self, sender: usize, header: &Header, no_ack: bool) -> Receiver {
        if header.receiver.is_group() {
            return Receiver::All;
        }
        let owner = self.by_address.get(&header.receiver).filter(|owner| **owner != sender);
        match owner {
            Some(owner) if no_ack || !header.is_acknowledged() => {
                Receiver::OneWithoutAnswer(self.radios[*owner].antenna)
            }
            Some(owner) => Receiver::One(self.radios[*owner].antenna),
            None => Receiver::Nobody,
        }
    }

    fn learn(&mut self, address: MacAddress, radio: usize) {
        if !address.is_group() && self.by_address.len() < MOST_ADDRESSES {
            self.by_address.insert(address, radio);
        }
    }

    fn deliver(&mut self, id: u64, by: Antenna, signal: Dbm, rate: PhyRate) -> Option<Outgoing> {
        let radio = self.radios.get(*self.by_antenna.get(&by)?)?.hardware;
        let sent = self.under_way.get(&id).filter(|sent| DELIVERABLE.contains(&sent.frame.len()))?;
        let outgoing = Outgoing {
            number: self.numbered.wrapping_add(1),
            message: Message::Delivery(Delivery {
                radio,
                frame: Arc::clone(&sent.frame),
                rate: legacy_index(rate, sent.frequency_mhz),
                signal_dbm: rounded(signal),
                frequency_mhz: Some(sent.frequency_mhz.into()),
            }),
        };
        self.numbered = outgoing.number;
        if let Some(sent) = self.under_way.get_mut(&id).filter(|sent| sent.to != Receiver::All) {
            sent.delivery = Some(outgoing.number);
            self.delivered.insert(outgoing.number, id);
        }
        Some(outgoing)
    }

    fn settle(&mut self, id: u64, tries: &[u32], acknowledged: Option<Dbm>) -> Option<Outgoing> {
        let sent = self.under_way.remove(&id)?;
        if let Some(number) = sent.delivery {
            self.delivered.remove(&number);
        }
        let acknowledged = acknowledged.filter(|_| !sent.refused);
        // A sender that heard no acknowledgement has tried all it could.
        let all = sent.refused && !sent.no_ack;
        let made = |(rate, made): (Tries, &u32)| Tries {
            count: if all { rate.count.max(1) } else { u8::try_from(*made).unwrap_or(u8::MAX) },
            ..rate
        };
        let rates = sent.rates.iter().zip(tries).map(made).take_while(|rate| rate.count > 0);
        let status = Status {
            radio: self.radios.get(sent.radio)?.hardware,
            cookie: sent.cookie,
            acknowledged: acknowledged.is_some(),
            no_ack: sent.no_ack,
            rates: Rates::new(rates),
            signal_dbm: acknowledged.map_or(0, rounded),
        };
        Some(self.number(Message::Status(status)))
    }

    fn number(&mut self, message: Message) -> Outgoing {
        self.numbered = self.numbered.wrapping_add(1);
        Outgoing { number: self.numbered, message }
    }
}

/// Returns the rates up to the first that is none, or else the slowest, once; and the same for the air.
fn usable(rates: &Rates, frequency_mhz: u16) -> (Rates, Vec<RateTries>) {
    const SLOWEST: Tries = Tries { index: 0, count: 1, flags: 0 };
    let known = |rates: &Rates| -> Vec<RateTries> {
        let on_air = |tries: Tries| {
            let rate = phy_rate(tries, frequency_mhz)?;
            Some(RateTries { rate, tries: tries.count.into(), rts: wants_rts(tries) })
        };
        rates.iter().map_while(on_air).collect()
    };
    let on_air = known(rates);
    if on_air.is_empty() {
        let slowest = Rates::new([SLOWEST]);
        return (slowest, known(&slowest));
    }
    (*rates, on_air)
}

/// Returns the access category of a frame (IEEE 802.11-2020, 10.2.3.2, tables 9-1 and 10-1): that of its user priority,
/// voice for management frames, and otherwise best effort.
fn category(header: &Header) -> Category {
    match (header.kind, header.tid) {
        (FrameType::Management, _) | (_, Some(6 | 7)) => Category::Voice,
        (_, Some(4 | 5)) => Category::Video,
        (_, Some(1 | 2)) => Category::Background,
        _ => Category::BestEffort,
    }
}

fn rounded(power: Dbm) -> i32 {
    power.0.round() as i32
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use cotorra_graph::{
        Capacity, DomainId, Driver, Edca, GapPolicy, HandoverTimes, HardwareGraph, Loss, Node, NodeKind,
        PathLoss, Position, RadioUnit, RateControl, Roaming, Robot, RobotModel, Shadowing, WifiStandard,
        WirelessNetwork,
    };

    use super::*;

    const AP: MacAddress = MacAddress([2, 0, 0, 0, 1, 0]);
    const STATION: MacAddress = MacAddress([2, 0, 0, 0, 2, 0]);
    const BROADCAST: MacAddress = MacAddress([0xff; 6]);
    const CHANNEL_36: u32 = 5180;
    const CHANNEL_40: u32 = 5200;

    fn network() -> WirelessNetwork {
        WirelessNetwork {
            standard: WifiStandard::A,
            delay: Duration::ZERO,
            rate: None,
            loss: Loss::None,
            fast_transition: true,
            mobility_domain: 1,
            path_loss: PathLoss::LogDistance { exponent: 3.0 },
            walls: None,
            access: Some(Edca { aggregation: false, rate_control: RateControl::Ideal, power_save: None }),
            interference: Vec::new(),
            shadowing: Shadowing { deviation_db: 0.0, correlation_m: 5.0 },
            fading: None,
            noise_floor: Dbm(-95.0),
            hysteresis_db: 4.0,
            time_to_trigger: Duration::from_millis(500),
            handover: HandoverTimes {
                scan: Duration::ZERO,
                visits: None,
                authenticate: Duration::ZERO,
                reassociate: Duration::ZERO,
                handshake: Duration::ZERO,
                variation: 0.0,
            },
            gap: GapPolicy::Hold,
        }
    }

    fn node(name: &str, x: f64, kind: NodeKind) -> Node {
        let (id, domain) = (NodeId::new(name).unwrap(), DomainId::new("d").unwrap());
        Node { id, domain, position: Some(Position::new(x, 0.0)), kind }
    }

    /// An access point at 0 and a station, with what the kernel was sent.
    struct World {
        fabric: Fabric,
        medium: Medium,
        now: Timestamp,
        sent: Vec<(Timestamp, Outgoing)>,
    }

    impl World {
        fn new(station_at: f64) -> Self {
            let capacity = Capacity { cpus: 1.0, memory_bytes: 1 };
            let unit = RadioUnit {
                capacity,
                network: "lab".into(),
                channel: 36,
                tx_power: Dbm(20.0),
                serving: true,
                deployment: Duration::ZERO,
                agent: None,
            };
            let robot = Robot {
                capacity,
                model: RobotModel::Turtlebot2,
                network: "lab".into(),
                tx_power: Dbm(20.0),
                heading: 0.0,
                roaming: Roaming::Instructed,
                driver: Driver::default(),
                sensors: Vec::new(),
            };
            let nodes = vec![
                node("ap", 0.0, NodeKind::RadioUnit(unit)),
                node("station", station_at, NodeKind::Robot(robot)),
            ];
            let graph = HardwareGraph {
                domains: vec![DomainId::new("d").unwrap()],
                nodes,
                links: Vec::new(),
                wireless: [("lab".to_owned(), network())].into(),
            };
            let (mut fabric, mut medium) = (Fabric::new(&graph, 1).unwrap(), Medium::new());
            for (name, hardware) in [("ap", AP), ("station", STATION)] {
                medium.join(Timestamp::ZERO, &mut fabric, &NodeId::new(name).unwrap(), hardware).unwrap();
            }
            let mut world = Self { fabric, medium, now: Timestamp::ZERO, sent: Vec::new() };
            for from in [AP, STATION] {
                world.handle(&Message::AddAddress(Alias { radio: from, address: from }));
                // What a radio sends first says where it listens.
                world.send(from, BROADCAST, CHANNEL_36);
            }
            world.run();
            world.sent.clear();
            world
        }

        fn handle(&mut self, message: &Message) {
            let answer = self.medium.handle(self.now, &mut self.fabric, message);
            self.sent.extend(answer.map(|answer| (self.now, answer)));
        }

        /// Sends a data frame with at most three tries at 54 and two at 6 Mbit/s.
        fn send(&mut self, from: MacAddress, to: MacAddress, frequency_mhz: u32) {
            let frame = [&[0x08, 0, 0, 0][..], &to.0, &from.0, &AP.0, &[0; 100]].concat();
            self.send_frame(from, frame, frequency_mhz, false);
        }

        fn send_frame(&mut self, from: MacAddress, frame: Vec<u8>, frequency_mhz: u32, no_ack: bool) {
            let rate = |index, count| Tries { index, count, flags: 0 };
            self.handle(&Message::Frame(Frame {
                radio: from,
                frame: frame.into(),
                frequency_mhz: Some(frequency_mhz),
                wants_status: true,
                no_ack,
                rates: Rates::new([rate(7, 3), rate(0, 2)]),
                cookie: 42,
            }));
        }

        /// Lets half a second pass.
        fn run(&mut self) {
            self.run_refusing(|_| false);
        }

        fn run_refusing(&mut self, refuses: impl Fn(&Delivery) -> bool) {
            let end = self.now + Duration::from_millis(500);
            while let Some(now) = self.fabric.poll(self.now, &mut |_, _| {}).filter(|next| *next <= end) {
                self.now = self.now.max(now);
                self.fabric.poll(self.now, &mut |_, _| {});
                while let Some(outgoing) = self.medium.poll(&mut self.fabric) {
                    if let Message::Delivery(delivery) = &outgoing.message
                        && refuses(delivery)
                    {
                        self.medium.refused(self.now, &mut self.fabric, outgoing.number);
                    }
                    self.sent.push((self.now, outgoing));
                }
            }
            self.now = end;
        }

        fn deliveries(&self) -> Vec<&Delivery> {
            let all = self.sent.iter().filter_map(|(_, outgoing)| match &outgoing.message {
                Message::Delivery(delivery) => Some(delivery),
                _ => None,
            });
            all.collect()
        }

        fn status(&self) -> &Status {
            let mut all = self.sent.iter().filter_map(|(_, outgoing)| match &outgoing.message {
                Message::Status(status) => Some(status),
                _ => None,
            });
            let status = all.next().expect("the kernel gets a status");
            assert!(all.next().is_none(), "the kernel gets one status");
            status
        }
    }

    fn tries(status: &Status) -> Vec<(u8, u8)> {
        status.rates.iter().map(|tries| (tries.index, tries.count)).collect()
    }

    #[test]
    fn a_frame_comes_to_its_receiver_with_signal_and_rate_and_is_acknowledged() {
        let mut world = World::new(5.0);
        world.send(STATION, AP, CHANNEL_36);
        world.run();
        let [delivery] = world.deliveries()[..] else { panic!("one radio receives it") };
        let loss = PathLoss::LogDistance { exponent: 3.0 }.loss_db(5.0, 5180);
        assert_eq!(delivery.signal_dbm, (20.0 - loss).round() as i32);
        assert_eq!((delivery.radio, delivery.rate, delivery.frequency_mhz), (AP, 7, Some(CHANNEL_36)));
        let status = world.status();
        assert_eq!((status.radio, status.cookie, status.acknowledged), (STATION, 42, true));
        assert_eq!(tries(status), [(7, 1)]);
        assert_eq!(status.signal_dbm, delivery.signal_dbm, "the way back is as long");
        assert_eq!(world.medium.under_way(), 0);
    }

    #[test]
    fn a_distant_frame_falls_back_to_its_slower_rate() {
        let mut world = World::new(60.0);
        world.send(STATION, AP, CHANNEL_36);
        world.run();
        assert_eq!(tries(world.status()), [(7, 3), (0, 1)]);
        assert_eq!(world.deliveries()[0].rate, 0);
    }

    #[test]
    fn a_group_frame_comes_to_all_others_and_the_kernel_decides_who_listens() {
        let mut world = World::new(5.0);
        world.send(AP, BROADCAST, CHANNEL_40);
        world.run();
        assert_eq!(world.deliveries().iter().map(|delivery| delivery.radio).collect::<Vec<_>>(), [STATION]);
        let status = world.status();
        assert_eq!((status.acknowledged, tries(status)), (false, vec![(7, 1)]));
    }

    #[test]
    fn addresses_come_and_go_with_interfaces() {
        let mut world = World::new(5.0);
        let other = MacAddress([2, 9, 9, 9, 9, 9]);
        world.send(AP, other, CHANNEL_36);
        world.run();
        assert!(world.deliveries().is_empty() && !world.status().acknowledged);
        assert_eq!(tries(world.status()), [(7, 3), (0, 2)]);
        for (add, received) in [(true, 1), (false, 0)] {
            world.sent.clear();
            let alias = Alias { radio: STATION, address: other };
            world.handle(&if add { Message::AddAddress(alias) } else { Message::RemoveAddress(alias) });
            world.send(AP, other, CHANNEL_36);
            world.run();
            assert_eq!((world.deliveries().len(), world.status().acknowledged), (received, add));
        }
    }

    #[test]
    fn a_frame_that_the_kernel_refuses_is_not_acknowledged_nor_are_later_ones() {
        let mut world = World::new(5.0);
        world.send(AP, STATION, CHANNEL_36);
        world.run_refusing(|_| true);
        assert_eq!((world.status().acknowledged, tries(world.status())), (false, vec![(7, 3), (0, 2)]));
        world.sent.clear();
        world.send(AP, STATION, CHANNEL_36);
        world.run();
        assert!(world.deliveries().is_empty() && !world.status().acknowledged);
        world.send(STATION, AP, CHANNEL_36);
        world.run();
        world.sent.clear();
        world.send(AP, STATION, CHANNEL_36);
        world.run();
        assert!(world.status().acknowledged, "it has sent again");
    }

    #[test]
    fn a_frame_without_acknowledgement_is_tried_once() {
        let mut world = World::new(5.0);
        let frame = [&[0x50, 0, 0, 0][..], &STATION.0, &AP.0, &AP.0, &[0; 30]].concat();
        world.send_frame(AP, frame, CHANNEL_36, true);
        world.run();
        assert_eq!(world.deliveries().len(), 1);
        assert_eq!((world.status().no_ack, world.status().acknowledged), (true, false));
        assert_eq!(tries(world.status()), [(7, 1)]);
    }

    #[test]
    fn every_frame_gets_a_status() {
        let mut world = World::new(5.0);
        // Too short for a header; too short for the kernel; of an unknown radio; on an impossible channel.
        world.send_frame(STATION, vec![0; 5], CHANNEL_36, false);
        assert_eq!(tries(world.status()), []);
        world.sent.clear();
        let poll = [&[0xa4, 0, 1, 0xc0][..], &AP.0, &STATION.0].concat();
        world.send_frame(STATION, poll, CHANNEL_36, false);
        world.run();
        assert!(world.deliveries().is_empty() && world.status().acknowledged);
        for (radio, mhz) in [(BROADCAST, CHANNEL_36), (STATION, 100_000)] {
            world.sent.clear();
            world.send_frame(radio, vec![0; 40], mhz, false);
            assert_eq!(world.status().radio, radio);
        }
        assert_eq!(world.medium.under_way(), 0);
    }

    #[test]
    fn categories_are_those_of_the_user_priority() {
        let qos = |tid: u8| {
            let frame = [&[0x88, 0, 0, 0][..], &AP.0, &STATION.0, &AP.0, &[0, 0, tid, 0]].concat();
            category(&Header::parse(&frame).unwrap())
        };
        use Category::{Background, BestEffort, Video, Voice};
        let all: Vec<_> = (0..9).map(qos).collect();
        let expected =
            [BestEffort, Background, Background, BestEffort, Video, Video, Voice, Voice, BestEffort];
        assert_eq!(all, expected);
        let beacon = [&[0x80, 0, 0, 0][..], &BROADCAST.0, &AP.0, &AP.0, &[0, 0]].concat();
        assert_eq!(category(&Header::parse(&beacon).unwrap()), Voice);
    }
}
