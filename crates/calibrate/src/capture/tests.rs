use cotorra_numbers::Draws;

use super::{
    testing::{Frame, Tcp, big_endian_pcap, block, pcap, pcap_cut, pcapng, udp},
    *,
};
use crate::{
    Calibration, Estimate, LinkCalibration, LinkMeasurement, Means, Measurements, OneWay, Options,
    calibrated_text, markdown,
};

const MS: i64 = 1_000_000;
const SECOND: i64 = 1000 * MS;

fn times(bytes: &[u8]) -> Vec<(i64, usize)> {
    read(bytes).unwrap().iter().map(|packet| (packet.at_ns, packet.frame_bytes)).collect()
}

#[test]
fn all_formats_give_the_same_packets() {
    let start = 1_700_000_000 * SECOND;
    let frames: Vec<Frame> = (0..3).map(|i| (start + i64::from(i) * MS, udp([1, 2], i, 100))).collect();
    let expected: Vec<_> = frames.iter().map(|(at, frame)| (*at, frame.len())).collect();
    assert_eq!(times(&pcap(&frames)), expected);
    assert_eq!(times(&big_endian_pcap(&frames)), expected);
    let scaled = |divisor: i64| -> Vec<_> {
        frames.iter().map(|(at, frame)| ((at / divisor) as u64, frame.clone())).collect()
    };
    // Microseconds without an option, nanoseconds by one, and milliseconds counted from an offset.
    assert_eq!(times(&pcapng(&[], &scaled(1000))), expected);
    assert_eq!(times(&pcapng(&[9, 0, 1, 0, 9, 0, 0, 0, 0, 0, 0, 0], &scaled(1))), expected);
    let offset =
        [&[9, 0, 1, 0, 3, 0, 0, 0, 14, 0, 8, 0][..], &1_700_000_000_i64.to_le_bytes(), &[0; 4]].concat();
    let from_offset: Vec<_> = (0..3).map(|i| (u64::from(i), udp([1, 2], i, 100))).collect();
    assert_eq!(times(&pcapng(&offset, &from_offset)), expected);
    // A unit of 2⁻¹⁰ s.
    let binary = pcapng(&[9, 0, 1, 0, 0x8a, 0, 0, 0], &[(512, udp([1, 2], 0, 100))]);
    assert_eq!(times(&binary), [(SECOND / 2, 142)]);
}

#[test]
fn a_capture_that_was_cut_off_keeps_its_whole_packets() {
    let frames: Vec<Frame> = (0..3).map(|i| (i64::from(i), udp([1, 2], i, 100))).collect();
    let ng = pcapng(&[9, 0, 1, 0, 9, 0, 0, 0], &[(0, udp([1, 2], 0, 100)), (1, udp([1, 2], 1, 100))]);
    assert_eq!(times(&pcap(&frames)[..pcap(&frames).len() - 1]).len(), 2);
    assert_eq!(times(&ng[..ng.len() - 1]).len(), 1);
    // Cut packets count with their whole size.
    assert_eq!(times(&pcap_cut(&frames, 60)), [(0, 142), (1, 142), (2, 142)]);
}

#[test]
fn what_is_no_capture_is_refused() {
    let ng = pcapng(&[], &[]);
    let section_only = &ng[..28];
    for (bytes, expected) in [
        (b"".to_vec(), "it is no capture: give a file of `tcpdump -w`, i.e. pcap or pcapng"),
        (
            b"64 bytes from 10.0.0.2".to_vec(),
            "it is no capture: give a file of `tcpdump -w`, i.e. pcap or pcapng",
        ),
        (pcap(&[])[..20].to_vec(), "the header of the capture is cut off"),
        (pcap(&[]), "none of its 0 packets is an IP packet over Ethernet or Linux's `any` interface"),
        (
            pcap(&[(0, vec![0; 60])]),
            "none of its 1 packets is an IP packet over Ethernet or Linux's `any` interface",
        ),
        ([section_only, &[6, 0, 0, 0, 5, 0, 0, 0]].concat(), "the capture is damaged at byte 28"),
        ([section_only, &block(6, &[0; 20])].concat(), "the capture is damaged at byte 28"),
        (block(0x0a0d_0d0a, &[0; 16]), "the capture is damaged at byte 0"),
    ] {
        assert_eq!(read(&bytes).unwrap_err().to_string(), expected);
    }
}

