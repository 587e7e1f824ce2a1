//! Parts of the time of round trips: of followed datagrams, and of flows on TCP.

use std::{
    sync::mpsc::{Receiver, channel},
    time::Duration,
};

use cotorra_fabric::{Checksum, Datagrams, Fabric, Followed, Frame, Offload, PortId, Progress, RoundTrip};
use cotorra_flows::headers::{IPV4, Ipv4, PROTOCOL_TCP, PROTOCOL_UDP, udp_header};
use cotorra_graph::{
    ConditionChange, Conditions, Direction, Event, Flow, FlowProtocol, HostAddress, Kpis, LinkTime, Loss,
    LostAt, LostCause, Probability, QueueLimit, Service, ServiceTime, TimeParts, Timestamp,
};
use proptest::{collection::vec, prelude::*};

use crate::common::{A, B, Delivery, Network, delay, ms, pair, rate};

const PORT: u16 = 7711;
const CLIENT: u16 = 40_000;

fn ipv4(from: PortId, to: PortId, protocol: u8, payload: &[u8]) -> Vec<u8> {
    let [source, destination] = [from, to].map(|port| HostAddress::of(port.0));
    let header =
        Ipv4 { ttl: 64, protocol, source: source.ipv4, destination: destination.ipv4, ..Ipv4::default() };
    [&destination.mac[..], &source.mac, &[8, 0], &header.header(payload.len()), payload].concat()
}

pub fn datagram(from: (PortId, u16), to: (PortId, u16), id: u64) -> Frame {
    let payload = id.to_le_bytes();
    let udp = [&udp_header(from.1, to.1, payload.len())[..], &payload].concat();
    Frame::new(ipv4(from.0, to.0, PROTOCOL_UDP, &udp))
}

fn segment(from: (PortId, u16), to: (PortId, u16), sequence: u32, payload: &[u8]) -> Frame {
    let mut tcp = [from.1.to_be_bytes(), to.1.to_be_bytes()].concat();
    tcp.extend(sequence.to_be_bytes());
    tcp.extend([0, 0, 0, 1, 0x50, 0x10, 0xff, 0xff, 0, 0, 0, 0]);
    tcp.extend(payload);
    let start = (14 + IPV4) as u16;
    let offload = Offload { checksum: Some(Checksum { start, offset: 16 }), segmentation: None };
    Frame::with_offload(ipv4(from.0, to.0, PROTOCOL_TCP, &tcp), offload)
}

/// Runs up to a time, and calls `answer` with each delivery.
fn run(
    fabric: &mut Fabric,
    now: &mut Timestamp,
    until: Timestamp,
    mut answer: impl FnMut(&mut Fabric, Delivery),
) {
    loop {
        let mut out = Vec::new();
        let at = *now;
        let mut next = fabric.poll(at, &mut |port, frame| out.push(Delivery { at, port, frame }));
        if !out.is_empty() {
            out.into_iter().for_each(|delivery| answer(fabric, delivery));
            continue;
        }
        next = next.filter(|next| *next <= until);
        match next {
            Some(next) => *now = next,
            None => return *now = until,
        }
    }
}

fn follow(fabric: &mut Fabric, from: &str) -> Receiver<RoundTrip> {
    let (sender, trips) = channel();
    let followed = Datagrams { from: from.parse().unwrap(), port: PORT, id_at: 0 };
    fabric.follow(
        &[followed],
        Box::new(move |followed| {
            if let Followed::RoundTrip(trip) = followed {
                sender.send(trip).unwrap();
            }
        }),
    );
    trips
}

/// A robot and a server with several links between them.
fn chain(delays: &[u64]) -> (Fabric, [PortId; 2]) {
    let mut network = Network::new().radio_unit("R1", 0.0).robot("p", 3.0).server("b");
    network = network.switches(&["s0", "s1", "s2"][..delays.len() - 1]);
    let names: Vec<_> = (0..delays.len() - 1).map(|i| format!("s{i}")).collect();
    let stops: Vec<&str> =
        std::iter::once("R1").chain(names.iter().map(String::as_str)).chain(["b"]).collect();
    for (ends, ms) in stops.windows(2).zip(delays) {
        network = network.link(ends[0], ends[1], delay(*ms));
    }
    let fabric = network.fabric(1);
    let ports = ["p", "b"].map(|name| fabric.port(&name.parse().unwrap()).unwrap());
    (fabric, ports)
}

