//! Calibrations of a testbed from texts, as the command does them.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{collections::BTreeMap, path::Path, time::Duration};

use cotorra_calibrate::{
    Calibration, ChannelSurvey, HandoverTime, LinkMeasurement, Measurements, Options, calibrated_text,
    markdown, parse_channel_survey, parse_round_trips, parse_survey,
};
use cotorra_graph::{InterfererKind, Jitter, JitterDistribution, Loss, PathLoss, Position, Rate, Testbed};
use cotorra_numbers::Draws;

/// A testbed whose values are all to be fitted. Its last line notes a setting.
const TESTBED: &str = "# A laboratory.
name: lab
wireless:
  lab: { standard: n }   # to be fitted
nodes:
  robot: { kind: robot, position: [1, 0], tx_power: 14 dBm }
  R: { kind: radio_unit, position: [0, 0], channel: 1, tx_power: 20 dBm }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [R, edge], delay: 5 ms, rate: 1 Mbit/s }
# set: links.R-edge.queue=50 packets
";

fn parse(text: &str) -> Testbed {
    cotorra_testbed_file::parse("lab", text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
}

/// A survey by the testbed's path loss, with an exponent of 2.2, 4 dB of reference loss, and noise.
fn survey() -> String {
    let mut draws = Draws::new(1, "survey");
    let mut row = |i: u32| {
        let (x, y) = (1.0 + f64::from(i % 20), 2.0 * f64::from(i / 20));
        let loss = PathLoss::LogDistance { exponent: 2.2 }
            .loss_db(Position::new(x, y).distance(Position::default()), 2412);
        format!("{i},{x},{y},R,{:.1}\n", 20.0 - 4.0 - loss + draws.normal())
    };
    "time_s,x,y,radio_unit,signal_dbm\n".to_owned() + &(0..120).map(&mut row).collect::<String>()
}

/// Output of `ping`: uniform jitter of ± 3 ms around 20 ms, and each 40th packet lost with the next two.
fn ping() -> String {
    let mut draws = Draws::new(2, "ping");
    let arrives = |i: &u32| i % 40 > 2;
    let mut line = |i: u32| {
        let ms = 17.0 + 6.0 * draws.unit();
        format!("[{}.5] 64 bytes from 10.0.0.2: icmp_seq={i} ttl=64 time={ms:.2} ms\n", 1_700_000_000 + i)
    };
    (1..=1200).filter(arrives).map(&mut line).collect()
}

fn measurements() -> Measurements {
    let trips = parse_round_trips(&ping()).unwrap();
    Measurements {
        survey: parse_survey(&survey()).unwrap(),
        links: BTreeMap::from([("R-edge".to_owned(), LinkMeasurement::RoundTrips(trips))]),
        ..Measurements::default()
    }
}

fn options() -> Options {
    Options { target: Some(Duration::from_millis(22)), ..Options::default() }
}

#[test]
fn the_calibrated_file_has_the_fitted_values_and_keeps_everything_else() {
    let calibration = Calibration::new(&parse(TESTBED), &measurements(), options()).unwrap();
    let text = calibrated_text(TESTBED, &calibration.settings);
    let (kept, _) = TESTBED.split_once("# set:").unwrap();
    assert!(text.starts_with(kept), "{text}");
    let testbed = parse(&text);
    let network = &testbed.graph.wireless["lab"];
    let PathLoss::LogDistance { exponent } = network.path_loss else { panic!("{:?}", network.path_loss) };
    assert!((exponent - 2.2).abs() < 0.3, "{exponent}");
    // The reference loss is off the power of both ends.
    let (_, unit) = testbed.graph.radio_units().next().unwrap();
    let (_, robot) = testbed.graph.robots().next().unwrap();
    assert!((unit.tx_power.0 - 16.0).abs() < 2.5, "{:?}", unit.tx_power);
    assert!((unit.tx_power.0 - robot.tx_power.0 - 6.0).abs() < 0.02);
    let link = &testbed.graph.links[0];
    let jitter = link.forward.jitter.unwrap();
    assert_eq!(jitter.distribution, JitterDistribution::Uniform);
    assert!((jitter.deviation.as_secs_f64() * 1e3 - 3.0).abs() < 0.1, "{jitter:?}");
    let Loss::Bursty { rate, mean_burst } = link.forward.loss else { panic!("{:?}", link.forward.loss) };
    assert!(
        (rate.get() - 52.0 / 718.0).abs() < 1e-4 && (mean_burst - 3.0).abs() < 0.05,
        "{rate:?} {mean_burst}"
    );
    // Both ways together, with 98 bytes sent at 1 Mbit/s, are the mean round trip.
    let delays = (link.forward.delay + link.backward.delay).as_secs_f64() * 1e3;
    assert!((delays + 2.0 * 0.784 - 20.0).abs() < 0.3, "{delays}");
    assert!(
        matches!(link.forward.rate, Rate::Fixed { bits_per_second } if bits_per_second.bits_per_second() == 1_000_000)
    );
    assert_eq!(link.forward.queue, cotorra_graph::QueueLimit::Packets(50), "the setting of the text holds");
    assert_eq!(link.backward.jitter.map(|jitter| jitter.deviation), Some(Duration::ZERO));
}

#[test]
fn the_calibrated_file_has_the_correlation_of_round_trips() {
    let mut draws = Draws::new(3, "correlated");
    let mut score = draws.normal();
    let mut row = |i: u32| {
        score = 0.6 * score + 0.8 * draws.normal();
        format!("{i},{}\n", 20.0 + score)
    };
    let rows = "seq,rtt_ms\n".to_owned() + &(0..2000).map(&mut row).collect::<String>();
    let trips = LinkMeasurement::RoundTrips(parse_round_trips(&rows).unwrap());
    let links = BTreeMap::from([("R-edge".to_owned(), trips)]);
    let measurements = Measurements { links, ..Measurements::default() };
    let calibration = Calibration::new(&parse(TESTBED), &measurements, options()).unwrap();
    let testbed = parse(&calibrated_text(TESTBED, &calibration.settings));
    let correlation = |jitter: Option<Jitter>| jitter.unwrap().correlation.get();
    let link = &testbed.graph.links[0];
    assert!((correlation(link.forward.jitter) - 0.6).abs() < 0.06, "{:?}", link.forward.jitter);
    assert_eq!(correlation(link.backward.jitter), 0.0);
    assert!(markdown(&calibration).contains("has it from packet to packet at any rate"));
}

#[test]
fn a_calibration_is_the_same_each_time() {
    let calibrate = |seed| {
        let options = Options { seed, ..options() };
        let calibration = Calibration::new(&parse(TESTBED), &measurements(), options).unwrap();
        (markdown(&calibration), serde_json::to_string(&calibration).unwrap())
    };
    assert_eq!(calibrate(1), calibrate(1));
    assert_ne!(calibrate(1).0, calibrate(2).0);
}

#[test]
fn the_report_matches_the_golden_file() {
    let calibration = Calibration::new(&parse(TESTBED), &measurements(), options()).unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/report.golden.md");
    let report = markdown(&calibration);
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(&golden, &report).unwrap();
    }
    assert_eq!(report, std::fs::read_to_string(golden).unwrap());
}

