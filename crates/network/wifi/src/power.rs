//! The power of a radio, which hostapd leaves to the kernel: nl80211, a family of generic netlink (linux/nl80211.h).

use std::io;

use cotorra_netlink::{
    DecodeError, Family, NETLINK_GENERIC, Netlink, answer,
    nl80211::{FAMILY, attribute, command, of_interface, power_setting},
    parse_i32,
};
use rustix::net::{AddressFamily, SocketType, netdevice};
use serde::{Deserialize, Serialize};

use crate::names::InterfaceName;

/// A transmit power.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Power {
    /// Power that the driver and the regulatory domain choose.
    Automatic,
    /// At most this much, in hundredths of dBm.
    AtMost(i32),
    /// This much, in hundredths of dBm.
    Fixed(i32),
}

impl Power {
    /// Returns the setting and the level.
    fn parts(self) -> (u32, Option<i32>) {
        match self {
            Self::Automatic => (power_setting::AUTOMATIC, None),
            Self::AtMost(level) => (power_setting::LIMITED, Some(level)),
            Self::Fixed(level) => (power_setting::FIXED, Some(level)),
        }
    }
}

/// The power of an interface's radio. A change of it is put back when this is dropped: as a limit, because the kernel does not
/// tell whether it was automatic.
#[derive(Debug)]
pub struct TransmitPower {
    socket: Netlink,
    nl80211: Family,
    interface: u32,
    before: Option<Power>,
}

impl TransmitPower {
    /// Borrows the power of an interface in the calling thread's network namespace.
    ///
    /// # Errors
    /// The error of the system, e.g. if there is no such interface, or no nl80211.
    pub fn of(interface: &InterfaceName) -> io::Result<Self> {
        let socket = rustix::net::socket(AddressFamily::INET, SocketType::DGRAM, None)?;
        let interface = netdevice::name_to_index(socket, interface.as_str())?;
        let (mut socket, mut nl80211) = (Netlink::new(NETLINK_GENERIC), Family::new(FAMILY));
        nl80211.number(&mut socket)?;
        Ok(Self { socket, nl80211, interface, before: None })
    }

    /// Returns the present power, in hundredths of dBm; `None` if the interface is down or its driver does not report it.
    ///
    /// # Errors
    /// The error of the kernel, e.g. if this is no Wi-Fi interface.
    pub fn read(&mut self) -> io::Result<Option<i32>> {
        let request = of_interface(self.interface).finish();
        self.nl80211.get(&mut self.socket, command::GET_INTERFACE, &request, level)
    }

    /// Changes the power.
    ///
    /// # Errors
    /// The error of the kernel, e.g. without the right to do so, or if the driver cannot.
    pub fn set(&mut self, power: Power) -> io::Result<()> {
        if self.before.is_none() {
            self.before = Some(self.read()?.map_or(Power::Automatic, Power::AtMost));
        }
        self.change(power)
    }

    /// Changes the power for good: it is not put back.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn change(&mut self, power: Power) -> io::Result<()> {
        let (kind, level) = power.parts();
        let mut request = of_interface(self.interface);
        request.words(attribute::TX_POWER_SETTING, &[kind]);
        if let Some(level) = level {
            request.words(attribute::TX_POWER_LEVEL, &[level.cast_unsigned()]);
        }
        self.nl80211.execute(&mut self.socket, command::SET_WIPHY, &request.finish()).map(drop)
    }

    /// Puts the power back.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn give_back(mut self) -> io::Result<()> {
        self.before.take().map_or(Ok(()), |power| self.change(power))
    }
}

impl Drop for TransmitPower {
    fn drop(&mut self) {
        if let Some(power) = self.before.take() {
            _ = self.change(power);
        }
    }
}

/// Reads the power of an interface.
fn level(body: &[u8]) -> Result<Option<i32>, DecodeError> {
    for found in answer(body) {
        if let (attribute::TX_POWER_LEVEL, value) = found? {
            return parse_i32(value).map(Some);
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use cotorra_netlink::Writer;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn an_interface_has_a_power_if_its_driver_reports_it() {
        let mut without = Writer::default();
        without.raw(&[command::GET_INTERFACE, 0, 0, 0]).words(attribute::IFINDEX, &[3]);
        let mut with = Writer::default();
        with.raw(&[command::GET_INTERFACE, 0, 0, 0]).words(attribute::TX_POWER_LEVEL, &[1500]);
        assert_eq!(level(&with.finish()), Ok(Some(1500)));
        assert_eq!(level(&without.finish()), Ok(None));
    }

    #[test]
    fn missing_interfaces_are_reported() {
        let error = TransmitPower::of(&"missing0".parse().expect("a name")).expect_err("there is none");
        assert_eq!(error.raw_os_error(), Some(rustix::io::Errno::NODEV.raw_os_error()));
    }

    proptest! {
        #[test]
        fn no_answer_makes_the_reader_panic(bytes: Vec<u8>) {
            _ = level(&bytes);
        }
    }
}
