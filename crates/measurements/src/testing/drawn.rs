//! Events whose declaration says all: their columns are drawn one by one, and read.

use std::sync::Arc;

use cotorra_graph::{Conditions, Event, Stamped, Timestamp, millis};
use proptest::{collection::vec, prelude::*, sample::select};

use super::{duration, real};
use crate::{
    Kind,
    codec::{Heard, ReadError, Source},
};

/// Draws an event of any kind without series, child rows and columns that only hold certain words.
pub(super) fn event() -> impl Strategy<Value = Event> {
    let is_drawn = |kind: &Kind| {
        let table = kind.table();
        let has_words = matches!(kind, Kind::Decision | Kind::Goal | Kind::Staleness | Kind::Vnf);
        table.series.is_empty() && table.children.is_none() && !has_words
    };
    let kinds: Vec<_> = Kind::ALL.into_iter().filter(is_drawn).collect();
    (select(kinds), vec(cell(), 16)).prop_filter_map(
        "a value is out of its column's range",
        |(kind, cells)| {
            let drawn = Stamped::take(kind, Timestamp::ZERO, &mut Drawn(cells.into_iter()));
            drawn.ok().map(|drawn| drawn.event)
        },
    )
}

/// A value for a column of any type.
#[derive(Debug, Clone)]
struct Cell {
    integer: i64,
    real: f64,
    text: String,
    name: Option<&'static str>,
}

prop_compose! {
    fn cell()(
        integer in prop_oneof![0..256_i64, any::<i64>()],
        // Milliseconds of longer durations are not exact.
        real in prop_oneof![
            real().prop_filter("a duration too long", |ms| !(2e9..1e15).contains(ms)),
            duration().prop_map(millis::of),
        ],
        text in ".*",
        name in prop_oneof![9 => select(vec![Some("a"), Some("b"), Some("c~d"), Some("9.x_y")]), 1 => Just(None)],
    ) -> Cell {
        Cell { integer, real, text, name }
    }
}

struct Drawn(std::vec::IntoIter<Cell>);

impl Drawn {
    fn next(&mut self) -> Cell {
        self.0.next().expect("a drawn event has few columns")
    }
}

type Column<T> = Result<Option<T>, ReadError>;

impl Source<ReadError> for Drawn {
    fn integer(&mut self) -> Column<i64> {
        Ok(Some(self.next().integer))
    }

    fn real(&mut self) -> Column<f64> {
        Ok(Some(self.next().real))
    }

    fn text(&mut self) -> Column<String> {
        Ok(Some(self.next().text))
    }

    fn name(&mut self) -> Column<Arc<str>> {
        Ok(self.next().name.map(Into::into))
    }

    fn conditions(&mut self) -> Result<Conditions, ReadError> {
        unreachable!("only links have conditions")
    }

    fn heard(&mut self) -> Column<Heard> {
        unreachable!("only robots have heard signals")
    }

    fn children(
        &mut self,
        _: &mut dyn FnMut(&mut dyn Source<ReadError>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        Ok(())
    }
}