fn round_trips(frames: &[Frame]) -> Vec<f64> {
    round_trips_of_capture(&pcap(frames)).unwrap().times_ms.into_iter().flatten().collect()
}

/// Data from host 1, and an acknowledgement by host 2.
fn data(sequence: u32, payload: usize, stamps: Option<[u32; 2]>) -> Vec<u8> {
    Tcp { hosts: [1, 2], sequence, payload, stamps, ..Tcp::default() }.frame()
}

fn acknowledgement(acknowledged: u32, stamps: Option<[u32; 2]>) -> Vec<u8> {
    Tcp { hosts: [2, 1], acknowledged, stamps, ..Tcp::default() }.frame()
}

#[test]
fn an_acknowledgement_ends_the_round_trip_of_the_last_segment_that_it_covers() {
    // The second acknowledgement covers two segments; sequence numbers begin again at 0.
    let begin = u32::MAX - 150;
    let frames = [
        (0, data(begin, 100, None)),
        (20 * MS, acknowledgement(begin.wrapping_add(100), None)),
        (30 * MS, data(begin.wrapping_add(100), 100, None)),
        (35 * MS, data(begin.wrapping_add(200), 100, None)),
        (56 * MS, acknowledgement(begin.wrapping_add(300), None)),
        (57 * MS, acknowledgement(begin.wrapping_add(300), None)),
    ];
    assert_eq!(round_trips(&frames), [20.0, 21.0]);
}

#[test]
fn segments_that_were_sent_again_count_only_if_timestamps_tell_them_apart() {
    let frames = |stamps: [Option<[u32; 2]>; 5]| {
        [
            (0, data(0, 100, stamps[0])),
            (10 * MS, data(100, 100, stamps[1])),
            (300 * MS, data(0, 100, stamps[2])),
            (320 * MS, acknowledgement(200, stamps[3])),
            (330 * MS, data(200, 100, stamps[4])),
            (355 * MS, acknowledgement(300, stamps[4])),
        ]
    };
    assert_eq!(round_trips(&frames([None; 5])), [25.0]);
    let stamps = [1, 11, 301, 0, 331].map(|stamp| Some([stamp, 0]));
    let echo = |echo| frames([stamps[0], stamps[1], stamps[2], Some([9, echo]), stamps[4]]);
    assert_eq!(round_trips(&echo(301)), [20.0, 25.0]);
    assert_eq!(round_trips(&echo(1)), [320.0, 25.0]);
    assert_eq!(round_trips(&echo(77)), [25.0]);
}

#[test]
fn round_trips_are_those_to_the_far_side() {
    // Host 2 is far: its answer to the handshake takes 20 ms, and is acknowledged at once.
    let syn = Tcp { hosts: [1, 2], sequence: 0, syn: true, ..Tcp::default() };
    let frames = |between: i64| {
        [
            (0, syn.frame()),
            (20 * MS, Tcp { hosts: [2, 1], acknowledged: 1, ..syn }.frame()),
            (
                20 * MS + between,
                Tcp { hosts: [1, 2], sequence: 1, acknowledged: 1, ..Tcp::default() }.frame(),
            ),
            (
                30 * MS,
                Tcp { hosts: [1, 2], sequence: 1, acknowledged: 1, payload: 50, ..Tcp::default() }.frame(),
            ),
            (52 * MS, Tcp { hosts: [2, 1], sequence: 1, acknowledged: 51, ..Tcp::default() }.frame()),
        ]
    };
    assert_eq!(round_trips(&frames(20_000)), [20.0, 22.0]);
    let notes = |between| round_trips_of_capture(&pcap(&frames(between))).unwrap().notes.join("\n");
    assert!(!notes(20_000).contains("between both hosts"));
    assert!(notes(5 * MS).contains("the other side is 5.000 ms away"), "{}", notes(5 * MS));
    assert!(notes(20_000).contains("may have delayed them"));
}

#[test]
fn captures_without_round_trips_or_with_offloads_are_refused() {
    let refusal = |frames: &[Frame]| round_trips_of_capture(&pcap(frames)).unwrap_err().to_string();
    assert_eq!(
        refusal(&[(0, udp([1, 2], 0, 100))]),
        "the capture has no TCP data with acknowledgements: for other flows, capture at both ends"
    );
    assert!(refusal(&[(0, data(0, 20_000, None))]).contains("switch offloads off"));
}

