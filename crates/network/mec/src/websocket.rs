//! Opens WebSockets of subscriptions, and sends what waits. Each notification is a text message.

use std::time::Duration;

use axum::{
    extract::{
        State, WebSocketUpgrade,
        ws::{Message, WebSocket, rejection::WebSocketUpgradeRejection},
    },
    http::StatusCode,
    response::{IntoResponse, Response},
};
use tokio::sync::mpsc;

use crate::{
    extract::Id,
    problem::Problem,
    service::{Machine, Service},
    subscribing::RequestError,
};

/// Longest accepted message, bytes. Consumers have nothing longer to send.
const LONGEST_MESSAGE: usize = 4096;
/// Time after which a consumer that accepts no data is disconnected.
const PATIENCE: Duration = Duration::from_secs(5);

/// Opens the WebSocket of a subscription, and closes an older one.
pub(crate) async fn open<M: Machine>(
    State(service): State<Service<M>>,
    Id(id): Id,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let not_found = || RequestError::NotFound { what: "WebSocket of a subscription", id: id.clone() };
    let subscription: u64 = id.parse().map_err(|_| not_found())?;
    if !service.with(|machine| machine.subscriptions().has_websocket(subscription)) {
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

async fn attend<M: Machine>(service: Service<M>, subscription: u64, mut socket: WebSocket) {
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
