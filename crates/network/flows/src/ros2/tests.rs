use proptest::{collection::vec, prelude::*, sample::Index};

use crate::{
    Counts, Id, Meter, Protocol,
    rtps::{Guid, Identity},
    testing::{
        End, frame, ms,
        rtps::{CUSTOM_RELATED, Message, RELATED, guid},
        samples, udp, udp_fragments,
    },
};

const ROBOT: End = (1, 7411);
const CLOUD: End = (2, 7411);
/// Writers on the robot, in the cloud, and on a node that is not measured.
const CAMERA: (u8, u8) = (11, 1);
const PLANNER: (u8, u8) = (12, 1);
const OTHER: (u8, u8) = (13, 1);

fn topics(id: Option<Id>) -> Meter {
    let (request, answer) = ("/camera".to_owned(), "/cmd_vel".to_owned());
    Meter::new(Protocol::Ros2 { request, answer, id }, ms(1000))
}

fn writer((participant, entity): (u8, u8)) -> Guid {
    guid(participant, entity)
}

fn message((participant, _): (u8, u8)) -> Message {
    // Participants have different byte orders.
    Message::of(participant, participant % 2 == 0)
}

fn leaves(meter: &mut Meter, at: u64, message: &Message) {
    meter.entered(ms(at), &frame(&udp(ROBOT, CLOUD, &message.bytes)), 0);
}

fn comes(meter: &mut Meter, at: u64, message: &Message) {
    meter.delivered(ms(at), &frame(&udp(CLOUD, ROBOT, &message.bytes)));
}

fn sample(of: (u8, u8), sequence: u64, body: &[u8]) -> Message {
    let message = message(of);
    let payload = message.serialized(body);
    message.data(writer(of), sequence, b"", &payload)
}

fn announce(meter: &mut Meter, is_here: bool, of: (u8, u8), topic: &str) {
    let message = message(of).announce(writer(of), topic);
    if is_here { leaves(meter, 0, &message) } else { comes(meter, 0, &message) }
}

fn announced_topics(id: Option<Id>) -> Meter {
    let mut meter = topics(id);
    announce(&mut meter, true, CAMERA, "rt/camera");
    announce(&mut meter, false, PLANNER, "rt/cmd_vel");
    meter
}

#[test]
fn topics_are_measured_from_a_message_to_the_next_message_of_the_other_topic() {
    let mut meter = announced_topics(None);
    leaves(&mut meter, 10, &sample(CAMERA, 1, b"image"));
    // The sample for another subscriber, and repeated for the first.
    leaves(&mut meter, 12, &sample(CAMERA, 1, b"image"));
    comes(&mut meter, 30, &sample(PLANNER, 1, b"twist"));
    leaves(&mut meter, 100, &sample(CAMERA, 2, b""));
    // The command is repeated because its acknowledgment was lost.
    comes(&mut meter, 105, &sample(PLANNER, 1, b"twist"));
    comes(&mut meter, 110, &sample(PLANNER, 2, b""));
    assert_eq!(samples(&mut meter), [(0, 10, Some(20)), (1, 100, Some(10))]);
    // An overtaken sample counts.
    leaves(&mut meter, 200, &sample(CAMERA, 3, b""));
    comes(&mut meter, 205, &sample(PLANNER, 4, b""));
    leaves(&mut meter, 300, &sample(CAMERA, 4, b""));
    comes(&mut meter, 303, &sample(PLANNER, 3, b""));
    assert_eq!(samples(&mut meter), [(2, 200, Some(5)), (3, 300, Some(3))]);
    assert_eq!(meter.counts(), Counts { requests: 4, ..Counts::default() });
}

#[test]
fn other_samples_are_ignored() {
    let mut meter = announced_topics(None);
    // Writers without an announcement, on another topic, and in the other direction.
    leaves(&mut meter, 1, &sample((11, 2), 1, b""));
    announce(&mut meter, true, (11, 3), "rt/camera_info");
    leaves(&mut meter, 1, &sample((11, 3), 1, b""));
    announce(&mut meter, false, OTHER, "rt/camera");
    comes(&mut meter, 1, &sample(OTHER, 1, b""));
    comes(&mut meter, 1, &sample(CAMERA, 1, b""));
    assert_eq!(meter.counts(), Counts::default());
    leaves(&mut meter, 2, &sample(CAMERA, 1, b""));
    leaves(&mut meter, 3, &sample(PLANNER, 1, b""));
    comes(&mut meter, 4, &sample(OTHER, 2, b""));
    assert_eq!(samples(&mut meter), []);
    // A writer that has left the topic.
    announce(&mut meter, false, PLANNER, "rt/other");
    comes(&mut meter, 5, &sample(PLANNER, 2, b""));
    assert_eq!(samples(&mut meter), []);
    announce(&mut meter, false, PLANNER, "rt/cmd_vel");
    comes(&mut meter, 6, &sample(PLANNER, 3, b""));
    assert_eq!(samples(&mut meter), [(0, 2, Some(4))]);
}

