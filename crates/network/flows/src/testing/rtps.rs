//! Builds messages of DDS's wire protocol for tests.

use crate::rtps::{Guid, Identity, PUBLICATIONS_WRITER};

pub(crate) const CUSTOM_RELATED: u16 = 0x800f;
pub(crate) const RELATED: u16 = 0x0083;

/// Returns the GUID of a participant's writer or reader.
pub(crate) fn guid(participant: u8, entity: u8) -> Guid {
    let mut guid = [participant; 16];
    guid[12..].copy_from_slice(&[0, 0, entity, 3]);
    guid
}

/// A message of a participant, in either byte order.
#[derive(Clone)]
pub(crate) struct Message {
    pub bytes: Vec<u8>,
    is_little: bool,
}

impl Message {
    pub fn of(participant: u8, is_little: bool) -> Self {
        let mut bytes = b"RTPS\x02\x03\x01\x10".to_vec();
        bytes.extend_from_slice(&[participant; 12]);
        Self { bytes, is_little }
    }

    fn order<const N: usize>(&self, mut big: [u8; N]) -> [u8; N] {
        if self.is_little {
            big.reverse();
        }
        big
    }

    fn n16(&self, number: u16) -> [u8; 2] {
        self.order(number.to_be_bytes())
    }

    fn n32(&self, number: u32) -> [u8; 4] {
        self.order(number.to_be_bytes())
    }

    fn sequence(&self, sequence: u64) -> Vec<u8> {
        [self.n32((sequence >> 32) as u32), self.n32(sequence as u32)].concat()
    }

    pub fn submessage(mut self, kind: u8, flags: u8, body: &[u8]) -> Self {
        self.bytes.extend_from_slice(&[kind, flags | u8::from(self.is_little)]);
        self.bytes.extend_from_slice(&self.n16(body.len() as u16));
        self.bytes.extend_from_slice(body);
        self
    }

    /// Builds a parameter of a list.
    pub fn parameter(&self, id: u16, value: &[u8]) -> Vec<u8> {
        [&self.n16(id)[..], &self.n16(value.len() as u16), value].concat()
    }

    pub fn related(&self, id: u16, identity: Identity) -> Vec<u8> {
        self.parameter(id, &[&identity.writer[..], &self.sequence(identity.sequence)].concat())
    }

    /// Adds a sample with parameters.
    pub fn data(self, writer: Guid, sequence: u64, parameters: &[u8], payload: &[u8]) -> Self {
        let mut body =
            [&[0, 0][..], &self.n16(16), &[0; 4], &writer[12..], &self.sequence(sequence)].concat();
        if !parameters.is_empty() {
            body.extend_from_slice(parameters);
            body.extend_from_slice(&self.parameter(1, b""));
        }
        body.extend_from_slice(payload);
        self.submessage(0x15, 0x04 | if parameters.is_empty() { 0 } else { 0x02 }, &body)
    }

    /// Adds a fragment of a sample, numbered from 0, `size` bytes each.
    pub fn fragment(self, writer: Guid, sequence: u64, number: usize, size: usize, sample: &[u8]) -> Self {
        self.fragment_with(b"", writer, sequence, number, size, sample)
    }

    /// Adds a fragment with parameters.
    pub fn fragment_with(
        self,
        parameters: &[u8],
        writer: Guid,
        sequence: u64,
        number: usize,
        size: usize,
        sample: &[u8],
    ) -> Self {
        let mut body =
            [&[0, 0][..], &self.n16(28), &[0; 4], &writer[12..], &self.sequence(sequence)].concat();
        body.extend_from_slice(&self.n32(number as u32 + 1));
        body.extend_from_slice(&self.n16(1));
        body.extend_from_slice(&self.n16(size as u16));
        body.extend_from_slice(&self.n32(sample.len() as u32));
        let has_parameters = !parameters.is_empty();
        if has_parameters {
            body.extend_from_slice(parameters);
            body.extend_from_slice(&self.parameter(1, b""));
        }
        body.extend_from_slice(sample.chunks(size).nth(number).unwrap());
        self.submessage(0x16, if has_parameters { 0x02 } else { 0 }, &body)
    }

    /// Adds the announcement of a writer on a topic.
    pub fn announce(self, writer: Guid, topic: &str) -> Self {
        let mut name = self.n32(topic.len() as u32 + 1).to_vec();
        name.extend_from_slice(topic.as_bytes());
        name.resize(name.len().next_multiple_of(4) + 4, 0);
        let payload = [
            &[0, 2 + u8::from(self.is_little), 0, 0][..],
            &self.parameter(0x0005, &name),
            &self.parameter(0x0007, b"any type"),
            &self.parameter(0x005a, &writer),
            &self.parameter(1, b""),
        ]
        .concat();
        let mut announcer = writer;
        announcer[12..].copy_from_slice(&PUBLICATIONS_WRITER);
        self.data(announcer, 1, b"", &payload)
    }

    /// Adds the encapsulation header to data.
    pub fn serialized(&self, body: &[u8]) -> Vec<u8> {
        [&[0, u8::from(self.is_little), 0, 0][..], body].concat()
    }

    /// Adds the headers of `rmw_cyclonedds`: the client and the number of its call.
    pub fn cyclone(&self, client: u64, call: u64, body: &[u8]) -> Vec<u8> {
        let [client, call] = [client, call].map(|number| self.order(number.to_be_bytes()));
        self.serialized(&[&client[..], &call, body].concat())
    }
}
