//! One fan-out of events, for runs in real time, runs in virtual time, and replays.

use std::sync::Arc;

use cotorra_graph::Stamped;
use cotorra_recording::Tap;
use cotorra_robot_middleware::{SensedData, SensedScan};

use super::{live::Live, stream::EventStream};
use crate::history::keeping::Keeper;

/// The receivers of a run's events and data. No receiver can hold the others up: each says itself what it missed.
#[derive(Default)]
pub(crate) struct Fanout {
    /// The state and the streams of the API, if it is served.
    pub(crate) api: Option<(Live, EventStream)>,
    /// The recording for files and viewers.
    pub(crate) tap: Option<Tap>,
    /// The store of sensors' large data.
    pub(crate) keeper: Option<Keeper>,
    /// Records an event in the history.
    pub(crate) history: Option<Box<dyn FnMut(Stamped) + Send>>,
}

impl Fanout {
    /// Passes an event on to each receiver once. `tell` gives it to those that belong to the kind of run, such as plug-ins,
    /// which find it in the API's state already.
    pub(crate) fn publish(&mut self, event: Arc<Stamped>, tell: impl FnOnce(&Arc<Stamped>)) {
        if let Some((live, _)) = &self.api {
            live.absorb(&event);
        }
        tell(&event);
        if let Some((_, stream)) = &self.api {
            stream.send(Arc::clone(&event));
        }
        if let Some(tap) = &self.tap {
            tap.event(Arc::clone(&event));
        }
        if let Some(record) = &mut self.history {
            record(Arc::unwrap_or_clone(event));
        }
    }

    /// Passes a turn of a lidar on.
    pub(crate) fn scan(&self, scan: SensedScan) {
        if let Some(tap) = &self.tap {
            tap.scan(scan);
        }
    }

    /// Stores large data. Call this before the data's event is published: readers of the event may ask for it.
    pub(crate) fn data(&self, data: SensedData) {
        if let Some(keeper) = &self.keeper {
            keeper.keep(data);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{
        pin::Pin,
        sync::mpsc,
        task::{Context, Poll, Waker},
    };

    use cotorra_graph::{Event, Timestamp};
    use tokio_stream::Stream as _;

    use super::*;
    use crate::events::stream::{EventReader, Received};

    const EVENTS: u64 = 5000;

    fn events() -> impl Iterator<Item = Stamped> {
        (1..=EVENTS).map(|number| Stamped {
            at: Timestamp::from_nanos(number),
            event: Event::Notice { message: number.to_string() },
        })
    }

    /// Returns the events that wait for a reader, and how many it missed before.
    fn received(mut reader: EventReader) -> (Vec<Stamped>, u64) {
        let (mut all, mut missed) = (Vec::new(), 0);
        let mut context = Context::from_waker(Waker::noop());
        while let Poll::Ready(Some(received)) = Pin::new(&mut reader).poll_next(&mut context) {
            match received {
                Received::Event(event) => all.push(Stamped::clone(&event)),
                Received::Missed(events) => missed += events,
            }
        }
        (all, missed)
    }

    #[test]
    fn each_receiver_has_each_event_once_and_in_order() {
        let (live, stream) = (Live::default(), EventStream::default());
        let (mut prompt, slow) = (stream.subscribe(), stream.subscribe());
        let (recorder, recorded) = mpsc::channel();
        let history: Box<dyn FnMut(Stamped) + Send> = Box::new(move |event| recorder.send(event).unwrap());
        let api = Some((live.clone(), stream));
        let mut fanout = Fanout { api, history: Some(history), ..Fanout::default() };
        let (mut told, mut read) = (Vec::new(), Vec::new());
        for event in events() {
            let at = event.at;
            fanout.publish(Arc::new(event), |event| {
                assert_eq!(live.read(|state| state.at), at, "the state has what plug-ins are told");
                told.push(Stamped::clone(event));
            });
            read.extend(prompt.waiting().map(Arc::unwrap_or_clone));
        }
        drop(fanout);
        let all: Vec<_> = events().collect();
        assert_eq!(told, all);
        assert_eq!(read, all);
        assert_eq!(recorded.iter().collect::<Vec<_>>(), all);
        let (newest, missed) = received(slow);
        assert!(missed > 0, "a reader that is far behind is told how many events it missed");
        assert_eq!(newest, all[missed as usize..]);
    }

    #[test]
    fn events_without_receivers_are_told_all_the_same() {
        let mut told = 0;
        events().for_each(|event| Fanout::default().publish(Arc::new(event), |_| told += 1));
        assert_eq!(told, EVENTS);
    }
}
