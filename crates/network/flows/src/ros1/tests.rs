use proptest::{collection::vec, prelude::*, sample::Index};

use crate::{
    Counts, Id, Meter, Protocol,
    testing::{End, FIN, RST, SYN, frame, ms, samples, tcp},
};

const ROBOT: u8 = 1;

/// A connection between the robot and another node, opened by either.
struct Talk {
    initiator: End,
    responder: End,
    next: [u32; 2],
}

impl Talk {
    fn begin(meter: &mut Meter, at: u64, initiator: End, responder: End) -> Self {
        let mut talk = Self { initiator, responder, next: [u32::MAX - 9, 500] };
        talk.say(meter, at, 0, SYN, b"");
        talk.say(meter, at, 1, SYN, b"");
        talk
    }

    /// Builds the next frame of the initiator (`side` 0) or the responder (1).
    fn frame(&mut self, side: usize, flags: u8, bytes: &[u8]) -> Vec<u8> {
        let ends = [self.initiator, self.responder];
        let acknowledged = if flags & SYN != 0 && side == 0 { 0 } else { self.next[1 - side] };
        let sent = tcp(ends[side], ends[1 - side], self.next[side], acknowledged, flags, bytes);
        self.next[side] = self.next[side].wrapping_add(bytes.len() as u32 + u32::from(flags & SYN != 0));
        sent
    }

    fn say(&mut self, meter: &mut Meter, at: u64, side: usize, flags: u8, bytes: &[u8]) {
        let from = [self.initiator, self.responder][side];
        let sent = self.frame(side, flags, bytes);
        pass(meter, at, from, &sent);
    }
}

fn pass(meter: &mut Meter, at: u64, from: End, sent: &[u8]) {
    match from.0 {
        ROBOT => meter.entered(ms(at), &frame(sent), 0),
        _ => meter.delivered(ms(at), &frame(sent)),
    }
}

fn framed(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes(), bytes].concat()
}

fn header(fields: &[&str]) -> Vec<u8> {
    framed(&fields.iter().map(|field| framed(field.as_bytes())).collect::<Vec<_>>().concat())
}

fn topics(id: Option<Id>) -> Meter {
    let (request, answer) = ("/camera".to_owned(), "/cmd_vel".to_owned());
    Meter::new(Protocol::Ros1 { request, answer, id }, ms(1000))
}

/// Opens a subscriber's connection to the publisher of a topic.
fn subscribed(meter: &mut Meter, subscriber: End, publisher: End, topic: &str) -> Talk {
    let mut talk = Talk::begin(meter, 0, subscriber, publisher);
    let asked = header(&["callerid=/node", &format!("topic={topic}"), "md5sum=*"]);
    // The header comes in two parts.
    talk.say(meter, 0, 0, 0, &asked[..9]);
    talk.say(meter, 0, 0, 0, &asked[9..]);
    talk.say(meter, 0, 1, 0, &header(&["callerid=/other", "md5sum=*"]));
    talk
}

const CAMERA: End = (ROBOT, 30_001);
const DETECTOR: End = (2, 40_001);
const PLANNER: End = (2, 30_002);
const BASE: End = (ROBOT, 40_002);

#[test]
fn topics_are_measured_from_the_first_byte_of_a_message_to_the_last_of_its_answer() {
    let mut meter = topics(None);
    let mut camera = subscribed(&mut meter, DETECTOR, CAMERA, "/camera");
    let mut commands = subscribed(&mut meter, BASE, PLANNER, "/cmd_vel");
    // Other subscribers get the same messages.
    let mut recorder = subscribed(&mut meter, (3, 40_003), CAMERA, "/camera");
    for (number, at) in [(0, 10), (1, 100)] {
        camera.say(&mut meter, at, 1, 0, &framed(b"image")[..6]);
        recorder.say(&mut meter, at, 1, 0, &framed(b"image"));
        camera.say(&mut meter, at + 1, 1, 0, b"age");
        commands.say(&mut meter, at + 20, 1, 0, &framed(b"twist")[..8]);
        assert_eq!(samples(&mut meter), []);
        commands.say(&mut meter, at + 30, 1, 0, b"t");
        assert_eq!(samples(&mut meter), [(number, at, Some(30))]);
    }
    // When the first subscriber has left, another's messages count.
    camera.say(&mut meter, 200, 0, RST, b"");
    recorder.say(&mut meter, 210, 1, 0, &framed(b""));
    commands.say(&mut meter, 220, 1, 0, &framed(b""));
    assert_eq!(samples(&mut meter), [(2, 210, Some(10))]);
    assert_eq!(meter.counts(), Counts { requests: 3, ..Counts::default() });
}

#[test]
fn other_connections_are_ignored() {
    let mut meter = topics(None);
    // Published elsewhere, subscribed to elsewhere, another topic, a service of that name, the master's XML-RPC.
    let mut others = vec![
        subscribed(&mut meter, (ROBOT, 1), (2, 2), "/camera"),
        subscribed(&mut meter, (2, 3), (ROBOT, 4), "/cmd_vel"),
        subscribed(&mut meter, (2, 5), (ROBOT, 6), "/camera_info"),
    ];
    let mut service = Talk::begin(&mut meter, 0, (ROBOT, 7), (2, 8));
    service.say(&mut meter, 0, 0, 0, &header(&["service=/camera"]));
    let mut master = Talk::begin(&mut meter, 0, (ROBOT, 9), (2, 11_311));
    master.say(&mut meter, 0, 0, 0, b"POST /RPC2 HTTP/1.1\r\n\r\n");
    others.extend([service, master]);
    for other in &mut others {
        other.say(&mut meter, 1, 1, 0, &framed(b"message"));
        other.say(&mut meter, 2, 1, 0, &framed(b"message"));
        other.say(&mut meter, 3, 1, FIN, b"");
    }
    // A connection whose beginning was not seen.
    pass(&mut meter, 4, CAMERA, &tcp(CAMERA, DETECTOR, 7, 8, 0, &framed(b"message")));
    assert_eq!((samples(&mut meter), meter.counts()), (vec![], Counts::default()));
}

