//! What a Kobuki base sends, in pieces.
#![no_main]

use cotorra_graph::Timestamp;
use cotorra_turtlebot::{Session, kobuki::Base};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut base = Base::default();
    base.connected(Timestamp::ZERO);
    for (i, piece) in (0..).zip(bytes.chunks(17)) {
        base.receive(Timestamp::from_nanos(i * 20_000_000), piece);
    }
    let (x, y) = base.odometry().position;
    assert!(x.is_finite() && y.is_finite() && base.odometry().heading.is_finite());
});
