#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod access_point;
mod address;
mod channel;
mod client;
mod control;
mod daemon;
mod hex;
mod interface;
mod names;
mod owner;
mod power;
mod secret;
mod security;
mod serialized;
mod station;
mod takeover;

pub use access_point::{AccessPoint, AccessPointDriver, BeaconInterval, Bss, Generation, Radio};
pub use address::{MacAddress, MacAddressError};
pub use channel::{Band, Channel, ChannelError, Width};
pub use client::{Client, ControlError, Events};
pub use control::{
    AnswerError, DisabledReason, Event, Message, Request, attach, detach, hostapd, ping, terminate,
    wpa_supplicant,
};
pub use daemon::{Daemon, Launcher, StartError, installed, launch_here};
pub use interface::interface_address;
pub use names::{CountryCode, InterfaceName, NameError, Ssid};
pub use owner::{Owner, TakeoverError};
pub use power::{Power, TransmitPower};
pub use secret::{DomainKey, Passphrase, PassphraseError};
pub use security::{
    Credentials, FastTransition, KeyExchange, KeyHolder, MobilityDomain, Protection, Security, Units,
};
pub use station::{BackgroundScan, BackgroundScanMethod, Network, Station, StationDriver};
pub use takeover::{AccessPointSettings, StationSettings, Taken};

/// Reads any bytes as each answer and as an event. For fuzzing.
#[doc(hidden)]
pub fn read_anything(bytes: &[u8]) {
    _ = Message::parse(bytes);
    _ = (
        hostapd::status().read(bytes),
        hostapd::configuration().read(bytes),
        hostapd::first_station().read(bytes),
    );
    _ = (wpa_supplicant::status().read(bytes), wpa_supplicant::scan_results().read(bytes));
    _ = (wpa_supplicant::networks(None).read(bytes), wpa_supplicant::add_network().read(bytes));
    _ = (wpa_supplicant::signal().read(bytes), ping().read(bytes), attach().read(bytes));
}