/// Sends datagrams from the robot, a millisecond apart, which the server answers after `thinks`. Returns the parts of each
/// round trip, with its time.
fn round_trips(
    fabric: &mut Fabric,
    [p, b]: [PortId; 2],
    count: u64,
    thinks: Duration,
) -> Vec<(TimeParts, Duration)> {
    let trips = follow(fabric, "p");
    let (mut now, mut emitted, mut took) = (ms(0.0), Vec::new(), Vec::new());
    let mut held: Vec<(Timestamp, Frame)> = Vec::new();
    for step in 0..2000 {
        let until = ms(f64::from(step));
        loop {
            let due = held.iter().map(|(at, _)| *at).min().filter(|at| *at <= until);
            run(fabric, &mut now, due.unwrap_or(until), |_, Delivery { at, port, frame }| {
                let id = u64::from_le_bytes(*frame.bytes()[42..].first_chunk().unwrap());
                if port == b {
                    held.push((at + thinks, datagram((b, PORT), (p, CLIENT), id)));
                } else {
                    took.push((id, at));
                }
            });
            let Some(due) = due else { break };
            let (ready, later) = held.drain(..).partition(|(at, _)| *at <= due);
            held = later;
            let ready: Vec<(Timestamp, Frame)> = ready;
            ready.into_iter().for_each(|(at, frame)| fabric.push(at, b, frame));
        }
        if step < count as i32 {
            emitted.push(now);
            fabric.push(now, p, datagram((p, CLIENT), (b, PORT), emitted.len() as u64 - 1));
        }
    }
    let split = |trip: RoundTrip| {
        let emitted = emitted[trip.id as usize];
        let took = took.iter().find(|(id, _)| *id == trip.id).unwrap().1.since(emitted);
        (trip.out.split(trip.back, emitted, took), took)
    };
    trips.try_iter().map(split).collect()
}

fn on<'a>(parts: &'a TimeParts, link: &str, back: bool) -> &'a LinkTime {
    parts.links.iter().find(|on| on.link == *link && on.back == back).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn parts_add_up_and_a_delay_shows_at_its_link_alone(
        delays in vec(1..20_u64, 2..=4),
        slow in any::<prop::sample::Index>(),
        backward: bool,
        extra in 1..30_u64,
        thinks in 0..9_u64,
    ) {
        let thinks = Duration::from_millis(thinks);
        let (mut fabric, ports) = chain(&delays);
        let before = round_trips(&mut fabric, ports, 3, thinks);
        let (mut fabric, ports) = chain(&delays);
        let names = fabric.link_contexts(ms(0.0));
        let direction = if backward { Direction::Backward } else { Direction::Forward };
        let slow = slow.index(delays.len());
        let link = names[2 * slow].link.clone();
        let change = ConditionChange { delay_ms: Some((delays[slow] + extra) as f64), ..ConditionChange::default() };
        fabric.change(ms(0.0), &link, Some(direction), &change).unwrap();
        let after = round_trips(&mut fabric, ports, 3, thinks);
        prop_assert_eq!((before.len(), after.len()), (3, 3));
        for ((before, _), (after, took)) in before.iter().zip(&after) {
            prop_assert_eq!(after.total(), *took);
            prop_assert_eq!((after.vnf, after.unknown, after.sender), (thinks, Duration::ZERO, Duration::ZERO));
            prop_assert_eq!(after.links.len(), 2 * (delays.len() + 1));
            for (before, after) in before.links.iter().zip(&after.links) {
                let is_it = after.link == link && after.direction == direction;
                let expected = before.crossing + Duration::from_millis(if is_it { extra } else { 0 });
                prop_assert_eq!((&after.link, after.back), (&before.link, before.back));
                if is_it || !after.link.as_str().contains('~') {
                    prop_assert_eq!((after.crossing, after.queueing), (expected, Duration::ZERO));
                } else {
                    // The air draws its backoff anew for packets that meet another channel.
                    prop_assert!(after.total() < before.total() + Duration::from_millis(2), "{:?}", after);
                }
            }
        }
    }
}

#[test]
fn packets_ahead_show_as_queueing() {
    let conditions = Conditions { rate: rate(8.0), ..delay(5) };
    let mut fabric = pair(conditions, 1);
    let trips = follow(&mut fabric, "a");
    // Three packets of a millisecond each.
    (0..3).for_each(|i| fabric.push(ms(0.0), A, crate::common::frame(A, B, i, 1000)));
    fabric.push(ms(0.5), A, datagram((A, CLIENT), (B, PORT), 7));
    let mut now = ms(0.5);
    run(&mut fabric, &mut now, ms(99.0), |fabric, Delivery { at, port, frame }| {
        if port == B && frame.len() < 100 {
            fabric.push(at, B, datagram((B, PORT), (A, CLIENT), 7));
        }
    });
    let RoundTrip { out, back, id, .. } = trips.try_recv().unwrap();
    assert_eq!(id, 7);
    assert_eq!((out.entered, out.links[0].queueing), (ms(0.5), Duration::from_micros(2500)));
    // 50 bytes take 50 µs.
    assert_eq!(out.links[0].crossing, Duration::from_micros(5050));
    assert_eq!((back.links[0].queueing, back.links[0].retries), (Duration::ZERO, Duration::ZERO));
    assert_eq!(back.links[0].direction, Direction::Backward);
}

