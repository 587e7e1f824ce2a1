//! Why a row of a history cannot be read.

use std::sync::Arc;

use crate::error::Error;

/// A row that cannot be read.
#[derive(Debug)]
pub(crate) enum ReadError {
    /// A column has a value that is never written.
    Unreadable(String),
    /// The engine failed.
    Engine(Error),
}

impl ReadError {
    /// Returns the error of a history with this name.
    pub fn of(self, history: &Arc<str>) -> Error {
        match self {
            Self::Unreadable(detail) => Error::Corrupt { history: history.clone(), detail },
            Self::Engine(error) => error,
        }
    }
}

impl From<Error> for ReadError {
    fn from(error: Error) -> Self {
        Self::Engine(error)
    }
}

pub(super) fn unreadable(what: impl std::fmt::Display) -> ReadError {
    ReadError::Unreadable(what.to_string())
}
