//! The distance between the clocks of the core and an agent, from the times of beats and reports (RFC 5905, section 8).

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::Timestamp;

use crate::message::Echo;

/// Exchanges of which the fastest counts. Clocks of two machines drift apart by some 50 µs a second at most.
const WINDOW: usize = 16;

/// An estimate of the distance of two clocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OffsetEstimate {
    /// The agent's clock less the core's, nanoseconds.
    pub offset_ns: i128,
    /// Most that the estimate is wrong by, whichever way was slower: half of the round trip.
    pub error: Duration,
}

impl OffsetEstimate {
    /// Converts a time of the agent's clock to the core's. Times before the core's first are its first.
    pub fn to_core(&self, agent_ns: u64) -> Timestamp {
        let core = i128::from(agent_ns) - self.offset_ns;
        Timestamp::from_nanos(u64::try_from(core.max(0)).unwrap_or(u64::MAX))
    }
}

/// Estimates the distance of an agent's clock from the core's by the fastest of the last exchanges.
#[derive(Debug, Clone, Default)]
pub struct ClockOffset {
    exchanges: VecDeque<OffsetEstimate>,
}

impl ClockOffset {
    /// Takes the answer to a beat, received at `now` on the core's clock. Ignores one with impossible times.
    pub fn receive(&mut self, now: Timestamp, echo: Echo) {
        let Echo { sent_ns, received_ns, replied_ns } = echo;
        let (Some(whole), Some(there)) =
            (now.as_nanos().checked_sub(sent_ns), replied_ns.checked_sub(received_ns))
        else {
            return;
        };
        let Some(round_trip) = whole.checked_sub(there) else { return };
        let ahead = i128::from(received_ns) - i128::from(sent_ns);
        let behind = i128::from(replied_ns) - i128::from(now.as_nanos());
        let estimate = OffsetEstimate {
            offset_ns: (ahead + behind) / 2,
            error: Duration::from_nanos(round_trip.div_ceil(2)),
        };
        if self.exchanges.len() == WINDOW {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back(estimate);
    }

    /// Returns the best estimate; `None` before the first exchange.
    pub fn estimate(&self) -> Option<OffsetEstimate> {
        self.exchanges.iter().min_by_key(|exchange| exchange.error).copied()
    }

    /// Forgets all exchanges, as for an agent that was started anew and has another clock.
    pub(crate) fn reset(&mut self) {
        self.exchanges.clear();
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Whatever the two ways take, the true offset is within the stated error of the estimate.
        #[test]
        fn the_true_offset_is_within_the_error(
            offset in -1_000_000_000_000_i64..1_000_000_000_000,
            exchanges in prop::collection::vec((0_u64..10_000_000, 0_u64..10_000_000, 0_u64..5_000_000), 1..40),
        ) {
            let mut clock = ClockOffset::default();
            let mut core = 2_000_000_000_000_u64;
            for (out, there, back) in exchanges {
                let agent = |core: u64| core.checked_add_signed(offset).unwrap();
                let echo = Echo {
                    sent_ns: core,
                    received_ns: agent(core + out),
                    replied_ns: agent(core + out + there),
                };
                core += out + there + back;
                clock.receive(Timestamp::from_nanos(core), echo);
                core += 500_000_000;
            }
            let estimate = clock.estimate().unwrap();
            let wrong = (estimate.offset_ns - i128::from(offset)).unsigned_abs();
            prop_assert!(wrong <= estimate.error.as_nanos() + 1);
        }

        #[test]
        fn any_times_are_taken(now: u64, sent_ns: u64, received_ns: u64, replied_ns: u64, at: u64) {
            let mut clock = ClockOffset::default();
            clock.receive(Timestamp::from_nanos(now), Echo { sent_ns, received_ns, replied_ns });
            if let Some(estimate) = clock.estimate() {
                estimate.to_core(at);
            }
        }
    }
}
