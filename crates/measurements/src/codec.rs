//! Rows of events, for every engine. What is in them is declared with the events ([`cotorra_graph::record`]).

pub(crate) mod binary;

use std::sync::Arc;

pub(crate) use cotorra_graph::record::{
    CONDITIONS, Columns, Fields, HEARD, Heard, Reader, Role, Source, Unreadable, Value,
};

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

impl From<Unreadable> for ReadError {
    fn from(error: Unreadable) -> Self {
        Self::Unreadable(error.to_string())
    }
}