#[test]
fn a_fragmented_request_begins_with_its_first_fragment() {
    let mut meter = announced_topics(None);
    // The sample is behind another one, in a later fragment.
    let (other, camera) = (sample(OTHER, 1, &[7; 4000]).bytes, sample(CAMERA, 1, &[7; 4000]).bytes);
    let source = [&[0x0c, 0, 0, 20][..], &[0; 8], &camera[8..20]].concat();
    let both = [&other, &source, &camera[20..]].concat();
    for (i, fragment) in udp_fragments(ROBOT, CLOUD, &both, 1480).iter().enumerate() {
        meter.entered(ms(10 + i as u64), &frame(fragment), 0);
    }
    comes(&mut meter, 40, &sample(PLANNER, 1, b""));
    assert_eq!(samples(&mut meter), [(0, 10, Some(30))]);
}

#[test]
fn fragments_of_a_lost_datagram_do_not_mix_with_a_later_one() {
    let mut meter = announced_topics(None);
    let [lost, later] = [1, 2]
        .map(|sequence| udp_fragments(CLOUD, ROBOT, &sample(PLANNER, sequence, &[7; 2000]).bytes, 1480));
    meter.delivered(ms(1), &frame(&lost[0]));
    leaves(&mut meter, 40_000, &sample(CAMERA, 1, b""));
    meter.delivered(ms(40_001), &frame(&later[1]));
    assert_eq!(samples(&mut meter), []);
    meter.delivered(ms(40_002), &frame(&later[0]));
    assert_eq!(samples(&mut meter), [(0, 40_000, Some(2))]);
}

#[test]
fn repeated_fragments_are_not_another_answer() {
    let mut meter = announced_topics(None);
    let answer = message(PLANNER).serialized(&[7; 60]);
    let mut parts = (0..2).map(|part| message(PLANNER).fragment(writer(PLANNER), 1, part, 32, &answer));
    let parts = [parts.next().unwrap(), parts.next().unwrap()];
    for at in [10, 20] {
        leaves(&mut meter, at, &sample(CAMERA, at, b""));
        parts.iter().for_each(|part| comes(&mut meter, at + 1, part));
    }
    assert_eq!(samples(&mut meter), [(0, 10, Some(1))]);
}

#[test]
fn repeated_samples_are_recognized_across_any_number_of_gaps() {
    let mut meter = announced_topics(Some(Id { offset: 0, length: 8 }));
    let mut leave = |sequence: u64| {
        leaves(&mut meter, 1, &sample(CAMERA, sequence, &sequence.to_be_bytes()));
        meter.counts().requests
    };
    for number in 1..=1025 {
        assert_eq!(leave(2 * number), number);
    }
    // The first gap is closed, and the next is not.
    assert_eq!([2, 3, 4, 2050].map(&mut leave), [1025; 4]);
    assert_eq!(leave(5), 1026);
}

#[test]
fn writers_beyond_the_bound_are_forgotten_and_counted() {
    let mut meter = announced_topics(None);
    for other in 2..=255 {
        announce(&mut meter, true, (21, other), "rt/camera");
    }
    assert_eq!(meter.counts().given_up, 0);
    // It is used, so that another one has been quiet for longer.
    leaves(&mut meter, 1, &sample(CAMERA, 1, b""));
    announce(&mut meter, true, (22, 1), "rt/camera");
    leaves(&mut meter, 2, &sample(CAMERA, 2, b""));
    comes(&mut meter, 3, &sample(PLANNER, 1, b""));
    assert_eq!(samples(&mut meter), [], "the planner is forgotten");
    assert_eq!(meter.counts(), Counts { requests: 2, given_up: 1, ..Counts::default() });
}

const CLIENT: (u8, u8) = (11, 1);
const SERVER: (u8, u8) = (12, 1);

