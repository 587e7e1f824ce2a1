//! Tables as comma-separated values (RFC 4180). A missing value is an empty field; an empty text is `""`.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, BufWriter, Write},
    path::{Path, PathBuf},
};

use super::{
    ExportError, Result,
    table::{Cell, Shape, TableWriter, Type},
};

pub struct Writer {
    path: PathBuf,
    file: BufWriter<File>,
}

impl Writer {
    pub fn create(path: &Path, shape: &Shape) -> Result<Self> {
        let file = File::create(path).map_err(ExportError::file(path))?;
        let mut writer = Self { path: path.to_owned(), file: BufWriter::new(file) };
        let names: Vec<_> = shape.columns.iter().map(|(name, _)| *name).collect();
        writeln!(writer.file, "{}", names.join(",")).map_err(ExportError::file(path))?;
        Ok(writer)
    }
}

impl TableWriter for Writer {
    fn row(&mut self, cells: &[Cell]) -> Result<()> {
        write_row(&mut self.file, cells).map_err(ExportError::file(&self.path))
    }

    fn finish(&mut self) -> Result<()> {
        self.file.flush().map_err(ExportError::file(&self.path))
    }
}

fn write_row(file: &mut impl Write, cells: &[Cell]) -> io::Result<()> {
    for (place, cell) in cells.iter().enumerate() {
        if place > 0 {
            file.write_all(b",")?;
        }
        match cell {
            Cell::Null => {}
            Cell::Integer(n) => write!(file, "{n}")?,
            Cell::Real(x) => write!(file, "{x}")?,
            Cell::Text(text) if text.is_empty() || text.contains([',', '"', '\n', '\r']) => {
                write!(file, "\"{}\"", text.replace('"', "\"\""))?;
            }
            Cell::Text(text) => file.write_all(text.as_bytes())?,
        }
    }
    file.write_all(b"\n")
}

pub struct Reader {
    path: PathBuf,
    file: BufReader<File>,
    types: Vec<Type>,
    line: usize,
}

/// A field, and whether it was quoted.
type Field = (String, bool);

impl Reader {
    pub fn open(path: &Path, shape: &Shape) -> Result<Self> {
        let file = File::open(path).map_err(ExportError::file(path))?;
        let types: Vec<_> = shape.columns.iter().map(|(_, of)| *of).collect();
        let mut reader = Self { path: path.to_owned(), file: BufReader::new(file), types, line: 1 };
        let heads = reader.fields()?.unwrap_or_default();
        let expected = shape.columns.iter().map(|(name, _)| *name);
        // Exports of older versions lack columns at the end.
        reader.types.truncate(heads.len());
        if heads.len() < 2
            || !heads.iter().map(|(name, _)| name.as_str()).eq(expected.clone().take(heads.len()))
        {
            let expected = expected.collect::<Vec<_>>().join(",");
            return Err(reader.wrong(format!("its columns are not {expected}")));
        }
        Ok(reader)
    }

    fn wrong(&self, problem: impl std::fmt::Display) -> ExportError {
        ExportError::malformed(&self.path, format_args!("line {}: {problem}", self.line))
    }

    /// Returns the fields of the next row; `None` at the end.
    fn fields(&mut self) -> Result<Option<Vec<Field>>> {
        let mut bytes = Vec::new();
        loop {
            let read = self.file.read_until(b'\n', &mut bytes).map_err(ExportError::file(&self.path))?;
            let quotes = bytes.iter().filter(|byte| **byte == b'"').count();
            if read == 0 && quotes % 2 == 1 {
                return Err(self.wrong("a quote is not closed"));
            }
            if read == 0 && bytes.is_empty() {
                return Ok(None);
            }
            // A line break within quotes belongs to the text.
            if quotes % 2 == 0 {
                break;
            }
        }
        let text = String::from_utf8(bytes).map_err(|_| self.wrong("it is not UTF-8"))?;
        let text = text.strip_suffix('\n').unwrap_or(&text);
        split(text.strip_suffix('\r').unwrap_or(text))
            .map(Some)
            .ok_or_else(|| self.wrong("quotes are out of place"))
    }

    fn row(&mut self) -> Result<Option<Vec<Cell>>> {
        self.line += 1;
        let Some(fields) = self.fields()? else { return Ok(None) };
        if fields.len() != self.types.len() {
            let (found, expected) = (fields.len(), self.types.len());
            return Err(self.wrong(format_args!("{found} fields, not {expected}")));
        }
        let cell = |((text, quoted), of): (Field, &Type)| match of {
            _ if text.is_empty() && !quoted => Some(Cell::Null),
            Type::Text | Type::Name(_) => Some(Cell::Text(text)),
            Type::Integer => text.parse().ok().map(Cell::Integer),
            Type::Real => text.parse().ok().map(Cell::Real),
        };
        let cells: Option<Vec<_>> = fields.into_iter().zip(&self.types).map(cell).collect();
        cells.map(Some).ok_or_else(|| self.wrong("expected a number"))
    }
}

/// Splits a row into fields; `None` if its quotes are wrong.
fn split(mut text: &str) -> Option<Vec<Field>> {
    let mut fields = Vec::new();
    loop {
        if let Some(mut rest) = text.strip_prefix('"') {
            let mut field = String::new();
            loop {
                let (part, after) = rest.split_once('"')?;
                field += part;
                match after.strip_prefix('"') {
                    Some(more) => {
                        field.push('"');
                        rest = more;
                    }
                    None => {
                        text = after;
                        break;
                    }
                }
            }
            fields.push((field, true));
        } else {
            let end = text.find(',').unwrap_or(text.len());
            fields.push((text[..end].to_owned(), false));
            text = &text[end..];
        }
        if text.is_empty() {
            return Some(fields);
        }
        text = text.strip_prefix(',')?;
    }
}

impl Iterator for Reader {
    type Item = Result<Vec<Cell>>;
    fn next(&mut self) -> Option<Self::Item> {
        self.row().transpose()
    }
}
