//! Events in tables: an event is a row, and its list is child rows. Databases, exports and files of bytes
//! take [`Value`]s and bring a [`Source`]; this module does not know them. All that was written stays readable: columns
//! are only added, at the end.

mod conditions;
mod embedding;
mod heard;
mod machine;
mod service_time;
pub(crate) mod slots;

use std::{borrow::Cow, fmt::Display, sync::Arc, time::Duration};

use serde::{Serialize, de::DeserializeOwned};

pub use self::{conditions::CONDITIONS, heard::Heard, service_time::PartOfTime};
use crate::{
    conditions::{Conditions, Scale},
    context::{AnswersRejected, Attachment, Handover, Lateness, LinkCounters, PathKind, PoseSource},
    goal::{GoalEvent, GoalState},
    hardware::Direction,
    id::{ComponentId, LinkId, NodeId, PluginId, SensorId, ServiceId, VnfId},
    sensor::DataFormat,
    staleness::{ContextKind, Staleness},
    units::{BitRate, Dbm, Position, Probability, Timestamp, millis},
    vnf_event::{VnfEvent, VnfState},
};

/// A table of events. Its key is (run, at_ns, seq), as in all of them.
#[derive(Debug)]
pub struct Table {
    /// Columns after the key, in order.
    pub columns: &'static [&'static str],
    /// Columns that name the series, which are the first of `columns`; none for kinds without series.
    pub series: &'static [&'static str],
    /// Table and columns of the child rows. Their key is the row's, followed by `place`, from 0.
    pub children: Option<(&'static str, &'static [&'static str])>,
}

impl Table {
    /// Returns a table without series and child rows.
    pub const fn plain(columns: &'static [&'static str]) -> Self {
        Self { columns, series: &[], children: None }
    }
}

/// Columns of signals that a robot heard, after their id.
pub const HEARD: &[&str] = &["signals"];

/// The details of an event, kept as a row and its child rows.
pub(crate) trait Record: Sized {
    /// The table.
    const TABLE: Table;

    /// Adds the row's columns, and those of its child rows.
    fn put<'a>(&'a self, at: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>);

    /// Reads a row and its child rows.
    fn take<E: From<Unreadable>>(at: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E>;

    /// Returns the parts of the series' name, in the order of [`Table::series`].
    fn series(&self) -> Option<[SeriesPart; 2]> {
        None
    }

    /// Returns the bytes of its texts and lists. Names count as nothing, because events share them.
    fn bytes(&self) -> usize {
        0
    }
}

/// Declares a record without child rows: its fields in the order of the columns, each with the names of its columns.
macro_rules! record {
    ($type:ident { $($field:ident => $($column:literal)+,)* }) => {
        impl Record for $type {
            const TABLE: Table = Table::plain(&[$($($column),+),*]);

            fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, _: &mut Fields<'a>) {
                $(self.$field.put(row);)*
            }

            fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
                let row = &mut Reader(source);
                Ok(Self { $($field: Columns::take(row)?),* })
            }

            fn bytes(&self) -> usize {
                [$(Columns::bytes(&self.$field)),*].into_iter().sum()
            }
        }
    };
}

/// Declares values that are part of a row: their fields in the order of the columns.
macro_rules! columns {
    ($($type:ident { $($field:ident),* })*) => { $(
        impl $crate::record::Columns for $type {
            fn put<'a>(&'a self, row: &mut $crate::record::Fields<'a>) {
                $($crate::record::Columns::put(&self.$field, row);)*
            }

            fn take<E: From<$crate::record::Unreadable>>(
                row: &mut $crate::record::Reader<'_, E>,
            ) -> Result<Self, E> {
                Ok(Self { $($field: $crate::record::Columns::take(row)?),* })
            }
        }
    )* };
}
pub(crate) use columns;

record!(Handover {
    robot => "robot",
    from => "from_radio_unit",
    to => "to_radio_unit",
    fast => "fast",
    gap => "gap_ms",
});
record!(VnfEvent { vnf => "vnf", node => "node", state => "state", detail => "detail", });
record!(Lateness { frames => "frames", p50_us => "p50_us", p99_us => "p99_us", max_us => "max_us", });
record!(AnswersRejected {
    robot => "robot",
    late => "late",
    forged => "forged",
    repeated => "repeated",
    unknown => "unknown",
    invalid => "invalid",
    redundant => "redundant",
});
record!(GoalEvent {
    robot => "robot",
    goal => "x" "y" "z",
    state => "state",
    remaining_m => "remaining_m",
    reason => "reason",
});
record!(Staleness {
    plugin => "plugin",
    kind => "kind",
    contexts => "contexts",
    youngest => "youngest_ms",
    oldest => "oldest_ms",
});
columns! {
    Attachment { radio_unit, attached, signal, age }
    LinkCounters { packets, bytes, lost, overflowed, duplicated, corrupted }
    Position { x, y, z }
    Scale { delay_scale, drop_scale }
}

