//! Frames of an access point and a station, through a fabric.

use std::{path::Path, time::Duration};

use cotorra_graph::PathLoss;

use super::*;

const AP: MacAddress = MacAddress([2, 0, 0, 0, 1, 0]);
const STATION: MacAddress = MacAddress([2, 0, 0, 0, 2, 0]);
const BROADCAST: MacAddress = MacAddress([0xff; 6]);
const CHANNEL_36: u32 = 5180;
const CHANNEL_40: u32 = 5200;

/// An access point at 0 and a station, with what the kernel was sent.
struct World {
    fabric: Fabric,
    medium: Medium,
    now: Timestamp,
    sent: Vec<(Timestamp, Outgoing)>,
}

impl World {
    fn new(station_at: f64) -> Self {
        let testbed = format!(
            "name: air\n\
             wireless: {{ lab: {{ standard: a, access: edca, path_loss: {{ model: log_distance, exponent: 3 }}, \
             shadowing: {{ deviation: 0 dB, correlation: 5 m }} }} }}\n\
             nodes:\n  \
             ap: {{ kind: radio_unit, position: [0, 0], channel: 36, tx_power: 20 dBm }}\n  \
             station: {{ kind: robot, position: [{station_at}, 0], cpus: 1, memory: 1 GB, tx_power: 20 dBm }}\n"
        );
        let graph = cotorra_testbed_file::parse("air", &testbed, Path::new("")).unwrap().graph;
        let (mut fabric, mut medium) = (Fabric::new(&graph, 1).unwrap(), Medium::new());
        for (name, hardware) in [("ap", AP), ("station", STATION)] {
            medium.join(Timestamp::ZERO, &mut fabric, &NodeId::new(name).unwrap(), hardware).unwrap();
        }
        let mut world = Self { fabric, medium, now: Timestamp::ZERO, sent: Vec::new() };
        for from in [AP, STATION] {
            world.handle(&Message::AddAddress(Alias { radio: from, address: from }));
            // A radio's first frame says where it listens.
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
            aggregates: false,
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
                self.medium.confirm();
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
    let counts = TryCounts { frames: 1, acknowledged: 1, tries: 4, aggregates: 0 };
    assert_eq!(world.medium.counts(STATION), Some(counts));
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
fn a_status_waits_until_refusals_of_its_frame_are_known() {
    for refuses in [false, true] {
        let mut world = World::new(5.0);
        world.send(STATION, AP, CHANNEL_36);
        // Its end and that of the acknowledgement are noticed late, together.
        world.now = world.now + Duration::from_millis(10);
        world.fabric.poll(world.now, &mut |_, _| {});
        let delivery = world.medium.poll(&mut world.fabric).expect("it arrives");
        assert_eq!((world.medium.poll(&mut world.fabric), world.medium.awaits_refusals()), (None, true));
        if refuses {
            world.medium.refused(world.now, &mut world.fabric, delivery.number);
        }
        world.medium.confirm();
        assert!(!world.medium.awaits_refusals());
        let status = world.medium.poll(&mut world.fabric).expect("it is settled").message;
        assert!(matches!(status, Message::Status(Status { acknowledged, .. }) if acknowledged != refuses));
    }
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
    let expected = [BestEffort, Background, Background, BestEffort, Video, Video, Voice, Voice, BestEffort];
    assert_eq!(all, expected);
    let beacon = [&[0x80, 0, 0, 0][..], &BROADCAST.0, &AP.0, &AP.0, &[0, 0]].concat();
    assert_eq!(category(&Header::parse(&beacon).unwrap()), Voice);
}

#[test]
fn frames_that_the_kernel_would_aggregate_arrive_together() {
    for (aggregates, times) in [(false, 3), (true, 1)] {
        let mut world = World::new(5.0);
        // Encrypted QoS data, as with protected management frames, whose agreement cannot be read.
        let frame = [&[0x88, 0x41, 0, 0][..], &AP.0, &STATION.0, &AP.0, &[0; 200]].concat();
        for cookie in 1..=3 {
            world.handle(&Message::Frame(Frame {
                radio: STATION,
                frame: frame.clone().into(),
                frequency_mhz: Some(CHANNEL_36),
                wants_status: true,
                no_ack: false,
                aggregates,
                // MCS 7.
                rates: Rates::new([Tries { index: 7, count: 3, flags: 1 << 3 }]),
                cookie,
            }));
        }
        world.run();
        let arrivals = world.sent.iter().filter(|(_, sent)| matches!(sent.message, Message::Delivery(_)));
        let mut arrivals: Vec<_> = arrivals.map(|(at, _)| *at).collect();
        assert_eq!(arrivals.len(), 3);
        arrivals.dedup();
        assert_eq!(arrivals.len(), times);
        let counts = world.medium.counts(STATION).unwrap();
        assert_eq!((counts.frames, counts.aggregates), (3, if aggregates { 3 } else { 0 }));
    }
}