#[test]
fn a_late_poll_is_unknown_and_no_part_of_a_link() {
    let mut fabric = pair(delay(5), 1);
    let trips = follow(&mut fabric, "a");
    fabric.push(ms(1.0), A, datagram((A, CLIENT), (B, PORT), 7));
    fabric.poll(ms(8.0), &mut |_, _| {});
    fabric.push(ms(9.0), B, datagram((B, PORT), (A, CLIENT), 7));
    fabric.poll(ms(16.0), &mut |_, _| {});
    let RoundTrip { out, back, .. } = trips.try_recv().unwrap();
    let parts = out.split(back, ms(0.5), Duration::from_micros(16_500));
    let expected = [0.5, 1.0, 1.0, 4.0].map(|ms| Duration::from_nanos((ms * 1e6) as u64));
    assert_eq!([parts.sender, parts.vnf, parts.receiver, parts.unknown], expected);
    assert_eq!(parts.links.iter().map(LinkTime::total).collect::<Vec<_>>(), [Duration::from_millis(5); 2]);
    assert_eq!(on(&parts, "a-b", true).direction, Direction::Backward);
}

#[test]
fn other_packets_and_answers_of_others_give_no_round_trip() {
    let mut fabric = pair(delay(5), 1);
    let trips = follow(&mut fabric, "a");
    // Another port; an answer without a request; an answer with another id.
    for (request, answer) in [((PORT + 1, 1), (PORT + 1, 1)), ((PORT, 2), (PORT, 3))] {
        fabric.push(ms(1.0), A, datagram((A, CLIENT), (B, request.0), request.1));
        fabric.poll(ms(8.0), &mut |_, _| {});
        fabric.push(ms(9.0), B, datagram((B, answer.0), (A, CLIENT), answer.1));
        fabric.poll(ms(16.0), &mut |_, _| {});
    }
    assert!(trips.try_recv().is_err());
}

/// A service whose flow begins at `a`.
fn flow_of_a(protocol: FlowProtocol) -> Service {
    let flow = Flow { from: "a".parse().unwrap(), timeout: Duration::from_secs(1), protocol };
    let kpis = Kpis {
        service_time: Duration::from_millis(50),
        kept: None,
        reliability: None,
        area: None,
        radio: None,
        flow: Some(flow),
        require: Vec::new(),
    };
    Service {
        id: "walk".parse().unwrap(),
        robot: "a".parse().unwrap(),
        vnfs: Vec::new(),
        virtual_links: Vec::new(),
        kpis,
        requests: Default::default(),
        policy: None,
    }
}

/// Measures TCP from `a` to `b`, and returns the samples of segments: time, whether `a` sends, sequence number, bytes.
fn tcp(segments: &[(f64, bool, u32, &[u8])]) -> Vec<ServiceTime> {
    let mut fabric = pair(delay(5), 1);
    fabric.measure_flows(&[flow_of_a(FlowProtocol::Tcp { port: PORT })]);
    let mut now = ms(0.0);
    for (at, is_client, sequence, payload) in segments {
        run(&mut fabric, &mut now, ms(*at), |_, _| {});
        let (from, to) = if *is_client { ((A, CLIENT), (B, PORT)) } else { ((B, PORT), (A, CLIENT)) };
        fabric.push(now, from.0, segment(from, to, *sequence, payload));
    }
    run(&mut fabric, &mut now, ms(500.0), |_, _| {});
    let sample = |stamped: cotorra_graph::Stamped| match stamped.event {
        Event::ServiceTime(sample) => Some(sample),
        _ => None,
    };
    std::iter::from_fn(|| fabric.next_event()).filter_map(sample).collect()
}

