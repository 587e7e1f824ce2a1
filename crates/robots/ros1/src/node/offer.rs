//! Services that a node offers.

use std::sync::mpsc;

use cotorra_ros_messages::Message;
use mio::Token;

use crate::tcpros::{self, Header};

/// A service that the node offers.
#[derive(Debug)]
pub(super) struct Offer {
    pub name: String,
    pub kind: &'static str,
    pub request_kind: &'static str,
    pub response_kind: &'static str,
    pub md5sum: String,
    /// Requests and their clients, to the service's thread.
    pub requests: mpsc::Sender<(Token, Vec<u8>)>,
}

impl Offer {
    /// The answer to a client's connection header.
    pub fn header(&self, node: &str) -> Header {
        Header::new([
            ("callerid", node),
            ("service", &self.name),
            ("type", self.kind),
            ("request_type", self.request_kind),
            ("response_type", self.response_kind),
            ("md5sum", &self.md5sum),
        ])
    }
}

/// Encodes a service's answer: whether it succeeded, then the response or the reason, with its length.
pub(super) fn response<M: Message>(answer: Result<M, String>) -> Vec<u8> {
    let framed = match &answer {
        Ok(response) => tcpros::frame(|buffer| response.encode_ros1(buffer)),
        Err(reason) => tcpros::frame(|buffer| buffer.extend_from_slice(reason.as_bytes())),
    };
    [&[u8::from(answer.is_ok())], framed.as_slice()].concat()
}
