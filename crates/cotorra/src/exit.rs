//! Exit statuses of the program. All are here.
//!
//! clap exits with 2 by itself if the arguments are wrong.

use std::process::ExitCode;

use cotorra_testbed::{Finished, Summary, Verdict};

/// Outcome of a command. Of several, the greatest counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// Done.
    Done,
    /// Stopped by Ctrl-C before the end. Status 130, as shells have it.
    Interrupted,
    /// A service kept its target less often than the testbed file demands. Status 4.
    Failed,
    /// A walk ended because no robot made progress any more. Status 5.
    NoProgress,
    /// Done, but the figures are not valid. Status 3.
    NotValid,
    /// An error, or a record that is not complete. Status 1.
    Error,
}

impl Status {
    /// Returns the number of the exit status.
    pub const fn number(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Error => 1,
            Self::NotValid => 3,
            Self::Failed => 4,
            Self::NoProgress => 5,
            Self::Interrupted => 130,
        }
    }

    /// Returns the outcome of a run with this summary.
    pub fn of(summary: &Summary) -> Self {
        if !summary.is_valid() {
            Self::NotValid
        } else if summary.is_stuck() {
            Self::NoProgress
        } else if summary.verdict == Some(Verdict::Fail) {
            Self::Failed
        } else {
            Self::Done
        }
    }

    /// Returns the outcome of a run, whose record may not be complete.
    pub fn of_run(finished: &Finished) -> Self {
        let recording = finished.recording.as_ref();
        let lacks = recording.is_some_and(|its| its.dropped > 0 || its.failed.is_some());
        let is_recorded = finished.unrecorded.is_empty() && finished.summary.history_dropped == 0 && !lacks;
        if is_recorded { Self::of(&finished.summary) } else { Self::Error }
    }
}

impl From<Status> for ExitCode {
    fn from(status: Status) -> Self {
        Self::from(status.number())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_counts_more_than_void_figures_and_these_more_than_no_progress() {
        let all = [
            Status::NoProgress,
            Status::NotValid,
            Status::Failed,
            Status::Done,
            Status::Error,
            Status::Interrupted,
        ];
        let mut sorted = all;
        sorted.sort_unstable();
        assert_eq!(sorted.map(Status::number), [0, 130, 4, 5, 3, 1]);
    }
}
