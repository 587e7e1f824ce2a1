use std::{cell::Cell, collections::BTreeSet};

use proptest::prelude::*;

use super::*;

const KEY: [u8; 32] = [7; 32];

fn share(at: u64) -> Share {
    Share::new(Duration::from_nanos(at), [at as u8; 8])
}

fn never() -> Share {
    panic!("this datagram begins no session")
}

fn ends() -> (Tunnel, Tunnel) {
    (Tunnel::new(End::Home, KEY, share(1)), Tunnel::new(End::Visited, KEY, share(2)))
}

fn greet(home: &mut Tunnel, visited: &mut Tunnel, fresh: Share) {
    let Received::Hello(answer) = visited.receive(&home.hello(), || fresh) else { panic!("no answer") };
    assert_eq!(home.receive(&answer, never), Received::Opened);
}

fn message(bytes: &[u8]) -> Received {
    Received::Message(bytes.to_vec())
}

fn open_ends() -> (Tunnel, Tunnel) {
    let (mut home, mut visited) = ends();
    greet(&mut home, &mut visited, share(3));
    let first = home.seal(b"first").unwrap();
    assert_eq!(visited.receive(&first, never), message(b"first"));
    (home, visited)
}

#[test]
fn messages_cross_in_both_directions_once_the_ends_have_greeted() {
    let (mut home, mut visited) = ends();
    assert_eq!((home.seal(b"x"), visited.seal(b"x")), (None, None));
    (home, visited) = open_ends();
    let answer = visited.seal(b"answer").unwrap();
    assert_eq!(home.receive(&answer, never), message(b"answer"));
    assert_eq!(Tunnel::id_of(&answer), Some(home.id()));
    assert!(!answer.windows(6).any(|part| part == b"answer"));
}

#[test]
fn lost_hellos_and_answers_are_made_up_for() {
    let (mut home, mut visited) = ends();
    let Received::Hello(lost) = visited.receive(&home.hello(), || share(3)) else { panic!("no answer") };
    let Received::Hello(again) = visited.receive(&home.hello(), never) else { panic!("no answer") };
    assert_eq!(lost, again, "one session for one hello");
    assert_eq!(home.receive(&again, never), Received::Opened);
    assert_eq!(home.receive(&lost, never), Received::Rejected, "the tunnel is open");
    let first = home.seal(b"first").unwrap();
    assert_eq!(visited.receive(&first, never), message(b"first"));
}

#[test]
fn each_message_opens_once_and_may_be_overtaken() {
    let (mut home, mut visited) = open_ends();
    let all: Vec<_> = (0..100u8).map(|number| home.seal(&[number]).unwrap()).collect();
    for number in [1, 0, 2, 63, 40, 99] {
        assert_eq!(visited.receive(&all[number], never), message(&[number as u8]));
        assert_eq!(visited.receive(&all[number], never), Received::Rejected);
    }
    assert_eq!(visited.receive(&all[30], never), Received::Rejected, "64 behind the last");
    assert_eq!(visited.receive(&all[36], never), message(&[36]));
}

#[test]
fn a_message_is_for_one_direction() {
    let (mut home, mut visited) = open_ends();
    let (there, back) = (home.seal(b"x").unwrap(), visited.seal(b"x").unwrap());
    assert_eq!(home.receive(&there, never), Received::Rejected);
    assert_eq!(visited.receive(&back, never), Received::Rejected);
    let hello = home.hello();
    assert_eq!(home.receive(&hello, never), Received::Rejected);
}

#[test]
fn a_recorded_session_opens_nothing_again() {
    let (mut home, mut visited) = ends();
    let hello = home.hello();
    greet(&mut home, &mut visited, share(3));
    let recorded = home.seal(b"attach").unwrap();
    assert_eq!(visited.receive(&recorded, never), message(b"attach"));
    let mut again = Tunnel::new(End::Visited, KEY, share(2));
    assert!(matches!(again.receive(&hello, || share(9)), Received::Hello(_)));
    assert_eq!(again.receive(&recorded, never), Received::Rejected);
}

#[test]
fn hellos_that_are_older_than_the_session_are_rejected() {
    let (mut home, mut visited) = ends();
    let recorded = home.hello();
    home.restart(share(5));
    let Received::Hello(answer) = visited.receive(&home.hello(), || share(6)) else { panic!("no answer") };
    // Between the answer and the first message, and afterwards.
    assert_eq!(visited.receive(&recorded, never), Received::Rejected);
    assert_eq!(home.receive(&answer, never), Received::Opened);
    let first = home.seal(b"first").unwrap();
    assert_eq!(visited.receive(&first, never), message(b"first"));
    assert_eq!(visited.receive(&recorded, never), Received::Rejected);
}

