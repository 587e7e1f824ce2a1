//! Kinds of events, and the series that some of them make.

pub(crate) use cotorra_graph::Series;
pub use cotorra_graph::{EventKind as Kind, InvalidKind};

#[cfg(test)]
mod tests {
    use cotorra_graph::Stamped;
    use proptest::prelude::*;

    use super::*;
    use crate::{codec::Fields, testing::stamped};

    proptest! {
        #[test]
        fn a_kind_is_named_as_its_event_is_in_json(stamped in stamped()) {
            let kind = Kind::of(&stamped.event);
            let json = serde_json::to_value(&stamped).unwrap();
            prop_assert_eq!(&json["event"], kind.as_str());
            prop_assert_eq!(kind.as_str().parse(), Ok(kind));
            prop_assert_eq!(serde_json::to_value(kind).unwrap(), kind.as_str());
        }

        #[test]
        fn an_event_has_the_columns_of_its_table(stamped in stamped()) {
            let table = Kind::of(&stamped.event).table();
            let (mut row, mut children) = (Fields::default(), Fields::default());
            stamped.put(&mut row, &mut children);
            prop_assert_eq!(row.0.len(), table.columns.len());
            prop_assert_eq!(children.0.len() % table.children.map_or(1, |(_, columns)| columns.len()), 0);
            prop_assert_eq!(stamped.event.series().is_some(), !table.series.is_empty());
            prop_assert!(table.columns.starts_with(table.series));
        }

        #[test]
        fn a_series_has_the_events_with_its_name(a in stamped(), b in stamped()) {
            let [of_a, of_b] = [&a, &b].map(|stamped| stamped.event.series());
            let named = |stamped: &Stamped| {
                let (mut row, kind) = (Fields::default(), Kind::of(&stamped.event));
                stamped.put(&mut row, &mut Fields::default());
                format!("{kind:?} {:?}", &row.0[..kind.table().series.len()])
            };
            if of_a.is_some() {
                prop_assert_eq!(named(&a) == named(&b), of_a == of_b);
            }
        }
    }

    #[test]
    fn kinds_are_in_the_order_of_their_numbers() {
        for (number, kind) in Kind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, number);
        }
        // A new kind is the last: histories have the numbers.
        let names = Kind::ALL.map(Kind::as_str);
        assert_eq!((names[0], names[10], names[19]), ("robot", "decision", "suggestion_answered"));
        assert_eq!((names[20], names[21]), ("staleness", "federation_requested"));
    }

    #[test]
    fn unknown_kinds_are_rejected() {
        let error = "weather".parse::<Kind>().unwrap_err();
        assert!(error.to_string().starts_with("`weather` is not a kind of event; one of robot, radio, link"));
    }
}
