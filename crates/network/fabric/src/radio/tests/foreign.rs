//! Radios that are not the fabric's, at lent antennas: timing, tries, losses, and the channel that they share with all
//! others.

use cotorra_graph::Fading;

use super::{
    contention::{bianchi, contending},
    *,
};

const CHANNEL_36: u16 = 5180;
const CHANNEL_40: u16 = 5200;

fn us(us: u64) -> Timestamp {
    Timestamp::from_nanos(us * 1000)
}

fn legacy(rate: u16, tries: u32) -> RateTries {
    RateTries { rate: PhyRate::legacy(rate, false).unwrap(), tries, rts: false }
}

/// A network whose antennas are all lent.
struct Air {
    world: World,
    antennas: Vec<Antenna>,
    sent: u64,
    /// Length of the packets in its frames.
    packet_bytes: Option<u32>,
    aggregates: bool,
    reports: Vec<Report>,
}

impl Air {
    /// A radio unit at 0, and robots at these places.
    fn new(network: WirelessNetwork, places: &[f64]) -> Self {
        Self::seeded(network, places, 1)
    }

    fn seeded(network: WirelessNetwork, places: &[f64], seed: u64) -> Self {
        let mut nodes = vec![unit("R", 0.0, 36)];
        let robots = places.iter().enumerate();
        nodes.extend(robots.map(|(i, x)| robot(&format!("r{i}"), *x, Roaming::Instructed)));
        let ids: Vec<_> = nodes.iter().map(|node| node.id.clone()).collect();
        let mut world = World::seeded(network, nodes, seed);
        let antennas = ids.iter().map(|id| world.radio.lend(Timestamp::ZERO, id).unwrap()).collect();
        Self { world, antennas, sent: 0, packet_bytes: None, aggregates: false, reports: Vec::new() }
    }

    /// Sends a frame of 1000 bytes from one antenna to another.
    fn send(&mut self, now: Timestamp, from: usize, to: usize, rates: &[RateTries]) -> u64 {
        let to = Receiver::One(self.antennas[to]);
        self.send_on(now, from, to, rates, CHANNEL_36)
    }

    fn send_on(
        &mut self,
        now: Timestamp,
        from: usize,
        to: Receiver,
        rates: &[RateTries],
        frequency_mhz: u16,
    ) -> u64 {
        self.sent += 1;
        let transmission = Transmission {
            id: self.sent,
            frequency_mhz,
            psdu_bytes: 1000,
            category: Category::BestEffort,
            to,
            packet_bytes: self.packet_bytes,
            aggregates: self.aggregates,
            rates: rates.to_vec(),
        };
        self.world.radio.transmit(now, self.antennas[from], transmission);
        self.sent
    }

    /// Makes all antennas listen on channel 36, by a frame without a receiver.
    fn tune_all(&mut self, now: Timestamp) {
        for from in 0..self.antennas.len() {
            self.send_on(now, from, Receiver::All, &[legacy(540, 1)], CHANNEL_36);
        }
        self.run(Timestamp::from_nanos(now.as_nanos() + 10_000_000));
        self.reports.clear();
    }

    fn deadline(&self) -> Option<Timestamp> {
        self.world.radio.alarm().into_iter().chain(self.world.radio.report_deadline()).min()
    }

    fn run(&mut self, until: Timestamp) {
        let mut arrivals = Vec::new();
        let mut now = self.deadline();
        while let Some(at) = now.filter(|now| *now <= until) {
            self.world.radio.poll(at, &mut Pool::default(), &mut arrivals);
            while let Some(report) = self.world.radio.next_report(at) {
                let can_wait = self.packet_bytes.is_some() && matches!(report, Report::Settled { .. });
                assert!(report.at() == at || can_wait, "reports come when they are due");
                self.reports.push(report);
            }
            now = self.deadline();
            assert!(now.is_none_or(|next| next > at), "everything due at {at} is done");
        }
        self.world.radio.poll(until, &mut Pool::default(), &mut arrivals);
        self.world.arrived.extend(arrivals.into_iter().map(|a| (a.due, a.at, a.frame)));
    }

