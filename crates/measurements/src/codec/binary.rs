//! Entries in bytes, column by column, for events that are kept beside a history for a while. Names and conditions are
//! written out instead of their ids.

use std::sync::Arc;

use cotorra_graph::{Conditions, Stamped, Timestamp};

use super::{Columns, Fields, Heard, ReadError, Reader, Source, Value};
use crate::{
    kind::Kind,
    run::{Entry, RunId},
};

const NULL: u8 = 0;
const INTEGER: u8 = 1;
const REAL: u8 = 2;
const TEXT: u8 = 3;

/// Appends an entry.
#[cfg_attr(not(any(test, feature = "databases")), expect(dead_code, reason = "used by spools only"))]
pub(crate) fn write(entry: &Entry, bytes: &mut Vec<u8>) {
    let (mut row, mut children) = (Fields::default(), Fields::default());
    entry.stamped.put(&mut row, &mut children);
    let kind = Kind::of(&entry.stamped.event);
    write_integer(entry.run.0, bytes);
    write_integer(entry.stamped.at.as_nanos().cast_signed(), bytes);
    bytes.push(kind as u8);
    row.0.iter().for_each(|value| write_value(value, bytes));
    if let Some((_, columns)) = kind.table().children {
        write_integer((children.0.len() / columns.len()) as i64, bytes);
        children.0.iter().for_each(|value| write_value(value, bytes));
    }
}

fn write_value(value: &Value<'_>, bytes: &mut Vec<u8>) {
    let mut text = |text: &str| {
        bytes.push(TEXT);
        write_integer(text.len() as i64, bytes);
        bytes.extend(text.as_bytes());
    };
    match value {
        Value::Null => bytes.push(NULL),
        Value::Integer(n) => {
            bytes.push(INTEGER);
            write_integer(*n, bytes);
        }
        Value::Real(x) => {
            bytes.push(REAL);
            bytes.extend(x.to_le_bytes());
        }
        Value::Text(value) => text(value),
        Value::Name(name) => text(name),
        Value::Conditions(_, conditions) => {
            let mut row = Fields::default();
            conditions.put(&mut row);
            row.0.iter().for_each(|value| write_value(value, bytes));
        }
        Value::Heard(heard) => text(&heard.text()),
    }
}

/// Appends an integer. Small ones of either sign take few bytes: zigzag and LEB128, as in Protocol Buffers' `sint64`.
pub(crate) fn write_integer(n: i64, bytes: &mut Vec<u8>) {
    let mut left = ((n << 1) ^ (n >> 63)).cast_unsigned();
    while left >= 0x80 {
        bytes.push(left as u8 | 0x80);
        left >>= 7;
    }
    bytes.push(left as u8);
}

/// Bytes that [`write()`] wrote, read from the first on.
pub(crate) struct Bytes<'a>(pub &'a [u8]);

type Answer<T> = std::result::Result<T, ReadError>;

impl Bytes<'_> {
    /// Reads the next entry.
    pub fn entry(&mut self) -> Answer<Entry> {
        let run = RunId(self.plain_integer()?);
        let at = Timestamp::from_nanos(self.plain_integer()?.cast_unsigned());
        let kind = self.byte()?;
        let kind = Kind::ALL.get(usize::from(kind)).ok_or_else(|| unreadable("an unknown kind of event"))?;
        Ok(Entry { run, stamped: Stamped::take(*kind, at, self)? })
    }

    /// Reads an integer of [`write_integer`].
    pub fn plain_integer(&mut self) -> Answer<i64> {
        let mut n = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            n |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok((n >> 1).cast_signed() ^ -((n & 1).cast_signed()));
            }
        }
        Err(unreadable("an integer has no end"))
    }

    /// Reads bytes as they are.
    pub fn plain_bytes(&mut self, count: i64) -> Answer<&[u8]> {
        self.take(usize::try_from(count).unwrap_or(usize::MAX))
    }

    /// Skips integers.
    pub fn skip(&mut self, integers: usize) -> Answer<()> {
        let mut left = integers;
        let end = self.0.iter().position(|byte| {
            left -= usize::from(*byte < 0x80 && left > 0);
            left == 0
        });
        if integers > 0 {
            let end = end.ok_or_else(|| unreadable("it ends early"))?;
            self.0 = &self.0[end + 1..];
        }
        Ok(())
    }

    fn byte(&mut self) -> Answer<u8> {
        Ok(self.take(1)?[0])
    }

    fn take(&mut self, count: usize) -> Answer<&[u8]> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or_else(|| unreadable("it ends early"))?;
        self.0 = rest;
        Ok(taken)
    }
}

