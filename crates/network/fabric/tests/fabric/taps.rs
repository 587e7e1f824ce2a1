//! Taps: packets that cross links, as their readers see them.

use std::sync::mpsc::{Receiver, TryRecvError, channel};

use cotorra_fabric::{Fabric, Passage, TapError};
use cotorra_graph::{Conditions, Direction, Probing, QueueLimit, Timestamp};

use crate::common::{A, B, Network, delay, frame, ms, number, pair, rate, run};

/// A packet as a reader saw it.
#[derive(Debug, Clone, PartialEq)]
struct Seen {
    link: String,
    direction: Direction,
    number: u32,
    /// Entered, due, delivered.
    times: [Timestamp; 3],
    overflowed: u64,
}

/// Taps a link or node, and returns what the reader sees. It reads as long as `most` packets are not reached.
fn tap(fabric: &mut Fabric, name: &str, most: usize) -> Receiver<Seen> {
    let (sender, seen) = channel();
    let mut count = 0;
    let reader = move |passage: Option<&Passage<'_>>| {
        if let Some(passage) = passage {
            count += 1;
            let seen = Seen {
                link: passage.link.to_string(),
                direction: passage.direction,
                number: number(passage.frame),
                times: [passage.entered, passage.due, passage.delivered],
                overflowed: passage.overflowed,
            };
            sender.send(seen).unwrap();
        }
        count < most
    };
    fabric.tap(name, Box::new(reader)).unwrap();
    seen
}

fn links(seen: &Receiver<Seen>) -> Vec<(String, u32)> {
    seen.try_iter().map(|seen| (seen.link, seen.number)).collect()
}

#[test]
fn readers_see_when_packets_were_due_and_delivered() {
    let mut fabric = pair(delay(5), 1);
    let seen = tap(&mut fabric, "a-b", usize::MAX);
    fabric.push(ms(1.0), A, frame(A, B, 7, 100));
    // A late poll.
    fabric.poll(ms(9.0), &mut |_, _| {});
    fabric.push(ms(10.0), B, frame(B, A, 8, 100));
    run(&mut fabric, ms(10.0), ms(100.0));
    let expect = |direction, number, times: [f64; 3]| Seen {
        link: "a-b".to_owned(),
        direction,
        number,
        times: times.map(ms),
        overflowed: 0,
    };
    let forward = expect(Direction::Forward, 7, [1.0, 6.0, 9.0]);
    assert_eq!(
        seen.try_iter().collect::<Vec<_>>(),
        [forward, expect(Direction::Backward, 8, [10.0, 15.0, 15.0])]
    );
}

#[test]
fn readers_see_how_many_packets_overflowed() {
    let queue = QueueLimit::Packets(1);
    let mut fabric = pair(Conditions { queue, rate: rate(8.0), ..Conditions::default() }, 1);
    let seen = tap(&mut fabric, "a-b", usize::MAX);
    (0..4).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 1000)));
    run(&mut fabric, ms(0.0), ms(100.0));
    assert_eq!(
        seen.try_iter().map(|seen| (seen.number, seen.overflowed)).collect::<Vec<_>>(),
        [(0, 2), (1, 2)]
    );
}

#[test]
fn a_tap_shows_its_links_only() {
    let network = Network::new().server("b").switches(&["s"]).radio_unit("R1", 0.0).robot("p", 2.0);
    let mut fabric = network.robot("q", 5.0).link("R1", "s", delay(3)).link("s", "b", delay(0)).fabric(1);
    let [b, p, q] = ["b", "p", "q"].map(|name| fabric.port(&name.parse().unwrap()).unwrap());
    let taps = ["p~R1", "p", "R1", "s", "s-b"].map(|name| tap(&mut fabric, name, usize::MAX));
    fabric.push(ms(0.0), p, frame(p, b, 1, 60));
    run(&mut fabric, ms(0.0), ms(50.0));
    fabric.push(ms(50.0), b, frame(b, q, 2, 60));
    run(&mut fabric, ms(50.0), ms(100.0));
    let expected: [&[(&str, u32)]; 5] = [
        &[("p~R1", 1)],
        &[("p~R1", 1)],
        &[("p~R1", 1), ("R1-s", 1), ("R1-s", 2), ("q~R1", 2)],
        &[("R1-s", 1), ("s-b", 1), ("s-b", 2), ("R1-s", 2)],
        &[("s-b", 1), ("s-b", 2)],
    ];
    for (seen, expected) in taps.iter().zip(expected) {
        let expected: Vec<_> = expected.iter().map(|(link, number)| (link.to_string(), *number)).collect();
        assert_eq!(links(seen), expected);
    }
    let unknown = fabric.tap("nothing", Box::new(|_| true)).unwrap_err();
    assert_eq!(unknown.to_string(), "there is no link or node `nothing`");
}

#[test]
fn a_reader_that_wants_no_more_is_forgotten() {
    let mut fabric = pair(delay(1), 1);
    let seen = tap(&mut fabric, "a", 1);
    (0..3).for_each(|i| fabric.push(ms(0.0), A, frame(A, B, i, 100)));
    run(&mut fabric, ms(0.0), ms(100.0));
    assert_eq!(links(&seen), [("a-b".to_owned(), 0)]);
    assert_eq!(seen.try_recv(), Err(TryRecvError::Disconnected));
    // A reader of a silent link, which ended meanwhile, makes room for the next one.
    let ended = tap(&mut fabric, "a", 0);
    assert_eq!(ended.try_recv(), Err(TryRecvError::Empty));
    tap(&mut fabric, "b", 1);
    assert_eq!(ended.try_recv(), Err(TryRecvError::Disconnected));
}

#[test]
fn taps_are_bounded_until_one_ends() {
    let mut fabric = pair(delay(1), 1);
    let _taps: Vec<_> = (0..16).map(|i| tap(&mut fabric, "a", i)).collect();
    // The first wanted nothing, and made room.
    let _last = tap(&mut fabric, "a", 1);
    assert_eq!(fabric.tap("a", Box::new(|_| true)), Err(TapError::TooMany));
}

#[test]
fn probes_are_not_shown() {
    let mut fabric = pair(delay(1), 1);
    fabric.probe_links(ms(0.0), Probing::default());
    let seen = tap(&mut fabric, "a-b", usize::MAX);
    run(&mut fabric, ms(0.0), ms(5000.0));
    assert!(fabric.link_contexts(ms(5000.0))[0].probed.is_some());
    assert_eq!(links(&seen), []);
}