    /// Returns the end of a frame with its tries, and whether it was acknowledged.
    fn settled(&self, id: u64) -> (Timestamp, Vec<u32>, bool) {
        let found = self.reports.iter().find_map(|report| match report {
            Report::Settled { at, id: of, tries, acknowledged } if *of == id => {
                Some((*at, tries.clone(), acknowledged.is_some()))
            }
            _ => None,
        });
        found.expect("it is settled")
    }

    /// Returns who received a frame, when, and with which power.
    fn received(&self, id: u64) -> Vec<(Timestamp, usize, f64)> {
        let received = self.reports.iter().filter_map(|report| match report {
            Report::Received { at, id: of, by, signal, .. } if *of == id => Some((*at, by.0, signal.0)),
            _ => None,
        });
        received.collect()
    }
}

#[test]
fn a_frame_takes_its_airtime_and_is_acknowledged_after_sifs() {
    let mut air = Air::new(contending(), &[5.0]);
    air.tune_all(at(0));
    let id = air.send(us(20_000), 1, 0, &[legacy(540, 3)]);
    air.run(at(40));
    let (received, by, signal) = air.received(id)[0];
    let (settled, tries, acknowledged) = air.settled(id);
    // It waits for the next slot boundary. 22 + 8000 bits in symbols of 216 take 20 + 38 × 4 µs; SIFS is 16 µs and an
    // acknowledgement at 24 Mbit/s 28 µs.
    assert!((172.0..=181.0).contains(&(received.since(us(20_000)).as_secs_f64() * 1e6)), "{received}");
    assert_eq!(settled.since(received), Duration::from_micros(16 + 28));
    assert_eq!((by, tries, acknowledged), (0, vec![1], true));
    // 20 dBm, and 3 × 10 dB per decade from 1 m on at 5180 MHz.
    let loss = PathLoss::LogDistance { exponent: 3.0 }.loss_db(5.0, CHANNEL_36);
    assert!((signal - (20.0 - loss)).abs() < 1e-9);
}

#[test]
fn a_frame_needs_two_polls() {
    let mut air = Air::new(contending(), &[5.0]);
    air.tune_all(Timestamp::ZERO);
    let now = us(20_000);
    let id = air.send(now, 1, 0, &[legacy(540, 1)]);
    // At the end of the frame, whose first report is due then, and at the end of the acknowledgement.
    let received = air.deadline().unwrap();
    air.run(received);
    assert!(matches!(air.reports[..], [Report::Received { at, .. }] if at == received));
    let settled = air.deadline().unwrap();
    air.run(settled);
    assert_eq!((air.settled(id).0, air.reports.len()), (settled, 2));
}

#[test]
fn the_status_of_a_packet_waits_for_the_next_frame() {
    let mut air = Air::new(contending(), &[5.0]);
    air.tune_all(Timestamp::ZERO);
    air.packet_bytes = Some(940);
    let sent: Vec<_> = (0..3).map(|_| air.send(us(20_000), 1, 0, &[legacy(540, 1)])).collect();
    let mut polls = 0;
    while let Some(at) = air.deadline() {
        polls += 1;
        air.run(at);
    }
    // The last status has nothing to wait for.
    assert_eq!((polls, sent.iter().filter(|id| air.settled(**id).2).count()), (4, 3));
}

