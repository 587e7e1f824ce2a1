//! Refused connections of agents, in words that help. Zenoh logs each of them as a lack of open files.

use std::{
    collections::BTreeSet,
    fmt,
    sync::mpsc::{self, SyncSender},
    thread,
};

use tracing::{Event, Subscriber, field::Field};
use tracing_subscriber::{
    Layer,
    filter::{LevelFilter, Targets},
    layer::Context,
};

/// Where Zenoh reports failed handshakes.
const ZENOH: &str = "zenoh_link_tls";
/// What it adds to the reason.
const HINT: &str = ". Hint: increase the system open file limit.";
/// Most reasons that are reported. Each is reported once.
const MOST: usize = 32;

/// A layer that reports each reason for which connections of agents are refused.
pub struct Refusals(SyncSender<String>);

/// Returns the layer with its filter. Reasons are logged by a thread of its own, because a layer cannot log.
pub fn refusals<S: Subscriber + for<'a> tracing_subscriber::registry::LookupSpan<'a>>() -> impl Layer<S> {
    let (reasons, inbox) = mpsc::sync_channel::<String>(MOST);
    let report = move || {
        let mut known = BTreeSet::new();
        for reason in inbox {
            if known.len() < MOST && known.insert(reason.clone()) {
                tracing::warn!(
                    "refused a connection of an agent: {reason}; `cotorra-agent check` there says what to do"
                );
            }
        }
    };
    // Without the thread, the run's log lacks these lines only.
    let _ = thread::Builder::new().name("refusals".to_owned()).spawn(report);
    Refusals(reasons).with_filter(Targets::new().with_target(ZENOH, LevelFilter::WARN))
}

impl<S: Subscriber> Layer<S> for Refusals {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut reason = Reason(None);
        event.record(&mut reason);
        if let Some(reason) = reason.0 {
            // More at once than the thread takes come again with the next attempts.
            let _ = self.0.try_send(reason);
        }
    }
}

/// The reason in Zenoh's message.
struct Reason(Option<String>);

impl tracing::field::Visit for Reason {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}").strip_suffix(HINT).map(str::to_owned);
        }
    }
}