#[test]
fn the_last_segment_of_a_request_ends_the_senders_part() {
    // The second half follows after 3 ms, and the server answers 10 ms after it has come. What follows is another request.
    let samples = tcp(&[
        (1.0, true, 100, b"half"),
        (4.0, true, 104, b"half"),
        (19.0, false, 1, b"yes"),
        (30.0, true, 108, b"next"),
        (37.0, false, 4, b"yes"),
    ]);
    let parts: Vec<_> = samples.iter().map(|sample| sample.parts.as_deref().unwrap()).collect();
    let millis =
        |parts: &TimeParts| [parts.sender, parts.vnf, parts.receiver, parts.unknown].map(|d| d.as_millis());
    assert_eq!(parts.iter().map(|parts| millis(parts)).collect::<Vec<_>>(), [[3, 10, 0, 0], [0, 2, 0, 0]]);
    for (sample, parts) in samples.iter().zip(parts) {
        assert_eq!(Some(parts.total()), sample.took);
        assert_eq!(parts.links.iter().map(|on| on.crossing.as_millis()).collect::<Vec<_>>(), [5, 5]);
    }
}

#[test]
fn a_segment_that_was_sent_again_counts_where_it_came_first() {
    // The copy arrives at 13 ms, before the answer.
    let samples = tcp(&[(1.0, true, 100, b"all"), (8.0, true, 100, b"all"), (16.0, false, 1, b"yes")]);
    let parts = samples[0].parts.as_deref().unwrap();
    assert_eq!((parts.sender, parts.vnf), (Duration::ZERO, Duration::from_millis(10)));
}

#[test]
fn the_gap_of_a_handover_shows_as_queueing_on_the_new_link() {
    let network = Network::new().radio_unit("R1", 0.0).radio_unit("R2", 100.0).robot("p", 50.0).server("b");
    let mut fabric = network.link("R1", "b", delay(3)).link("R2", "b", delay(3)).fabric(1);
    let [p, b] = ["p", "b"].map(|name| fabric.port(&name.parse().unwrap()).unwrap());
    let trips = follow(&mut fabric, "p");
    let from = fabric.attached_to(&"p".parse().unwrap()).unwrap().clone();
    let to = if from.as_str() == "R1" { "R2" } else { "R1" };
    fabric.attach(ms(0.0), &"p".parse().unwrap(), &to.parse().unwrap()).unwrap();
    fabric.push(ms(1.0), p, datagram((p, CLIENT), (b, PORT), 7));
    let mut now = ms(1.0);
    run(&mut fabric, &mut now, ms(999.0), |fabric, Delivery { at, port, .. }| {
        if port == b {
            fabric.push(at, b, datagram((b, PORT), (p, CLIENT), 7));
        }
    });
    let Event::Handover(handover) = fabric.next_event().unwrap().event else { panic!("a handover") };
    let RoundTrip { out, back, .. } = trips.try_recv().unwrap();
    assert_eq!(out.links[0].link.as_str(), format!("p~{to}"));
    assert_eq!(out.links[0].queueing, handover.gap - Duration::from_millis(1));
    assert_eq!(back.links[1].queueing, Duration::ZERO);
}

/// Follows datagrams from `a`, and returns where those that were lost ended.
fn losses(fabric: &mut Fabric, from: &str) -> Receiver<(u64, LostAt)> {
    let (sender, losses) = channel();
    let followed = Datagrams { from: from.parse().unwrap(), port: PORT, id_at: 0 };
    let read = move |followed| {
        if let Followed::Progress { id, progress: Progress::Lost(at) } = followed {
            sender.send((id, at)).unwrap();
        }
    };
    fabric.follow(&[followed], Box::new(read));
    losses
}

/// Sends datagrams from `a` and answers them. Returns where those that were lost ended.
fn lost_between(out: Conditions, back: Conditions, count: u64) -> Vec<(u64, LostAt)> {
    let mut fabric = pair(delay(5), 1);
    let link = "a-b".parse().unwrap();
    for (direction, conditions) in [(Direction::Forward, out), (Direction::Backward, back)] {
        let change = ConditionChange {
            loss: Some(conditions.loss),
            corruption: Some(conditions.corruption),
            rate: Some(conditions.rate),
            queue: Some(conditions.queue),
            ..ConditionChange::default()
        };
        fabric.change(ms(0.0), &link, Some(direction), &change).unwrap();
    }
    let losses = losses(&mut fabric, "a");
    (0..count).for_each(|id| fabric.push(ms(0.0), A, datagram((A, CLIENT), (B, PORT), id)));
    let mut now = ms(0.0);
    run(&mut fabric, &mut now, ms(999.0), |fabric, Delivery { at, port, frame }| {
        if port == B {
            let id = u64::from_le_bytes(*frame.bytes()[42..].first_chunk().unwrap());
            fabric.push(at, B, datagram((B, PORT), (A, CLIENT), id));
        }
    });
    losses.try_iter().collect()
}

fn at(link: &str, back: bool, cause: LostCause) -> LostAt {
    LostAt { link: Some(link.parse().unwrap()), back, cause }
}

