//! Passes encoded messages through RustDDS. They are decoded by `cotorra-ros-messages`, after their type was checked.

use std::convert::Infallible;

use rustdds::{
    RepresentationIdentifier,
    bytes::Bytes,
    no_key::{DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter, SimpleDataReader},
};

/// Length of the encapsulation header, which names the encoding.
const ENCAPSULATION_LEN: usize = 4;

/// Reads messages from RustDDS.
pub type Reader = SimpleDataReader<Vec<u8>, Plain>;
/// Writes messages to RustDDS.
pub type Writer = DataWriter<Bytes, Plain>;

/// Passes encoded messages through, with their encapsulation header.
#[derive(Debug, Clone, Copy)]
pub struct Plain;

/// Returns an encoded message without its encapsulation header, which RustDDS writes itself.
pub fn body(encoded: Vec<u8>) -> Bytes {
    Bytes::from(encoded).slice(ENCAPSULATION_LEN..)
}

impl SerializerAdapter<Bytes> for Plain {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(body: &Bytes) -> Result<Bytes, Infallible> {
        Ok(body.clone())
    }
}

impl DeserializerAdapter<Vec<u8>> for Plain {
    type Error = Infallible;
    type Decoded = Vec<u8>;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: Vec<u8>) -> Vec<u8> {
        decoded
    }
}

impl DefaultDecoder<Vec<u8>> for Plain {
    type Decoder = Self;
    const DECODER: Self = Self;
}

impl<'de> Decode<'de, Vec<u8>> for Plain {
    type Error = Infallible;

    fn decode_bytes(
        self,
        body: &'de [u8],
        encoding: RepresentationIdentifier,
    ) -> Result<Vec<u8>, Infallible> {
        let little = u8::from(encoding == RepresentationIdentifier::CDR_LE);
        let mut encoded = Vec::with_capacity(ENCAPSULATION_LEN + body.len());
        encoded.extend_from_slice(&[0, little, 0, 0]);
        encoded.extend_from_slice(body);
        Ok(encoded)
    }
}
