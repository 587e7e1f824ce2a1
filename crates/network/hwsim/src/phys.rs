//! Moves phys between network namespaces, and gives them interfaces (linux/nl80211.h).

use std::os::fd::{AsFd, AsRawFd};

use cotorra_netlink::{
    DecodeError, Family, NETLINK_GENERIC, Netlink, Writer, answer,
    nl80211::{self, attribute as attr, command, interface_type, power_setting},
    parse_u32, text,
};

use crate::error::Error;

/// Wi-Fi devices of the calling thread's network namespace.
#[derive(Debug)]
pub struct Phys {
    socket: Netlink,
    family: Family,
}

impl Default for Phys {
    fn default() -> Self {
        Self::new()
    }
}

impl Phys {
    /// Returns a client. Opens nothing yet.
    pub const fn new() -> Self {
        Self { socket: Netlink::new(NETLINK_GENERIC), family: Family::new(nl80211::FAMILY) }
    }

    /// Moves a phy with all its interfaces into a network namespace, such as an open `/proc/PID/ns/net`.
    ///
    /// # Errors
    /// [`Error::NoPhy`], [`Error::NoRights`] or [`Error::Refused`].
    pub fn move_to(&mut self, phy: &str, namespace: impl AsFd) -> Result<(), Error> {
        let fd = namespace.as_fd().as_raw_fd().cast_unsigned();
        let mut attributes = Writer::default();
        attributes.words(attr::WIPHY, &[self.index(phy)?]).words(attr::NETNS_FD, &[fd]);
        self.execute("move a phy", command::SET_WIPHY_NETNS, attributes)
    }

    /// Gives a phy an interface for a station. An access point turns it into its own kind.
    ///
    /// # Errors
    /// [`Error::NoPhy`], [`Error::NoRights`] or [`Error::Refused`].
    pub fn add_station(&mut self, phy: &str, interface: &str) -> Result<(), Error> {
        let mut attributes = Writer::default();
        attributes.words(attr::WIPHY, &[self.index(phy)?]).text(attr::IFNAME, interface);
        attributes.words(attr::IFTYPE, &[interface_type::STATION]);
        self.execute("add an interface", command::NEW_INTERFACE, attributes)
    }

    /// Sets the transmit power of a phy, dBm, in steps of 1 dB, less where its regulatory domain allows less. Simulated radios show it;
    /// with which power their frames arrive is for the medium to decide.
    ///
    /// # Errors
    /// [`Error::NoPhy`], [`Error::NoRights`] or [`Error::Refused`], also for a power below 0 dBm.
    pub fn set_power(&mut self, phy: &str, dbm: f64) -> Result<(), Error> {
        let level = (dbm.round() * 100.0) as i32;
        let mut attributes = Writer::default();
        attributes
            .words(attr::WIPHY, &[self.index(phy)?])
            .words(attr::TX_POWER_SETTING, &[power_setting::LIMITED]);
        attributes.words(attr::TX_POWER_LEVEL, &[level.cast_unsigned()]);
        self.execute("set a transmit power", command::SET_WIPHY, attributes)
    }

    fn index(&mut self, phy: &str) -> Result<u32, Error> {
        let mut attributes = Writer::default();
        // Without it, the kernel squeezes all it knows of a device into one message.
        attributes.bytes(attr::SPLIT_WIPHY_DUMP, &[]);
        let listed = self.family.dump(&mut self.socket, command::GET_WIPHY, &attributes.finish(), device);
        let listed = listed.map_err(Error::of("list phys"))?;
        let found = listed.into_iter().find(|(_, name)| name == phy);
        found.map(|(index, _)| index).ok_or_else(|| Error::NoPhy(phy.to_owned()))
    }

    fn execute(&mut self, what: &'static str, command: u8, attributes: Writer) -> Result<(), Error> {
        let done = self.family.execute(&mut self.socket, command, &attributes.finish());
        done.map(drop).map_err(Error::of(what))
    }
}

/// Reads the index and the name of a phy.
pub(crate) fn device(body: &[u8]) -> Result<Option<(u32, String)>, DecodeError> {
    let (mut index, mut name) = (None, None);
    for attribute in answer(body) {
        match attribute? {
            (attr::WIPHY, value) => index = Some(parse_u32(value)?),
            (attr::WIPHY_NAME, value) => name = Some(text(value)),
            _ => {}
        }
    }
    Ok(index.zip(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_phy_has_an_index_and_a_name() {
        let mut attributes = Writer::default();
        attributes.raw(&[3, 1, 0, 0]).words(attr::WIPHY, &[4]).text(attr::WIPHY_NAME, "phy1");
        let body = attributes.finish();
        assert_eq!(device(&body), Ok(Some((4, "phy1".to_owned()))));
        assert_eq!(device(&body[..12]), Ok(None));
        assert!(device(&body[..14]).is_ok() && device(&body[..18]).is_err());
    }
}