#[test]
fn what_does_not_fit_the_testbed_is_refused() {
    let refusal = |text: &str, link: &str, trips: &str| {
        let trips = LinkMeasurement::RoundTrips(parse_round_trips(trips).unwrap());
        let links = BTreeMap::from([(link.to_owned(), trips)]);
        let measurements = Measurements { links, ..Measurements::default() };
        Calibration::new(&parse(text), &measurements, options()).unwrap_err().to_string()
    };
    assert_eq!(
        refusal(TESTBED, "lan-edge", &ping()),
        "the testbed has no wired link `lan-edge`; its links are: R-edge"
    );
    let scaled = TESTBED.replace("delay: 5 ms", "delay_scale: 2");
    assert!(refusal(&scaled, "R-edge", &ping()).starts_with("link `R-edge` has scales"));
    let slow = TESTBED.replace("1 Mbit/s", "10 kbit/s");
    let refused = refusal(&slow, "R-edge", &ping());
    let expected = "link `R-edge`: at the rates of the testbed, sending a frame takes 156.800 ms, but the shortest round trip is ";
    assert!(refused.starts_with(expected), "{refused}");
    let few: String = ping().lines().take(150).map(|line| line.to_owned() + "\n").collect();
    assert_eq!(
        refusal(TESTBED, "R-edge", &few),
        "link `R-edge`: 91 of 97 packets arrived in the part to fit: it needs 100 or more"
    );
    let lost = "seq,rtt_ms\n".to_owned() + &(0..300).map(|i| format!("{i},\n")).collect::<String>();
    assert_eq!(
        refusal(TESTBED, "R-edge", &lost),
        "link `R-edge`: all 180 packets of the part to fit were lost"
    );
    let surveyed = |rows: usize| {
        let rows: Vec<String> = survey().lines().take(rows + 1).map(|line| line.to_owned() + "\n").collect();
        let survey = parse_survey(&rows.concat()).unwrap();
        Calibration::new(&parse(TESTBED), &Measurements { survey, ..Measurements::default() }, options())
    };
    assert_eq!(
        surveyed(40).unwrap_err().to_string(),
        "in the first 60 % of the survey, network `lab` has 24 readings: a fit needs 30 or more"
    );
    assert_eq!(surveyed(50).unwrap().networks["lab"].comparison.test_readings, 20);
    let nothing = Calibration::new(&parse(TESTBED), &Measurements::default(), options());
    assert_eq!(nothing.unwrap_err().to_string(), "there are no measurements to fit");
}