/// Truth of one direction.
#[derive(Clone, Copy)]
struct Truth {
    delay_ms: f64,
    jitter_ms: f64,
    lost_every: u32,
}

const FORWARD: Truth = Truth { delay_ms: 12.0, jitter_ms: 3.0, lost_every: 20 };
const BACKWARD: Truth = Truth { delay_ms: 10.5, jitter_ms: 0.5, lost_every: 50 };
/// The clock at the second end: an hour behind, and 40 ppm faster.
fn second_clock(at_ns: i64) -> i64 {
    at_ns - 3600 * SECOND + (at_ns as f64 * 40e-6) as i64
}

/// Returns the captures at both ends of packets with uniform jitter, 10 ms apart.
fn both_ends(ways: &[([u8; 2], Truth)], packets: u32) -> [Vec<Frame>; 2] {
    let start = 5000 * SECOND;
    let mut draws = Draws::new(3, "captures");
    let mut ends = [Vec::new(), Vec::new()];
    for &(hosts, truth) in ways {
        for number in 0..packets {
            let sent = start + i64::from(number) * 10 * MS;
            let ms = truth.delay_ms + truth.jitter_ms * (2.0 * draws.unit() - 1.0);
            let arrived = sent + (ms * 1e6) as i64;
            let mut frame = udp(hosts, number, 100);
            let (near, far) = if hosts[0] < hosts[1] { (sent, arrived) } else { (arrived, sent) };
            let is_lost = number % truth.lost_every == truth.lost_every / 2;
            if hosts[0] < hosts[1] || !is_lost {
                ends[0].push((near, frame.clone()));
            }
            // A router counts hops, and a network card completes checksums.
            frame[22] -= 1;
            frame[40] = 0xaa;
            if hosts[0] > hosts[1] || !is_lost {
                ends[1].push((second_clock(far), frame));
            }
        }
    }
    ends.each_mut().map(|end| {
        end.sort_by_key(|(at, _)| *at);
        std::mem::take(end)
    })
}

fn one_way([first, second]: &[Vec<Frame>; 2]) -> OneWay {
    one_way_of_captures(&pcap(first), &pcap(second)).unwrap()
}

fn holds(estimate: Estimate, truth: f64) {
    assert!(estimate.covers(truth), "{estimate:.4} {truth}");
}

const TESTBED: &str = "name: lab
nodes:
  a: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  b: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links: [{ ends: [a, b], delay: 7 ms }]
";

fn calibrate(measured: OneWay) -> Calibration {
    let testbed = cotorra_testbed_file::parse("lab", TESTBED, std::path::Path::new(""))
        .unwrap_or_else(|e| panic!("{e}"));
    let links = [("a-b".to_owned(), LinkMeasurement::OneWay(measured))].into();
    Calibration::new(&testbed, &Measurements { links, ..Measurements::default() }, Options::default())
        .unwrap()
}

#[test]
fn captures_at_both_ends_tell_directions_apart_whatever_the_clocks_say() {
    let ends = both_ends(&[([1, 2], FORWARD), ([2, 1], BACKWARD)], 1500);
    let measured = one_way(&ends);
    assert_eq!(measured.means, Means::Halves);
    let lost = measured
        .ways
        .each_ref()
        .map(|way| way.as_ref().unwrap().times_ms.iter().filter(|t| t.is_none()).count());
    assert_eq!(lost, [75, 30]);
    let calibration = calibrate(measured);
    let LinkCalibration::OneWay { forward: Some(forward), backward: Some(backward), .. } =
        &calibration.links["a-b"]
    else {
        panic!()
    };
    for (path, truth) in [(forward, FORWARD), (backward, BACKWARD)] {
        holds(path.fit.deviation_ms, truth.jitter_ms);
        holds(path.fit.loss.unwrap().share, 1.0 / f64::from(truth.lost_every));
    }
    // The shortest times are 9 and 10 ms, of which each direction gets half.
    holds(forward.fit.mean_ms, 9.5 + 3.0);
    holds(backward.fit.mean_ms, 9.5 + 0.5);
    let sum = forward.fit.mean_ms.value + backward.fit.mean_ms.value;
    assert!((sum - FORWARD.delay_ms - BACKWARD.delay_ms).abs() < 0.2, "{sum}");

    let text = calibrated_text(TESTBED, &calibration.settings);
    let fitted =
        cotorra_testbed_file::parse("lab", &text, std::path::Path::new("")).unwrap_or_else(|e| panic!("{e}"));
    let link = &fitted.graph.links[0];
    assert!((link.backward.jitter.unwrap().deviation.as_secs_f64() * 1e3 - 0.5).abs() < 0.05);
    assert!((link.forward.jitter.unwrap().deviation.as_secs_f64() * 1e3 - 3.0).abs() < 0.2);
    let report = markdown(&calibration);
    assert!(report.contains("## Link a-b, forward") && report.contains("## Link a-b, backward"), "{report}");
}

