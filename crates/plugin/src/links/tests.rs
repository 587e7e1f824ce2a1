//! Figures of one wire, and of the air of one robot.

use cotorra_graph::{BitRate, Conditions, LinkCounters, Probed, Rate};
use cotorra_graph_testing as base;

use super::*;

const WAYS: [Direction; 2] = [Direction::Forward, Direction::Backward];

fn seconds(seconds: f64) -> Timestamp {
    Timestamp::from_secs_f64(seconds)
}

fn ms(ms: f64) -> Duration {
    Duration::from_secs_f64(ms / 1e3)
}

/// A link of 5 ms and 10 Mbit/s each way, probed twice a second over 10 s.
struct Bed {
    links: Links,
    context: LinkContext,
    /// Rate at which bytes cross forward, bit/s.
    load_bps: f64,
}

/// Returns the wire between a switch and a server.
fn bed(measurements: Option<Measurements>) -> Bed {
    bed_of("lan-cloud", measurements)
}

/// Returns the air between a robot and a radio unit.
fn air() -> Bed {
    bed_of("r~a~unit", Some(Measurements::default()))
}

fn testbed() -> Testbed {
    let text = "
name: one
wireless: { lab: { delay: 5 ms, rate: 10 Mbit/s } }
nodes:
  r~a: { kind: robot, position: [0, 0] }
  q: { kind: robot, position: [0, 0] }
  s: { kind: robot, position: [0, 0] }
  unit: { kind: radio_unit, position: [1, 0], channel: 1 }
  lan: { kind: switch }
  cloud: { kind: server, tier: cloud, cpus: 1, memory: 1 GB }
links:
  - { ends: [lan, cloud], delay: 5 ms, rate: 10 Mbit/s }
  - { ends: [lan, unit] }
";
    cotorra_testbed_file::parse("one.yaml", text, std::path::Path::new("")).unwrap()
}

fn bed_of(link: &str, measurements: Option<Measurements>) -> Bed {
    let rate = Rate::Fixed { bits_per_second: BitRate::from_mbps(10.0).unwrap() };
    let effective = Conditions { delay: ms(5.0), rate, ..Conditions::default() };
    let context = LinkContext { effective, ..base::link_context(link) };
    Bed { links: Links::new(&testbed(), measurements), context, load_bps: 0.0 }
}

impl Bed {
    /// Learns contexts from `from` to `to`, ten a second. Returns how often there were news of measurements.
    fn learn(&mut self, from: f64, to: f64) -> usize {
        let steps = ((to - from) * 10.0).round() as u32;
        let mut news = 0;
        for step in 0..steps {
            let now = seconds(from + f64::from(step) / 10.0);
            self.context.counters.bytes += (self.load_bps / 80.0) as u64;
            self.links.forget(now);
            for direction in WAYS {
                let idle = LinkContext {
                    probed: None,
                    delay: None,
                    counters: LinkCounters::default(),
                    ..self.context.clone()
                };
                let context = if direction == Direction::Forward { self.context.clone() } else { idle };
                let context = LinkContext { direction, ..context };
                news += usize::from(self.links.learn(now, &context) == News::Measured);
            }
        }
        news
    }

    fn probed(&mut self, delay: f64) {
        let (delay, age) = (Some(ms(delay)), ms(100.0));
        let probed = Probed { delay, jitter: None, delay_age: Some(age), loss: None, loss_age: age };
        self.context.probed = Some(probed);
    }

    fn figures(&self) -> RoundTrip {
        self.links.figures(&self.context.link)
    }

    fn beyond(&self) -> Beyond {
        self.figures().beyond
    }
}

#[test]
fn measured_delay_counts_at_once_and_until_the_window_has_passed() {
    let mut bed = bed(Some(Measurements::default()));
    bed.probed(5.9);
    assert_eq!(bed.learn(0.0, 5.0), 0, "that is within the tolerance");
    assert_eq!(bed.beyond(), Beyond::default());
    bed.probed(29.0);
    assert_eq!(bed.learn(5.0, 5.1), 1);
    assert_eq!(bed.beyond().delay, ms(24.0));
    assert_eq!(bed.figures().configured, ms(10.0));
    bed.probed(5.0);
    assert_eq!(bed.learn(5.1, 15.0), 0);
    assert_eq!(bed.beyond().delay, ms(24.0), "it was so 9.9 s ago");
    assert_eq!(bed.learn(15.0, 16.0), 1);
    assert_eq!(bed.beyond(), Beyond::default());
}

