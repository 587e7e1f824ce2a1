//! Streams of events to plug-ins that virtual time waits for.

use std::sync::Arc;

use cotorra_graph::{Event, PluginId, SensorId, Stamped, Timestamp};
use cotorra_measurements::Kind;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

use crate::domain::{self, DomainView};

/// The events that a reader of a stream receives: those that its domain sees, of the requested kinds. Without a restriction
/// it receives all.
#[derive(Debug, Default)]
pub(crate) struct EventFilter {
    /// The reader's domain; `None` for the operator.
    pub(crate) view: Option<Arc<DomainView>>,
    pub(crate) kinds: Option<Vec<Kind>>,
    /// Names of the sensors whose readings are requested.
    pub(crate) sensors: Option<Vec<SensorId>>,
}

impl EventFilter {
    /// Returns an event as the reader sees it, or `None` if it does not receive it.
    pub(crate) fn apply(&self, event: &Arc<Stamped>) -> Option<Arc<Stamped>> {
        let seen = domain::seen(self.view.as_deref(), event)?;
        self.includes(&seen.event).then_some(seen)
    }

    fn includes(&self, event: &Event) -> bool {
        let is_of_sensor = |sensors: &Vec<SensorId>| match event {
            Event::Sensor(reading) => sensors.contains(&reading.sensor),
            _ => true,
        };
        self.kinds.as_ref().is_none_or(|kinds| kinds.contains(&Kind::of(event)))
            && self.sensors.as_ref().is_none_or(is_of_sensor)
    }
}

/// A message on the stream of a plug-in that virtual time waits for.
pub(crate) enum PluginMessage {
    Event(Arc<Stamped>),
    /// The plug-in has all events up to now. Time stands still until it returns the mark.
    Mark {
        number: u64,
        now: Timestamp,
    },
}

/// The sending end of a stream to a plug-in that virtual time waits for.
pub(crate) struct Follower {
    pub(crate) plugin: PluginId,
    filter: EventFilter,
    sender: UnboundedSender<PluginMessage>,
}

impl Follower {
    /// Opens a stream to a plug-in, and returns both ends.
    pub(crate) fn new(plugin: PluginId, filter: EventFilter) -> (Self, UnboundedReceiver<PluginMessage>) {
        let (sender, receiver) = unbounded_channel();
        (Self { plugin, filter, sender }, receiver)
    }

    /// Returns an event as the plug-in sees it, or `None` if it does not receive it.
    pub(crate) fn sees(&self, event: &Arc<Stamped>) -> Option<Arc<Stamped>> {
        self.filter.apply(event)
    }

    /// Sends a message. Returns false if the reader is gone.
    pub(crate) fn send(&self, message: PluginMessage) -> bool {
        self.sender.send(message).is_ok()
    }

    /// Whether the reader is gone.
    pub(crate) fn is_gone(&self) -> bool {
        self.sender.is_closed()
    }
}
