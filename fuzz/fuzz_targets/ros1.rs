//! What peers of a ROS 1 node send it: XML-RPC, HTTP, connection headers and messages.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| cotorra_ros1::parse_anything(bytes));
