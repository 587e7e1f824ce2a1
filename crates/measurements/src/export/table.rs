//! Tables of an export: their columns, and rows of cells on their way in or out.

use std::path::{Path, PathBuf};

use super::Result;
use crate::{
    Kind,
    codec::{CONDITIONS, HEARD},
};

/// Type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Type {
    Integer,
    Real,
    Text,
    /// A code in the history, and its name in the table: the names in the order of their codes.
    Name(&'static [&'static str]),
}

/// A value of a row.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    Null,
    Integer(i64),
    Real(f64),
    Text(String),
}

/// A table.
#[derive(Debug, Clone)]
pub struct Shape {
    pub name: &'static str,
    pub columns: Vec<(&'static str, Type)>,
}

impl Shape {
    fn new(name: &'static str, keys: &[&'static str], columns: &[&'static str]) -> Self {
        let columns = keys.iter().chain(columns).map(|column| (*column, type_of(column))).collect();
        Self { name, columns }
    }

    /// Puts names in place of the codes of a row.
    pub fn name(&self, cells: &mut [Cell]) {
        for (cell, (_, of)) in cells.iter_mut().zip(&self.columns) {
            if let (Cell::Integer(code), Type::Name(names)) = (&*cell, of) {
                let name = usize::try_from(*code).ok().and_then(|code| names.get(code));
                *cell = name.map_or(Cell::Null, |name| Cell::Text((*name).to_owned()));
            }
        }
    }

    /// Puts codes in place of the names of a row.
    ///
    /// # Errors
    /// The description of a name that has no code.
    pub fn code(&self, cells: &mut [Cell]) -> std::result::Result<(), String> {
        for (cell, (column, of)) in cells.iter_mut().zip(&self.columns) {
            if let (Cell::Text(text), Type::Name(names)) = (&*cell, of) {
                let code = names.iter().position(|name| name == text);
                let unknown = || format!("`{text}` in column {column} is none of {}", names.join(", "));
                *cell = Cell::Integer(code.ok_or_else(unknown)? as i64);
            }
        }
        Ok(())
    }

    /// Returns the table of a kind's events: their place, time, and columns.
    pub fn of(kind: Kind) -> Self {
        Self::new(kind.as_str(), &["n", "at_ns"], kind.table().columns)
    }

    /// Returns the table of a kind's child rows, if it has any.
    pub fn children(kind: Kind) -> Option<Self> {
        let (name, columns) = kind.table().children?;
        Some(Self::new(name, &["n", "place"], columns))
    }

    /// Returns the table of conditions of links.
    pub fn conditions() -> Self {
        Self::new("conditions", &["id"], CONDITIONS)
    }

    /// Returns the table of signals that robots heard.
    pub fn heard() -> Self {
        Self::new("heard", &["id"], HEARD)
    }

    /// Returns the table of gaps.
    pub fn gaps() -> Self {
        Self::new("gap", &["at_ns", "until_ns", "events"], &[])
    }
}

#[rustfmt::skip]
const TEXTS: &[&str] = &[
    "robot", "radio_unit", "link", "vnf", "node", "from_vnf", "to_vnf", "service", "attachment", "server",
    "from_radio_unit", "to_radio_unit", "state", "detail", "plugin", "kind", "instruction", "subject", "object",
    "change", "reason", "refused", "message", "health", "sensor", "component", "path", "others", "format",
    "jitter_distribution", "loss", "trace_ms", "trace_file", "queue_discipline", "part", "interface", "wifi", "signals",
    "lost_at",
];
#[rustfmt::skip]
const REALS: &[&str] = &[
    "x", "y", "z", "value", "heading", "roll", "pitch", "linear", "vertical", "angular",
    "load", "downlink_bps", "uplink_bps", "throughput_bps", "delay_scale", "drop_scale", "loss_share", "loss_mean_burst",
    "duplication", "corruption", "reordering", "jitter_correlation", "probed_loss", "tested_throughput_bps", "tested_offered_bps",
    "cpu_busy", "one_minute", "five_minutes", "fifteen_minutes", "received_throughput_bps", "sent_throughput_bps",
];
/// Names of directions, in the order of their codes.
const DIRECTIONS: &[&str] = &["forward", "backward"];
/// Names of the sources of a pose, in the order of their codes.
const SOURCES: &[&str] = &["simulator", "odometry", "localization"];
const UNITS_OF_REALS: &[&str] = &["_m", "_mps", "_dbm", "_ms", "_us"];

/// Returns the type of a column in the schema.
fn type_of(column: &str) -> Type {
    let of = column.strip_prefix("odometry_").unwrap_or(column);
    if of == "direction" {
        Type::Name(DIRECTIONS)
    } else if of == "source" {
        Type::Name(SOURCES)
    } else if TEXTS.contains(&column) {
        Type::Text
    } else if REALS.contains(&of)
        || UNITS_OF_REALS.iter().any(|unit| of.ends_with(unit))
        || of.starts_with("cov_")
    {
        Type::Real
    } else {
        Type::Integer
    }
}

/// A table that is being written.
pub trait TableWriter {
    /// Adds a row, its cells in the order of the columns.
    fn row(&mut self, cells: &[Cell]) -> Result<()>;
    /// Completes the file.
    fn finish(&mut self) -> Result<()>;
}

/// A table that is being read, with a view of the next row.
pub struct Rows {
    path: PathBuf,
    rows: Box<dyn Iterator<Item = Result<Vec<Cell>>>>,
    next: Option<Vec<Cell>>,
    begun: bool,
}

impl Rows {
    pub fn new(path: PathBuf, rows: Box<dyn Iterator<Item = Result<Vec<Cell>>>>) -> Self {
        Self { path, rows, next: None, begun: false }
    }

    pub fn none(path: PathBuf) -> Self {
        Self::new(path, Box::new(std::iter::empty()))
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the key of the next row, its first value.
    pub fn key(&mut self) -> Result<Option<i64>> {
        if !self.begun {
            self.begun = true;
            self.next = self.rows.next().transpose()?;
        }
        match &self.next {
            None => Ok(None),
            Some(cells) => match cells.first() {
                Some(Cell::Integer(key)) => Ok(Some(*key)),
                _ => Err(super::ExportError::malformed(&self.path, "a row does not begin with a number")),
            },
        }
    }

    /// Takes the next row.
    pub fn take(&mut self) -> Result<Option<Vec<Cell>>> {
        self.key()?;
        let row = self.next.take();
        if row.is_some() {
            self.next = self.rows.next().transpose()?;
        }
        Ok(row)
    }
}
