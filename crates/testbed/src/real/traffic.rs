//! Traffic of links whose packets bypass the fabric. The kernel counts it from the beginning, and λ is the difference
//! between two readings.

use std::collections::HashMap;

use cotorra_graph::{Direction, LinkContext, LinkCounters, LinkId, Timestamp};
use parking_lot::Mutex;

/// The counters of links, by direction.
pub(crate) type TrafficCounters = HashMap<(LinkId, Direction), LinkCounters>;

/// The traffic of links at the last reading.
#[derive(Debug, Default)]
pub(crate) struct Traffic(Mutex<Reading>);

/// The time and the bytes of the last reading.
#[derive(Debug, Default)]
struct Reading {
    at: Timestamp,
    bytes: HashMap<(LinkId, Direction), u64>,
}

impl Traffic {
    /// Completes the contexts of counted links with the counters, and with λ since the last reading. A reading of `all`
    /// links begins a new interval; one of a single link does not.
    pub(crate) fn complete(
        &self,
        now: Timestamp,
        contexts: &mut [LinkContext],
        counted: &TrafficCounters,
        all: bool,
    ) {
        let mut last = self.0.lock();
        let seconds = now.since(last.at).as_secs_f64();
        for context in contexts {
            let key = (context.link.clone(), context.direction);
            let Some(counters) = counted.get(&key) else { continue };
            let before = last.bytes.get(&key).copied().unwrap_or(0);
            if seconds > 0.0 {
                context.throughput_bps = counters.bytes.saturating_sub(before) as f64 * 8.0 / seconds;
            }
            context.counters = *counters;
        }
        if all {
            let bytes = counted.iter().map(|(key, counters)| (key.clone(), counters.bytes)).collect();
            *last = Reading { at: now, bytes };
        }
    }
}