#[test]
fn packets_count_on_the_link_of_their_association() {
    let mut air = Air::new(contending(), &[72.0, 5.0]);
    air.tune_all(Timestamp::ZERO);
    let [unit, robot] = ["R", "r0"].map(id);
    let association = Association { began: Timestamp::ZERO, fast: false };
    air.world.radio.associate_lent(us(10_000), &robot, &unit, association).unwrap();
    air.packet_bytes = Some(940);
    let mut now = us(20_000);
    let mut sent = Vec::new();
    for _ in 0..200 {
        now = now + Duration::from_millis(2);
        sent.push(air.send(now, 1, 0, &[legacy(240, 1)]));
        air.run(now + Duration::from_millis(1));
    }
    let arrived = sent.iter().filter(|id| air.settled(**id).2).count() as u64;
    assert!((20..180).contains(&arrived), "{arrived} of 200");
    // A beacon carries no packet, the other robot is not associated, and a group frame counts where it may arrive.
    let frames = [(1, Receiver::One(air.antennas[0]), None), (2, Receiver::One(air.antennas[0]), Some(940))];
    for (from, to, packet_bytes) in frames.into_iter().chain([(0, Receiver::All, Some(300))]) {
        now = now + Duration::from_millis(5);
        air.packet_bytes = packet_bytes;
        air.send_on(now, from, to, &[legacy(60, 1)], CHANNEL_36);
        air.run(now + Duration::from_millis(5));
    }
    let contexts = air.world.radio.link_contexts(now, |_, _| None);
    let counted: Vec<_> = contexts
        .iter()
        .filter(|context| context.counters != LinkCounters::default())
        .map(|context| (context.link.to_string(), context.direction, context.counters))
        .collect();
    let up =
        LinkCounters { packets: arrived, bytes: 940 * arrived, lost: 200 - arrived, ..Default::default() };
    let down = LinkCounters { packets: 1, bytes: 300, ..Default::default() };
    assert_eq!(
        counted,
        [("r0~R".to_owned(), Direction::Forward, up), ("r0~R".to_owned(), Direction::Backward, down)]
    );
    // They took their airtime, of 340 µs and more.
    let delay = air.world.radio.link_contexts(us(420_000), |_, _| None)[0].delay.unwrap();
    assert!((340..600).contains(&delay.as_micros()), "{delay:?}");
    assert_eq!(air.world.radio.balance(), Balance::default(), "no packet of the fabric's was lost");
}

#[test]
fn conditions_of_a_link_lose_and_slow_its_packets() {
    let mut air = Air::new(contending(), &[5.0]);
    air.tune_all(Timestamp::ZERO);
    let [unit, robot] = ["R", "r0"].map(id);
    let association = Association { began: Timestamp::ZERO, fast: false };
    air.world.radio.associate_lent(us(10_000), &robot, &unit, association).unwrap();
    air.packet_bytes = Some(1000);
    let rate = Rate::Fixed { bits_per_second: BitRate::from_mbps(1.0).unwrap() };
    let loss = Loss::Independent { rate: Probability::new(0.5).unwrap() };
    let change = ConditionChange { rate: Some(rate), loss: Some(loss), ..ConditionChange::default() };
    let link = LinkId::new("r0~R").unwrap();
    air.world.radio.change(us(10_000), &link, Some(Direction::Forward), &change).unwrap();
    for (from, to, passes) in [(1, 0, 60..140), (0, 1, 200..201)] {
        let mut arrived = 0;
        for round in 0..200 {
            let now = us(2_000_000 * (2 - from as u64) + round * 10_000);
            let sent = air.send(now, from, to, &[legacy(540, 3)]);
            air.run(now + Duration::from_millis(10));
            let (settled, tries, acknowledged) = air.settled(sent);
            // 8 ms at 1 Mbit/s; the radios have done their part.
            assert_eq!((settled.since(now).as_millis(), tries, acknowledged), ([0, 8][from], vec![1], true));
            arrived += air.received(sent).len();
        }
        assert!(passes.contains(&arrived), "{arrived} of 200");
    }
}

