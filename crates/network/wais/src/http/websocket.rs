//! WebSockets for consumers that cannot be called back. Each notification is a text message.

use std::{collections::HashMap, sync::Arc, time::Duration};

use axum::{
    extract::{
        State, WebSocketUpgrade,
        ws::{Message, WebSocket, rejection::WebSocketUpgradeRejection},
    },
    http::StatusCode,
    response::{IntoResponse, Response},
};
use cotorra_mec::{Outcome, Problem};
use parking_lot::Mutex;
use tokio::sync::{mpsc, oneshot};

use super::{Service, extract::Id};
use crate::wais::RequestError;

/// Longest accepted message, bytes. Consumers have nothing longer to send.
const LONGEST_MESSAGE: usize = 4096;
/// Time after which a consumer that accepts no data is disconnected.
const PATIENCE: Duration = Duration::from_secs(5);

/// A notification, and a channel to confirm that it was sent.
type Outgoing = (Arc<str>, oneshot::Sender<()>);

/// Open WebSockets by subscription. The number distinguishes an older one from a newer.
type Open = HashMap<u64, (u64, mpsc::Sender<Outgoing>)>;

/// Open WebSockets, and the last number assigned.
#[derive(Debug, Default)]
pub(super) struct Sockets(Mutex<(u64, Open)>);

impl Sockets {
    fn with<R>(
        &self,
        act: impl FnOnce(&mut u64, &mut HashMap<u64, (u64, mpsc::Sender<Outgoing>)>) -> R,
    ) -> R {
        let mut open = self.0.lock();
        let (last, sockets) = &mut *open;
        act(last, sockets)
    }

    /// Closes the WebSockets of subscriptions that have ended.
    pub(super) fn keep(&self, is_active: impl Fn(u64) -> bool) {
        self.with(|_, sockets| sockets.retain(|subscription, _| is_active(*subscription)));
    }

    pub(super) async fn send(&self, subscription: u64, body: Arc<str>) -> Outcome {
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

/// Opens the WebSocket of a subscription, and closes an older one.
pub(super) async fn open(
    State(service): State<Service>,
    Id(id): Id,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let not_found = || RequestError::NotFound { what: "WebSocket of a subscription", id: id.clone() };
    let subscription: u64 = id.parse().map_err(|_| not_found())?;
    if !service.with(|wais| wais.has_websocket(subscription)) {
        return Err(not_found().into());
    }
    let upgrade = upgrade.map_err(|rejection| {
        let status = rejection.status();
        let status = if status.is_client_error() { status } else { StatusCode::BAD_REQUEST };
        Problem::new(status, format!("this opens a WebSocket: {}", rejection.body_text()))
    })?;
    let upgrade = upgrade.max_message_size(LONGEST_MESSAGE);
    Ok(upgrade.on_upgrade(move |socket| attend(service, subscription, socket)).into_response())
}

async fn attend(service: Service, subscription: u64, mut socket: WebSocket) {
    let (sender, mut outgoing) = mpsc::channel(1);
    let own = service.sockets().with(|last, sockets| {
        *last += 1;
        sockets.insert(subscription, (*last, sender));
        *last
    });
    service.set_websocket_open(subscription, true);
    loop {
        tokio::select! {
            next = outgoing.recv() => {
                // A newer WebSocket took its place, or the subscription has ended.
                let Some((body, sent)) = next else { break };
                let message = Message::text(body.to_string());
                match tokio::time::timeout(PATIENCE, socket.send(message)).await {
                    Ok(Ok(())) => drop(sent.send(())),
                    _ => break,
                }
            }
            // Messages from the consumer only show that it is alive. Pings are answered automatically.
            received = socket.recv() => match received {
                Some(Ok(Message::Close(_)) | Err(_)) | None => break,
                Some(Ok(_)) => {}
            }
        }
    }
    let was_last = service.sockets().with(|_, sockets| {
        let is_own = sockets.get(&subscription).is_some_and(|(number, _)| *number == own);
        is_own && sockets.remove(&subscription).is_some()
    });
    if was_last {
        service.set_websocket_open(subscription, false);
    }
    let _ = tokio::time::timeout(PATIENCE, socket.send(Message::Close(None))).await;
}
