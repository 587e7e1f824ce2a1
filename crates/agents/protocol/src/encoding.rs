//! Encodes messages as JSON, and decodes those that are within bounds.

use cotorra_graph::{LinkId, Reached};
use serde::{Serialize, de::DeserializeOwned};

/// Error of a received message.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// It is longer than this kind of message can be.
    #[error("{bytes} bytes, of at most {most}")]
    TooLong { bytes: usize, most: usize },
    /// It is not of this protocol.
    #[error(transparent)]
    Malformed(#[from] serde_json::Error),
    /// It is more than a machine can run.
    #[error("{0} instances, of at most {MOST_INSTANCES}")]
    TooMany(usize),
    /// It is more than a core can want.
    #[error("{0} links, of at most {most}", most = Reached::MOST_VIA_AGENT)]
    TooManyLinks(usize),
    /// A link would be probed too often, or over too long a time.
    #[error("probes of `{0}` beyond the bounds")]
    Probes(LinkId),
    /// It is more than Wi-Fi interfaces can have.
    #[error("{number} {what}, of at most {most}")]
    TooMuchWifi { what: &'static str, number: usize, most: usize },
    /// No robot can say it.
    #[error("readings beyond those of a robot")]
    Impossible,
}

/// Most instances on one machine.
pub(crate) const MOST_INSTANCES: usize = 1024;

/// A message with a longest encoding.
pub(crate) trait Message: Serialize + DeserializeOwned {
    /// Longest encoding, bytes.
    const LONGEST: usize;

    /// Checks what its type does not say.
    fn check(&self) -> Result<(), MessageError> {
        Ok(())
    }
}

macro_rules! message {
    ($name:ident, $longest:expr $(, $check:expr)?) => {
        impl Message for $name {
            const LONGEST: usize = $longest;
            $(fn check(&self) -> Result<(), MessageError> {
                $check(self)
            })?
        }

        impl $name {
            /// Encodes it.
            pub fn encode(&self) -> Vec<u8> {
                serde_json::to_vec(self).expect("it has text keys and finite numbers")
            }

            /// Decodes a received message.
            ///
            /// # Errors
            /// [`MessageError`].
            pub fn decode(bytes: &[u8]) -> Result<Self, MessageError> {
                decode(bytes)
            }
        }
    };
}

pub(crate) use message;

pub(crate) fn decode<M: Message>(bytes: &[u8]) -> Result<M, MessageError> {
    if bytes.len() > M::LONGEST {
        return Err(MessageError::TooLong { bytes: bytes.len(), most: M::LONGEST });
    }
    let message: M = serde_json::from_slice(bytes)?;
    message.check()?;
    Ok(message)
}
