//! The node's thread: it handles discovery, receives messages of peers, and sends queued messages.

use std::{io, sync::Arc};

use rustdds::{
    DomainParticipantStatusListener, StatusEvented,
    mio1::{Events, Interest, Poll, Token, Waker},
};

use super::shared::{RETRY, Shared};

const WAKER: Token = Token(0);
const DISCOVERY: Token = Token(1);
/// First identifier of other event sources.
pub const FIRST_ID: usize = 2;

/// Returns the thread's poll and its waker.
pub fn poll() -> io::Result<(Poll, Waker)> {
    let poll = Poll::new()?;
    let waker = Waker::new(poll.registry(), WAKER)?;
    Ok((poll, waker))
}

/// The node's thread.
pub struct Engine {
    poll: Poll,
    discovery: DomainParticipantStatusListener,
    shared: Arc<Shared>,
}

impl Engine {
    pub fn new(
        poll: Poll,
        mut discovery: DomainParticipantStatusListener,
        shared: Arc<Shared>,
    ) -> io::Result<Self> {
        poll.registry().register(discovery.as_status_source_mio1(), DISCOVERY, Interest::READABLE)?;
        Ok(Self { poll, discovery, shared })
    }

    pub fn run(mut self) {
        let mut events = Events::with_capacity(64);
        let mut timeout = None;
        while !self.shared.is_stopped() {
            if let Err(error) = self.poll.poll(&mut events, timeout)
                && error.kind() != io::ErrorKind::Interrupted
            {
                tracing::error!("{}: stops receiving: {error}", self.shared.names.node());
                return;
            }
            // First discovery, then messages.
            while let Some(event) = self.discovery.try_recv_status() {
                self.shared.graph.lock().apply(event);
            }
            let (subscriptions, publications) = {
                let state = self.shared.state.lock();
                let subscriptions = events.iter().filter_map(|event| state.readers.get(&event.token().0));
                let publications: Vec<_> = state.publications.values().cloned().collect();
                (subscriptions.cloned().collect::<Vec<_>>(), publications)
            };
            for (subscription, kind) in subscriptions {
                subscription.take(kind, &self.shared.graph);
            }
            let waits = publications.iter().filter(|publication| publication.flush(&self.shared)).count() > 0;
            timeout = waits.then_some(RETRY);
        }
    }
}
