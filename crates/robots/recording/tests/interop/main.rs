//! Recordings, read by programs of others.

#[cfg(feature = "foxglove")]
mod foxglove;
mod peers;
