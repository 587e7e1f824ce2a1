//! No datagram makes a decoder panic, and decoded packets survive encoding.
#![no_main]

use cotorra_plugin::wire::{Answer, ImagePacket, NavigationPacket, PosePacket, PositionPacket, ScanPacket};
use cotorra_ros_messages::{
    BatteryState, CompressedImage, Float64MultiArray, Image, Imu, LaserScan, Message, OccupancyGrid,
    Odometry, TFMessage, TwistStamped,
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
    let _ = LaserScan::decode_cdr(bytes);
    let _ = Odometry::decode_cdr(bytes);
    let _ = (TFMessage::decode_cdr(bytes), OccupancyGrid::decode_cdr(bytes), TwistStamped::decode_cdr(bytes));
    let _ = (Imu::decode_cdr(bytes), BatteryState::decode_cdr(bytes), Float64MultiArray::decode_cdr(bytes));
    let _ = (Image::decode_cdr(bytes), CompressedImage::decode_cdr(bytes));
});
