//! The place at which the packets of a sample without an answer ended.

use serde::{Deserialize, Serialize};

use crate::id::LinkId;

/// The place at which the packets of a sample ended, and why it got no answer.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LostAt {
    /// The link; `None` if they ended on none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<LinkId>,
    /// Whether it was the answer that ended there.
    pub back: bool,
    /// The reason.
    pub cause: LostCause,
}

/// The reason for which a sample got no answer.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum LostCause {
    /// The link lost it.
    Loss,
    /// The link damaged it.
    Corruption,
    /// The link's queue had no room for it, or dropped it early.
    FullQueue,
    /// The robot was attached to no radio unit, or in a handover.
    NoAttachment,
    /// No path led to its receiver.
    NoRoute,
    /// It left for the core of another domain, which did not follow it.
    OtherCore,
    /// The VNF had it and did not answer in time.
    NoAnswer,
    /// It was still under way when the sample was given up.
    Late,
    /// The answer came, and the robot rejected it.
    Rejected,
    /// It was due and not sent, because the core did not run then.
    NotSent,
}

impl LostCause {
    /// Returns its name, as it is serialized.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Loss => "loss",
            Self::Corruption => "corruption",
            Self::FullQueue => "full_queue",
            Self::NoAttachment => "no_attachment",
            Self::NoRoute => "no_route",
            Self::OtherCore => "other_core",
            Self::NoAnswer => "no_answer",
            Self::Late => "late",
            Self::Rejected => "rejected",
            Self::NotSent => "not_sent",
        }
    }
}