#[test]
fn an_aggregate_takes_its_airtime_and_one_block_acknowledgement() {
    let mut air = Air::new(contending(), &[5.0]);
    air.tune_all(Timestamp::ZERO);
    air.aggregates = true;
    let mcs7 = PhyRate::ht(7, ChannelWidth::Mhz20, false).unwrap();
    let rates = [RateTries { rate: mcs7, tries: 3, rts: false }];
    let sent: Vec<_> = (0..3).map(|_| air.send(us(20_000), 1, 0, &rates)).collect();
    air.run(at(40));
    let first = air.received(sent[0])[0].0;
    // After DIFS and at most 15 slots: a preamble of 36 µs, and 22 + 3 · 8032 bits in symbols of 260.
    let took = first.since(us(20_000)).as_micros();
    assert!((36 + 93 * 4..=36 + 93 * 4 + 43 + 16 * 9).contains(&took), "{took} µs");
    for id in sent {
        assert_eq!(air.received(id)[0].0, first);
        // SIFS, and 32 bytes at 24 Mbit/s.
        assert_eq!(air.settled(id), (first + Duration::from_micros(16 + 32), vec![1], true));
    }
}

#[test]
fn lost_frames_of_an_aggregate_go_again_before_others() {
    let mut air = Air::new(contending(), &[32.0]);
    air.tune_all(Timestamp::ZERO);
    air.aggregates = true;
    let mcs7 = PhyRate::ht(7, ChannelWidth::Mhz20, false).unwrap();
    let rates = [RateTries { rate: mcs7, tries: 30, rts: false }];
    let sent: Vec<_> = (0..40).map(|_| air.send(us(20_000), 1, 0, &rates)).collect();
    air.run(at(200));
    let arrivals: Vec<_> = sent.iter().map(|id| air.received(*id)[0].0).collect();
    let tries: Vec<_> = sent.iter().map(|id| air.settled(*id).1[0]).collect();
    assert!(tries.iter().any(|tries| *tries > 1) && tries.contains(&1), "{tries:?}");
    // All of the first aggregate's frames that are left go in the next one.
    let first: Vec<_> = tries.iter().zip(&arrivals).take(20).collect();
    for (tries, arrival) in &first {
        for (other_tries, other_arrival) in &first {
            assert_eq!(tries.cmp(other_tries), arrival.cmp(other_arrival));
        }
    }
}

#[test]
fn a_frame_that_is_given_up_does_not_end_the_row_of_failures_of_others() {
    let mcs7 = PhyRate::ht(7, ChannelWidth::Mhz20, false).unwrap();
    let rates = |tries| [RateTries { rate: mcs7, tries, rts: false }];
    // Nobody answers so far away. Returns when the last frame is given up.
    let ended = |seed, others: &[u32]| {
        let mut air = Air::seeded(contending(), &[900.0], seed);
        air.tune_all(Timestamp::ZERO);
        air.aggregates = true;
        others.iter().for_each(|tries| _ = air.send(us(20_000), 1, 0, &rates(*tries)));
        let last = air.send(us(20_000), 1, 0, &rates(6));
        air.run(at(200));
        air.settled(last).0.since(us(20_000)).as_secs_f64()
    };
    let mean = |others: &[u32]| (0..200).map(|seed| ended(seed, others)).sum::<f64>() / 200.0;
    // Six tries with windows of 15 to 511 slots of 9 µs take some 7 ms; three more windows from 15 slots on, half of that.
    let (alone, beside) = (mean(&[]), mean(&[1, 2]));
    assert!((beside / alone - 1.0).abs() < 0.2, "{beside} s beside others, {alone} s alone");
}

#[test]
fn rates_are_tried_in_order_until_one_arrives() {
    // 54 Mbit/s does not reach so far, 6 Mbit/s does.
    let mut air = Air::new(contending(), &[60.0]);
    air.tune_all(at(0));
    let slow = air.send(at(20), 1, 0, &[legacy(540, 2), legacy(360, 0), legacy(60, 3)]);
    let lost = air.send(at(30), 1, 0, &[legacy(540, 2), legacy(480, 1)]);
    air.run(at(60));
    assert_eq!(air.settled(slow).1, [2, 1, 1]);
    assert!(air.settled(slow).2);
    assert_eq!((air.settled(lost).1, air.settled(lost).2), (vec![2, 1], false));
    assert_eq!((air.received(slow).len(), air.received(lost).len()), (1, 0));
}

