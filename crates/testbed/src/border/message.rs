//! Messages between two cores about one robot and one radio unit: its frames, and what each core wants or reports. States
//! are sent again and again, so that a lost one does no harm. They are numbered, because they may overtake each other.

use std::ops::RangeInclusive;

use cotorra_graph::Direction;
use serde::{Deserialize, Serialize};

/// Longest message: a frame of an Ethernet link, or a state.
pub(super) const LONGEST: usize = 1 + LONGEST_FRAME;
/// Header, VLAN tag, and what a host sends at most.
const LONGEST_FRAME: usize = 14 + 4 + 1500;
/// Largest coordinate of a robot, metres.
const FARTHEST: f64 = 1e6;
/// Signals that can be, dBm.
const SIGNALS: RangeInclusive<f64> = -200.0..=100.0;
/// Longest reason, bytes.
const LONGEST_REASON: usize = 200;

const FORWARD: u8 = 0;
const BACKWARD: u8 = 1;
const HOME: u8 = 2;
const VISITED: u8 = 3;

/// A message.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Message {
    /// A frame of the robot, or to it.
    Frame(Direction, Vec<u8>),
    State(State),
}

/// Wish or report of one core.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum State {
    Home(HomeState),
    Visited(VisitedState),
}

/// The robot, as its core knows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct HomeState {
    pub(super) number: u64,
    /// Number of the attempt to attach to the radio unit; 0 while it is not to be attached.
    pub(super) attempt: u32,
    /// Position, metres.
    pub(super) position: [f64; 3],
}

/// The robot at the radio unit, as that one's core knows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct VisitedState {
    pub(super) number: u64,
    /// The attempt that this is about.
    pub(super) attempt: u32,
    /// Signal at the robot; `None` if the radio unit is off, or out of reach.
    pub(super) signal_dbm: Option<f64>,
    pub(super) attached: Option<Attached>,
    /// Reason for which the attempt failed or ended.
    pub(super) refused: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Attached {
    /// Whether it was a fast transition.
    pub(super) fast: bool,
}

impl Message {
    pub(super) fn encode(&self) -> Vec<u8> {
        match self {
            Self::Frame(direction, bytes) => {
                let kind = if *direction == Direction::Forward { FORWARD } else { BACKWARD };
                [&[kind][..], bytes].concat()
            }
            Self::State(State::Home(state)) => json(HOME, state),
            Self::State(State::Visited(state)) => json(VISITED, state),
        }
    }

    /// Decodes a message; `None` if it is not one, or says what cannot be.
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (kind, rest) = bytes.split_first().filter(|_| bytes.len() <= LONGEST)?;
        match *kind {
            FORWARD => Some(Self::Frame(Direction::Forward, rest.to_vec())),
            BACKWARD => Some(Self::Frame(Direction::Backward, rest.to_vec())),
            HOME => {
                let state: HomeState = serde_json::from_slice(rest).ok()?;
                let is_near = |metres: &f64| metres.abs() <= FARTHEST;
                state.position.iter().all(is_near).then_some(Self::State(State::Home(state)))
            }
            VISITED => {
                let state: VisitedState = serde_json::from_slice(rest).ok()?;
                let is_signal = state.signal_dbm.is_none_or(|signal| SIGNALS.contains(&signal));
                // It is shown on a terminal.
                let is_text = |text: &str| text.len() <= LONGEST_REASON && !text.contains(char::is_control);
                let is_valid = is_signal && state.refused.as_deref().is_none_or(is_text);
                is_valid.then_some(Self::State(State::Visited(state)))
            }
            _ => None,
        }
    }
}

/// Shortens a reason to what other cores accept.
pub(super) fn reason(text: &str) -> String {
    let text: String = text.chars().filter(|character| !character.is_control()).collect();
    text[..text.floor_char_boundary(LONGEST_REASON)].to_owned()
}

fn json(kind: u8, state: &impl Serialize) -> Vec<u8> {
    let mut bytes = vec![kind];
    serde_json::to_writer(&mut bytes, state).expect("a state has strings for keys");
    bytes
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn visited() -> VisitedState {
        VisitedState {
            number: 8,
            attempt: 2,
            signal_dbm: Some(-61.5),
            attached: Some(Attached { fast: true }),
            refused: Some("gone".to_owned()),
        }
    }

    #[test]
    fn messages_are_read_as_they_were_written() {
        let home = HomeState { number: 7, attempt: 2, position: [1.5, -2.0, 0.0] };
        for message in [
            Message::Frame(Direction::Forward, vec![1, 2, 3]),
            Message::Frame(Direction::Backward, Vec::new()),
            Message::Frame(Direction::Backward, vec![9; LONGEST_FRAME]),
            Message::State(State::Home(home)),
            Message::State(State::Visited(visited())),
        ] {
            assert_eq!(Message::decode(&message.encode()), Some(message));
        }
    }

    #[test]
    fn messages_that_say_what_cannot_be_are_rejected() {
        let far = HomeState { number: 1, attempt: 0, position: [0.0, 1e7, 0.0] };
        let loud = VisitedState { signal_dbm: Some(101.0), ..visited() };
        let long = VisitedState { refused: Some("x".repeat(LONGEST_REASON + 1)), ..visited() };
        let colourful = VisitedState { refused: Some("\u{1b}[31m".to_owned()), ..visited() };
        for state in [State::Home(far), State::Visited(loud), State::Visited(long), State::Visited(colourful)]
        {
            assert_eq!(Message::decode(&Message::State(state.clone()).encode()), None, "{state:?}");
        }
        let giant = Message::Frame(Direction::Forward, vec![0; LONGEST_FRAME + 1]);
        assert_eq!(Message::decode(&giant.encode()), None);
    }

    proptest! {
        #[test]
        fn every_reason_is_accepted_once_it_is_shortened(text in any::<String>()) {
            let state = VisitedState { refused: Some(reason(&text.repeat(9))), ..visited() };
            let message = Message::State(State::Visited(state));
            prop_assert_eq!(Message::decode(&message.encode()), Some(message));
        }

        #[test]
        fn arbitrary_messages_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..100)) {
            let _ = Message::decode(&bytes);
        }
    }
}
