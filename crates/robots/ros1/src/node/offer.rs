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
    /// Requests, and whose they are, to the service's thread.
    pub requests: mpsc::Sender<(Token, Vec<u8>)>,
}

impl Offer {
    /// What a client's connection header is answered with.
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

/// What a service answers: whether it worked, then the response or the reason, with its length.
pub(super) fn response<M: Message>(answer: Result<M, String>) -> Vec<u8> {
    let framed = match &answer {
        Ok(response) => tcpros::frame(|buffer| response.encode_ros1(buffer)),
        Err(reason) => tcpros::frame(|buffer| buffer.extend_from_slice(reason.as_bytes())),
    };
    [&[u8::from(answer.is_ok())], framed.as_slice()].concat()
}
