//! Events to readers that may be slow: the API's streams, and services that follow the run. The newest are kept, up to a
//! number and to bytes in memory. A reader that is further behind misses the oldest.

use std::{
    collections::VecDeque,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, ready},
};

use cotorra_graph::Stamped;
use parking_lot::Mutex;
use tokio::sync::broadcast;
use tokio_stream::{
    Stream,
    wrappers::{BroadcastStream, errors::BroadcastStreamRecvError},
};

/// The most events that wait for a reader.
const MOST: usize = 4096;
/// The most bytes of events that wait for a reader.
const MOST_BYTES: usize = 16 << 20;

/// The sending end. Clones send to the same readers.
#[derive(Clone)]
pub(crate) struct EventStream {
    sender: broadcast::Sender<Arc<Slot>>,
    kept: Arc<Mutex<Kept>>,
}

/// An event, until it has to make room for newer ones.
struct Slot(Mutex<Option<Arc<Stamped>>>);

/// The events that are kept, the oldest first.
#[derive(Default)]
struct Kept {
    slots: VecDeque<(Arc<Slot>, usize)>,
    bytes: usize,
}

impl Kept {
    fn pop(&mut self) {
        if let Some((slot, bytes)) = self.slots.pop_front() {
            slot.0.lock().take();
            self.bytes -= bytes;
        }
    }
}

impl Default for EventStream {
    fn default() -> Self {
        Self { sender: broadcast::channel(MOST).0, kept: Arc::default() }
    }
}

impl EventStream {
    /// Sends an event to all readers. Returns their number.
    pub(crate) fn send(&self, event: Arc<Stamped>) -> usize {
        let mut kept = self.kept.lock();
        if self.sender.receiver_count() == 0 {
            *kept = Kept::default();
            return 0;
        }
        let bytes = event.event.bytes();
        let slot = Arc::new(Slot(Mutex::new(Some(event))));
        kept.bytes += bytes;
        kept.slots.push_back((Arc::clone(&slot), bytes));
        while kept.slots.len() > MOST || kept.bytes > MOST_BYTES {
            kept.pop();
        }
        // Under the lock, so that readers have the events in the order in which they are kept.
        self.sender.send(slot).unwrap_or_default()
    }

    /// Returns a reader of all events from now on.
    pub(crate) fn subscribe(&self) -> EventReader {
        EventReader { slots: BroadcastStream::new(self.sender.subscribe()), missed: 0, next: None }
    }

    /// Returns the number of readers.
    #[cfg(test)]
    pub(crate) fn readers(&self) -> usize {
        self.sender.receiver_count()
    }

    /// Returns the bytes of all events that are kept.
    #[cfg(test)]
    pub(crate) fn bytes(&self) -> usize {
        self.kept.lock().bytes
    }
}

/// The receiving end: a stream without an end before that of the run. Events missed in a row are one item.
pub(crate) struct EventReader {
    slots: BroadcastStream<Arc<Slot>>,
    missed: u64,
    /// The event after those that were missed.
    next: Option<Arc<Stamped>>,
}

/// Item of a reader's stream.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Received {
    Event(Arc<Stamped>),
    /// The number of events that it missed.
    Missed(u64),
}

impl Stream for EventReader {
    type Item = Received;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Received>> {
        if let Some(next) = self.next.take() {
            return Poll::Ready(Some(Received::Event(next)));
        }
        loop {
            // The newest event is always kept, so that one follows those that were missed.
            let event = match ready!(Pin::new(&mut self.slots).poll_next(context)) {
                Some(Ok(slot)) => slot.0.lock().clone(),
                Some(Err(BroadcastStreamRecvError::Lagged(missed))) => {
                    self.missed += missed;
                    continue;
                }
                None => return Poll::Ready(None),
            };
            let Some(event) = event else {
                self.missed += 1;
                continue;
            };
            return Poll::Ready(Some(match std::mem::take(&mut self.missed) {
                0 => Received::Event(event),
                missed => {
                    self.next = Some(event);
                    Received::Missed(missed)
                }
            }));
        }
    }
}

#[cfg(test)]
impl EventReader {
    /// Returns the next event if it waits already, and none was missed.
    pub(crate) fn waiting(&mut self) -> Option<Arc<Stamped>> {
        match Pin::new(self).poll_next(&mut Context::from_waker(std::task::Waker::noop())) {
            Poll::Ready(Some(Received::Event(event))) => Some(event),
            _ => None,
        }
    }

    /// Waits for the next event.
    pub(crate) fn wait(&mut self) -> Arc<Stamped> {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        match runtime.block_on(tokio_stream::StreamExt::next(self)) {
            Some(Received::Event(event)) => event,
            other => panic!("{other:?}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Event, Timestamp};

    use super::*;

    fn next(reader: &mut EventReader) -> Received {
        let next = Pin::new(reader).poll_next(&mut Context::from_waker(std::task::Waker::noop()));
        let Poll::Ready(Some(received)) = next else { panic!("an event waits") };
        received
    }

    fn notice(bytes: usize) -> Arc<Stamped> {
        Arc::new(Stamped { at: Timestamp::ZERO, event: Event::Notice { message: "x".repeat(bytes) } })
    }

    #[test]
    fn the_bytes_of_waiting_events_are_bounded_and_missed_ones_are_counted() {
        let stream = EventStream::default();
        let mut reader = stream.subscribe();
        for _ in 0..1000 {
            stream.send(notice(100_000));
            assert!(stream.bytes() <= MOST_BYTES, "{}", stream.bytes());
        }
        let Received::Missed(missed) = next(&mut reader) else { panic!("it is far behind") };
        let events = std::iter::from_fn(|| reader.waiting()).count();
        assert_eq!((missed as usize + events, stream.kept.lock().slots.len()), (1000, events));
        drop(reader);
        stream.send(notice(1));
        assert_eq!((stream.readers(), stream.bytes()), (0, 0), "nothing is kept for nobody");
    }

    #[test]
    fn many_small_events_are_bounded_by_number() {
        let stream = EventStream::default();
        let mut reader = stream.subscribe();
        (0..5000).for_each(|_| _ = stream.send(notice(1)));
        assert_eq!(next(&mut reader), Received::Missed(5000 - MOST as u64));
        assert_eq!(std::iter::from_fn(|| reader.waiting()).count(), MOST);
    }
}
