use proptest::prelude::*;
use serde_json::json;

use super::*;
use crate::testing::STATION;

fn station() -> Value {
    json!({
        "staId": { "macId": "02:77:00:00:00:0a", "ssid": ["lab", "it's, (a) net"], "ipAddress": ["10.77.0.10"] },
        "channel": 6,
        "rssi": { "rssi": 110 },
        "beaconReport": [
            { "measurementId": "m", "bssid": "02:77:00:00:00:01", "channel": 1, "rcpi": 90 },
            { "measurementId": "m", "bssid": "02:77:00:00:00:02", "channel": 6, "rcpi": 50 },
        ],
        "neighborReport": [{ "bssidInfo": { "mobilityDomain": true } }],
    })
}

fn filter(text: &str) -> Filter {
    Filter::parse(text, STATION).unwrap_or_else(|error| panic!("{text}: {error}"))
}

#[test]
fn every_operator_compares() {
    for (text, expected) in [
        ("(eq,channel,6)", true),
        ("(eq,channel,6.0)", true),
        ("(eq,channel,7)", false),
        ("(neq,channel,7)", true),
        ("(neq,channel,6)", false),
        ("(gt,rssi/rssi,109)", true),
        ("(gt,rssi/rssi,110)", false),
        ("(lt,rssi/rssi,111)", true),
        ("(lt,rssi/rssi,110)", false),
        ("(gte,rssi/rssi,110)", true),
        ("(gte,rssi/rssi,111)", false),
        ("(lte,rssi/rssi,110)", true),
        ("(lte,rssi/rssi,109)", false),
        ("(in,channel,1,6,11)", true),
        ("(in,channel,1,11)", false),
        ("(nin,channel,1,11)", true),
        ("(nin,channel,1,6)", false),
        ("(cont,staId/macId,00:00:0A,ff)", true),
        ("(cont,staId/macId,ff)", false),
        ("(ncont,staId/macId,ff,ee)", true),
        ("(ncont,staId/macId,ff,77)", false),
        ("(eq,neighborReport/bssidInfo/mobilityDomain,true)", true),
        ("(eq,neighborReport/bssidInfo/mobilityDomain,false)", false),
    ] {
        assert_eq!(filter(text).matches(&station()), expected, "{text}");
    }
}

#[test]
fn one_array_element_must_meet_all_expressions_with_its_prefix() {
    for (text, expected) in [
        ("(eq,channel,6);(gt,rssi/rssi,100)", true),
        ("(eq,channel,6);(gt,rssi/rssi,200)", false),
        ("(gt,beaconReport/rcpi,80);(eq,beaconReport/channel,1)", true),
        // Each is met by an element, but no element meets both.
        ("(gt,beaconReport/rcpi,80);(eq,beaconReport/channel,6)", false),
        ("(eq,staId/ssid,lab)", true),
        ("(eq,staId/ssid,'it''s, (a) net')", true),
        ("(eq,staId/ssid,other)", false),
    ] {
        assert_eq!(filter(text).matches(&station()), expected, "{text}");
    }
}

#[test]
fn missing_attributes_meet_no_expression() {
    for text in
        ["(eq,apAssociated/bssid,02:77:00:00:00:01)", "(neq,apAssociated/bssid,x)", "(nin,staId/aid,1)"]
    {
        assert!(!filter(text).matches(&station()), "{text}");
    }
}

#[test]
fn addresses_compare_in_any_notation() {
    for text in ["(eq,staId/macId,02:77:00:00:00:0A)", "(eq,staId/macId,02-77-00-00-00-0a)"] {
        assert!(filter(text).matches(&station()), "{text}");
    }
}

