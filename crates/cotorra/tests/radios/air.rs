//! Frames of all radios, as the kernel's own monitor interface of mac80211_hwsim shows them when they are sent.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "the run's clock is the kernel's")]

use std::{os::fd::OwnedFd, process::Command, time::SystemTime};

use rustix::net::{AddressFamily, RecvFlags, SocketType, eth, recv, socket};

/// Frame control of a beacon.
const BEACON: u8 = 0x80;

/// A look at the air.
pub struct Air(OwnedFd);

impl Air {
    /// Begins to listen.
    pub fn listen() -> Self {
        let up = Command::new("ip").args(["link", "set", "hwsim0", "up"]).status();
        assert!(up.unwrap().success());
        // Of all interfaces here. The others have no radio.
        Self(socket(AddressFamily::PACKET, SocketType::RAW, Some(eth::ALL)).unwrap())
    }

    /// Waits for the next beacon of an access point. Returns when it was sent.
    pub fn wait_for_beacon(&self, bssid: &str) -> SystemTime {
        let bssid: Vec<u8> = bssid.split(':').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        let mut buffer = [0; 4096];
        loop {
            let (_, length) = recv(&self.0, &mut buffer[..], RecvFlags::empty()).unwrap();
            let now = SystemTime::now();
            // The radiotap header has its length in it.
            let frame =
                buffer[..length].split_at_checked(usize::from(u16::from_le_bytes([buffer[2], buffer[3]])));
            if frame
                .is_some_and(|(_, frame)| frame.first() == Some(&BEACON) && frame.get(10..16) == Some(&bssid))
            {
                return now;
            }
        }
    }
}