#[test]
fn a_new_hello_does_not_end_the_session_before_its_first_message() {
    let (mut home, mut visited) = open_ends();
    let newer = Tunnel::new(End::Home, KEY, share(8)).hello();
    assert!(matches!(visited.receive(&newer, || share(9)), Received::Hello(_)));
    let next = home.seal(b"next").unwrap();
    assert_eq!(visited.receive(&next, never), message(b"next"));
}

#[test]
fn either_end_may_start_again() {
    let (mut home, _) = open_ends();
    let mut visited = Tunnel::new(End::Visited, KEY, share(4));
    assert_eq!(visited.receive(&home.seal(b"x").unwrap(), never), Received::Rejected);
    home.restart(share(5));
    assert_eq!(home.seal(b"x"), None);
    greet(&mut home, &mut visited, share(6));
    assert_eq!(visited.receive(&home.seal(b"again").unwrap(), never), message(b"again"));

    let mut home = Tunnel::new(End::Home, KEY, share(7));
    greet(&mut home, &mut visited, share(8));
    assert_eq!(visited.receive(&home.seal(b"and again").unwrap(), never), message(b"and again"));
}

#[test]
fn another_key_opens_nothing() {
    let (mut home, visited) = open_ends();
    let mut other = Tunnel::new(End::Visited, [8; 32], share(2));
    assert_ne!(other.id(), visited.id());
    other.id = visited.id();
    assert_eq!(other.receive(&home.hello(), never), Received::Rejected);
    assert_eq!(other.receive(&home.seal(b"x").unwrap(), never), Received::Rejected);
    assert!(!format!("{home:?}").contains("7, 7"));
}

proptest! {
    #[test]
    fn changed_datagrams_do_not_open(at in any::<prop::sample::Index>(), bit in 0..8u8, hello: bool) {
        let (mut home, mut visited) = open_ends();
        let mut datagram = if hello { home.hello() } else { home.seal(b"message").unwrap() };
        *at.get_mut(&mut datagram) ^= 1u8 << bit;
        prop_assert_eq!(visited.receive(&datagram, never), Received::Rejected);
    }

    #[test]
    fn arbitrary_datagrams_never_panic(mut datagram in prop::collection::vec(any::<u8>(), 0..200)) {
        let (_, mut visited) = open_ends();
        prop_assert_eq!(visited.receive(&datagram, never), Received::Rejected);
        if let Some(head) = datagram.first_chunk_mut() {
            *head = visited.id().0;
            prop_assert_eq!(visited.receive(&datagram, never), Received::Rejected);
        }
    }

    /// Whatever the network loses, repeats and reorders, and whenever an end starts again: nothing opens twice, and nothing
    /// opens that was not sealed.
    #[test]
    fn nothing_opens_twice_on_any_network(steps in prop::collection::vec((0..7u8, any::<prop::sample::Index>()), 1..80)) {
        let (mut home, mut visited) = ends();
        let clock = Cell::new(10);
        let next = || share(clock.replace(clock.get() + 1));
        let (mut to_visited, mut to_home) = (vec![home.hello()], Vec::<Vec<u8>>::new());
        let (mut sealed, mut opened) = (0u32, BTreeSet::new());
        for (step, which) in steps {
            match step {
                0 => home.restart(next()),
                1 => visited = Tunnel::new(End::Visited, KEY, next()),
                2 => to_visited.push(home.hello()),
                3 | 4 => {
                    let end = if step == 3 { &mut home } else { &mut visited };
                    if let Some(datagram) = end.seal(&sealed.to_be_bytes()) {
                        sealed += 1;
                        if step == 3 { to_visited.push(datagram) } else { to_home.push(datagram) }
                    }
                }
                _ => {
                    let (end, from) = if step == 5 { (&mut visited, &to_visited) } else { (&mut home, &to_home) };
                    if from.is_empty() { continue }
                    match end.receive(&from[which.index(from.len())], next) {
                        Received::Hello(answer) => to_home.push(answer),
                        Received::Message(bytes) => {
                            let number = u32::from_be_bytes(bytes.try_into().unwrap());
                            prop_assert!(number < sealed);
                            prop_assert!(opened.insert(number), "{} opened twice", number);
                        }
                        Received::Opened | Received::Rejected => {}
                    }
                }
            }
        }
        // And in the end the tunnel opens.
        home.restart(next());
        let Received::Hello(answer) = visited.receive(&home.hello(), next) else { panic!("no answer") };
        prop_assert_eq!(home.receive(&answer, never), Received::Opened);
        let last = home.seal(b"last").unwrap();
        prop_assert_eq!(visited.receive(&last, never), message(b"last"));
    }

    #[test]
    fn a_window_takes_each_number_once(numbers in prop::collection::vec(0..200u64, 0..100)) {
        let mut window = Window::default();
        let mut taken = BTreeSet::new();
        for number in numbers {
            if window.is_new(number) {
                prop_assert!(taken.insert(number));
                window.take(number);
            } else {
                let last = taken.last().copied().unwrap_or_default();
                prop_assert!(taken.contains(&number) || number + 64 <= last);
            }
        }
    }
}