/// Handovers whose phases vary by 30 %: scans of 200 ms, fast transitions of 10 and 40 ms, and handshakes of 50 ms.
fn handovers(number: usize, fast: impl Fn(usize) -> bool) -> Vec<HandoverTime> {
    let mut draws = Draws::new(5, "handovers");
    let mut phase = |ms: f64| ms * (0.7 + 0.6 * draws.unit());
    let mut handover = |i| {
        let join_ms = phase(10.0) + phase(40.0) + if fast(i) { 0.0 } else { phase(50.0) };
        let scan_ms = i.is_multiple_of(2).then(|| phase(200.0));
        HandoverTime { radio_unit: "R".to_owned(), fast: fast(i), scan_ms, join_ms }
    };
    (0..number).map(&mut handover).collect()
}

fn calibrate_handovers(text: &str, handovers: Vec<HandoverTime>) -> Result<Calibration, String> {
    let measurements = Measurements { handovers, ..Measurements::default() };
    Calibration::new(&parse(text), &measurements, options()).map_err(|error| error.to_string())
}

#[test]
fn handovers_give_their_phases() {
    let text = TESTBED.replace("standard: n", "handover: { authenticate: 15 ms, reassociate: 60 ms }");
    let calibration = calibrate_handovers(&text, handovers(80, |i| i % 4 != 3)).unwrap();
    let fit = &calibration.handovers["lab"];
    for (estimate, truth) in [(fit.scan_ms, 200.0), (fit.fast_ms, 50.0), (fit.full_ms, 100.0)] {
        let estimate = estimate.unwrap();
        assert!(estimate.covers(truth), "{estimate} {truth}");
    }
    assert!(fit.variation.covers(0.3) && fit.variation.high < 0.4, "{fit:?}");
    let times = parse(&calibrated_text(&text, &calibration.settings)).graph.wireless["lab"].handover;
    let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
    // The share of authentication cannot be seen, and stays.
    assert!((ms(times.reassociate) / ms(times.authenticate) - 4.0).abs() < 0.01, "{times:?}");
    assert!((ms(times.authenticate + times.reassociate) - 50.0).abs() < 4.0, "{times:?}");
    assert!((ms(times.handshake) - 50.0).abs() < 10.0 && (ms(times.scan) - 200.0).abs() < 10.0, "{times:?}");
    assert!((times.variation - fit.variation.value).abs() < 1e-4);
    assert!(markdown(&calibration).contains("## Handovers of network lab\n\n80 handovers."));
}

#[test]
fn handovers_of_one_kind_leave_the_other_phases_in_proportion() {
    let calibration = calibrate_handovers(TESTBED, handovers(40, |_| false)).unwrap();
    let before = parse(TESTBED).graph.wireless["lab"].handover;
    let after = parse(&calibrated_text(TESTBED, &calibration.settings)).graph.wireless["lab"].handover;
    let ratio = |times: cotorra_graph::HandoverTimes| {
        times.handshake.as_secs_f64() / times.authenticate.as_secs_f64()
    };
    assert!((ratio(before) - ratio(after)).abs() < 0.01, "{after:?}");
    assert_eq!(calibration.handovers["lab"].fast_ms, None);
}