#[test]
fn nobody_acknowledges_a_frame_to_nobody_or_to_a_radio_on_another_channel() {
    let mut air = Air::new(contending(), &[5.0, 8.0]);
    air.tune_all(at(0));
    let nobody = air.send_on(at(20), 1, Receiver::Nobody, &[legacy(60, 2)], CHANNEL_36);
    air.send_on(at(30), 2, Receiver::All, &[legacy(60, 1)], CHANNEL_40);
    let elsewhere = air.send(at(40), 1, 2, &[legacy(60, 2)]);
    air.run(at(50));
    assert_eq!(air.settled(nobody).1, [2]);
    assert_eq!(air.settled(elsewhere).1, [2]);
    assert!(!air.settled(elsewhere).2 && air.received(elsewhere).is_empty());
    // A radio whose owner says that it is off is deaf until it sends again.
    let before = air.send(at(50), 1, 0, &[legacy(60, 2)]);
    air.run(at(60));
    air.world.radio.stop_listening(at(60), air.antennas[0]);
    let off = air.send(at(60), 1, 0, &[legacy(60, 2)]);
    air.run(at(70));
    air.send_on(at(70), 0, Receiver::All, &[legacy(60, 1)], CHANNEL_36);
    let after = air.send(at(80), 1, 0, &[legacy(60, 2)]);
    air.run(at(90));
    assert_eq!([before, off, after].map(|id| air.settled(id).2), [true, false, true]);
}

#[test]
fn a_group_frame_is_sent_once_and_reaches_all_within_reach() {
    let mut air = Air::new(contending(), &[5.0, 10.0, 900.0]);
    air.tune_all(at(0));
    let id = air.send_on(at(20), 1, Receiver::All, &[legacy(60, 4), legacy(60, 4)], CHANNEL_36);
    air.run(at(40));
    let received: Vec<_> = air.received(id).iter().map(|(_, by, _)| *by).collect();
    assert_eq!(received, [0, 2]);
    let (settled, tries, acknowledged) = air.settled(id);
    assert_eq!((tries, acknowledged), (vec![1, 0], false));
    assert_eq!(settled, air.received(id)[0].0, "nobody answers");
}

#[test]
fn a_frame_for_another_channel_waits_for_those_before_it() {
    let mut air = Air::new(contending(), &[5.0]);
    air.tune_all(at(0));
    let first = air.send(at(20), 1, 0, &[legacy(60, 1)]);
    let scan = air.send_on(at(20), 1, Receiver::All, &[legacy(60, 1)], CHANNEL_40);
    let back = air.send(at(20), 1, 0, &[legacy(60, 1)]);
    air.run(at(40));
    let ends = [first, scan, back].map(|id| air.settled(id).0);
    assert!(ends.is_sorted(), "{ends:?}");
    assert!(air.settled(first).2 && air.settled(back).2);
}

#[test]
fn a_full_queue_rejects_frames_at_once() {
    let mut air = Air::new(contending(), &[5.0]);
    let ids: Vec<_> = (0..97).map(|_| air.send(at(0), 1, 0, &[legacy(60, 1)])).collect();
    let none = air.send(at(0), 1, 0, &[]);
    air.run(at(0));
    assert_eq!(air.settled(ids[96]).1, Vec::<u32>::new());
    assert_eq!(air.settled(none).1, Vec::<u32>::new());
    air.run(at(1000));
    assert!(ids[..96].iter().all(|id| air.settled(*id).1 == [1]));
}

