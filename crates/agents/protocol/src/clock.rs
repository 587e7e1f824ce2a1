//! The distance between the clocks of the core and an agent, from the times of beats and reports (RFC 5905, section 8).

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{ReadingTime, Timestamp};

use crate::message::Echo;

/// Exchanges of which the best counts.
const WINDOW: usize = 16;
/// Two clocks drift apart by a nanosecond in so many at most, while NTP corrects one of them: 500 µs a second.
const DRIFT: u128 = 2000;

/// The distance of two clocks by one exchange.
#[derive(Debug, Clone, Copy)]
struct Exchange {
    /// The agent's clock less the core's, nanoseconds.
    offset_ns: i128,
    /// Most that this is wrong by, whichever way was slower: half of the round trip.
    error_ns: u64,
    /// Beginning and end, on the core's clock.
    began: Timestamp,
    ended: Timestamp,
}

impl Exchange {
    /// Returns the exchange of an answer to a beat, received at `now` on the core's clock; `None` for impossible times.
    fn new(now: Timestamp, echo: Echo) -> Option<Self> {
        let Echo { sent_ns, received_ns, replied_ns } = echo;
        let whole = now.as_nanos().checked_sub(sent_ns)?;
        let round_trip = whole.checked_sub(replied_ns.checked_sub(received_ns)?)?;
        let ahead = i128::from(received_ns) - i128::from(sent_ns);
        let behind = i128::from(replied_ns) - i128::from(now.as_nanos());
        Some(Self {
            offset_ns: (ahead + behind) / 2,
            error_ns: round_trip.div_ceil(2),
            began: Timestamp::from_nanos(sent_ns),
            ended: now,
        })
    }

    /// Converts a time of the agent's clock to the core's. Times before the core's first are its first.
    fn to_core(self, agent_ns: u64) -> ReadingTime {
        let core = (i128::from(agent_ns) - self.offset_ns).max(0);
        let measured = Timestamp::from_nanos(u64::try_from(core).unwrap_or(u64::MAX));
        // The clocks drifted since the two halves of the exchange, and while the agent measured its part of it.
        let whole = self.ended.since(self.began).as_nanos();
        let from = |moment: Timestamp| u128::from(measured.as_nanos().abs_diff(moment.as_nanos()));
        let drift = (from(self.began) + from(self.ended) + whole).div_ceil(2 * DRIFT);
        let error = u128::from(self.error_ns) + drift;
        // The time itself, since which they drifted, is wrong by that much. The last nanosecond is for halves.
        let error = error + error.div_ceil(DRIFT - 1) + 1;
        ReadingTime { measured, error: Duration::from_nanos(u64::try_from(error).unwrap_or(u64::MAX)) }
    }
}

/// Converts times of an agent's clock to the core's by the best of the last exchanges.
#[derive(Debug, Clone, Default)]
pub struct AgentClock {
    exchanges: VecDeque<Exchange>,
}

impl AgentClock {
    /// Takes the answer to a beat, received at `now` on the core's clock. Ignores one with impossible times.
    pub fn receive(&mut self, now: Timestamp, echo: Echo) {
        let Some(exchange) = Exchange::new(now, echo) else { return };
        if self.exchanges.len() == WINDOW {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back(exchange);
    }

    /// Converts a time of the agent's clock; `None` before the first exchange.
    pub fn to_core(&self, agent_ns: u64) -> Option<ReadingTime> {
        self.exchanges.iter().map(|exchange| exchange.to_core(agent_ns)).min_by_key(|time| time.error)
    }

    /// Forgets all exchanges, as for an agent that has another clock because it was started anew, or whose machine slept.
    pub(crate) fn reset(&mut self) {
        self.exchanges.clear();
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn any_times_are_taken(now: u64, sent_ns: u64, received_ns: u64, replied_ns: u64, at: u64) {
            let mut clock = AgentClock::default();
            clock.receive(Timestamp::from_nanos(now), Echo { sent_ns, received_ns, replied_ns });
            clock.to_core(at);
        }
    }
}