#[test]
fn the_configured_delay_is_the_least() {
    let mut bed = bed(Some(Measurements::default()));
    bed.probed(1.0);
    bed.learn(0.0, 5.0);
    let figures = bed.figures();
    assert_eq!((figures.configured, figures.beyond), (ms(10.0), Beyond::default()));
}

#[test]
fn packets_count_where_probes_are_old_or_absent() {
    let mut bed = bed(Some(Measurements::default()));
    bed.context.delay = Some(ms(12.0));
    bed.learn(0.0, 1.0);
    assert_eq!(bed.beyond().delay, ms(7.0));
    bed.probed(5.0);
    bed.learn(1.0, 12.0);
    assert_eq!(bed.beyond().delay, Duration::ZERO, "what probes meet counts first");
    bed.context.probed.as_mut().unwrap().delay_age = Some(ms(10_100.0));
    bed.learn(12.0, 12.1);
    assert_eq!(bed.beyond().delay, ms(7.0));
}

#[test]
fn measurements_of_other_conditions_do_not_count() {
    let mut bed = bed(Some(Measurements::default()));
    bed.context.effective.delay = ms(30.0);
    bed.probed(30.0);
    bed.learn(0.0, 20.0);
    bed.context.effective.delay = ms(5.0);
    bed.learn(20.0, 20.1);
    let figures = bed.figures();
    assert_eq!((figures.configured, figures.beyond.delay), (ms(10.0), Duration::ZERO));
    bed.learn(20.1, 29.0);
    assert_eq!(bed.beyond().delay, Duration::ZERO, "probes of before are in their mean");
    bed.learn(29.0, 31.0);
    assert_eq!(bed.beyond().delay, ms(25.0));
}

#[test]
fn load_is_the_mean_of_the_window_and_counts_from_a_twentieth_of_the_rate() {
    let mut bed = bed(Some(Measurements::default()));
    bed.load_bps = 0.4e6;
    bed.learn(0.0, 10.0);
    assert_eq!(bed.beyond().load_bps, 0.0);
    bed.load_bps = 8e6;
    bed.learn(10.0, 25.0);
    assert!((bed.beyond().load_bps / 8e6 - 1.0).abs() < 0.01, "{:?}", bed.beyond());
}

#[test]
fn loss_counts_as_far_as_it_is_certain() {
    let mut bed = bed(Some(Measurements::default()));
    bed.learn(0.0, 1.0);
    bed.context.counters = LinkCounters { packets: 199, lost: 1, ..LinkCounters::default() };
    bed.learn(1.0, 3.0);
    let one = bed.beyond().delivery;
    assert!((0.998..1.0).contains(&one), "{one}");
    bed.context.counters =
        LinkCounters { packets: 1980, lost: 10, overflowed: 10, ..LinkCounters::default() };
    bed.learn(3.0, 5.0);
    let many = bed.beyond().delivery;
    assert!((0.99..0.995).contains(&many), "of 1 %: {many}");
}

#[test]
fn without_measurements_only_the_configuration_counts() {
    let mut bed = bed(None);
    bed.probed(29.0);
    bed.load_bps = 8e6;
    assert_eq!(bed.learn(0.0, 20.0), 0);
    assert_eq!(bed.beyond(), Beyond::default());
    assert!(!bed.links.any_beyond());
    bed.context.effective.delay = ms(6.0);
    let context = bed.context.clone();
    assert_eq!(bed.links.learn(seconds(20.0), &context), News::Configured);
    assert_eq!(bed.figures().configured, ms(11.0));
}

#[test]
fn lost_probes_count_as_far_as_they_are_certain() {
    let mut bed = bed(Some(Measurements::default()));
    bed.probed(5.0);
    bed.context.probed.as_mut().unwrap().loss = Some(0.5);
    bed.learn(0.0, 1.0);
    let delivery = bed.beyond().delivery;
    assert!((0.65..0.75).contains(&delivery), "of 10 of 20 lost probes: {delivery}");
    bed.context.probed.as_mut().unwrap().loss_age = ms(10_001.0);
    bed.learn(1.0, 12.0);
    assert_eq!(bed.beyond().delivery, 1.0);
}

