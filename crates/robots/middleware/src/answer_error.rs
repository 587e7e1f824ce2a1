//! Answers that a robot does not follow, and why.

use cotorra_graph::AnswersRejected;

/// Why a robot does not follow a packet that arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AnswerError {
    /// It answers a packet that was given up.
    #[error("the answer is late")]
    Late,
    /// It answers a packet, but has not its nonce, or comes from elsewhere than where that was sent.
    #[error("the answer is forged")]
    Forged,
    /// It answers a packet that was answered.
    #[error("the answer is repeated")]
    Repeated,
    /// It answers a packet that went to several instances, of which another answered first.
    #[error("another instance answered first")]
    Redundant,
    /// It answers no packet of this robot's.
    #[error("the answer is to no packet that is known")]
    Unknown,
    /// It is no packet, or says what cannot be.
    #[error("the answer is invalid")]
    Invalid,
}

impl AnswerError {
    /// Counts it.
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
