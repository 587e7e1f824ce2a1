//! Answers: verdicts, and lines of `name=value`.

use std::str::FromStr;

/// Why a request has no answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AnswerError {
    /// The program refused.
    #[error("the program refused (its log says why)")]
    Failed,
    /// Another request is under way.
    #[error("the program is busy with another request of this kind")]
    Busy,
    /// The program does not know the command, or was built without it.
    #[error("the program does not know this command, or was built without it")]
    UnknownCommand,
    /// The answer lacks this, or it cannot be read.
    #[error("the answer has no readable {0}")]
    Unexpected(&'static str),
}

/// Returns the text of an answer without its last line feed, or the refusal that it is.
pub(crate) fn verdict(answer: &str) -> Result<&str, AnswerError> {
    match answer.strip_suffix('\n').unwrap_or(answer) {
        "FAIL" => Err(AnswerError::Failed),
        "FAIL-BUSY" => Err(AnswerError::Busy),
        "UNKNOWN COMMAND" => Err(AnswerError::UnknownCommand),
        text => Ok(text),
    }
}

/// Reads the answer `OK`.
pub(crate) fn done(answer: Result<&str, AnswerError>) -> Result<(), AnswerError> {
    match answer? {
        "OK" => Ok(()),
        _ => Err(AnswerError::Unexpected("OK")),
    }
}

/// Lines of `name=value`. Others are left out.
pub(crate) struct Fields<'a>(&'a str);

impl<'a> Fields<'a> {
    pub(crate) fn of(text: &'a str) -> Self {
        Self(text)
    }

    /// Returns the text of the first field with this name.
    pub(crate) fn text(&self, name: &str) -> Option<&'a str> {
        let with_name = |line: &'a str| line.strip_prefix(name)?.strip_prefix('=');
        self.0.lines().find_map(with_name)
    }

    /// Returns the value of a field; `None` if it is missing or cannot be read.
    pub(crate) fn value<T: FromStr>(&self, name: &str) -> Option<T> {
        self.text(name)?.parse().ok()
    }

    /// Returns the value of a field that must be there.
    pub(crate) fn needed<T: FromStr>(&self, name: &'static str) -> Result<T, AnswerError> {
        self.value(name).ok_or(AnswerError::Unexpected(name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_by_their_whole_name() {
        let fields = Fields::of("ssid[0]=a=b\nssid=c\nfreq=2412\nempty=\nnothing");
        assert_eq!(fields.text("ssid"), Some("c"));
        assert_eq!(fields.text("ssid[0]"), Some("a=b"));
        assert_eq!(fields.value("freq"), Some(2412));
        assert_eq!(fields.value::<u32>("empty"), None);
        assert_eq!(fields.text("nothing"), None);
        assert_eq!(fields.needed::<u32>("ssid"), Err(AnswerError::Unexpected("ssid")));
    }
}