fn unreadable(what: &str) -> ReadError {
    ReadError::Unreadable(what.to_owned())
}

impl Source<ReadError> for Bytes<'_> {
    fn integer(&mut self) -> Answer<Option<i64>> {
        match self.byte()? {
            NULL => Ok(None),
            INTEGER => self.plain_integer().map(Some),
            _ => Err(unreadable("expected an integer")),
        }
    }

    fn real(&mut self) -> Answer<Option<f64>> {
        match self.byte()? {
            NULL => Ok(None),
            REAL => {
                let bytes = self.take(8)?.try_into().expect("eight bytes were taken");
                Ok(Some(f64::from_le_bytes(bytes)))
            }
            _ => Err(unreadable("expected a number")),
        }
    }

    fn text(&mut self) -> Answer<Option<String>> {
        match self.byte()? {
            NULL => Ok(None),
            TEXT => {
                let length = usize::try_from(self.plain_integer()?)
                    .map_err(|_| unreadable("a text has a negative length"))?;
                let text =
                    str::from_utf8(self.take(length)?).map_err(|_| unreadable("a text is not UTF-8"))?;
                Ok(Some(text.to_owned()))
            }
            _ => Err(unreadable("expected a text")),
        }
    }

    fn name(&mut self) -> Answer<Option<Arc<str>>> {
        Ok(self.text()?.map(Arc::from))
    }

    fn conditions(&mut self) -> Answer<Conditions> {
        Conditions::take(&mut Reader(self))
    }

    fn heard(&mut self) -> Answer<Option<Heard>> {
        self.text()?.as_deref().map(Heard::parse).transpose()
    }

    fn children(&mut self, read: &mut dyn FnMut(&mut dyn Source<ReadError>) -> Answer<()>) -> Answer<()> {
        for _ in 0..self.plain_integer()? {
            read(self)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;
    use crate::testing::stamped;

    /// A line is an entry in hexadecimal, and its event in JSON. Spools that another version left are read.
    #[test]
    fn entries_have_the_same_bytes_in_all_versions() {
        for line in include_str!("golden.txt").lines() {
            let (hex, json) = line.split_once(' ').unwrap();
            let byte = |place| u8::from_str_radix(&hex[place..place + 2], 16).unwrap();
            let bytes: Vec<u8> = (0..hex.len()).step_by(2).map(byte).collect();
            let entry = Bytes(&bytes).entry().unwrap();
            assert_eq!(serde_json::to_string(&entry.stamped).unwrap(), json);
            let mut again = Vec::new();
            write(&entry, &mut again);
            assert_eq!(again, bytes, "{json}");
        }
    }

    proptest! {
        #[test]
        fn written_entries_are_read_back(events in vec((any::<i64>(), stamped()), 0..10)) {
            let entries: Vec<_> =
                events.into_iter().map(|(run, stamped)| Entry { run: RunId(run), stamped }).collect();
            let mut bytes = Vec::new();
            entries.iter().for_each(|entry| write(entry, &mut bytes));
            let mut rest = Bytes(&bytes);
            for entry in &entries {
                prop_assert_eq!(&rest.entry().unwrap(), entry);
            }
            prop_assert!(rest.0.is_empty());
        }

        #[test]
        fn arbitrary_bytes_cause_no_panic(bytes in vec(any::<u8>(), 0..200)) {
            let mut rest = Bytes(&bytes);
            while rest.entry().is_ok() {}
        }
    }
}
