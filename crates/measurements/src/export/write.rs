//! Writes a run to tables.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
};

use cotorra_graph::{Conditions, Stamped};

use super::{
    Format, Result, create,
    table::{Cell, Shape, TableWriter},
};
use crate::{
    Gap, Kind,
    codec::{Columns, Fields, Value},
};

/// Tables, each created with its first row.
pub struct Tables {
    folder: PathBuf,
    format: Format,
    open: BTreeMap<&'static str, Box<dyn TableWriter>>,
    /// Conditions that were written, by their JSON.
    conditions: HashMap<String, i64>,
    /// Signals that were written.
    heard: HashMap<String, i64>,
    events: u64,
}

impl Tables {
    pub fn new(folder: &Path, format: Format) -> Result<Self> {
        let (open, conditions, heard) = Default::default();
        let mut tables = Self { folder: folder.to_owned(), format, open, conditions, heard, events: 0 };
        // Created at once, so that an unsupported format fails at once.
        tables.table(&Shape::gaps())?;
        Ok(tables)
    }

    pub fn events(&self) -> u64 {
        self.events
    }

    fn row(&mut self, shape: &Shape, mut cells: Vec<Cell>) -> Result<()> {
        shape.name(&mut cells);
        self.table(shape)?.row(&cells)
    }

    fn table(&mut self, shape: &Shape) -> Result<&mut dyn TableWriter> {
        if !self.open.contains_key(shape.name) {
            self.open.insert(shape.name, create(self.format, &self.folder, shape)?);
        }
        Ok(&mut **self.open.get_mut(shape.name).expect("it was just made"))
    }

    pub fn event(&mut self, stamped: &Stamped) -> Result<()> {
        let kind = Kind::of(&stamped.event);
        let (mut row, mut children) = (Fields::default(), Fields::default());
        stamped.put(&mut row, &mut children);
        let n = Cell::Integer(self.events.cast_signed());
        let mut cells = vec![n.clone(), Cell::Integer(stamped.at.as_nanos().cast_signed())];
        for value in row.0 {
            cells.push(self.cell(value)?);
        }
        self.row(&Shape::of(kind), cells)?;
        if let Some(shape) = Shape::children(kind) {
            let width = shape.columns.len() - 2;
            for (place, child) in children.0.chunks(width).enumerate() {
                let mut cells = vec![n.clone(), Cell::Integer(place as i64)];
                for value in child {
                    cells.push(self.cell(value.clone())?);
                }
                self.row(&shape, cells)?;
            }
        }
        self.events += 1;
        Ok(())
    }

    pub fn gap(&mut self, gap: &Gap) -> Result<()> {
        let figures = [gap.from.as_nanos(), gap.until.as_nanos(), gap.events];
        self.row(&Shape::gaps(), figures.map(|n| Cell::Integer(n.cast_signed())).to_vec())
    }

    fn cell(&mut self, value: Value<'_>) -> Result<Cell> {
        Ok(match value {
            Value::Null => Cell::Null,
            Value::Integer(n) => Cell::Integer(n),
            Value::Real(x) if x.is_nan() => Cell::Null,
            Value::Real(x) => Cell::Real(x),
            Value::Text(text) => Cell::Text(text.into_owned()),
            Value::Name(name) => Cell::Text(name.to_owned()),
            Value::Conditions(_, conditions) => Cell::Integer(self.id(conditions)?),
            Value::Heard(heard) => Cell::Integer(self.heard(heard.text())?),
        })
    }

    fn id(&mut self, conditions: &Conditions) -> Result<i64> {
        let json = serde_json::to_string(conditions).expect("conditions hold only what JSON can");
        if let Some(id) = self.conditions.get(&json) {
            return Ok(*id);
        }
        let id = self.conditions.len() as i64;
        let mut fields = Fields::default();
        conditions.put(&mut fields);
        let mut cells = vec![Cell::Integer(id)];
        for value in fields.0 {
            cells.push(self.cell(value)?);
        }
        self.row(&Shape::conditions(), cells)?;
        self.conditions.insert(json, id);
        Ok(id)
    }

    fn heard(&mut self, signals: String) -> Result<i64> {
        if let Some(id) = self.heard.get(&signals) {
            return Ok(*id);
        }
        let id = self.heard.len() as i64;
        self.row(&Shape::heard(), vec![Cell::Integer(id), Cell::Text(signals.clone())])?;
        self.heard.insert(signals, id);
        Ok(id)
    }

    /// Completes the files, and returns the number of events.
    pub fn finish(mut self) -> Result<u64> {
        self.open.values_mut().try_for_each(|table| table.finish())?;
        Ok(self.events)
    }
}
