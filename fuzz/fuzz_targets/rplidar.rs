//! What an RPLIDAR sends, in pieces, also while it measures.
#![no_main]

use cotorra_graph::Timestamp;
use cotorra_turtlebot::{
    Session,
    rplidar::{Lidar, LidarSettings},
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut lidar = Lidar::new(LidarSettings::default());
    lidar.connected(Timestamp::ZERO);
    for (i, piece) in (0..).zip(bytes.chunks(17)) {
        let now = Timestamp::from_nanos(i * 20_000_000);
        while lidar.poll_transmit(now).is_some() {}
        lidar.receive(now, piece);
    }
    let samples = lidar.turn().map_or(&[][..], |turn| &turn.samples);
    assert!(samples.iter().all(|sample| (0.0..=std::f64::consts::TAU).contains(&sample.angle)));
});
