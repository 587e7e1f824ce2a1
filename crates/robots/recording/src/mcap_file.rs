//! Writes MCAP files like `ros2 bag`: profile `ros2`, CDR, `ros2msg` schemas, QoS of each channel, and LZ4 chunks with
//! indexes and a summary.
//!
//! A chunk is written as a whole, at once. A file of a killed writer has all chunks before that: `mcap recover` and
//! sequential readers can read it.

use std::{
    fs::File,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use cotorra_graph::Timestamp;
use mcap::{
    Attachment, Compression, McapError, WriteOptions, Writer,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};

use crate::{
    channel::Encoded,
    sink::{RecordingError, Sink},
};

/// Size at which a chunk ends, bytes before compression.
const CHUNK_BYTES: usize = 1 << 20;
/// Time of the run after which a chunk ends: the most that a kill loses.
const CHUNK_TIME: std::time::Duration = std::time::Duration::from_secs(2);

/// Description of the recorded run.
#[derive(Debug, Clone, Copy)]
pub struct About<'a> {
    /// The testbed's name.
    pub name: &'a str,
    /// The run's seed.
    pub seed: u64,
    /// Begin of the run, nanoseconds since 1970; 0 in virtual time.
    pub started_at_unix_ns: i64,
    /// The testbed file's text.
    pub testbed_file: &'a str,
}

/// An MCAP file that is being written.
pub struct McapFile {
    path: PathBuf,
    /// `None` once it is finished.
    writer: Option<Writer<NoSeek<io::BufWriter<File>>>>,
    /// MCAP's channel numbers, by the index of ours.
    opened: Vec<OpenChannel>,
    /// Time of the chunk's first message, and its bytes so far; `None` between two chunks.
    chunk: Option<(Timestamp, usize)>,
}

struct OpenChannel {
    id: u16,
    messages: u32,
}

impl McapFile {
    /// Creates the file with the description of the run: metadata `cotorra`, and the testbed file as an attachment.
    ///
    /// # Errors
    /// [`RecordingError`] if it exists already or cannot be created.
    pub fn create(path: &Path, about: About<'_>) -> Result<Self, RecordingError> {
        let file = File::create_new(path).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => RecordingError::Taken(path.to_owned()),
            _ => RecordingError::File { path: path.to_owned(), source },
        })?;
        Self::on(file, path, about)
    }

    /// Writes to an open, empty file.
    pub(crate) fn on(file: File, path: &Path, about: About<'_>) -> Result<Self, RecordingError> {
        Self::begin(file, path, about).map_err(|error| failed(path, error))
    }

    fn begin(file: File, path: &Path, about: About<'_>) -> Result<Self, McapError> {
        let version = env!("CARGO_PKG_VERSION");
        let options = WriteOptions::new()
            .profile("ros2")
            .library(format!("cotorra {version}"))
            .compression(Some(Compression::Lz4))
            .chunk_size(None)
            // Without seeking, a chunk is built in memory, so that the file never has an incomplete header.
            .disable_seeking(true);
        let mut writer = options.create(NoSeek::new(io::BufWriter::new(file)))?;
        let metadata = [
            ("testbed", about.name.to_owned()),
            ("seed", about.seed.to_string()),
            ("started_at_unix_ns", about.started_at_unix_ns.to_string()),
            ("version", version.to_owned()),
        ];
        let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        writer.write_metadata(&Metadata { name: "cotorra".to_owned(), metadata })?;
        writer.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name: "testbed.yaml".to_owned(),
            media_type: "application/yaml".to_owned(),
            data: about.testbed_file.as_bytes().into(),
        })?;
        writer.flush()?;
        Ok(Self { path: path.to_owned(), writer: Some(writer), opened: Vec::new(), chunk: None })
    }

    fn put(&mut self, message: &Encoded<'_>) -> Result<(), McapError> {
        let Some(writer) = &mut self.writer else { return Err(McapError::AttemptedWriteAfterFailure) };
        let Encoded { channel, at, payload } = *message;
        if self.chunk.is_some_and(|(began, bytes)| at.since(began) >= CHUNK_TIME || bytes >= CHUNK_BYTES) {
            writer.flush()?;
            self.chunk = None;
        }
        self.chunk.get_or_insert((at, 0)).1 += payload.len();
        if channel.index >= self.opened.len() {
            let schema = writer.add_schema(channel.type_name, "ros2msg", channel.schema.as_bytes())?;
            let id = writer.add_channel(schema, &channel.topic, "cdr", &channel.metadata())?;
            self.opened.push(OpenChannel { id, messages: 0 });
        }
        let opened = &mut self.opened[channel.index];
        let time = at.as_nanos();
        let header = MessageHeader {
            channel_id: opened.id,
            sequence: opened.messages,
            log_time: time,
            publish_time: time,
        };
        opened.messages = opened.messages.wrapping_add(1);
        writer.write_to_known_channel(&header, payload)
    }
}

impl Sink for McapFile {
    fn write(&mut self, message: &Encoded<'_>) -> Result<(), RecordingError> {
        self.put(message).map_err(|error| failed(&self.path, error))
    }

    fn finish(&mut self) -> Result<(), RecordingError> {
        let Some(mut writer) = self.writer.take() else { return Ok(()) };
        let finished = writer.finish().map_err(|error| failed(&self.path, error));
        let flushed = writer.into_inner().into_inner().flush();
        finished?;
        flushed.map_err(|error| failed(&self.path, McapError::Io(error)))
    }
}

fn failed(path: &Path, error: McapError) -> RecordingError {
    let source = match error {
        McapError::Io(source) => source,
        other => io::Error::other(other),
    };
    RecordingError::File { path: path.to_owned(), source }
}