#[test]
fn losses_are_those_of_the_rate_and_the_signal() {
    // A distance at which some frames of 1000 bytes at 54 Mbit/s are lost.
    let loss = PathLoss::LogDistance { exponent: 3.0 };
    let rate = PhyRate::legacy(540, false).unwrap();
    let lost = |m: f64| rate.error_rate(20.0 - loss.loss_db(m, CHANNEL_36) + 95.0, 1000);
    let place = (1..1000).map(|dm| f64::from(dm) / 10.0).find(|m| lost(*m) > 0.3).unwrap();
    let mut air = Air::new(contending(), &[place]);
    air.tune_all(at(0));
    let sent = 2000_u64;
    let ids: Vec<_> =
        (0..sent).map(|n| air.send(at(20 + n), 1, 0, &[RateTries { rate, tries: 1, rts: false }])).collect();
    air.run(at(3000));
    let arrived = ids.iter().filter(|id| air.settled(**id).2).count() as f64;
    let (n, p) = (sent as f64, 1.0 - lost(place));
    // The 99 % interval of the binomial distribution.
    let deviation = 2.576 * (n * p * (1.0 - p)).sqrt();
    assert!((arrived - n * p).abs() < deviation, "{arrived} of {n}, not {}", n * p);
}

#[test]
fn saturated_radios_share_the_channel_as_bianchi_says() {
    let places = [5.0, -5.0, 5.0, -5.0, 5.0];
    let mut air = Air::new(contending(), &places);
    air.tune_all(at(0));
    let mut waiting = BTreeMap::new();
    let one_second = us(1_020_000);
    for from in 1..=places.len() {
        for _ in 0..2 {
            waiting.insert(air.send(at(20), from, 0, &[legacy(540, 7)]), from);
        }
    }
    // Each settled frame is followed by another one of its sender.
    let mut arrived = 0;
    while let Some(next) = air.deadline().filter(|next| *next <= one_second) {
        air.run(next);
        for report in std::mem::take(&mut air.reports) {
            if let Report::Settled { at, id, acknowledged, .. } = report {
                arrived += u64::from(acknowledged.is_some());
                let from = waiting.remove(&id).unwrap();
                waiting.insert(air.send(at, from, 0, &[legacy(540, 7)]), from);
            }
        }
    }
    // 1000 bytes at 54 Mbit/s take 20 + 4 × 38 µs; SIFS and an acknowledgement at 24 Mbit/s follow.
    let model = bianchi(places.len() as i32, 20.0 + 4.0 * 38.0 + 16.0 + 28.0);
    assert!((arrived as f64 / model - 1.0).abs() < 0.03, "{arrived}/s, not {model:.0}/s");
}

#[test]
fn lent_antennas_and_the_fabrics_own_share_one_channel() {
    let mut nodes = vec![unit("R", 0.0, 36), unit("S", -1.0, 36)];
    nodes.extend(["r0", "r1"].map(|name| robot(name, 5.0, Roaming::Instructed)));
    let mut world = World::new(contending(), nodes);
    let antennas = ["S", "r1"].map(|name| world.radio.lend(Timestamp::ZERO, &id(name)).unwrap()).to_vec();
    let mut air =
        Air { world, antennas, sent: 0, packet_bytes: None, aggregates: false, reports: Vec::new() };
    air.tune_all(at(0));
    (0..200).for_each(|_| air.world.up(at(20), "r0", 1000));
    (0..90).for_each(|_| {
        air.send(at(20), 1, 0, &[legacy(540, 7)]);
    });
    air.run(at(35));
    let own = air.world.arrived.iter().filter(|(due, ..)| *due <= at(35)).count() as f64;
    let lent = air.reports.iter().filter(|report| matches!(report, Report::Received { .. })).count() as f64;
    assert!(own > 20.0 && lent > 20.0, "{own} and {lent}");
    assert!((0.5..2.0).contains(&(own / lent)), "{own} and {lent}");
}