#[test]
fn a_lost_datagram_tells_its_link_its_way_and_the_cause() {
    let fine = || delay(5);
    let lossy = || Conditions { loss: Loss::Independent { rate: Probability::ONE }, ..delay(5) };
    let corrupt = || Conditions { corruption: Probability::ONE, ..delay(5) };
    let narrow = || Conditions { rate: rate(0.1), queue: QueueLimit::Packets(1), ..delay(5) };
    let cases = [
        (lossy(), fine(), 2, at("a-b", false, LostCause::Loss)),
        (fine(), lossy(), 2, at("a-b", true, LostCause::Loss)),
        (corrupt(), fine(), 2, at("a-b", false, LostCause::Corruption)),
        (fine(), corrupt(), 2, at("a-b", true, LostCause::Corruption)),
        (narrow(), fine(), 2, at("a-b", false, LostCause::FullQueue)),
        (fine(), narrow(), 2, at("a-b", true, LostCause::FullQueue)),
    ];
    for (out, back, lost, expected) in cases {
        let count = if expected.cause == LostCause::FullQueue { 2 + lost } else { lost };
        let found = lost_between(out, back, count);
        let expected: Vec<_> = (count - lost..count).map(|id| (id, expected.clone())).collect();
        assert_eq!(found, expected);
    }
}

#[test]
fn a_datagram_on_the_air_or_without_a_route_tells_where_it_ended() {
    // Nothing leads to `c`.
    let network = Network::new().radio_unit("R1", 0.0).robot("p", 3.0).server("b").server("c");
    let mut fabric = network.link("R1", "b", delay(1)).fabric(1);
    let [p, b, c] = ["p", "b", "c"].map(|name| fabric.port(&name.parse().unwrap()).unwrap());
    let losses = losses(&mut fabric, "p");
    let loss =
        |rate| ConditionChange { loss: Some(Loss::Independent { rate }), ..ConditionChange::default() };
    let air = "p~R1".parse().unwrap();
    fabric.change(ms(0.0), &air, Some(Direction::Forward), &loss(Probability::ONE)).unwrap();
    fabric.push(ms(1.0), p, datagram((p, CLIENT), (b, PORT), 1));
    let mut now = ms(1.0);
    run(&mut fabric, &mut now, ms(50.0), |_, _| {});
    fabric.change(ms(50.0), &air, None, &loss(Probability::ZERO)).unwrap();
    fabric.push(ms(60.0), p, datagram((p, CLIENT), (c, PORT), 2));
    run(&mut fabric, &mut now, ms(99.0), |_, _| {});
    let found: Vec<_> = losses.try_iter().collect();
    let unroutable = LostAt { link: None, back: false, cause: LostCause::NoRoute };
    assert_eq!(found, [(1, at("p~R1", false, LostCause::Loss)), (2, unroutable)]);
}

/// Sends requests of a flow from `a`, and returns where its samples without an answer ended.
fn unanswered(conditions: Conditions, answers: bool) -> Vec<Option<LostAt>> {
    let mut fabric = pair(conditions, 1);
    fabric.measure_flows(&[flow_of_a(FlowProtocol::Udp { port: PORT, id: None })]);
    let mut now = ms(0.0);
    for step in 0..3 {
        fabric.push(now, A, datagram((A, CLIENT), (B, PORT), step));
        run(&mut fabric, &mut now, ms(2000.0 * (step + 1) as f64), |fabric, Delivery { at, port, .. }| {
            if port == B && answers {
                fabric.push(at, B, datagram((B, PORT), (A, CLIENT), step));
            }
        });
    }
    let sample = |stamped: cotorra_graph::Stamped| match stamped.event {
        Event::ServiceTime(sample) => Some(sample.lost_at.map(|at| *at)),
        _ => None,
    };
    std::iter::from_fn(|| fabric.next_event()).filter_map(sample).collect()
}

#[test]
fn a_request_of_a_flow_without_an_answer_tells_where_it_ended() {
    let lossy = Conditions { loss: Loss::Independent { rate: Probability::ONE }, ..delay(5) };
    let silent = LostAt { link: None, back: false, cause: LostCause::NoAnswer };
    assert_eq!(unanswered(lossy, true), vec![Some(at("a-b", false, LostCause::Loss)); 3]);
    assert_eq!(unanswered(delay(5), false), vec![Some(silent); 3]);
    assert_eq!(unanswered(delay(5), true), [None, None, None], "all were answered");
    let late = LostAt { link: None, back: false, cause: LostCause::Late };
    assert_eq!(unanswered(delay(5000), true)[0], Some(late));
}
