//! No filter or request makes a reader panic, and what is read is written as what reads the same.
#![no_main]

use cotorra_wais::{
    Filter, Kind, Query,
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
    for filter in [Filter::of_access_points(text), Filter::of_stations(text)].into_iter().flatten() {
        let again = Filter::of_stations(&filter.to_string()).or_else(|_| Filter::of_access_points(&filter.to_string()));
        assert_eq!(again.expect("it was written here"), filter);
    }
    for name in ["fields", "exclude_fields"] {
        let _ = Query::read(Kind::Stations, &[(name.to_owned(), text.to_owned())]);
    }
});