#[test]
fn rts_keeps_hidden_radios_silent() {
    // Both reach the radio unit, but not each other.
    let received = |rts: bool| {
        let mut air = Air::new(contending(), &[80.0, -80.0]);
        air.tune_all(at(0));
        for from in 1..=2 {
            for _ in 0..90 {
                air.send(at(20), from, 0, &[RateTries { rts, ..legacy(60, 7) }]);
            }
        }
        air.run(at(120));
        air.reports.iter().filter(|report| matches!(report, Report::Received { .. })).count()
    };
    let (without, with) = (received(false), received(true));
    assert!(with as f64 > 1.2 * without as f64, "{with} with RTS, {without} without");
}

#[test]
fn signals_fade_from_frame_to_frame_about_their_mean() {
    let fading = Some(Fading { k_factor_db: None, motion_mps: 1.0 });
    let mut air = Air::new(WirelessNetwork { fading, ..contending() }, &[5.0]);
    air.tune_all(at(0));
    for n in 0..500 {
        air.send_on(at(20 + 10 * n), 1, Receiver::All, &[legacy(60, 1)], CHANNEL_36);
    }
    air.run(at(6000));
    let signals: Vec<f64> = (1..=air.sent).flat_map(|id| air.received(id)).map(|(_, _, dbm)| dbm).collect();
    let mean_mw = signals.iter().map(|dbm| 10f64.powf(dbm / 10.0)).sum::<f64>() / signals.len() as f64;
    let loss = PathLoss::LogDistance { exponent: 3.0 }.loss_db(5.0, CHANNEL_36);
    assert!((10.0 * mean_mw.log10() - (20.0 - loss)).abs() < 1.0);
    let low = signals.iter().filter(|dbm| **dbm < 20.0 - loss - 10.0).count() as f64 / signals.len() as f64;
    assert!((0.04..0.16).contains(&low), "a tenth is 10 dB below the mean, not {low}");
}

#[test]
fn antennas_are_lent_once_and_for_good() {
    let mut world = World::new(contending(), vec![unit("R", 0.0, 36), robot("r", 5.0, Roaming::Instructed)]);
    assert_eq!(world.attached("r"), Some(world.port("R")));
    world.radio.lend(at(0), &id("r")).unwrap();
    assert_eq!(world.attached("r"), None);
    assert_eq!(world.radio.lend(at(0), &id("r")), Err(FabricError::Lent(id("r"))));
    assert_eq!(world.radio.lend(at(0), &id("x")), Err(FabricError::NoAntenna(id("x"))));
    assert_eq!(world.radio.scan(at(0), &id("r")), Err(FabricError::Lent(id("r"))));
    assert_eq!(world.radio.attach(at(0), &id("r"), &id("R")), Err(FabricError::Lent(id("r"))));
    // It moves, and does not look for radio units.
    world.radio.move_robot(at(0), &id("r"), Position::new(6.0, 0.0)).unwrap();
    world.up(at(1), "r", 1000);
    world.run(at(5000));
    assert!(world.arrived.is_empty() && world.attached("r").is_none());
    let mut turns = corridor(network(), Roaming::Instructed);
    assert_eq!(turns.radio.lend(at(0), &id("r")), Err(FabricError::NoContention(id("r"))));
}

#[test]
fn the_same_seed_gives_the_same_reports() {
    let reports = |seed| {
        let mut air = Air::seeded(contending(), &[40.0, -40.0], seed);
        air.tune_all(at(0));
        for n in 0..50 {
            air.send(at(20 + n), 1, 0, &[legacy(360, 3), legacy(60, 2)]);
            air.send(at(20 + n), 2, 0, &[legacy(360, 3), legacy(60, 2)]);
        }
        air.run(at(1000));
        air.reports
    };
    assert_eq!(reports(1), reports(1));
    assert_ne!(reports(1), reports(2));
}
