//! No datagram makes a decoder panic, and what is decoded is encoded to what decodes to the same.
#![no_main]

use cotorra_plugin::{
    messages::{
        BatteryState, CompressedImage, Float64MultiArray, Image, Imu, LaserScan, Message, OccupancyGrid, Odometry,
        TFMessage, TwistStamped,
    },
    wire::{Answer, ImagePacket, NavigationPacket, PosePacket, PositionPacket, ScanPacket},
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut again = Vec::new();
    if let Ok(packet) = PositionPacket::decode(bytes) {
        packet.encode(&mut again);
        let mut twice = Vec::new();
        PositionPacket::decode(&again).expect("it was encoded here").encode(&mut twice);
        assert_eq!(again, twice);
    }
    if let Ok(packet) = NavigationPacket::decode(bytes) {
        packet.encode(&mut again);
        let mut twice = Vec::new();
        NavigationPacket::decode(&again).expect("it was encoded here").encode(&mut twice);
        assert_eq!(again, twice);
    }
    if let Ok(packet) = ScanPacket::decode(bytes) {
        packet.encode(&mut again);
        assert_eq!(ScanPacket::decode(&again).expect("it was encoded here"), packet);
    }
    if let Ok(packet) = PosePacket::decode(bytes) {
        packet.encode(&mut again);
        assert_eq!(PosePacket::decode(&again).expect("it was encoded here"), packet);
    }
    if let Ok(packet) = ImagePacket::decode(bytes) {
        packet.encode(&mut again);
        assert_eq!(again, bytes);
    }
    let _ = Answer::decode(bytes);
    let _ = LaserScan::decode(bytes);
    let _ = Odometry::decode(bytes);
    let _ = (TFMessage::decode(bytes), OccupancyGrid::decode(bytes), TwistStamped::decode(bytes));
    let _ = (Imu::decode(bytes), BatteryState::decode(bytes), Float64MultiArray::decode(bytes));
    let _ = (Image::decode(bytes), CompressedImage::decode(bytes));
});
