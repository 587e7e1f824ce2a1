//! YAML files read so that every mistake in them is reported in place: a tree that knows where each value stands, and
//! decoders that go on after an error, so that one look shows them all. A file's record is declared once, and gives
//! both its decoder and its JSON Schema.

pub(crate) mod decode;
mod diagnostics;
mod quantity;
mod tree;

pub use diagnostics::{Diagnostic, Diagnostics};
pub(crate) use diagnostics::{Sink, Span};
pub(crate) use quantity::{
    Angle, Bytes, Decibels, DecisionTime, Drift, Frequency, Metres, Speed, WattHours, Watts,
};
pub(crate) use tree::{parse, shorten};