/// A part of a series' name.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SeriesPart {
    /// The name has only one part.
    None,
    /// A number, such as that of a direction.
    Code(i64),
    /// A name.
    Name(Arc<str>),
}

impl From<()> for SeriesPart {
    fn from((): ()) -> Self {
        Self::None
    }
}

impl From<Direction> for SeriesPart {
    fn from(direction: Direction) -> Self {
        Self::Code(code(direction))
    }
}

/// A value on its way into a column.
#[derive(Debug, Clone)]
pub enum Value<'a> {
    /// Nothing.
    Null,
    /// A number or code.
    Integer(i64),
    /// A figure. NaN becomes NULL.
    Real(f64),
    /// A text.
    Text(Cow<'a, str>),
    /// Becomes the id of the name's row.
    Name(&'a str),
    /// Becomes the id of the conditions' row.
    Conditions(Role, &'a Conditions),
    /// Becomes the id of the signals' row.
    Heard(Heard),
}

/// The role of conditions of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Role {
    /// The conditions that were asked for.
    Asked,
    /// The conditions that are in force.
    Effective,
}

impl Role {
    /// Number of roles.
    pub const COUNT: usize = 2;
}

/// Columns of one row, or of several child rows one after the other.
#[derive(Debug, Default)]
pub struct Fields<'a>(pub Vec<Value<'a>>);

impl<'a> Fields<'a> {
    /// Adds what has no column of its own.
    fn nulls(&mut self, count: usize) {
        self.0.extend(std::iter::repeat_n(Value::Null, count));
    }

    /// Adds a text that is a value in JSON, if there is one.
    fn json<T: Serialize>(&mut self, value: Option<&T>) {
        self.0.push(match value {
            Some(value) => Value::Text(json(value).into()),
            None => Value::Null,
        });
    }
}

/// A row that is read column by column, from the first to the last.
#[expect(missing_docs, reason = "each reads a column of the type in its name")]
pub trait Source<E> {
    fn integer(&mut self) -> Result<Option<i64>, E>;
    fn real(&mut self) -> Result<Option<f64>, E>;
    fn text(&mut self) -> Result<Option<String>, E>;
    fn name(&mut self) -> Result<Option<Arc<str>>, E>;
    fn conditions(&mut self) -> Result<Conditions, E>;
    fn heard(&mut self) -> Result<Option<Heard>, E>;
    /// Calls `read` with each of the row's child rows, in their order.
    fn children(&mut self, read: &mut dyn FnMut(&mut dyn Source<E>) -> Result<(), E>) -> Result<(), E>;
}

/// A column has a value that is never written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unreadable(String);

impl Unreadable {
    /// Returns an error with these words.
    pub fn new(what: impl Display) -> Self {
        Self(what.to_string())
    }
}

fn unreadable<E: From<Unreadable>>(what: impl Display) -> E {
    Unreadable::new(what).into()
}

pub(crate) fn required<T, E: From<Unreadable>>(value: Option<T>) -> Result<T, E> {
    value.ok_or_else(|| unreadable("a required column is NULL"))
}

fn json<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).expect("names, texts and finite numbers are JSON")
}

fn parse_json<T: DeserializeOwned, E: From<Unreadable>>(text: &str) -> Result<T, E> {
    serde_json::from_str(text).map_err(unreadable)
}

/// Typed columns on top of a [`Source`].
pub struct Reader<'a, E>(pub &'a mut dyn Source<E>);

impl<E: From<Unreadable>> Reader<'_, E> {
    /// Reads the next columns.
    pub(crate) fn take<T: Columns>(&mut self) -> Result<T, E> {
        T::take(self)
    }

    /// Reads a value in JSON.
    fn json<T: DeserializeOwned>(&mut self) -> Result<Option<T>, E> {
        self.0.text()?.as_deref().map(parse_json).transpose()
    }
}

/// Reads all child rows.
fn children<T: Columns, E: From<Unreadable>>(source: &mut dyn Source<E>) -> Result<Vec<T>, E> {
    let mut all = Vec::new();
    source.children(&mut |child| {
        all.push(T::take(&mut Reader(child))?);
        Ok(())
    })?;
    Ok(all)
}

/// A value in one or more columns that follow each other.
pub trait Columns: Sized {
    /// Adds the columns.
    fn put<'a>(&'a self, row: &mut Fields<'a>);

    /// Reads the columns.
    ///
    /// # Errors
    /// [`Unreadable`], or an error of the source.
    fn take<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Self, E>;

    /// Returns the bytes of its texts. Names count as nothing, because events share them.
    fn bytes(&self) -> usize {
        0
    }
}

/// A value in one column, which can be NULL if there is none.
pub(crate) trait Column: Sized {
    fn value(&self) -> Value<'_>;

    fn read<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Option<Self>, E>;

    /// Returns what NULL stands for in a column that always has a value.
    fn of_null() -> Option<Self> {
        None
    }

    fn bytes(&self) -> usize {
        0
    }
}