#[test]
fn the_air_is_as_slow_as_it_is_all_the_time() {
    let mut bed = air();
    assert_eq!((bed.figures().configured, bed.figures().rate_bps), (ms(10.0), 10e6));
    bed.probed(25.0);
    assert_eq!(bed.learn(0.0, 20.0), 0, "that can be a scan");
    assert_eq!(bed.beyond(), Beyond::default());
    assert_eq!(bed.learn(20.0, 20.2), 1);
    assert_eq!(bed.beyond().delay, ms(20.0));
    bed.probed(8.0);
    bed.learn(20.2, 20.3);
    assert_eq!(bed.beyond().delay, ms(3.0));
    bed.probed(60.0);
    bed.learn(20.3, 40.0);
    assert_eq!(bed.beyond().delay, ms(3.0), "a scan holds up packets for a moment");
}

#[test]
fn a_robot_that_left_a_radio_unit_knows_nothing_of_its_air() {
    let mut bed = air();
    bed.probed(25.0);
    bed.learn(0.0, 30.0);
    assert_eq!(bed.beyond().delay, ms(20.0));
    bed.context.probed = None;
    bed.learn(30.0, 51.0);
    assert_eq!(bed.beyond().delay, Duration::ZERO);
    bed.probed(25.0);
    bed.learn(51.0, 60.0);
    assert_eq!(bed.beyond().delay, Duration::ZERO);
}

#[test]
fn a_rate_is_free_if_nobody_uses_or_declares_it() {
    let mut bed = bed(Some(Measurements::default()));
    bed.load_bps = 4e6;
    bed.learn(0.0, 20.0);
    let figures = bed.figures();
    let free = |own, others| (figures.free_bps(own, others) / 1e5).round() / 10.0;
    assert_eq!(free(0.0, 0.0), 6.0);
    assert_eq!(free(1e6, 0.0), 7.0, "the metered load has the own rate in it");
    assert_eq!(free(0.0, 5e6), 5.0, "an idle reservation is not free");
    assert_eq!(free(0.0, 1e6), 6.0);
}

#[test]
fn the_air_to_other_radio_units_counts_as_their_stations_measure_it_if_candidates_count() {
    let [unit, station, idle, other] = ["unit", "r~a", "q", "s"].map(|name| NodeId::new(name).unwrap());
    let measured = |candidates| {
        let mut bed = bed_of("r~a~unit", Some(Measurements { candidates, ..Measurements::default() }));
        bed.probed(35.0);
        bed.learn(0.0, 30.0);
        // The second station waits for half as long.
        bed.context.link = LinkId::wireless(&other, &unit);
        bed.probed(20.0);
        bed.learn(0.0, 30.0);
        bed.links
    };
    let delays = |links: &Links| [&station, &other, &idle].map(|robot| links.air(robot, &unit).beyond.delay);
    let (without, with) = (measured(false), measured(true));
    assert_eq!(delays(&without), [ms(30.0), ms(15.0), Duration::ZERO]);
    assert_eq!(delays(&with), [ms(30.0), ms(15.0), ms(22.5)], "its own measurements come first");
    let nowhere = NodeId::new("elsewhere").unwrap();
    assert_eq!(
        with.air(&idle, &nowhere).beyond,
        Beyond::default(),
        "a unit without stations is as configured"
    );
}

#[test]
fn candidates_have_a_source_and_an_age() {
    let [unit, station, idle] = ["unit", "r~a", "q"].map(|name| NodeId::new(name).unwrap());
    let testbed = testbed();
    let mut bed = air();
    bed.probed(35.0);
    bed.learn(0.0, 30.0);
    let heard = |robot: &NodeId, attached| {
        let attachments = vec![base::attachment("unit", attached, Some(-50.0))];
        let context = base::robot_context(robot.as_str(), base::pose(0.0, 0.0, 0.0));
        RobotContext { robot: robot.clone(), attachments, ..context }
    };
    let stations = [(&station, &unit)];
    let uplink = |now, robot, attached| {
        let all = bed.links.candidates(seconds(now), &testbed.graph, &heard(robot, attached), &stations);
        (all[0].uplink.delay, all[0].uplink.source, all[0].uplink.age)
    };
    use cotorra_graph::FigureSource::{Configured, Estimated, Probed};
    // The last context is of 29.9 s, and its probe is 0.1 s older.
    assert_eq!(uplink(30.0, &station, true), (ms(35.0), Probed, ms(200.0)));
    assert_eq!(uplink(31.0, &idle, false), (ms(35.0), Estimated, ms(1200.0)));
    assert_eq!(uplink(60.0, &idle, false), (ms(5.0), Configured, Duration::ZERO), "that is too old");
}
