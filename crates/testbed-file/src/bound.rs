//! Bounds on figures, as KPIs of services have them.

use cotorra_graph::{Bound, InvalidBound};
use serde_json::{Value as Json, json};

use crate::yaml::{
    Sink, Span,
    decode::{Decode, Node, expected, nearest},
};

impl Decode for Bound {
    fn schema() -> Json {
        let examples = ["service_time p95 <= 15 ms", "answered >= 99.9 %", "localization_error p95 <= 0.1 m"];
        json!({ "type": "string", "pattern": "(<=|>=)", "examples": examples })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let Some(text) = node.text() else {
            expected(node, "a bound on a figure", "write one, such as `service_time p95 <= 15 ms`", sink);
            return None;
        };
        text.parse().map_err(|wrong| report(&wrong, &node.span, sink)).ok()
    }
}

/// Reports a wrong bound at its place.
pub(crate) fn report(wrong: &InvalidBound, span: &Span, sink: &mut Sink) {
    let text = wrong.to_string();
    let near = wrong.unknown_figure().and_then(|(name, mut figures)| nearest(name, &mut figures));
    let (message, help) = text.split_once(": ").unwrap_or((&text, "see docs/reference/testbed-file.md"));
    let help = near.map_or_else(|| help.to_owned(), |near| format!("did you mean `{near}`?"));
    sink.error(span, message).help(help);
}
