//! Events to a program that is away from the core, in real time. The API sends them to it when they have arrived there.

use std::sync::{Arc, Weak};

use cotorra_graph::Stamped;
use parking_lot::Mutex;

use super::{
    follower::EventFilter,
    stream::{EventReader, EventStream},
};

/// The stream of a program. Clones are the same stream.
#[derive(Clone, Default)]
pub(crate) struct DistantStream {
    arrived: EventStream,
    /// The events that its readers want.
    wanted: Arc<Mutex<Vec<Weak<EventFilter>>>>,
}

impl DistantStream {
    /// Returns a reader of events that arrive from now on. Those that pass the filter set off to it as long as it is held.
    pub(crate) fn subscribe(&self, filter: &Arc<EventFilter>) -> EventReader {
        self.wanted.lock().push(Arc::downgrade(filter));
        self.arrived.subscribe()
    }

    /// Whether a reader wants an event.
    pub(crate) fn wants(&self, event: &Arc<Stamped>) -> bool {
        let mut wanted = self.wanted.lock();
        wanted.retain(|filter| filter.strong_count() > 0);
        wanted.iter().filter_map(Weak::upgrade).any(|filter| filter.apply(event).is_some())
    }

    /// Passes an event on that has arrived. Readers apply their filters to it.
    pub(crate) fn arrive(&self, event: Arc<Stamped>) {
        self.arrived.send(event);
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Event, Timestamp};
    use cotorra_measurements::Kind;

    use super::*;

    #[test]
    fn events_are_wanted_while_a_reader_follows_that_asks_for_their_kind() {
        let stream = DistantStream::default();
        let notice = Event::Notice { message: String::new() };
        let event = Arc::new(Stamped { at: Timestamp::ZERO, event: notice });
        assert!(!stream.wants(&event), "nobody follows");
        let of = |kind: Kind| Arc::new(EventFilter { kinds: Some(vec![kind]), ..EventFilter::default() });
        let (robots, notices) = (of(Kind::Robot), of(Kind::Notice));
        let _reader = stream.subscribe(&robots);
        assert!(!stream.wants(&event));
        let mut reader = stream.subscribe(&notices);
        assert!(stream.wants(&event) && reader.waiting().is_none(), "it has not arrived yet");
        stream.arrive(Arc::clone(&event));
        assert_eq!(reader.waiting(), Some(Arc::clone(&event)));
        drop(notices);
        assert!(!stream.wants(&event), "its reader is gone");
    }
}
