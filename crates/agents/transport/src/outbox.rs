//! Frames that wait to be written to a connection.

use std::collections::VecDeque;

use crate::frame::{Frame, Kind};

/// Most frames that wait in a lane.
const MOST: usize = 64;
/// Most bytes that wait in a lane. One message of the longest kind fits.
const MOST_BYTES: usize = 2 << 20;

/// Frames of one urgency, oldest first.
#[derive(Debug, Default)]
struct Lane {
    frames: VecDeque<Frame>,
    bytes: usize,
}

/// Frames that wait, in lanes: an urgent one overtakes a lidar's turns, and these overtake contexts.
#[derive(Debug, Default)]
pub(crate) struct Outbox([Lane; 3]);

/// Returns the lane of a kind.
fn lane(kind: Kind) -> usize {
    match kind {
        Kind::Turn => 1,
        Kind::Context | Kind::Fetch | Kind::Part | Kind::Missing => 2,
        _ => 0,
    }
}

impl Outbox {
    /// Adds a frame. One that does not fit is dropped.
    pub(crate) fn push(&mut self, frame: Frame) {
        let Lane { frames, bytes } = &mut self.0[lane(frame.kind)];
        if frames.len() < MOST && *bytes + frame.message.len() <= MOST_BYTES {
            *bytes += frame.message.len();
            frames.push_back(frame);
        }
    }

    /// Removes the most urgent frame.
    pub(crate) fn pop(&mut self) -> Option<Frame> {
        let lane = self.0.iter_mut().find(|lane| !lane.frames.is_empty())?;
        let frame = lane.frames.pop_front()?;
        lane.bytes -= frame.message.len();
        Some(frame)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.iter().all(|lane| lane.frames.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(kind: Kind, length: usize) -> Frame {
        Frame { kind, message: vec![0; length] }
    }

    #[test]
    fn urgent_frames_overtake_and_others_keep_their_order() {
        let mut outbox = Outbox::default();
        for (kind, length) in
            [(Kind::Context, 1), (Kind::Turn, 2), (Kind::Report, 3), (Kind::Context, 4), (Kind::Beat, 5)]
        {
            outbox.push(frame(kind, length));
        }
        let order: Vec<_> = std::iter::from_fn(|| outbox.pop()).map(|frame| frame.message.len()).collect();
        assert_eq!(order, [3, 5, 2, 1, 4]);
        assert!(outbox.is_empty());
    }

    #[test]
    fn a_full_lane_drops_the_newest_frame_and_leaves_room_in_the_others() {
        let mut outbox = Outbox::default();
        (0..=MOST).for_each(|length| outbox.push(frame(Kind::Turn, length)));
        (0..3).for_each(|_| outbox.push(frame(Kind::Wanted, MOST_BYTES / 2)));
        let kept: Vec<_> = std::iter::from_fn(|| outbox.pop()).collect();
        assert_eq!(kept.iter().filter(|frame| frame.kind == Kind::Wanted).count(), 2);
        let turns = kept.iter().filter(|frame| frame.kind == Kind::Turn).map(|frame| frame.message.len());
        assert!(turns.eq(0..MOST));
        outbox.push(frame(Kind::Wanted, MOST_BYTES));
        assert!(!outbox.is_empty(), "what was removed leaves room");
    }
}
