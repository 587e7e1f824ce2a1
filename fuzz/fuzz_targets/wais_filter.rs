//! No filter or request makes a reader panic, and what is read is written as what reads the same.
#![no_main]

use cotorra_mec::{Filter, Query, Subscribed as _};
use cotorra_wais::{
    Kind,
    requests::{MeasurementConfig, Subscription},
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(subscription) = Subscription::read(bytes) {
        let _ = subscription.check();
    }
    if let Ok(config) = MeasurementConfig::read(bytes) {
        let _ = config.check();
    }
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    for attributes in [Kind::AccessPoints, Kind::Stations].map(Kind::attributes) {
        if let Ok(filter) = Filter::parse(text, attributes) {
            assert_eq!(Filter::parse(&filter.to_string(), attributes), Ok(filter));
        }
        for name in ["fields", "exclude_fields"] {
            let _ = Query::read(attributes, &[(name.to_owned(), text.to_owned())]);
        }
    }
});
