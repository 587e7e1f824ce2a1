//! A packet, and why there may be none.

/// A packet of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Kind of its first header: a `LINKTYPE_`, such as [`ETHERNET`](crate::ETHERNET).
    pub link_type: u16,
    /// Time of the capture's clock, ns since 1970.
    pub at_ns: i64,
    /// Its first bytes, or all.
    pub bytes: &'a [u8],
    /// Its whole length, bytes.
    pub original: u32,
}

/// A file that is no capture.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReadError {
    /// It begins as no capture does.
    #[error("it is no capture: give a file of `tcpdump -w`, i.e. pcap or pcapng")]
    NoCapture,
    /// It ends within its header.
    #[error("the header of the capture is cut off")]
    CutOff,
    /// No capture has these bytes here.
    #[error("the capture is damaged at byte {0}")]
    Damaged(usize),
}
