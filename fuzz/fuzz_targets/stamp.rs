//! No datagram that comes to either side of a STAMP session panics, nor makes it say what cannot be.
#![no_main]

use std::time::Duration;

use cotorra_stamp::{Link, Reflector, Session, SessionConfig, Utc};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|datagrams: Vec<(u32, &[u8])>| {
    let mut now = Utc::UNIX_EPOCH;
    let mut session = Session::new(SessionConfig::default(), now);
    let mut link = Link::new(SessionConfig::default(), now);
    let mut reflector = Reflector::default();
    for (nanos, bytes) in datagrams {
        now = now + Duration::from_nanos(nanos.into());
        _ = session.poll(now);
        _ = link.poll(now);
        _ = session.receive(bytes, now);
        _ = link.reflect(bytes, now, now);
        _ = link.receive(bytes, now);
        if let Ok(reflection) = reflector.reflect(0, bytes, now, None) {
            assert!(reflection.sent_at(now).len() >= bytes.len().min(44));
        }
    }
    if let Some(measured) = session.measurement(now) {
        assert!((0.0..=1.0).contains(&measured.loss()));
    }
    for told in link.estimates(now).into_iter().flatten() {
        assert!(told.loss.is_none_or(|loss| (0.0..=1.0).contains(&loss)));
    }
});