/// The ways in which replies name their requests.
#[derive(Debug, Clone, Copy)]
enum Mapping {
    /// Replies name the request.
    Request(u16),
    /// Requests name the reader of the reply, and replies name that reader.
    Reader(u16),
    Cyclone,
}

const READER: (u8, u8) = (11, 9);
const MAPPINGS: [Mapping; 5] = [
    Mapping::Request(RELATED),
    Mapping::Request(CUSTOM_RELATED),
    Mapping::Reader(RELATED),
    Mapping::Reader(CUSTOM_RELATED),
    Mapping::Cyclone,
];

impl Mapping {
    fn request(self, of: (u8, u8), sequence: u64, body: &[u8]) -> Message {
        let message = message(of);
        let (mut parameters, mut payload) = (Vec::new(), message.serialized(body));
        match self {
            Self::Request(_) => {}
            Self::Reader(id) => {
                // Fast DDS's sequence number for none.
                let reader = Identity { writer: writer(READER), sequence: u64::from(u32::MAX) << 32 };
                parameters = message.related(id, reader);
            }
            Self::Cyclone => payload = message.cyclone(u64::from(of.1), 100 + sequence, body),
        }
        message.data(writer(of), sequence, &parameters, &payload)
    }

    /// A server's reply to a request.
    fn reply(self, of: (u8, u8), to: (u8, u8), sequence: u64, request: u64, body: &[u8]) -> Message {
        let message = message(of);
        let (mut parameters, mut payload) = (Vec::new(), message.serialized(body));
        match self {
            Self::Request(id) => {
                parameters = message.related(id, Identity { writer: writer(to), sequence: request });
            }
            Self::Reader(id) => {
                parameters = message.related(id, Identity { writer: writer(READER), sequence: request });
            }
            Self::Cyclone => payload = message.cyclone(u64::from(to.1), 100 + request, body),
        }
        message.data(writer(of), sequence, &parameters, &payload)
    }
}

#[test]
fn replies_answer_the_calls_that_they_name() {
    for mapping in MAPPINGS {
        let mut meter = Meter::new(Protocol::Ros2Service { service: "/plan".to_owned() }, ms(1000));
        announce(&mut meter, true, CLIENT, "rq/planRequest");
        announce(&mut meter, false, SERVER, "rr/planReply");
        for (call, at) in [(1, 10), (2, 20), (3, 30)] {
            leaves(&mut meter, at, &mapping.request(CLIENT, call, b"the same goal"));
        }
        // Replies to another client and to none, the second before the first, and the first repeated.
        comes(&mut meter, 40, &mapping.reply(SERVER, OTHER, 1, 9, b"path"));
        comes(&mut meter, 41, &sample(SERVER, 2, b"path"));
        comes(&mut meter, 42, &mapping.reply(SERVER, CLIENT, 3, 2, b"path"));
        comes(&mut meter, 43, &mapping.reply(SERVER, CLIENT, 4, 1, b"path"));
        comes(&mut meter, 44, &mapping.reply(SERVER, CLIENT, 5, 1, b"path"));
        assert_eq!(samples(&mut meter), [(1, 20, Some(22)), (0, 10, Some(33))], "{mapping:?}");
        // A reply in fragments, of which the last does not name the request.
        if let Mapping::Request(id) = mapping {
            let message = message(SERVER);
            let related = message.related(id, Identity { writer: writer(CLIENT), sequence: 3 });
            let path = message.serialized(b"a long path");
            let first = message.clone().fragment_with(&related, writer(SERVER), 6, 0, 8, &path);
            comes(&mut meter, 50, &first);
            comes(&mut meter, 51, &message.fragment(writer(SERVER), 6, 1, 8, &path));
            assert_eq!(samples(&mut meter), [(2, 30, Some(21))], "{mapping:?}");
            continue;
        }
        meter.expire(ms(1030));
        assert_eq!(samples(&mut meter), [(2, 30, None)], "{mapping:?}");
    }
}