#[test]
fn calls_are_measured_up_to_the_end_of_their_result() {
    let mut meter = Meter::new(Protocol::Ros1Service { service: "/plan".to_owned() }, ms(1000));
    let mut probe = Talk::begin(&mut meter, 0, (ROBOT, 1), (2, 8));
    probe.say(&mut meter, 0, 0, 0, &header(&["probe=1", "service=/plan"]));
    let mut talk = Talk::begin(&mut meter, 0, (ROBOT, 2), (2, 8));
    talk.say(&mut meter, 1, 0, 0, &header(&["service=/plan", "persistent=1"]));
    talk.say(&mut meter, 3, 1, 0, &header(&["callerid=/planner"]));
    talk.say(&mut meter, 10, 0, 0, &framed(b"goal")[..5]);
    talk.say(&mut meter, 12, 0, 0, b"oal");
    let result = [&[1], &framed(b"path")[..]].concat();
    talk.say(&mut meter, 20, 1, 0, &result[..1]);
    talk.say(&mut meter, 21, 1, 0, &result[1..8]);
    assert_eq!(samples(&mut meter), []);
    talk.say(&mut meter, 25, 1, 0, &result[8..]);
    // A call that fails, and one without content.
    talk.say(&mut meter, 30, 0, 0, &framed(b"nowhere"));
    talk.say(&mut meter, 33, 1, 0, &[&[0], &framed(b"no way")[..]].concat());
    talk.say(&mut meter, 40, 0, 0, &framed(b""));
    talk.say(&mut meter, 41, 1, 0, &[1, 0, 0, 0, 0]);
    assert_eq!(samples(&mut meter), [(0, 10, Some(15)), (1, 30, Some(3)), (2, 40, Some(1))]);
    assert_eq!(meter.counts().requests, 3);
}

proptest! {
    /// Messages with ids, cut and reordered on their way back, are answered when their last byte and all before have come.
    /// Each answer counts once, also with several subscribers.
    #[test]
    fn ids_distinguish_messages(
        sizes in vec(0..60_usize, 1..12),
        drops in vec(any::<bool>(), 12),
        cuts in vec(any::<Index>(), 0..20),
        order in vec(any::<Index>(), 0..30),
    ) {
        let mut meter = topics(Some(Id { offset: 4, length: 8 }));
        let mut camera = subscribed(&mut meter, DETECTOR, CAMERA, "/camera");
        let mut recorder = subscribed(&mut meter, (3, 40_003), CAMERA, "/camera");
        let commands = subscribed(&mut meter, BASE, PLANNER, "/cmd_vel");
        let message = |number: usize, size: usize, what: u8| {
            let mut message = vec![what; 4];
            message.extend_from_slice(&(number as u64).to_be_bytes());
            message.resize(12 + size, what);
            framed(&message)
        };
        let (mut said, mut ends) = (Vec::new(), Vec::new());
        for (number, size) in sizes.iter().enumerate() {
            // The first byte comes by itself.
            let sent = message(number, *size, 1);
            camera.say(&mut meter, number as u64, 1, 0, &sent[..1]);
            camera.say(&mut meter, 50, 1, 0, &sent[1..]);
            recorder.say(&mut meter, 60, 1, 0, &sent);
            if !drops[number] {
                said.extend(message(number, 60 - size, 2));
                ends.push((number as u32, said.len()));
            }
        }
        // A message too short for an id.
        said.extend(framed(&[0; 11]));
        let mut places: Vec<_> = cuts.iter().map(|cut| cut.index(said.len())).chain([0, said.len()]).collect();
        places.sort_unstable();
        places.dedup();
        let mut parts: Vec<_> = places.windows(2).map(|ends| (ends[0], ends[1])).collect();
        for (i, other) in order.iter().enumerate() {
            let (i, other) = (i % parts.len(), other.index(parts.len()));
            parts.swap(i, other);
        }
        let mut came = vec![0; said.len()];
        for (i, (from, to)) in parts.iter().enumerate() {
            let at = 100 + i as u64;
            came[*from..*to].fill(at);
            let sequence = commands.next[1].wrapping_add(*from as u32);
            pass(&mut meter, at, PLANNER, &tcp(PLANNER, BASE, sequence, 0, 0, &said[*from..*to]));
        }
        let expected: Vec<_> = ends
            .iter()
            .map(|(number, end)| {
                let entered = u64::from(*number);
                (*number, entered, came[..*end].iter().max().map(|came| came - entered))
            })
            .collect();
        prop_assert_eq!(samples(&mut meter), expected);
        prop_assert_eq!(meter.counts(), Counts { requests: sizes.len() as u64, ..Counts::default() });
    }
}
