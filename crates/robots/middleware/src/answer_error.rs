//! Reasons for which a robot rejects answers.

use cotorra_graph::AnswersRejected;

/// The reason for which a robot rejects an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AnswerError {
    /// The request had timed out.
    #[error("the answer is late")]
    Late,
    /// The nonce or the sender's address does not match the request.
    #[error("the answer is forged")]
    Forged,
    /// The request was answered before.
    #[error("the answer is repeated")]
    Repeated,
    /// Another recipient of the request answered first.
    #[error("another instance answered first")]
    Redundant,
    /// The robot sent no such request.
    #[error("the answer is to no packet that is known")]
    Unknown,
    /// The packet is malformed or its content is impossible.
    #[error("the answer is invalid")]
    Invalid,
}

impl AnswerError {
    /// Increments the counter of this reason.
    pub(crate) fn count(self, counts: &mut AnswersRejected) {
        *match self {
            Self::Late => &mut counts.late,
            Self::Forged => &mut counts.forged,
            Self::Repeated => &mut counts.repeated,
            Self::Redundant => &mut counts.redundant,
            Self::Unknown => &mut counts.unknown,
            Self::Invalid => &mut counts.invalid,
        } += 1;
    }
}