impl<T: Column> Columns for T {
    fn put<'a>(&'a self, row: &mut Fields<'a>) {
        row.0.push(self.value());
    }

    fn take<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Self, E> {
        required(T::read(row)?.or_else(T::of_null))
    }

    fn bytes(&self) -> usize {
        Column::bytes(self)
    }
}

impl<T: Column> Column for Option<T> {
    fn value(&self) -> Value<'_> {
        self.as_ref().map_or(Value::Null, T::value)
    }

    fn read<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Option<Self>, E> {
        T::read(row).map(Some)
    }

    fn bytes(&self) -> usize {
        self.as_ref().map_or(0, Column::bytes)
    }
}

macro_rules! names {
    ($($id:ident)*) => { $(
        impl Column for $id {
            fn value(&self) -> Value<'_> {
                Value::Name(self.as_str())
            }

            fn read<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Option<Self>, E> {
                row.0.name()?.map(|name| name.parse().map_err(unreadable)).transpose()
            }
        }

        impl From<&$id> for SeriesPart {
            fn from(id: &$id) -> Self {
                Self::Name(id.into())
            }
        }
    )* };
}
names!(ComponentId LinkId NodeId PluginId SensorId ServiceId VnfId);

macro_rules! integers {
    ($($type:ty: $to:expr, $from:expr;)*) => { $(
        impl Column for $type {
            fn value(&self) -> Value<'_> {
                let to: fn($type) -> i64 = $to;
                Value::Integer(to(*self))
            }

            fn read<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Option<Self>, E> {
                let from: fn(i64) -> Result<$type, E> = $from;
                row.0.integer()?.map(from).transpose()
            }
        }
    )* };
}
integers! {
    bool: i64::from, |n| Ok(n != 0);
    u8: i64::from, in_range;
    u32: i64::from, in_range;
    u64: u64::cast_signed, |n| Ok(n.cast_unsigned());
    Timestamp: |t| t.as_nanos().cast_signed(), |n| Ok(Self::from_nanos(n.cast_unsigned()));
    BitRate: |rate| rate.bits_per_second().cast_signed(), |n| {
        let rate = Self::from_bits_per_second(n.cast_unsigned());
        rate.ok_or_else(|| unreadable(format_args!("{n} is not a rate")))
    };
    Direction: code, |n| match n {
        0 => Ok(Self::Forward),
        1 => Ok(Self::Backward),
        n => Err(unreadable(format_args!("{n} is not a direction"))),
    };
    PoseSource: |source| match source {
        PoseSource::Simulator => 0,
        PoseSource::Odometry => 1,
        PoseSource::Localization => 2,
    }, |n| match n {
        0 => Ok(Self::Simulator),
        1 => Ok(Self::Odometry),
        2 => Ok(Self::Localization),
        n => Err(unreadable(format_args!("{n} is not a source of a pose"))),
    };
}

/// Returns a direction as it is stored.
pub(crate) const fn code(direction: Direction) -> i64 {
    match direction {
        Direction::Forward => 0,
        Direction::Backward => 1,
    }
}

fn in_range<T: TryFrom<i64>, E: From<Unreadable>>(n: i64) -> Result<T, E> {
    n.try_into().map_err(|_| unreadable(format_args!("{n} is out of its column's range")))
}

macro_rules! reals {
    ($($type:ty: $to:expr, $from:expr, $null:expr;)*) => { $(
        impl Column for $type {
            fn value(&self) -> Value<'_> {
                let to: fn($type) -> f64 = $to;
                Value::Real(to(*self))
            }

            fn read<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Option<Self>, E> {
                let from: fn(f64) -> Result<$type, E> = $from;
                row.0.real()?.map(from).transpose()
            }

            fn of_null() -> Option<Self> {
                $null
            }
        }
    )* };
}
reals! {
    f64: |x| x, Ok, Some(f64::NAN);
    Dbm: |signal| signal.0, |x| Ok(Self(x)), Some(Self(f64::NAN));
    Duration: millis::of, |ms| millis::duration(ms).map_err(unreadable), None;
    Probability: Self::get, |share| {
        Self::new(share).ok_or_else(|| unreadable(format_args!("{share} is not a share")))
    }, None;
}

impl Column for String {
    fn value(&self) -> Value<'_> {
        Value::Text(self.into())
    }

    fn read<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Option<Self>, E> {
        row.0.text()
    }

    fn bytes(&self) -> usize {
        self.len()
    }
}

macro_rules! words {
    ($($type:ty: $what:literal;)*) => { $(
        impl Column for $type {
            fn value(&self) -> Value<'_> {
                Value::Text(self.as_str().into())
            }

            fn read<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Option<Self>, E> {
                let Some(word) = row.0.text()? else { return Ok(None) };
                let known = Self::ALL.into_iter().find(|known| known.as_str() == word);
                known.map(Some).ok_or_else(|| unreadable(format_args!(concat!("`{}` is not ", $what), word)))
            }
        }
    )* };
}
words! {
    ContextKind: "a kind of context";
    DataFormat: "a format of data";
    GoalState: "a state of a goal";
    PathKind: "a kind of path";
    VnfState: "a state of a VNF";
}
