//! Links that a service left because of what was measured there.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{LinkId, Timestamp};

use super::figures::Beyond;

/// Longest time for which [`Memory`] keeps figures.
const LONGEST_HOLD: Duration = Duration::from_secs(600);

/// Links that a service left, as they were then.
///
/// A measured delay includes the queueing that the service itself causes. A service that leaves such a link would find it idle,
/// and come back. Therefore the figures count for some time, and twice as long each time that it leaves again.
#[derive(Debug, Default)]
pub struct Memory(BTreeMap<LinkId, Left>);

/// A link that was left.
#[derive(Debug)]
struct Left {
    beyond: Beyond,
    /// Until then the figures count.
    until: Timestamp,
    hold: Duration,
}

impl Memory {
    /// Notes that a service leaves a link with these figures. A service that comes back and leaves again stays away for twice
    /// as long.
    pub fn leave(&mut self, now: Timestamp, link: &LinkId, beyond: Beyond, hold: Duration) {
        let left =
            self.0.entry(link.clone()).or_insert_with(|| Left { beyond, until: now, hold: Duration::ZERO });
        if left.hold.is_zero() || now > left.until + left.hold {
            (left.hold, left.beyond) = (hold, beyond);
        } else if now >= left.until {
            (left.hold, left.beyond) = ((left.hold * 2).min(LONGEST_HOLD.max(hold)), beyond);
        } else {
            // It is still on its way.
            left.beyond = left.beyond.worse(beyond);
        }
        left.until = now + left.hold;
    }

    /// Returns the figures of a link with those at which it was left.
    pub fn with(&self, now: Timestamp, link: &LinkId, beyond: Beyond) -> Beyond {
        match self.0.get(link) {
            Some(left) if now < left.until => beyond.worse(left.beyond),
            _ => beyond,
        }
    }

    /// Whether any of them counts.
    pub fn is_held(&self, now: Timestamp) -> bool {
        self.0.values().any(|left| now < left.until)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn seconds(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    fn link() -> LinkId {
        LinkId::new("lan-cloud").unwrap()
    }

    #[test]
    fn a_link_that_is_left_again_is_held_twice_as_long() {
        let (mut memory, hold) = (Memory::default(), Duration::from_secs(60));
        let slow = Beyond { delay: Duration::from_millis(24), ..Beyond::default() };
        let held = |memory: &Memory, at: f64| memory.with(seconds(at), &link(), Beyond::default()) == slow;
        memory.leave(seconds(100.0), &link(), slow, hold);
        memory.leave(seconds(101.0), &link(), slow, hold);
        assert!(held(&memory, 160.0) && !held(&memory, 162.0), "it was on its way");
        memory.leave(seconds(170.0), &link(), slow, hold);
        assert!(held(&memory, 289.0) && !held(&memory, 291.0));
        // It stayed for long.
        memory.leave(seconds(1000.0), &link(), slow, hold);
        assert!(held(&memory, 1059.0) && !held(&memory, 1061.0));
    }

    proptest! {
        #[test]
        fn a_link_is_never_left_for_longer_than_the_longest_hold(times in prop::collection::vec(0u32..5000, 1..50)) {
            let mut times = times;
            times.sort_unstable();
            let mut memory = Memory::default();
            for time in times {
                let now = seconds(f64::from(time));
                memory.leave(now, &link(), Beyond::default(), Duration::from_secs(60));
                prop_assert!(!memory.is_held(now + LONGEST_HOLD));
            }
        }
    }
}