#[test]
fn fewer_than_ten_handovers_are_refused() {
    let refused = calibrate_handovers(TESTBED, handovers(9, |_| true)).unwrap_err();
    assert!(refused.starts_with("network `lab` has 9 handovers: a fit needs 10 or more"), "{refused}");
    let mut elsewhere = handovers(20, |_| true);
    elsewhere[3].radio_unit = "R9".to_owned();
    let refused = calibrate_handovers(TESTBED, elsewhere).unwrap_err();
    assert_eq!(refused, "the testbed has no radio unit `R9`; its radio units are: R");
    // A few of another kind are left out, and a note says so.
    let calibration = calibrate_handovers(TESTBED, handovers(23, |i| i > 2)).unwrap();
    let fit = &calibration.handovers["lab"];
    assert_eq!(fit.full_ms, None);
    assert_eq!(fit.notes, ["3 handovers with key handshakes are too few to fit: it takes 10"]);
}

#[test]
fn scans_by_visits_are_not_fitted() {
    let text = TESTBED.replace(
        "standard: n",
        "handover: { scan: { channels: 13, dwell: 60 ms, away: 125 ms, back: 200 ms } }",
    );
    let calibration = calibrate_handovers(&text, handovers(40, |_| true)).unwrap();
    assert_eq!(calibration.handovers["lab"].scan_ms, None);
    assert!(!calibration.settings.iter().any(|setting| setting.path.ends_with("scan")));
}

/// Counters of channel 1, each second: others take 30 % of it for half a minute, and 4 % for another one. Its own frames take
/// 10 %.
fn channels(seconds: u32) -> ChannelSurvey {
    let mut draws = Draws::new(6, "channels");
    let (mut busy, mut text) = (0.0, "channel,active_ms,busy_ms,tx_ms,own_rx_ms\n".to_owned());
    for second in 0..seconds {
        text += &format!("1,{},{busy:.0},{},0\n", second * 1000, second * 100);
        let others = if (second / 30) % 2 == 0 { 300.0 } else { 40.0 };
        busy += 100.0 + others + 10.0 * draws.normal();
    }
    parse_channel_survey(&text).unwrap()
}

fn calibrate_channels(text: &str, names: &[&str], seconds: u32) -> Result<Calibration, String> {
    let channels = names.iter().map(|name| ((*name).to_owned(), channels(seconds))).collect();
    let measurements = Measurements { channels, ..Measurements::default() };
    Calibration::new(&parse(text), &measurements, options()).map_err(|error| error.to_string())
}

#[test]
fn a_channel_survey_gives_interference_that_comes_and_goes() {
    let calibration = calibrate_channels(TESTBED, &["R"], 1500).unwrap();
    let fit = &calibration.interference["R"];
    let presence = fit.presence.unwrap();
    assert!(
        (fit.load.value - 0.3).abs() < 0.01 && (presence.background.value - 0.04).abs() < 0.01,
        "{fit:?}"
    );
    assert!(presence.on_s.covers(30.0) && presence.off_s.covers(30.0), "{fit:?}");
    let network = &parse(&calibrated_text(TESTBED, &calibration.settings)).graph.wireless["lab"];
    assert!(network.access.contends());
    let [always, at_times] = network.access.interference() else { panic!("{network:?}") };
    assert_eq!((always.name.as_str(), at_times.name.as_str()), ("around-R", "at-times-around-R"));
    assert_eq!((always.channel, always.presence), (1, None));
    let InterfererKind::Network { load, .. } = at_times.kind else { panic!("{at_times:?}") };
    assert!((load.get() - 0.26).abs() < 0.01);
    let on = at_times.presence.unwrap().on.as_secs_f64();
    assert!((on - presence.on_s.value).abs() < 0.001);
    assert!(
        markdown(&calibration)
            .contains("## Interference on channel 1 of network lab\n\nMeasured by R: 1499 differences")
    );
}