#[test]
fn the_other_order_of_captures_swaps_the_directions() {
    let [first, second] = both_ends(&[([1, 2], FORWARD), ([2, 1], BACKWARD)], 600);
    let there = one_way(&[first.clone(), second.clone()]).ways.map(|way| way.unwrap().times_ms.len());
    let back = one_way(&[second, first]).ways.map(|way| way.unwrap().times_ms.len());
    assert_eq!([there[1], there[0]], back);
}

#[test]
fn packets_in_one_direction_leave_the_delay_as_it_is() {
    let [first, second] = both_ends(&[([1, 2], FORWARD)], 1000);
    let on_time = |(at, frame): &Frame| (at + 3600 * SECOND, frame.clone());
    let measured = one_way(&[first, second.iter().map(on_time).collect()]);
    assert_eq!(measured.means, Means::Unknown);
    let calibration = calibrate(measured);
    let paths: Vec<_> = calibration.settings.iter().map(|setting| setting.path.as_str()).collect();
    assert_eq!(
        paths,
        ["links.a-b.forward.jitter", "links.a-b.forward.loss", "links.a-b.forward.duplication"]
    );
    let LinkCalibration::OneWay { forward: Some(forward), .. } = &calibration.links["a-b"] else { panic!() };
    holds(forward.fit.deviation_ms, FORWARD.jitter_ms);
    assert!(markdown(&calibration).contains("no setting"), "{}", markdown(&calibration));
}

#[test]
fn duplicates_and_overtaken_packets_are_counted() {
    let [first, mut second] = both_ends(&[([1, 2], FORWARD), ([2, 1], BACKWARD)], 600);
    let again = second.iter().find(|(_, frame)| frame[29] == 1).unwrap().clone();
    second.push((again.0 + 3 * SECOND, again.1));
    second.sort_by_key(|(at, _)| *at);
    let measured = one_way(&[first, second]);
    let [forward, backward] = measured.ways.map(Option::unwrap);
    assert_eq!((forward.duplicated.len(), backward.duplicated.len()), (1, 0));
    assert_eq!(forward.late, 0);
}

#[test]
fn captures_that_do_not_fit_together_are_refused() {
    let refusal = |first: &[u8], second: &[u8]| one_way_of_captures(first, second).unwrap_err().to_string();
    let [first, second] = both_ends(&[([1, 2], FORWARD), ([2, 1], BACKWARD)], 600);
    let other: Vec<Frame> = (0..500).map(|i| (i64::from(i) * MS, udp([1, 2], 1_000_000 + i, 100))).collect();
    assert!(refusal(&pcap(&first), &pcap(&other)).starts_with("no host sent another one 200 packets"));
    assert!(refusal(&pcap_cut(&first, 50), &pcap(&second)).starts_with("the captures have only 36 bytes"));
    let fewer: Vec<Frame> =
        first.iter().enumerate().filter(|(i, _)| i % 10 != 0).map(|(_, f)| f.clone()).collect();
    assert!(refusal(&pcap(&fewer), &pcap(&second)).contains("are not in the sender's capture"));
    let equal = |frames: &[Frame]| -> Vec<Frame> {
        let mut numbered = frames.iter().cloned().enumerate();
        numbered.by_ref().map(|(i, (at, _))| (at, udp([1, 2], (i / 4) as u32, 100))).collect()
    };
    assert!(refusal(&pcap(&equal(&first)), &pcap(&equal(&first))).contains("are equal to another one"));
}
