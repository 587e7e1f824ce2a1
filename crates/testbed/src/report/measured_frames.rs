//! Frames by whose lateness a run is judged, and how late they may be.

/// Highest trusted lateness at the 99th percentile, µs.
pub(super) const VALID_P99_US: f64 = 1000.0;

/// Highest trusted lateness at the median, µs.
pub(super) const VALID_P50_US: f64 = 250.0;

/// Frames whose lateness is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MeasuredFrames {
    /// All frames, in virtual time, where none is late.
    Exact,
    /// All frames, because the fabric carried them.
    All,
    /// The frames that the fabric carried; others crossed interfaces of this machine.
    Emulated,
    /// Probes alone, because the kernel carried the frames.
    Probes,
}
