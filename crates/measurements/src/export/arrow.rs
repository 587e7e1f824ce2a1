//! Tables as Apache Parquet and in Arrow's IPC file format: the same record batches in two kinds of files.

use std::{
    fs::File,
    io::{self, BufReader, BufWriter},
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::{
    Array, ArrayRef, Float64Array, Int64Array, RecordBatch, RecordBatchReader, StringArray,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_schema::{ArrowError, DataType, Field, Schema};
use parquet::{
    arrow::{ArrowWriter, arrow_reader::ParquetRecordBatchReaderBuilder},
    basic::Compression,
    file::properties::WriterProperties,
};

use super::{
    ExportError, Result,
    table::{Cell, Shape, TableWriter, Type},
};

/// Rows of a record batch.
const BATCH: usize = 8192;
/// Rows of a row group of a Parquet file, which stays in memory until it is complete.
const ROW_GROUP: usize = 65_536;

fn schema(shape: &Shape) -> Arc<Schema> {
    let field = |(name, of): &(&'static str, Type)| {
        let of = match of {
            Type::Integer => DataType::Int64,
            Type::Real => DataType::Float64,
            Type::Text | Type::Name(_) => DataType::Utf8,
        };
        Field::new(*name, of, true)
    };
    Arc::new(Schema::new(shape.columns.iter().map(field).collect::<Vec<_>>()))
}

enum Sink {
    // `None` once complete.
    Parquet(Option<ArrowWriter<BufWriter<File>>>),
    Ipc(arrow_ipc::writer::FileWriter<BufWriter<File>>),
}

/// Gathers rows and writes them by columns.
pub struct Writer {
    path: PathBuf,
    schema: Arc<Schema>,
    rows: Vec<Vec<Cell>>,
    sink: Sink,
}

impl Writer {
    pub fn parquet(path: &Path, shape: &Shape) -> Result<Self> {
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_max_row_group_row_count(Some(ROW_GROUP))
            .build();
        Self::new(path, shape, |file, schema| {
            Ok(Sink::Parquet(Some(ArrowWriter::try_new(file, schema, Some(properties))?)))
        })
    }

    pub fn ipc(path: &Path, shape: &Shape) -> Result<Self> {
        Self::new(path, shape, |file, schema| {
            Ok(Sink::Ipc(arrow_ipc::writer::FileWriter::try_new(file, &schema)?))
        })
    }

    fn new(
        path: &Path,
        shape: &Shape,
        sink: impl FnOnce(BufWriter<File>, Arc<Schema>) -> std::result::Result<Sink, ArrowError>,
    ) -> Result<Self> {
        let file = File::create(path).map_err(ExportError::file(path))?;
        let schema = schema(shape);
        let sink = sink(BufWriter::new(file), schema.clone()).map_err(|e| failed(path, e))?;
        Ok(Self { path: path.to_owned(), schema, rows: Vec::new(), sink })
    }

    fn write(&mut self) -> std::result::Result<(), ArrowError> {
        let rows = std::mem::take(&mut self.rows);
        if rows.is_empty() {
            return Ok(());
        }
        let column = |(place, field): (usize, &Arc<Field>)| -> ArrayRef {
            let cells = rows.iter().map(|row| &row[place]);
            match field.data_type() {
                DataType::Int64 => Arc::new(Int64Array::from_iter(cells.map(|cell| match cell {
                    Cell::Integer(n) => Some(*n),
                    _ => None,
                }))),
                DataType::Float64 => Arc::new(Float64Array::from_iter(cells.map(|cell| match cell {
                    Cell::Real(x) => Some(*x),
                    _ => None,
                }))),
                _ => Arc::new(StringArray::from_iter(cells.map(|cell| match cell {
                    Cell::Text(text) => Some(text.as_str()),
                    _ => None,
                }))),
            }
        };
        let columns = self.schema.fields().iter().enumerate().map(column).collect();
        let batch = RecordBatch::try_new(self.schema.clone(), columns)?;
        match &mut self.sink {
            Sink::Parquet(Some(writer)) => Ok(writer.write(&batch)?),
            Sink::Parquet(None) => Ok(()),
            Sink::Ipc(writer) => writer.write(&batch),
        }
    }
}

fn failed(path: &Path, error: ArrowError) -> ExportError {
    match error {
        ArrowError::IoError(_, source) => ExportError::File { path: path.to_owned(), source },
        other => ExportError::File { path: path.to_owned(), source: io::Error::other(other) },
    }
}

impl TableWriter for Writer {
    fn row(&mut self, cells: &[Cell]) -> Result<()> {
        self.rows.push(cells.to_vec());
        if self.rows.len() < BATCH {
            return Ok(());
        }
        self.write().map_err(|e| failed(&self.path, e))
    }

    fn finish(&mut self) -> Result<()> {
        let complete = |writer: &mut Self| -> std::result::Result<(), ArrowError> {
            writer.write()?;
            match &mut writer.sink {
                Sink::Parquet(sink) => {
                    if let Some(sink) = sink.take() {
                        sink.close()?;
                    }
                    Ok(())
                }
                Sink::Ipc(sink) => sink.finish(),
            }
        };
        complete(self).map_err(|e| failed(&self.path, e))
    }
}

/// The rows of a Parquet file.
pub fn parquet(path: &Path, shape: &Shape) -> Result<impl Iterator<Item = Result<Vec<Cell>>> + use<>> {
    let file = File::open(path).map_err(ExportError::file(path))?;
    let reader = ParquetRecordBatchReaderBuilder::try_new(file)
        .and_then(|builder| builder.with_batch_size(BATCH).build())
        .map_err(|e| ExportError::malformed(path, e))?;
    rows(path, shape, &reader.schema(), reader)
}

/// The rows of an Arrow IPC file.
pub fn ipc(path: &Path, shape: &Shape) -> Result<impl Iterator<Item = Result<Vec<Cell>>> + use<>> {
    let file = File::open(path).map_err(ExportError::file(path))?;
    let reader = arrow_ipc::reader::FileReader::try_new(BufReader::new(file), None)
        .map_err(|e| ExportError::malformed(path, e))?;
    rows(path, shape, &reader.schema(), reader)
}

fn rows<B: Iterator<Item = std::result::Result<RecordBatch, ArrowError>>>(
    path: &Path,
    shape: &Shape,
    found: &Schema,
    batches: B,
) -> Result<impl Iterator<Item = Result<Vec<Cell>>> + use<B>> {
    let expected = schema(shape);
    let columns = |schema: &Schema| -> Vec<_> {
        schema.fields().iter().map(|f| (f.name().clone(), f.data_type().clone())).collect()
    };
    // Exports of older versions lack columns at the end.
    let found = columns(found);
    if found.len() < 2 || !columns(&expected).starts_with(&found) {
        let names: Vec<_> = expected
            .fields()
            .iter()
            .map(|field| format!("{} ({})", field.name(), field.data_type()))
            .collect();
        return Err(ExportError::malformed(path, format_args!("its columns are not {}", names.join(", "))));
    }
    let path = path.to_owned();
    Ok(batches.flat_map(move |batch| -> Box<dyn Iterator<Item = Result<Vec<Cell>>>> {
        match batch {
            Ok(batch) => Box::new((0..batch.num_rows()).map(move |row| Ok(cells(&batch, row)))),
            Err(error) => Box::new(std::iter::once(Err(ExportError::malformed(&path, error)))),
        }
    }))
}

fn cells(batch: &RecordBatch, row: usize) -> Vec<Cell> {
    let cell = |column: &ArrayRef| match column.data_type() {
        _ if column.is_null(row) => Cell::Null,
        DataType::Int64 => Cell::Integer(column.as_primitive::<Int64Type>().value(row)),
        DataType::Float64 => Cell::Real(column.as_primitive::<Float64Type>().value(row)),
        _ => Cell::Text(column.as_string::<i32>().value(row).to_owned()),
    };
    batch.columns().iter().map(cell).collect()
}