#[test]
fn channel_surveys_that_do_not_fit_are_refused() {
    let refusal = |text: &str, names: &[&str], seconds| calibrate_channels(text, names, seconds).unwrap_err();
    let few = "radio unit `R` has 59 differences of counters: a fit needs 60 or more";
    assert_eq!(refusal(TESTBED, &["R"], 60), few);
    assert!(refusal(TESTBED, &["Q"], 100).starts_with("the testbed has no radio unit `Q`"));
    let elsewhere = TESTBED.replace("channel: 1", "channel: 6");
    let expected = "radio unit `R` is on channel 6, but its channel survey has channel 1";
    assert_eq!(refusal(&elsewhere, &["R"], 100), expected);
    let second = "  S: { kind: radio_unit, position: [9, 0], channel: 1, network: lab }\n  edge:";
    let two = TESTBED
        .replace("  edge:", second)
        .replace("[R, edge]", "[edge, [R, S]]")
        .replace("# set: links.R-edge.queue=50 packets\n", "");
    assert!(refusal(&two, &["R", "S"], 100).starts_with("radio units `R` and `S` are both on channel 1"));
    let shared = two
        .replace("network: lab }", "network: hall }")
        .replace("}   # to be fitted", ", access: turns }\n  hall: { access: turns }")
        .replace("channel: 1, tx", "channel: 1, network: lab, tx")
        .replace("kind: robot,", "kind: robot, network: lab,");
    assert!(refusal(&shared, &["R"], 100).contains("its network `lab` shares a channel with `hall`"));
}

/// A walk away from R with a reading each 0.2 m, by the testbed's path loss, 4 dB of reference loss, and fading in dB.
fn walk(readings: u32, mut fading: impl FnMut(&mut Draws) -> f64) -> Result<Calibration, String> {
    let mut draws = Draws::new(8, "walk");
    let mut row = |i: u32| {
        let distance = 1.0 + 0.2 * f64::from(i);
        let loss = PathLoss::LogDistance { exponent: 2.2 }.loss_db(distance, 2412);
        format!("{i},{distance},0,R,{:.0}\n", 20.0 - 4.0 - loss + fading(&mut draws))
    };
    let rows: String = (0..readings).map(&mut row).collect();
    let survey = parse_survey(&("time_s,x,y,radio_unit,signal_dbm\n".to_owned() + &rows)).unwrap();
    let text = TESTBED.replace("standard: n", "fading: { motion: 0.3 m/s }");
    let options = Options { fading: true, ..options() };
    Calibration::new(&parse(&text), &Measurements { survey, ..Measurements::default() }, options)
        .map_err(|error| error.to_string())
}

/// Rician fading with a line of sight of this power, in dB.
fn rice(k_factor_db: f64, draws: &mut Draws) -> f64 {
    let k = 10f64.powf(k_factor_db / 10.0);
    let [a, b] = [0; 2].map(|_| draws.normal() / 2f64.sqrt());
    10.0 * (((k.sqrt() + a).powi(2) + b * b) / (1.0 + k)).log10()
}

#[test]
fn single_frames_give_the_k_factor_and_the_mean_power() {
    let calibration = walk(500, |draws| rice(6.0, draws)).unwrap();
    let network = &calibration.networks["lab"];
    assert!(network.fading.as_ref().unwrap().k_factor_db.covers(6.0), "{network:?}");
    let testbed = parse(&calibrated_text(TESTBED, &calibration.settings));
    let fading = testbed.graph.wireless["lab"].fading.unwrap();
    assert!((fading.k_factor_db.unwrap() - 6.0).abs() < 2.0 && fading.motion_mps == 0.3, "{fading:?}");
    // The mean of the signals in dB is 1 dB below their mean power.
    let (_, unit) = testbed.graph.radio_units().next().unwrap();
    let power = 20.0 - network.fit.reference_loss_db.value - network.fading.as_ref().unwrap().mean_db;
    assert!(
        (unit.tx_power.0 - power).abs() < 0.01
            && (network.fading.as_ref().unwrap().mean_db + 1.0).abs() < 0.4
    );
}

#[test]
fn no_line_of_sight_is_rayleigh_fading() {
    let calibration = walk(500, |draws| 1.05 * rice(-40.0, draws)).unwrap();
    let setting = calibration.settings.iter().find(|setting| setting.path.ends_with("fading")).unwrap();
    assert_eq!(setting.value, "{ motion: 0.3 m/s }");
}

#[test]
fn signals_that_do_not_tell_fading_are_refused() {
    let few = walk(120, |draws| rice(6.0, draws)).unwrap_err();
    assert!(few.contains("`lab` has 71 pairs of readings of one radio unit, one after another,"), "{few}");
    let averaged = walk(500, |_| 0.0).unwrap_err();
    assert!(averaged.contains("too little to tell fading from none: averaged signals hide it"), "{averaged}");
    let wild = walk(500, |draws| 9.0 * draws.normal()).unwrap_err();
    assert!(wild.contains("but Rayleigh fading by 5.57 dB only"), "{wild}");
}
