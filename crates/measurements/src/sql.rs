//! Histories in SQL databases: the statements and the conversion of rows that SQLite and servers share.
//!
//! An engine brings a [`Session`], which runs statements, and a [`Batch`], which takes the rows of one append. It keeps
//! connections, the transaction of an append, and errors to itself.

mod read;
mod runs;
mod session;
mod thin;
mod write;

#[cfg(test)]
pub(crate) use self::read::Select;
#[cfg(feature = "databases")]
pub(crate) use self::session::{column_list, quoted};
pub(crate) use self::{
    read::Reader,
    runs::{begin_run, end_run, remove_run},
    session::{Cell, Dialect, Row, Session, integer, integers, transaction},
    thin::{note_retained, thin},
    write::{Batch, Known, Stretch, Target, append},
};
