//! Reorders the segments of one direction of a TCP connection.

/// Most bytes that all streams of a flow may hold back for missing ones.
const MOST_HELD: usize = 8 << 20;
/// Most segments that one stream may hold back.
const MOST_AHEAD: usize = 4096;

/// The stream reached a bound and cannot be followed any more.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Full;

#[derive(Debug)]
struct Ahead {
    sequence: u32,
    bytes: Vec<u8>,
}

/// Reorders segments that may be repeated or overlap.
#[derive(Debug)]
pub(crate) struct Stream {
    next: u32,
    /// Segments held back, by their distance behind `next`.
    ahead: Vec<Ahead>,
    end: Option<u32>,
}

/// Returns how far `to` is behind `from` in a stream; negative if it is before.
fn distance(from: u32, to: u32) -> i32 {
    to.wrapping_sub(from).cast_signed()
}

impl Stream {
    /// Creates a stream whose first byte has this sequence number.
    pub fn new(first: u32) -> Self {
        Self { next: first, ahead: Vec::new(), end: None }
    }

    /// Takes a segment, and passes the bytes that are in order now to `take`. `held` counts the bytes that all streams hold
    /// back.
    ///
    /// # Errors
    /// [`Full`] if a bound is exceeded.
    pub fn push(
        &mut self,
        sequence: u32,
        bytes: &[u8],
        fin: bool,
        held: &mut usize,
        take: &mut dyn FnMut(&[u8]),
    ) -> Result<(), Full> {
        if fin {
            self.end = Some(sequence.wrapping_add(bytes.len() as u32));
        }
        if distance(self.next, sequence) > 0 {
            return self.keep(sequence, bytes, held);
        }
        advance(&mut self.next, sequence, bytes, take);
        let mut reached = 0;
        while let Some(ahead) = self.ahead.get(reached).filter(|a| distance(self.next, a.sequence) <= 0) {
            reached += 1;
            *held -= ahead.bytes.len();
            advance(&mut self.next, ahead.sequence, &ahead.bytes, take);
        }
        self.ahead.drain(..reached);
        Ok(())
    }

    fn keep(&mut self, sequence: u32, bytes: &[u8], held: &mut usize) -> Result<(), Full> {
        let behind = |ahead: &Ahead| distance(self.next, ahead.sequence);
        let place = self.ahead.partition_point(|ahead| behind(ahead) < distance(self.next, sequence));
        let again = |ahead: &Ahead| ahead.sequence == sequence && ahead.bytes.len() >= bytes.len();
        if bytes.is_empty() || self.ahead.get(place).is_some_and(again) {
            return Ok(());
        }
        if *held + bytes.len() > MOST_HELD || self.ahead.len() == MOST_AHEAD {
            return Err(Full);
        }
        *held += bytes.len();
        self.ahead.insert(place, Ahead { sequence, bytes: bytes.to_vec() });
        Ok(())
    }

    /// Returns the bytes held back.
    pub fn held(&self) -> usize {
        self.ahead.iter().map(|ahead| ahead.bytes.len()).sum()
    }

    /// Drops the bytes held back. Returns their number.
    pub fn clear(&mut self) -> usize {
        let held = self.held();
        self.ahead = Vec::new();
        held
    }

    /// Whether everything up to the sender's FIN has come.
    pub fn is_over(&self) -> bool {
        self.end.is_some_and(|end| distance(end, self.next) >= 0)
    }
}

/// Passes the bytes from `next` on to `take`, and advances `next`.
fn advance(next: &mut u32, sequence: u32, bytes: &[u8], take: &mut dyn FnMut(&[u8])) {
    let skipped = next.wrapping_sub(sequence) as usize;
    if let Some(new) = bytes.get(skipped..).filter(|new| !new.is_empty()) {
        *next = next.wrapping_add(new.len() as u32);
        take(new);
    }
}
