//! One direction of a TCP connection, put in order.

/// Bytes that may wait for others before them, of all streams of a flow.
const MOST_HELD: usize = 8 << 20;
/// Segments of one stream that may wait.
const MOST_AHEAD: usize = 4096;

/// What a stream may hold is held already.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Full;

#[derive(Debug)]
struct Ahead {
    sequence: u32,
    bytes: Vec<u8>,
}

/// Puts segments in order, whichever came first, more than once, or overlap.
#[derive(Debug)]
pub(crate) struct Stream {
    next: u32,
    /// In order, by how far they are behind `next`.
    ahead: Vec<Ahead>,
    end: Option<u32>,
}

/// How far a place in a stream is behind another; negative before it.
fn distance(from: u32, to: u32) -> i32 {
    to.wrapping_sub(from).cast_signed()
}

impl Stream {
    /// A stream whose first byte has this number.
    pub fn new(first: u32) -> Self {
        Self { next: first, ahead: Vec::new(), end: None }
    }

    /// Takes a segment, and hands out what is in order now. `held` is what all streams hold.
    ///
    /// # Errors
    /// [`Full`]: the stream cannot be followed any more.
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

    /// What it holds.
    pub fn held(&self) -> usize {
        self.ahead.iter().map(|ahead| ahead.bytes.len()).sum()
    }

    /// Lets go of what it holds; gives how much that was.
    pub fn clear(&mut self) -> usize {
        let held = self.held();
        self.ahead = Vec::new();
        held
    }

    /// Whether all of it, to the end that its sender made, has come.
    pub fn is_over(&self) -> bool {
        self.end.is_some_and(|end| distance(end, self.next) >= 0)
    }
}

/// Hands out what of these bytes is not behind `next`, and moves that.
fn advance(next: &mut u32, sequence: u32, bytes: &[u8], take: &mut dyn FnMut(&[u8])) {
    let skipped = next.wrapping_sub(sequence) as usize;
    if let Some(new) = bytes.get(skipped..).filter(|new| !new.is_empty()) {
        *next = next.wrapping_add(new.len() as u32);
        take(new);
    }
}