#[test]
fn goals_are_measured_up_to_their_results() {
    for mapping in MAPPINGS {
        let mut meter = Meter::new(Protocol::Ros2Action { action: "/dock".to_owned() }, ms(1000));
        let of = |entity| [(11, entity), (12, entity)];
        let ([goals, acceptances], [asks, results]) = (of(1), of(2));
        announce(&mut meter, true, goals, "rq/dock/_action/send_goalRequest");
        announce(&mut meter, false, acceptances, "rr/dock/_action/send_goalReply");
        announce(&mut meter, true, asks, "rq/dock/_action/get_resultRequest");
        announce(&mut meter, false, results, "rr/dock/_action/get_resultReply");
        let goal = |number: u8| [&[number; 16][..], b"station and more bytes than a header has"].concat();
        let acceptance = |is_accepted: bool| [&[u8::from(is_accepted), 0, 0, 0][..], &[1; 8]].concat();
        for (number, at) in [(1, 10), (2, 11), (3, 12)] {
            leaves(&mut meter, at, &mapping.request(goals, u64::from(number), &goal(number)));
        }
        for (number, is_accepted) in [(1, true), (2, false), (3, true)] {
            let reply = mapping.reply(acceptances, goals, number, number, &acceptance(is_accepted));
            comes(&mut meter, 20, &reply);
        }
        // The third result is called for first, and comes first.
        leaves(&mut meter, 30, &mapping.request(asks, 1, &[3; 16]));
        leaves(&mut meter, 31, &mapping.request(asks, 2, &[1; 16]));
        // A result of another client, and a repeated one.
        leaves(&mut meter, 32, &mapping.request(asks, 3, &[9; 16]));
        leaves(&mut meter, 33, &mapping.request(asks, 4, &[3; 16]));
        assert_eq!(samples(&mut meter), []);
        comes(&mut meter, 100, &mapping.reply(results, asks, 1, 1, b"\x04\0\0\0result"));
        comes(&mut meter, 200, &mapping.reply(results, asks, 2, 2, b"\x04\0\0\0result"));
        comes(&mut meter, 201, &mapping.reply(results, asks, 3, 3, b"\x04\0\0\0result"));
        assert_eq!(samples(&mut meter), [(2, 12, Some(88)), (0, 10, Some(190))], "{mapping:?}");
        assert_eq!(meter.counts(), Counts { requests: 3, rejected: 1, ..Counts::default() });
        assert_eq!(meter.deadline(), None);
    }
}

proptest! {
    /// Messages with ids, in fragments that come repeatedly and in any order, are answered with the last missing one.
    #[test]
    fn fragments_complete_answers_in_any_order(
        sizes in vec(12..400_usize, 1..8),
        size in 12..100_usize,
        order in vec(any::<Index>(), 200),
        again in vec(any::<Index>(), 0..20),
        packed in 1..4_usize,
    ) {
        let mut meter = announced_topics(Some(Id { offset: 0, length: 8 }));
        let body = |number: usize, length: usize, what: u8| {
            let mut body = (number as u64).to_be_bytes().to_vec();
            body.resize(length, what);
            body
        };
        let mut parts = Vec::new();
        for (number, length) in sizes.iter().enumerate() {
            let request = message(CAMERA).serialized(&body(number, 412 - length, 1));
            for part in 0..request.len().div_ceil(size) {
                let at = number as u64 + 20 * part as u64;
                let sequence = number as u64 + 1;
                leaves(&mut meter, at, &message(CAMERA).fragment(writer(CAMERA), sequence, part, size, &request));
            }
            let answer = message(PLANNER).serialized(&body(number, *length, 2));
            parts.extend((0..answer.len().div_ceil(size)).map(|part| (number, part, answer.clone())));
        }
        for i in 0..parts.len() {
            let other = order[i % order.len()].index(parts.len());
            parts.swap(i, other);
        }
        let first = parts.len();
        parts.extend_from_slice(&again.iter().map(|again| parts[again.index(first)].clone()).collect::<Vec<_>>());
        let mut expected = Vec::new();
        let mut came = vec![std::collections::BTreeSet::new(); sizes.len()];
        for (i, together) in parts.chunks(packed).enumerate() {
            let at = 500 + i as u64;
            let mut all = message(PLANNER);
            for (number, part, answer) in together {
                all = all.fragment(writer(PLANNER), *number as u64 + 1, *part, size, answer);
                if came[*number].insert(part) && came[*number].len() == answer.len().div_ceil(size) {
                    expected.push((*number as u32, *number as u64, Some(at - *number as u64)));
                }
            }
            comes(&mut meter, at, &all);
        }
        prop_assert_eq!(samples(&mut meter), expected);
        prop_assert_eq!(meter.counts(), Counts { requests: sizes.len() as u64, ..Counts::default() });
    }
}
