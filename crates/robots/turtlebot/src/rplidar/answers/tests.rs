use proptest::{collection::vec, prelude::*, sample::Index};

use super::*;
use crate::rplidar::capsule::SIZE;

fn answers(bytes: &[u8]) -> Vec<Answer> {
    let (mut answers, mut found) = (Answers::default(), Vec::new());
    answers.feed(bytes, |answer| found.push(answer));
    found
}

/// Descriptors of LR001.
const INFO: [u8; 7] = [0xA5, 0x5A, 0x14, 0, 0, 0, 0x04];
const HEALTH: [u8; 7] = [0xA5, 0x5A, 0x03, 0, 0, 0, 0x06];
const RATE: [u8; 7] = [0xA5, 0x5A, 0x04, 0, 0, 0, 0x15];
const NODES: [u8; 7] = [0xA5, 0x5A, 0x05, 0, 0, 0x40, 0x81];
const CAPSULES: [u8; 7] = [0xA5, 0x5A, 0x54, 0, 0, 0x40, 0x82];

/// A capsule that begins at an angle, in 1/64°, with these distances in quarters of millimetres.
fn capsule(start: u16, distance: u16) -> Vec<u8> {
    let mut body = start.to_le_bytes().to_vec();
    for _ in 0..16 {
        let [low, high] = (distance & 0xFFFC).to_le_bytes();
        body.extend([low, high, low, high, 0]);
    }
    let sum = body.iter().fold(0, |sum, byte| sum ^ byte);
    [&[0xA0 | sum & 0xF, 0x50 | sum >> 4], &body[..]].concat()
}

fn node(is_first: bool, angle: u16, distance: u16) -> Vec<u8> {
    let [low, high] = (angle << 1 | 1).to_le_bytes();
    let [near, far] = distance.to_le_bytes();
    vec![if is_first { 0x3D } else { 0x3E }, low, high, near, far]
}

#[test]
fn answers_are_those_of_the_protocol() {
    let mut stream = b"RP LIDAR System.\r\n".to_vec();
    stream.extend(INFO);
    stream.extend([0x28, 0x1D, 0x01, 0x06]);
    stream.extend([7; 16]);
    stream.extend(HEALTH);
    stream.extend([2, 0x34, 0x12]);
    stream.extend(RATE);
    stream.extend([0xF4, 0x01, 0xFA, 0x00]);
    stream.extend(NODES);
    stream.extend(node(true, 90 * 64, 4000));
    let expected = [
        Answer::Info { model: 0x28, firmware: (1, 0x1D) },
        Answer::Health(Health::Error(0x1234)),
        Answer::SampleRate { standard: 500, express: 250 },
        Answer::Node { is_first: true, angle: std::f64::consts::FRAC_PI_2, range: 1.0 },
    ];
    assert_eq!(answers(&stream), expected);
}

#[test]
fn angles_of_a_capsule_are_between_its_start_and_the_next() {
    let mut bytes = capsule(350 * 64, 4000);
    // The second sample has a distance of 2 m, and a correction of 63 eighths of a degree: 3 and 15.
    (bytes[6], bytes[7], bytes[8]) = (0x40 | 3, 0x1F, 0xF0);
    let sum = bytes[2..].iter().fold(0, |sum, byte| sum ^ byte);
    (bytes[0], bytes[1]) = (0xA0 | sum & 0xF, 0x50 | sum >> 4);
    let stream = [&CAPSULES[..], &bytes, &capsule(22 * 64, 0)].concat();
    let [Answer::Capsule(first), Answer::Capsule(second)] = answers(&stream)[..] else { panic!("two") };
    assert!(!first.follows && second.follows && !first.is_first);
    let samples: Vec<_> = first.samples(&second).collect();
    let degrees = |i: usize| samples[i].0.to_degrees();
    assert_eq!(samples.len(), 32);
    assert!((degrees(0) - 350.0).abs() < 1e-9 && (degrees(10) - 0.0).abs() < 1e-9, "{samples:?}");
    assert!((degrees(1) - (351.0 - 7.875)).abs() < 1e-5, "{}", degrees(1));
    assert_eq!((samples[0].1, samples[1].1), (1.0, 2.0));
}

