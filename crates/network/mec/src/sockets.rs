//! Open WebSockets for consumers that cannot be called back.

use std::{collections::HashMap, sync::Arc};

use parking_lot::Mutex;
use tokio::sync::{mpsc, oneshot};

use crate::outbox::Outcome;

/// A notification, and a channel to confirm that it was sent.
type Outgoing = (Arc<str>, oneshot::Sender<()>);

/// Open WebSockets by subscription. The number distinguishes an older one from a newer.
type Open = HashMap<u64, (u64, mpsc::Sender<Outgoing>)>;

/// Open WebSockets, and the last number assigned.
#[derive(Debug, Default)]
pub(crate) struct Sockets(Mutex<(u64, Open)>);

impl Sockets {
    pub(crate) fn with<R>(
        &self,
        act: impl FnOnce(&mut u64, &mut HashMap<u64, (u64, mpsc::Sender<Outgoing>)>) -> R,
    ) -> R {
        let mut open = self.0.lock();
        let (last, sockets) = &mut *open;
        act(last, sockets)
    }

    /// Closes the WebSockets of subscriptions that have ended.
    pub(crate) fn keep(&self, is_active: impl Fn(u64) -> bool) {
        self.with(|_, sockets| sockets.retain(|subscription, _| is_active(*subscription)));
    }

    pub(crate) async fn send(&self, subscription: u64, body: Arc<str>) -> Outcome {
        let closed = || Outcome::Failed("the WebSocket is closed".to_owned());
        let sender = self.with(|_, sockets| sockets.get(&subscription).map(|(_, sender)| sender.clone()));
        let Some(sender) = sender else { return closed() };
        let (sent, was_sent) = oneshot::channel();
        if sender.send((body, sent)).await.is_err() {
            return closed();
        }
        was_sent.await.map_or_else(|_| closed(), |()| Outcome::Delivered)
    }
}
