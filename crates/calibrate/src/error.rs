//! Errors of a calibration.

/// Reason why measurements were not read or not fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrateError {
    /// A line cannot be read.
    #[error("line {line}: {reason}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// The mistake, and the remedy.
        reason: String,
    },
    /// The text has no measurements, or too many.
    #[error("{0}")]
    Unreadable(String),
    /// The measurements do not say enough.
    #[error("{0}")]
    TooLittle(String),
    /// The testbed has no such radio unit or link, or one that cannot be fitted.
    #[error("{0}")]
    Unsuited(String),
}

impl CalibrateError {
    /// Names the link that an error is about.
    pub(crate) fn of_link(link: &str, error: Self) -> Self {
        match error {
            Self::TooLittle(reason) => Self::TooLittle(format!("link `{link}`: {reason}")),
            Self::Unsuited(reason) => Self::Unsuited(format!("link `{link}`: {reason}")),
            other => other,
        }
    }

    /// Names the part of a survey that an error is about.
    pub(crate) fn of_survey_part(fitted_share: f64, error: Self) -> Self {
        match error {
            Self::TooLittle(reason) => {
                Self::TooLittle(format!("in the first {:.0} % of the survey, {reason}", fitted_share * 100.0))
            }
            other => other,
        }
    }

    pub(crate) fn line(line: usize, reason: impl Into<String>) -> Self {
        Self::Line { line, reason: reason.into() }
    }

    pub(crate) fn too_little(reason: impl Into<String>) -> Self {
        Self::TooLittle(reason.into())
    }

    pub(crate) fn unsuited(reason: impl Into<String>) -> Self {
        Self::Unsuited(reason.into())
    }
}
