//! Pages, which bound the size of answers, and the cursors that join them.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

use crate::error::Error;

/// The place where a page ends and the next one begins: an event's time, and its place in the order of recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Cursor {
    pub(crate) t: i64,
    pub(crate) seq: i64,
}

impl Cursor {
    /// Returns the place before every event at `t` or later.
    pub(crate) const fn before(t: i64) -> Self {
        Self { t, seq: -1 }
    }
}

impl fmt::Display for Cursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.t, self.seq)
    }
}

/// A text that is not a cursor.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a cursor: give back the `next` of the page before as it was")]
pub struct InvalidCursor(String);

impl FromStr for Cursor {
    type Err = InvalidCursor;
    fn from_str(text: &str) -> std::result::Result<Self, InvalidCursor> {
        let number = |part: &str| part.parse::<u64>().ok().and_then(|n| i64::try_from(n).ok());
        text.split_once('-')
            .and_then(|(t, seq)| Some(Self { t: number(t)?, seq: number(seq)? }))
            .ok_or_else(|| InvalidCursor(text.chars().take(60).collect()))
    }
}

impl TryFrom<String> for Cursor {
    type Error = InvalidCursor;
    fn try_from(text: String) -> std::result::Result<Self, InvalidCursor> {
        text.parse()
    }
}

impl From<Cursor> for String {
    fn from(cursor: Cursor) -> Self {
        cursor.to_string()
    }
}

/// Part of an answer. With a `next` there is more.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Page<T> {
    /// In the order of time; at the same time, in the order of recording.
    pub items: Vec<T>,
    /// Cursor of the next page; `None` on the last one.
    #[schema(value_type = Option<String>)]
    pub next: Option<Cursor>,
}

impl<T> Page<T> {
    pub(crate) fn map<U>(self, item: impl FnMut(T) -> U) -> Page<U> {
        Page { items: self.items.into_iter().map(item).collect(), next: self.next }
    }
}

/// The requested part of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageRequest {
    /// Most items of the page; clamped to 1 … [`Self::MAX`].
    pub limit: usize,
    /// The `next` of the page before; `None` for the first page.
    pub after: Option<Cursor>,
}

impl PageRequest {
    /// Most items of any page.
    pub const MAX: usize = 10_000;

    /// Requests the first page.
    pub const fn first(limit: usize) -> Self {
        Self { limit, after: None }
    }

    /// Requests the page that begins at a cursor.
    pub const fn after(cursor: Cursor, limit: usize) -> Self {
        Self { limit, after: Some(cursor) }
    }

    pub(crate) fn size(self) -> usize {
        self.limit.clamp(1, Self::MAX)
    }
}

/// Reads all pages of an answer.
pub(crate) fn pages<T>(
    ask: impl Fn(PageRequest) -> Result<Page<T>, Error>,
    mut each: impl FnMut(T),
) -> Result<(), Error> {
    let mut request = PageRequest::first(PageRequest::MAX);
    loop {
        let page = ask(request)?;
        page.items.into_iter().for_each(&mut each);
        let Some(next) = page.next else { return Ok(()) };
        request = PageRequest::after(next, PageRequest::MAX);
    }
}

impl Default for PageRequest {
    /// Requests the first 1000 items.
    fn default() -> Self {
        Self::first(1000)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn written_cursors_are_read_back(t in 0..=i64::MAX, seq in 0..=i64::MAX) {
            let cursor = Cursor { t, seq };
            prop_assert_eq!(cursor.to_string().parse(), Ok(cursor));
        }
    }

    #[test]
    fn invalid_cursors_are_rejected() {
        for text in ["", "-", "1", "1-", "-1-1", "1-x", "99999999999999999999-1"] {
            let error = text.parse::<Cursor>().unwrap_err();
            assert_eq!(
                error.to_string(),
                format!("`{text}` is not a cursor: give back the `next` of the page before as it was")
            );
        }
    }
}
