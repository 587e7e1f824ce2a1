//! Reasons for the end of a run.

/// Reason for the end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// Every walk is done.
    Walked,
    /// The requested duration is over.
    Until,
    /// No robot made progress on its walk.
    NoProgress,
    /// The history reached its limit.
    HistoryFull,
    /// A user stopped it.
    Stopped,
    /// The emulated network is gone.
    Broken,
}

impl End {
    /// Returns the text of `ended` in `summary.json`.
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Walked => "every walk is done",
            Self::Until => "the time that was asked for is over",
            Self::NoProgress => "no robot made progress for 60 s",
            Self::HistoryFull => "the history reached its limit",
            Self::Stopped => "it was stopped",
            Self::Broken => "the emulated network failed",
        }
    }
}
