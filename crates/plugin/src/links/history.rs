//! The history as a source of what is known of links.

use std::fmt;

use cotorra_graph::{LinkContext, Timestamp};

use crate::client::Client;

/// A history of links' contexts.
pub trait LinkHistory: fmt::Debug + Send {
    /// Returns the last context of each direction of each link up to `now`, with its time.
    ///
    /// # Errors
    /// Reason for which the history cannot be read.
    fn latest(&mut self, now: Timestamp) -> Result<Vec<(Timestamp, LinkContext)>, String>;
}

/// The history behind a testbed's API, up to the testbed's present time.
impl LinkHistory for Client {
    fn latest(&mut self, _now: Timestamp) -> Result<Vec<(Timestamp, LinkContext)>, String> {
        let state = self.state(None).map_err(|error| error.to_string())?;
        Ok(state.links.into_iter().map(|sample| (sample.at, sample.value)).collect())
    }
}