#[test]
fn errors_name_their_place() {
    for (text, at, part) in [
        ("", 1, "begins with `(`"),
        ("eq,channel,6", 1, "begins with `(`"),
        ("(is,channel,6)", 2, "no operator `is`"),
        ("(eq)", 4, "`,` and an attribute"),
        ("(eq,chanel,6)", 5, "no attribute `chanel`"),
        ("(eq,staId/bssid,6)", 11, "no attribute `bssid`; there are macId"),
        ("(eq,staId,6)", 10, "`staId` has attributes"),
        ("(eq,channel/x,6)", 13, "`channel` has no attributes"),
        ("(eq,channel)", 12, "and a value"),
        ("(eq,channel,six)", 13, "`channel` is a number"),
        ("(eq,channel,inf)", 13, "`channel` is a number"),
        ("(eq,neighborReport/bssidInfo/ftm,1)", 34, "`true` or `false`"),
        ("(eq,channel,6,7)", 16, "takes one value"),
        ("(gt,staId/macId,1)", 2, "compares numbers"),
        ("(cont,channel,6)", 2, "compares strings"),
        ("(eq,channel,6", 14, "ends with `)`"),
        ("(eq,channel,6)(eq,channel,6)", 15, "expected `;`"),
        ("(eq,channel,6);", 16, "begins with `(`"),
        ("(eq,staId/ssid,it's)", 18, "in quotes"),
        ("(eq,staId/ssid,'é", 18, "ends with `'`"),
    ] {
        let error = Filter::parse(text, STATION).unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
        assert!(error.contains(&format!("at character {at}:")), "{text}: {error}");
    }
}

/// Paths of all simple attributes.
fn leaves() -> Vec<(String, Kind)> {
    fn collect(of: &'static [Attribute], prefix: &str, leaves: &mut Vec<(String, Kind)>) {
        for attribute in of {
            let path = format!("{prefix}{}", attribute.name);
            match attribute.kind {
                Kind::Structure(inner) => collect(inner, &format!("{path}/"), leaves),
                kind => leaves.push((path, kind)),
            }
        }
    }
    let mut all = Vec::new();
    collect(STATION, "", &mut all);
    all
}

/// A valid expression and the value that it compares with.
fn expression() -> impl Strategy<Value = String> {
    let leaves = leaves();
    (0..leaves.len(), 0..OPS.len(), prop::collection::vec(any::<i32>(), 1..4), "\\PC{0,8}").prop_filter_map(
        "the operator suits the attribute",
        move |(leaf, op, numbers, text)| {
            let (path, kind) = &leaves[leaf];
            let (name, op) = OPS[op];
            op.suits(*kind).ok()?;
            let values: Vec<String> = match kind {
                Kind::Number => numbers.iter().map(|n| (f64::from(*n) / 8.0).to_string()).collect(),
                Kind::Flag => vec!["true".to_owned()],
                _ => numbers.iter().map(|n| format!("'{}{n}'", text.replace('\'', "''"))).collect(),
            };
            let values = if op.takes_many() { values.join(",") } else { values[0].clone() };
            Some(format!("({name},{path},{values})"))
        },
    )
}

proptest! {
    #[test]
    fn valid_filters_survive_display_and_parsing(
        expressions in prop::collection::vec(expression(), 1..6)
    ) {
        let read = filter(&expressions.join(";"));
        prop_assert_eq!(filter(&read.to_string()), read);
    }

    #[test]
    fn filters_without_arrays_are_conjunctions(
        channel in 0_i64..4, rssi in 0_i64..4, a in 0_i64..4, b in 0_i64..4, op in 0_usize..6, other in 0_usize..6,
    ) {
        let station = json!({ "channel": channel, "rssi": { "rssi": rssi } });
        let (one, two) = (
            format!("({},channel,{a})", OPS[op].0),
            format!("({},rssi/rssi,{b})", OPS[other].0),
        );
        let both = filter(&format!("{one};{two}")).matches(&station);
        prop_assert_eq!(both, filter(&one).matches(&station) && filter(&two).matches(&station));
    }

    #[test]
    fn negated_operators_invert_the_result_for_one_value(
        channel in 0_i64..4, a in 0_i64..4, b in 0_i64..4
    ) {
        let station = json!({ "channel": channel });
        for (one, other, values) in
            [("eq", "neq", format!("{a}")), ("in", "nin", format!("{a},{b}")), ("gt", "lte", format!("{a}")), ("lt", "gte", format!("{a}"))]
        {
            let holds = |op: &str| filter(&format!("({op},channel,{values})")).matches(&station);
            prop_assert_ne!(holds(one), holds(other));
        }
    }

    #[test]
    fn arbitrary_text_never_panics(text in "\\PC{0,40}|[(),;'/a-z0-9]{0,40}") {
        if let Ok(read) = Filter::parse(&text, STATION) {
            prop_assert_eq!(filter(&read.to_string()), read);
        }
    }
}
