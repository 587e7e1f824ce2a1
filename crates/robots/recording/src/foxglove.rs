//! Serves recorded messages live over Foxglove's WebSocket protocol. New viewers get the last message of each latched
//! topic at once, as in ROS 2.

use std::{collections::BTreeMap, net::SocketAddr, sync::Arc};

use foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServer, WebSocketServerHandle,
    websocket::{ChannelView, Client, ServerListener},
};
use parking_lot::Mutex;

use crate::{
    channel::{Encoded, Qos},
    sink::{RecordingError, Sink},
};

/// A server that viewers connect to.
pub(crate) struct FoxgloveServer {
    context: Arc<Context>,
    server: Option<WebSocketServerHandle>,
    /// Foxglove's channels, by the index of ours.
    opened: Vec<Arc<RawChannel>>,
    latched: Arc<Latched>,
}

/// The last message of each latched topic.
#[derive(Default)]
struct Latched(Mutex<BTreeMap<String, Last>>);

struct Last {
    channel: Arc<RawChannel>,
    at: PartialMetadata,
    payload: Vec<u8>,
}

impl FoxgloveServer {
    /// Serves the testbed `name`. Returns the server and its address; port 0 chooses a free one.
    pub fn start(address: SocketAddr, name: &str) -> Result<(Self, SocketAddr), RecordingError> {
        let (context, latched) = (Context::new(), Arc::new(Latched::default()));
        let server = WebSocketServer::new()
            .name(format!("cotorra: {name}"))
            .context(&context)
            .listener(Arc::clone(&latched) as Arc<dyn ServerListener>)
            .bind(address.ip().to_string(), address.port())
            .start_blocking()
            .map_err(|error| RecordingError::Serve { address, reason: error.to_string() })?;
        let address = SocketAddr::new(address.ip(), server.port());
        Ok((Self { context, server: Some(server), opened: Vec::new(), latched }, address))
    }
}

impl Sink for FoxgloveServer {
    fn write(&mut self, message: &Encoded<'_>) -> Result<(), RecordingError> {
        let Encoded { channel, at, payload } = *message;
        if channel.index >= self.opened.len() {
            let schema = Schema::new(channel.type_name, "ros2msg", channel.schema.clone().into_bytes());
            let opened = ChannelBuilder::new(channel.topic.as_str())
                .message_encoding("cdr")
                .schema(schema)
                .metadata(channel.metadata())
                .context(&self.context)
                .build_raw()
                .expect("a channel with a known encoding can be created");
            self.opened.push(opened);
        }
        let opened = &self.opened[channel.index];
        let at = PartialMetadata::with_log_time(at.as_nanos());
        if channel.qos == Qos::Latched {
            let last = Last { channel: Arc::clone(opened), at, payload: payload.to_vec() };
            self.latched.0.lock().insert(channel.topic.clone(), last);
        }
        opened.log_with_meta(payload, at);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), RecordingError> {
        if let Some(server) = self.server.take() {
            server.stop().wait_blocking();
        }
        Ok(())
    }
}

impl ServerListener for Latched {
    fn on_subscribe(&self, client: Client, channel: ChannelView<'_>) {
        if let Some(last) = self.0.lock().get(channel.topic()) {
            last.channel.log_with_meta_to_sink(&last.payload, last.at, client.sink_id());
        }
    }
}
