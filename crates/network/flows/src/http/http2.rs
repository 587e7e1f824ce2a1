//! Parses requests and responses of HTTP/2 on one connection (RFC 9113). A stream that the client opens is a request. Its
//! response ends with the server's half of the stream, behind trailers such as those of gRPC.

use std::{borrow::Cow, collections::HashMap, fmt};

use loona_hpack::Decoder;

use self::frames::{Frame, Frames, Taken};
use super::{MOST, NotHttp, Passed};

mod frames;

/// Longest field section of a request whose path counts, bytes.
const MOST_FIELDS: usize = 8 << 10;
/// Largest table of field lines that a client may use, bytes.
const MOST_TABLE: usize = 64 << 10;

/// The state of both directions of a connection.
#[derive(Debug)]
pub(super) struct Exchange {
    /// Rest of what the client sends before its first frame.
    preface: &'static [u8],
    client: Frames,
    /// Time and mark of the first byte of the present frame.
    began: Option<Passed>,
    /// Fields of the client's requests; `None` if all paths count.
    fields: Option<Fields>,
    /// The stream whose field section is under way, and the time of its first byte.
    opening: Option<(u32, Passed)>,
    /// The last stream that the client opened.
    last: u32,
    server: Frames,
    /// The stream that ends with the server's present field section.
    closing: Option<u32>,
    /// Number of the measured request of each stream without a response.
    pending: HashMap<u32, u64>,
    /// Number of measured requests so far.
    count: u64,
}

impl Exchange {
    /// Creates the exchange of a connection whose client still has to send that rest of its preface.
    pub fn new(preface: &'static [u8], path: Option<String>) -> Self {
        Self {
            preface,
            client: Frames::default(),
            began: None,
            fields: path.map(Fields::new),
            opening: None,
            last: 0,
            server: Frames::default(),
            closing: None,
            pending: HashMap::new(),
            count: 0,
        }
    }

    /// Takes the client's next bytes. Passes each measured request to `begin`.
    pub fn client(
        &mut self,
        now: Passed,
        mut bytes: &[u8],
        mut begin: impl FnMut(u64, Passed),
    ) -> Result<(), NotHttp> {
        let preface = self.preface.len().min(bytes.len());
        bytes = bytes.strip_prefix(&self.preface[..preface]).ok_or(NotHttp)?;
        self.preface = &self.preface[preface..];
        while !bytes.is_empty() {
            let began = *self.began.get_or_insert(now);
            let Some(Taken { frame, payload, is_over }) = self.client.take(&mut bytes) else { continue };
            if frame.kind == Frame::HEADERS {
                self.opening.get_or_insert((frame.stream, began));
            }
            if let Some(fields) = self.fields.as_mut().filter(|_| frame.has_fields()) {
                fields.extend(payload)?;
            }
            if is_over {
                self.began = None;
                self.end_client_frame(frame, &mut begin)?;
            }
        }
        Ok(())
    }

    fn end_client_frame(&mut self, frame: Frame, begin: &mut impl FnMut(u64, Passed)) -> Result<(), NotHttp> {
        if frame.kind == Frame::RST_STREAM {
            // Nobody waits for the response any more.
            self.pending.remove(&frame.stream);
        }
        if !frame.has_fields() {
            return Ok(());
        }
        let (stream, began) = self.opening.filter(|(stream, _)| *stream == frame.stream).ok_or(NotHttp)?;
        if let Some(fields) = &mut self.fields {
            fields.end_frame(frame)?;
        }
        if !frame.ends_fields() {
            return Ok(());
        }
        self.opening = None;
        let is_measured = match &mut self.fields {
            Some(fields) => fields.are_of_path()?,
            None => true,
        };
        // Further fields of a stream are trailers.
        if stream <= self.last {
            return Ok(());
        }
        self.last = stream;
        if is_measured {
            if self.pending.len() == MOST {
                return Err(NotHttp);
            }
            begin(self.count, began);
            self.pending.insert(stream, self.count);
            self.count += 1;
        }
        Ok(())
    }

    /// Takes the server's next bytes. Passes each measured request whose response ends in them to `answer`.
    pub fn server(&mut self, mut bytes: &[u8], mut answer: impl FnMut(u64)) -> Result<(), NotHttp> {
        while !bytes.is_empty() {
            let Some(Taken { frame, is_over: true, .. }) = self.server.take(&mut bytes) else { continue };
            if frame.ends_stream() {
                self.closing = Some(frame.stream);
            }
            // A field section goes on in frames of its own.
            if frame.has_fields() && !frame.ends_fields() {
                continue;
            }
            let closed = match frame.kind {
                Frame::RST_STREAM => {
                    self.pending.remove(&frame.stream);
                    None
                }
                _ => self.closing.take_if(|closing| *closing == frame.stream),
            };
            if let Some(request) = closed.and_then(|stream| self.pending.remove(&stream)) {
                answer(request);
            }
        }
        Ok(())
    }
}

/// Fields of a client's requests, of which those of one path count.
struct Fields {
    path: String,
    decoder: Decoder<'static>,
    /// The field section so far, in its compressed form (RFC 7541).
    section: Vec<u8>,
    /// Where the part of the present frame begins.
    frame: usize,
}

impl fmt::Debug for Fields {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Fields").field("path", &self.path).finish_non_exhaustive()
    }
}

impl Fields {
    fn new(path: String) -> Self {
        let mut decoder = Decoder::new();
        decoder.set_max_allowed_table_size(MOST_TABLE);
        Self { path, decoder, section: Vec::new(), frame: 0 }
    }

    /// Takes the next bytes of a frame's payload.
    fn extend(&mut self, part: &[u8]) -> Result<(), NotHttp> {
        if self.section.len() + part.len() > MOST_FIELDS {
            return Err(NotHttp);
        }
        self.section.extend_from_slice(part);
        Ok(())
    }

    /// Removes what is no field from the payload of a frame that ends.
    fn end_frame(&mut self, frame: Frame) -> Result<(), NotHttp> {
        let fields = frame.fields(&self.section[self.frame..]).ok_or(NotHttp)?;
        self.section.truncate(self.frame + fields.end);
        self.section.drain(self.frame..self.frame + fields.start);
        self.frame = self.section.len();
        Ok(())
    }

    /// Ends a field section. Returns whether it is of a request that counts, whatever its query.
    fn are_of_path(&mut self) -> Result<bool, NotHttp> {
        let mut is_of_path = false;
        let field = |name: Cow<'_, [u8]>, value: Cow<'_, [u8]>| {
            if *name == *b":path" {
                let path = value.split(|byte| *byte == b'?').next().unwrap_or_default();
                is_of_path = path == self.path.as_bytes();
            }
        };
        self.decoder.decode_with_cb(&self.section, field).map_err(|_| NotHttp)?;
        self.section.clear();
        self.frame = 0;
        Ok(is_of_path)
    }
}