#[test]
fn corrupt_capsule_is_left_out_and_the_next_does_not_follow() {
    let mut corrupt = capsule(3200, 4000);
    corrupt[40] ^= 0x10;
    let stream = [&CAPSULES[..], &capsule(1600, 1), &corrupt, &capsule(4800, 1), &capsule(6400, 1)].concat();
    let follows: Vec<_> = answers(&stream)
        .into_iter()
        .map(|answer| matches!(answer, Answer::Capsule(capsule) if capsule.follows))
        .collect();
    assert_eq!(follows, [false, false, true]);
}

#[test]
fn standard_scan_goes_on_behind_a_corrupt_and_behind_a_torn_sample() {
    let nodes: Vec<_> = (0..100).map(|i| node(i % 20 == 0, i * 200, 3000 + i)).collect();
    let sent = |nodes: &[Vec<u8>]| answers(&[&NODES[..], &nodes.concat()].concat());
    let whole = sent(&nodes);
    assert_eq!(whole.len(), 100);
    let mut corrupt = nodes.clone();
    corrupt[30][0] |= 3;
    let found = sent(&corrupt);
    assert_eq!((found.len(), &found[30..]), (99, &whole[31..]), "only that is lost");
    let mut torn = nodes.clone();
    torn[30].drain(1..3);
    let found = sent(&torn);
    assert_eq!(found[found.len() - 60..], whole[40..]);
}

proptest! {
    #[test]
    fn any_split_of_a_stream_gives_the_same_answers(
        distances in vec(any::<u16>(), 1..6),
        express in any::<bool>(),
        noise in vec(any::<u8>(), 0..20),
        cuts in vec(any::<Index>(), 0..8),
    ) {
        let mut stream = if express { CAPSULES.to_vec() } else { NODES.to_vec() };
        for (i, distance) in (0_u16..).zip(&distances) {
            stream.extend(if express { capsule(i * 1843, *distance) } else { node(false, i * 64, *distance) });
            stream.extend(&noise);
        }
        let mut cuts: Vec<_> = cuts.iter().map(|cut| cut.index(stream.len())).collect();
        cuts.sort_unstable();
        let (mut split, mut found, mut from) = (Answers::default(), Vec::new(), 0);
        for to in cuts.into_iter().chain([stream.len()]) {
            split.feed(&stream[from..to], |answer| found.push(answer));
            from = to;
        }
        prop_assert_eq!(found, answers(&stream));
    }

    /// Capsules that are not touched are all found. A checksum that is right by chance is excluded.
    #[test]
    fn corruption_costs_only_the_capsules_that_it_touches(
        distances in vec(any::<u16>(), 3..8),
        which in any::<Index>(),
        at in 0..SIZE,
        instead in vec(any::<u8>(), 0..4),
        length in 1..4_usize,
    ) {
        let capsules: Vec<_> = (0_u16..).zip(&distances).map(|(i, d)| capsule(i * 1843, *d)).collect();
        let which = which.index(capsules.len());
        let whole = answers(&[&CAPSULES[..], &capsules.concat()].concat());
        let mut broken = capsules;
        let to = (at + length).min(SIZE);
        broken[which].splice(at..to, instead);
        let found = answers(&[&CAPSULES[..], &broken.concat(), &[0; SIZE]].concat());
        let same = |a: &Answer, b: &Answer| match (a, b) {
            (Answer::Capsule(a), Answer::Capsule(b)) => *a == Capsule { follows: a.follows, ..*b },
            _ => false,
        };
        prop_assume!(found.iter().all(|found| whole.iter().any(|sent| same(found, sent))));
        let mut rest = found.iter();
        for (i, sent) in whole.iter().enumerate() {
            prop_assert!(i == which || rest.any(|found| same(found, sent)), "{i} of {which} is lost");
        }
    }

    #[test]
    fn noise_never_panics_and_is_kept_in_bounds(
        kind in 0..5_usize,
        bytes in vec(any::<u8>(), 0..3000),
    ) {
        let mut answers = Answers::default();
        answers.feed(&[INFO, HEALTH, RATE, NODES, CAPSULES][kind], |_| {});
        for piece in bytes.chunks(100) {
            answers.feed(piece, |_| {});
            prop_assert!(answers.buffer.len() <= 128);
        }
    }
}
