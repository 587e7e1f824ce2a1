//! Captures packets that cross links: which, and how they get from the fabric to their reader.

mod file;
mod filter;
mod pcapng;

use std::{
    convert::Infallible,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    task::{Context, Poll, ready},
};

use axum::body::Bytes;
use cotorra_fabric::{TapError, TapReader};
use tokio::sync::mpsc::{Receiver, channel};
use tokio_stream::Stream;

pub use self::file::{CaptureError, CapturePlan, create_capture};
use self::pcapng::{Captured, Writer};
pub(crate) use self::{file::CaptureFile, filter::Filter};

/// Media type of pcapng, as Wireshark registers it.
pub(crate) const PCAPNG: &str = "application/x-pcapng";
/// Bytes to keep of a packet by default: more than any has.
pub(crate) const WHOLE: u32 = 262_144;
/// Most packets that wait for a reader. Further ones are missed.
const MOST_WAITING: usize = 8192;
/// Most bytes that wait for a reader.
const MOST_WAITING_BYTES: usize = 16 << 20;
/// Packets that are written together.
const BATCH: usize = 64;

/// Shows the packets that cross a link, or the links of a node, to a reader.
pub(crate) type Wiretap = Arc<dyn Fn(&str, TapReader) -> Result<(), WiretapError> + Send + Sync>;

/// Error of a capture that cannot begin.
#[derive(Debug, thiserror::Error)]
pub(crate) enum WiretapError {
    #[error(transparent)]
    Tap(#[from] TapError),
    /// The fabric does not carry these packets.
    #[error("{0}")]
    Elsewhere(String),
}

/// A capture as the bytes of a pcapng file.
pub(crate) struct Capture {
    packets: Receiver<Captured>,
    waiting: Arc<AtomicUsize>,
    writer: Writer,
    batch: Vec<Captured>,
    /// Bytes to hand out at once.
    ready: Vec<u8>,
}

impl Capture {
    /// Creates a capture, and the reader that feeds it. The reader never blocks: packets that the capture's own reader is
    /// too slow for are missed, and counted in the next packet.
    pub(crate) fn new(filter: Option<Filter>, snap: u32) -> (Self, TapReader) {
        let (sender, packets) = channel(MOST_WAITING);
        let waiting = Arc::new(AtomicUsize::new(0));
        let also_waiting = Arc::clone(&waiting);
        let mut missed = 0;
        let reader: TapReader = Box::new(move |passage| {
            if sender.is_closed() {
                return false;
            }
            let selects = |bytes| filter.as_ref().is_none_or(|filter| filter.selects(bytes));
            let Some(passage) = passage.filter(|passage| selects(passage.frame.bytes())) else { return true };
            let length = passage.frame.len();
            if waiting.load(Ordering::Relaxed) + length > MOST_WAITING_BYTES {
                missed += u64::from(passage.frame.wire_packets());
                return true;
            }
            match sender.try_reserve() {
                Ok(place) => {
                    waiting.fetch_add(length, Ordering::Relaxed);
                    place.send(Captured::new(passage, std::mem::take(&mut missed)));
                }
                Err(_) => missed += u64::from(passage.frame.wire_packets()),
            }
            true
        });
        let mut ready = Vec::new();
        let writer = Writer::new(snap, &mut ready);
        (Self { packets, waiting: also_waiting, writer, batch: Vec::new(), ready }, reader)
    }
}

impl Stream for Capture {
    type Item = Result<Bytes, Infallible>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let Self { packets, waiting, writer, batch, ready } = &mut *self;
        // The first block goes out at once, so that the reader knows that the capture has begun.
        if ready.is_empty() {
            if ready!(packets.poll_recv_many(context, batch, BATCH)) == 0 {
                return Poll::Ready(None);
            }
            for packet in batch.drain(..) {
                waiting.fetch_sub(packet.len(), Ordering::Relaxed);
                writer.write(packet, ready);
            }
        }
        Poll::Ready(Some(Ok(std::mem::take(ready).into())))
    }
}

#[cfg(test)]
mod tests;
