//! Reads a run from tables, merging the events of all kinds in their order.

use std::{collections::HashMap, path::Path, sync::Arc, vec};

use cotorra_graph::{Conditions, Stamped, Timestamp};

use super::{
    ExportError, Format, Result, open,
    table::{Cell, Rows, Shape},
};
use crate::{
    Gap, Kind,
    codec::{Columns, Heard, ReadError, Reader, Source},
};

/// Tables of an export.
pub struct Tables {
    kinds: Vec<(Kind, Rows, Option<Rows>)>,
    gaps: Rows,
    shared: Shared,
    events: u64,
}

/// Rows that several events refer to, by id.
#[derive(Default)]
struct Shared {
    conditions: HashMap<i64, Conditions>,
    heard: HashMap<i64, Heard>,
}

impl Tables {
    /// Opens the tables in a folder.
    pub fn open(folder: &Path, format: Format) -> Result<Self> {
        let mut kinds = Vec::new();
        for kind in Kind::ALL {
            let children = Shape::children(kind).map(|shape| open(format, folder, &shape)).transpose()?;
            kinds.push((kind, open(format, folder, &Shape::of(kind))?, children));
        }
        let mut rows = open(format, folder, &Shape::conditions())?;
        let mut shared = Shared::default();
        while let Some(id) = rows.key()? {
            let cells = rows.take()?.into_iter().flatten().skip(1).collect::<Vec<_>>();
            let decoded = Conditions::take(&mut Reader(&mut Row {
                cells: cells.into_iter(),
                children: Vec::new(),
                shared: &Shared::default(),
            }));
            shared.conditions.insert(id, decoded.map_err(|e| ExportError::unreadable(rows.path(), e))?);
        }
        let mut rows = open(format, folder, &Shape::heard())?;
        while let Some(id) = rows.key()? {
            let signals = match rows.take()?.unwrap_or_default().pop() {
                Some(Cell::Text(signals)) => signals,
                _ => String::new(),
            };
            let heard =
                Heard::parse(&signals).map_err(|e: ReadError| ExportError::unreadable(rows.path(), e))?;
            shared.heard.insert(id, heard);
        }
        Ok(Self { kinds, gaps: open(format, folder, &Shape::gaps())?, shared, events: 0 })
    }

    pub fn events(&self) -> u64 {
        self.events
    }

    /// Returns the next event of the run.
    pub fn event(&mut self) -> Result<Option<Stamped>> {
        let mut first: Option<(i64, usize)> = None;
        for (place, (_, rows, _)) in self.kinds.iter_mut().enumerate() {
            if let Some(n) = rows.key()?
                && first.is_none_or(|(least, _)| n < least)
            {
                first = Some((n, place));
            }
        }
        let Some((n, place)) = first else { return Ok(None) };
        let (kind, rows, belonging) = &mut self.kinds[place];
        let mut children = Vec::new();
        if let Some(belonging) = belonging {
            while let Some(of) = belonging.key()?
                && of <= n
            {
                let child = belonging.take()?.into_iter().flatten().skip(2).collect::<Vec<_>>();
                if of < n {
                    let problem = format!("a row belongs to event {of}, which does not exist");
                    return Err(ExportError::malformed(belonging.path(), problem));
                }
                children.push(child);
            }
        }
        let mut cells = rows.take()?.unwrap_or_default().into_iter().skip(1);
        let Some(Cell::Integer(at @ 0..)) = cells.next() else {
            return Err(ExportError::malformed(rows.path(), format!("event {n} has no time")));
        };
        let at = Timestamp::from_nanos(at.cast_unsigned());
        let mut row = Row { cells: cells.collect::<Vec<_>>().into_iter(), children, shared: &self.shared };
        let stamped =
            Stamped::take(*kind, at, &mut row).map_err(|e| ExportError::unreadable(rows.path(), e))?;
        if !stamped.is_storable() {
            let problem = format!("event {n} has values that no history can hold");
            return Err(ExportError::malformed(rows.path(), problem));
        }
        self.events += 1;
        Ok(Some(stamped))
    }

    /// Returns the next gap of the run.
    pub fn gap(&mut self) -> Result<Option<Gap>> {
        let Some(cells) = self.gaps.take()? else { return Ok(None) };
        let [Cell::Integer(from), Cell::Integer(until), Cell::Integer(events)] = cells[..] else {
            return Err(ExportError::malformed(self.gaps.path(), "a row lacks a figure"));
        };
        let time = |t: i64| Timestamp::from_nanos(t.cast_unsigned());
        Ok(Some(Gap { from: time(from), until: time(until), events: events.cast_unsigned() }))
    }
}

/// A row as the codec reads it.
struct Row<'a> {
    cells: vec::IntoIter<Cell>,
    children: Vec<Vec<Cell>>,
    shared: &'a Shared,
}

type Column<T> = std::result::Result<Option<T>, ReadError>;

fn other<T>(cell: &Cell) -> Column<T> {
    Err(ReadError::Unreadable(format!("{cell:?} is in a column of another type")))
}

impl Source<ReadError> for Row<'_> {
    fn integer(&mut self) -> Column<i64> {
        match self.cells.next() {
            None | Some(Cell::Null) => Ok(None),
            Some(Cell::Integer(n)) => Ok(Some(n)),
            Some(cell) => other(&cell),
        }
    }

    fn real(&mut self) -> Column<f64> {
        match self.cells.next() {
            None | Some(Cell::Null) => Ok(None),
            Some(Cell::Real(x)) => Ok(Some(x)),
            Some(cell) => other(&cell),
        }
    }

    fn text(&mut self) -> Column<String> {
        match self.cells.next() {
            None | Some(Cell::Null) => Ok(None),
            Some(Cell::Text(text)) => Ok(Some(text)),
            Some(cell) => other(&cell),
        }
    }

    fn name(&mut self) -> Column<Arc<str>> {
        Ok(self.text()?.map(Into::into))
    }

    fn conditions(&mut self) -> std::result::Result<Conditions, ReadError> {
        let known = self.integer()?.and_then(|id| self.shared.conditions.get(&id));
        known.cloned().ok_or_else(|| ReadError::Unreadable("a link refers to missing conditions".to_owned()))
    }

    fn heard(&mut self) -> Column<Heard> {
        let Some(id) = self.integer()? else { return Ok(None) };
        let missing = || ReadError::Unreadable("a robot refers to missing signals".to_owned());
        self.shared.heard.get(&id).cloned().map(Some).ok_or_else(missing)
    }

    fn children(
        &mut self,
        read: &mut dyn FnMut(&mut dyn Source<ReadError>) -> std::result::Result<(), ReadError>,
    ) -> std::result::Result<(), ReadError> {
        std::mem::take(&mut self.children).into_iter().try_for_each(|cells| {
            read(&mut Row { cells: cells.into_iter(), children: Vec::new(), shared: self.shared })
        })
    }
}
