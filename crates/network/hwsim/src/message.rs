//! Messages of the family `MAC80211_HWSIM` (drivers/net/wireless/mac80211_hwsim.h of Linux 6.1), without their netlink header.

use std::sync::Arc;

use cotorra_netlink::{
    DecodeError, Writer, answer, parse_i32, parse_mac, parse_u16, parse_u32, parse_u64, text,
};

use crate::address::MacAddress;

/// Version of the family.
const VERSION: u8 = 1;
/// Rates that a frame is tried with, at most (`IEEE80211_TX_MAX_RATES`).
pub const MOST_RATES: usize = 4;
/// Lengths of a frame that the kernel takes, bytes: three addresses at least, and `IEEE80211_MAX_DATA_LEN` at most.
/// Shorter ones, such as PS-Poll and block acknowledgement requests, never reach a radio.
pub const DELIVERABLE: std::ops::RangeInclusive<usize> = 24..=2304;

/// `HWSIM_CMD_*`.
mod command {
    pub(super) const REGISTER: u8 = 1;
    pub(super) const FRAME: u8 = 2;
    pub(super) const TX_INFO_FRAME: u8 = 3;
    pub(super) const NEW_RADIO: u8 = 4;
    pub(super) const DEL_RADIO: u8 = 5;
    pub(super) const GET_RADIO: u8 = 6;
    pub(super) const ADD_MAC_ADDR: u8 = 7;
    pub(super) const DEL_MAC_ADDR: u8 = 8;
}

/// `HWSIM_ATTR_*`.
mod attr {
    pub(super) const ADDR_RECEIVER: u16 = 1;
    pub(super) const ADDR_TRANSMITTER: u16 = 2;
    pub(super) const FRAME: u16 = 3;
    pub(super) const FLAGS: u16 = 4;
    pub(super) const RX_RATE: u16 = 5;
    /// i32 in a u32, dBm.
    pub(super) const SIGNAL: u16 = 6;
    /// Four times `struct hwsim_tx_rate`: i8 and u8.
    pub(super) const TX_INFO: u16 = 7;
    pub(super) const COOKIE: u16 = 8;
    pub(super) const CHANNELS: u16 = 9;
    pub(super) const RADIO_ID: u16 = 10;
    pub(super) const REG_HINT_ALPHA2: u16 = 11;
    pub(super) const REG_CUSTOM_REG: u16 = 12;
    pub(super) const REG_STRICT_REG: u16 = 13;
    pub(super) const SUPPORT_P2P_DEVICE: u16 = 14;
    pub(super) const USE_CHANCTX: u16 = 15;
    pub(super) const DESTROY_RADIO_ON_CLOSE: u16 = 16;
    pub(super) const RADIO_NAME: u16 = 17;
    pub(super) const NO_VIF: u16 = 18;
    /// u32, MHz.
    pub(super) const FREQ: u16 = 19;
    /// Four times `struct hwsim_tx_rate_flag`: i8 and u16, packed.
    pub(super) const TX_INFO_FLAGS: u16 = 21;
    pub(super) const PERM_ADDR: u16 = 22;
    /// u32, bits by `NL80211_IFTYPE_*`.
    pub(super) const IFTYPE_SUPPORT: u16 = 23;
    /// u32 each.
    pub(super) const CIPHER_SUPPORT: u16 = 24;
    pub(super) const MLO_SUPPORT: u16 = 25;
}

/// `HWSIM_TX_CTL_*` and `HWSIM_TX_STAT_*`.
mod flag {
    pub(super) const REQ_TX_STATUS: u32 = 1 << 0;
    pub(super) const NO_ACK: u32 = 1 << 1;
    pub(super) const ACK: u32 = 1 << 2;
    /// Linux 6.1 has no such flag; that of `scripts/radio-kernel` does.
    pub(super) const AGGREGATES: u32 = 1 << 3;
}

/// A message between a medium and the kernel's radios.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Message {
    /// Makes the sender the medium of all radios of its network namespace, also where they are moved to. Rejected if there
    /// is one already, or if a radio has several channels.
    Register,
    /// A frame that a radio sends. From the kernel.
    Frame(Frame),
    /// A frame that a radio receives. To the kernel.
    Delivery(Delivery),
    /// Fate of a frame that a radio sent. To the kernel.
    Status(Status),
    /// Creates a radio, or says that one was created.
    NewRadio(Radio),
    /// Deletes a radio of the network namespace, or says that one was deleted. It needs its number or its name.
    DeleteRadio(Radio),
    /// Asks for a radio by its number, or for all, or describes one.
    GetRadio(Radio),
    /// A radio receives frames to this address, too: that of an interface, or a random one during a scan. From the kernel.
    AddAddress(Alias),
    /// A radio no longer receives frames to this address. From the kernel.
    RemoveAddress(Alias),
}

/// A frame that a radio sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// Hardware address of the radio.
    pub radio: MacAddress,
    /// MAC header and body, without check sequence.
    pub frame: Arc<[u8]>,
    /// Centre of the channel, MHz; `None` before Linux 4.1.
    pub frequency_mhz: Option<u32>,
    /// Whether the kernel waits for the status. It does so for all frames; the flag is that of mac80211.
    pub wants_status: bool,
    /// Whether it needs no acknowledgement.
    pub no_ack: bool,
    /// Whether it may go in an A-MPDU. Only the kernel of `scripts/radio-kernel` says so.
    pub aggregates: bool,
    /// Rates to try, in this order; none if rate control is off.
    pub rates: Rates,
    /// Number by which the radio knows the frame.
    pub cookie: u64,
}

/// A frame that a radio receives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Delivery {
    /// Hardware address of the radio.
    pub radio: MacAddress,
    /// MAC header and body, without check sequence; the kernel takes [`DELIVERABLE`] lengths.
    pub frame: Arc<[u8]>,
    /// Index of the rate among the band's legacy rates. The kernel rejects others, also those of HT and VHT.
    pub rate: u32,
    /// Received power, dBm.
    pub signal_dbm: i32,
    /// Centre of the channel, MHz. The kernel rejects frames of other channels than the radio listens to now.
    pub frequency_mhz: Option<u32>,
}

/// Fate of a frame that a radio sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Status {
    /// Hardware address of the radio.
    pub radio: MacAddress,
    /// Number by which the radio knows the frame.
    pub cookie: u64,
    /// Whether an acknowledgement came.
    pub acknowledged: bool,
    /// Whether none was expected.
    pub no_ack: bool,
    /// Rates that were tried, each with the number of tries; none if it was not sent.
    pub rates: Rates,
    /// Received power of the acknowledgement, dBm.
    pub signal_dbm: i32,
}

/// One rate of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tries {
    /// Index of the rate, from 0: a legacy rate of the band, an HT MCS, or VHT streams and MCS, by the flags.
    pub index: u8,
    /// Tries with it.
    pub count: u8,
    /// `MAC80211_HWSIM_TX_RC_*`.
    pub flags: u16,
}

/// Rates of a frame, [`MOST_RATES`] at most.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Rates([Option<Tries>; MOST_RATES]);

/// Attributes of a radio: what it is asked to be, or what it is. What is `None` or `false` is left to the kernel, or not said.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Radio {
    /// Its number.
    pub id: Option<u32>,
    /// Name of its phy.
    pub name: Option<String>,
    /// Permanent address. Then it is also the hardware address; otherwise both follow from the number.
    pub permanent_address: Option<MacAddress>,
    /// Channels that it can use at a time. The kernel takes no medium with more than one.
    pub channels: Option<u32>,
    /// Whether it uses channel contexts, also with one channel.
    pub channel_contexts: bool,
    /// Whether it has no interface at first.
    pub no_interface: bool,
    /// Whether it goes when the socket that created it is closed.
    pub ends_with_socket: bool,
    /// Whether it has Wi-Fi Direct devices.
    pub p2p_device: bool,
    /// Country that its driver hints at.
    pub country: Option<[u8; 2]>,
    /// Number of the driver's custom regulatory domain.
    pub custom_regulation: Option<u32>,
    /// Whether it obeys its own regulatory domain only.
    pub strict_regulation: bool,
    /// Types of interfaces, as bits by `NL80211_IFTYPE_*`.
    pub interface_types: Option<u32>,
    /// Cipher suites.
    pub ciphers: Option<Vec<u32>>,
    /// Whether it has several links (802.11be).
    pub multi_link: bool,
}

/// An address by which a radio receives frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Alias {
    /// Hardware address of the radio.
    pub radio: MacAddress,
    /// The other address.
    pub address: MacAddress,
}

impl Rates {
    /// Returns these rates, without those beyond [`MOST_RATES`].
    pub fn new(rates: impl IntoIterator<Item = Tries>) -> Self {
        let mut all = [None; MOST_RATES];
        for (place, tries) in all.iter_mut().zip(rates) {
            *place = Some(tries);
        }
        Self(all)
    }

    /// Returns the rates in order.
    pub fn iter(&self) -> impl Iterator<Item = Tries> {
        self.0.iter().map_while(|tries| *tries)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0[0].is_none()
    }

    fn encode(&self, w: &mut Writer) {
        let (mut info, mut flags) = (Vec::new(), Vec::new());
        for tries in self.0 {
            let Tries { index, count, flags: of } =
                tries.unwrap_or(Tries { index: u8::MAX, count: 0, flags: 0 });
            info.extend([index, count]);
            flags.push(index);
            flags.extend(of.to_ne_bytes());
        }
        w.bytes(attr::TX_INFO, &info).bytes(attr::TX_INFO_FLAGS, &flags);
    }

    /// Reads both attributes. The first negative index ends the list.
    fn decode(info: &[u8], flags: Option<&[u8]>) -> Result<Self, DecodeError> {
        if info.len() != 2 * MOST_RATES || flags.is_some_and(|flags| flags.len() != 3 * MOST_RATES) {
            return Err(DecodeError("the rates of a frame have another length"));
        }
        let flags = |place: usize| match flags.and_then(|flags| flags.get(3 * place + 1..3 * place + 3)) {
            Some(flags) => parse_u16(flags),
            None => Ok(0),
        };
        let mut all = [None; MOST_RATES];
        for (place, tries) in info.chunks_exact(2).enumerate() {
            let (index, count) = (tries[0], tries[1]);
            if index > i8::MAX as u8 {
                break;
            }
            all[place] = Some(Tries { index, count, flags: flags(place)? });
        }
        Ok(Self(all))
    }
}

impl Message {
    /// Encodes the message: the header of generic netlink and the attributes.
    pub fn encode(&self) -> Vec<u8> {
        let mut w = Writer::default();
        w.raw(&[self.command(), VERSION, 0, 0]);
        match self {
            Self::Register => {}
            Self::Frame(frame) => frame.encode(&mut w),
            Self::Delivery(delivery) => delivery.encode(&mut w),
            Self::Status(status) => status.encode(&mut w),
            Self::NewRadio(radio) | Self::DeleteRadio(radio) | Self::GetRadio(radio) => radio.encode(&mut w),
            Self::AddAddress(alias) | Self::RemoveAddress(alias) => {
                w.bytes(attr::ADDR_TRANSMITTER, &alias.radio.0).bytes(attr::ADDR_RECEIVER, &alias.address.0);
            }
        }
        w.finish()
    }

    const fn command(&self) -> u8 {
        match self {
            Self::Register => command::REGISTER,
            Self::Frame(_) | Self::Delivery(_) => command::FRAME,
            Self::Status(_) => command::TX_INFO_FRAME,
            Self::NewRadio(_) => command::NEW_RADIO,
            Self::DeleteRadio(_) => command::DEL_RADIO,
            Self::GetRadio(_) => command::GET_RADIO,
            Self::AddAddress(_) => command::ADD_MAC_ADDR,
            Self::RemoveAddress(_) => command::DEL_MAC_ADDR,
        }
    }

    /// Decodes a message; `None` for a command that this crate does not know, such as those of peer measurements.
    ///
    /// # Errors
    /// [`DecodeError`] for malformed attributes, or for too few.
    pub fn decode(body: &[u8]) -> Result<Option<Self>, DecodeError> {
        let Some(&command) = body.first() else { return Err(DecodeError("a message has no command")) };
        let message = match command {
            command::REGISTER => Self::Register,
            command::FRAME => return frame(body).map(Some),
            command::TX_INFO_FRAME => Self::Status(Status::decode(body)?),
            command::NEW_RADIO => Self::NewRadio(Radio::decode(body)?),
            command::DEL_RADIO => Self::DeleteRadio(Radio::decode(body)?),
            command::GET_RADIO => Self::GetRadio(Radio::decode(body)?),
            command::ADD_MAC_ADDR => Self::AddAddress(Alias::decode(body)?),
            command::DEL_MAC_ADDR => Self::RemoveAddress(Alias::decode(body)?),
            _ => return Ok(None),
        };
        Ok(Some(message))
    }
}

fn required<T>(value: Option<T>) -> Result<T, DecodeError> {
    value.ok_or(DecodeError("an attribute is missing"))
}

/// Decodes a frame that a radio sends, or one that it receives: the former has a sender.
fn frame(body: &[u8]) -> Result<Message, DecodeError> {
    let (mut from, mut to, mut frame, mut flags, mut rate) = (None, None, None, None, None);
    let (mut signal, mut info, mut info_flags, mut cookie, mut frequency) = (None, None, None, None, None);
    for attribute in answer(body) {
        match attribute? {
            (attr::ADDR_TRANSMITTER, value) => from = Some(MacAddress(parse_mac(value)?)),
            (attr::ADDR_RECEIVER, value) => to = Some(MacAddress(parse_mac(value)?)),
            (attr::FRAME, value) => frame = Some(value.into()),
            (attr::FLAGS, value) => flags = Some(parse_u32(value)?),
            (attr::RX_RATE, value) => rate = Some(parse_u32(value)?),
            (attr::SIGNAL, value) => signal = Some(parse_i32(value)?),
            (attr::TX_INFO, value) => info = Some(value),
            (attr::TX_INFO_FLAGS, value) => info_flags = Some(value),
            (attr::COOKIE, value) => cookie = Some(parse_u64(value)?),
            (attr::FREQ, value) => frequency = Some(parse_u32(value)?),
            _ => {}
        }
    }
    let frame = required(frame)?;
    let Some(radio) = from else {
        return Ok(Message::Delivery(Delivery {
            radio: required(to)?,
            frame,
            rate: required(rate)?,
            signal_dbm: required(signal)?,
            frequency_mhz: frequency,
        }));
    };
    let flags = required(flags)?;
    Ok(Message::Frame(Frame {
        radio,
        frame,
        frequency_mhz: frequency,
        wants_status: flags & flag::REQ_TX_STATUS != 0,
        no_ack: flags & flag::NO_ACK != 0,
        aggregates: flags & flag::AGGREGATES != 0,
        rates: Rates::decode(required(info)?, info_flags)?,
        cookie: required(cookie)?,
    }))
}

/// Returns those flags that are set.
fn flags(flags: &[(bool, u32)]) -> u32 {
    flags.iter().filter(|(set, _)| *set).fold(0, |all, (_, flag)| all | flag)
}

impl Frame {
    fn encode(&self, w: &mut Writer) {
        w.bytes(attr::ADDR_TRANSMITTER, &self.radio.0).bytes(attr::FRAME, &self.frame);
        let flags = flags(&[
            (self.wants_status, flag::REQ_TX_STATUS),
            (self.no_ack, flag::NO_ACK),
            (self.aggregates, flag::AGGREGATES),
        ]);
        w.words(attr::FLAGS, &[flags]);
        if let Some(mhz) = self.frequency_mhz {
            w.words(attr::FREQ, &[mhz]);
        }
        self.rates.encode(w);
        w.u64(attr::COOKIE, self.cookie);
    }
}

impl Delivery {
    fn encode(&self, w: &mut Writer) {
        w.bytes(attr::ADDR_RECEIVER, &self.radio.0).bytes(attr::FRAME, &self.frame);
        w.words(attr::RX_RATE, &[self.rate]).bytes(attr::SIGNAL, &self.signal_dbm.to_ne_bytes());
        if let Some(mhz) = self.frequency_mhz {
            w.words(attr::FREQ, &[mhz]);
        }
    }
}

impl Status {
    fn encode(&self, w: &mut Writer) {
        let flags = flags(&[(self.acknowledged, flag::ACK), (self.no_ack, flag::NO_ACK)]);
        w.bytes(attr::ADDR_TRANSMITTER, &self.radio.0).words(attr::FLAGS, &[flags]);
        w.u64(attr::COOKIE, self.cookie).bytes(attr::SIGNAL, &self.signal_dbm.to_ne_bytes());
        self.rates.encode(w);
    }

    fn decode(body: &[u8]) -> Result<Self, DecodeError> {
        let (mut radio, mut flags, mut cookie, mut signal) = (None, None, None, None);
        let (mut info, mut info_flags) = (None, None);
        for attribute in answer(body) {
            match attribute? {
                (attr::ADDR_TRANSMITTER, value) => radio = Some(MacAddress(parse_mac(value)?)),
                (attr::FLAGS, value) => flags = Some(parse_u32(value)?),
                (attr::COOKIE, value) => cookie = Some(parse_u64(value)?),
                (attr::SIGNAL, value) => signal = Some(parse_i32(value)?),
                (attr::TX_INFO, value) => info = Some(value),
                (attr::TX_INFO_FLAGS, value) => info_flags = Some(value),
                _ => {}
            }
        }
        let flags = required(flags)?;
        Ok(Self {
            radio: required(radio)?,
            cookie: required(cookie)?,
            acknowledged: flags & flag::ACK != 0,
            no_ack: flags & flag::NO_ACK != 0,
            rates: Rates::decode(required(info)?, info_flags)?,
            signal_dbm: required(signal)?,
        })
    }
}

impl Radio {
    fn encode(&self, w: &mut Writer) {
        let numbers = [
            (self.id, attr::RADIO_ID),
            (self.channels, attr::CHANNELS),
            (self.custom_regulation, attr::REG_CUSTOM_REG),
            (self.interface_types, attr::IFTYPE_SUPPORT),
        ];
        for (value, kind) in numbers {
            if let Some(value) = value {
                w.words(kind, &[value]);
            }
        }
        // The kernel takes the name's length as that of the attribute.
        let name = self.name.as_ref().map(String::as_bytes);
        let address = self.permanent_address.as_ref().map(|address| &address.0[..]);
        let country = self.country.as_ref().map(|country| &country[..]);
        let values = [(name, attr::RADIO_NAME), (address, attr::PERM_ADDR), (country, attr::REG_HINT_ALPHA2)];
        for (value, kind) in values {
            if let Some(value) = value {
                w.bytes(kind, value);
            }
        }
        if let Some(ciphers) = &self.ciphers {
            w.words(attr::CIPHER_SUPPORT, ciphers);
        }
        let flags = [
            (self.channel_contexts, attr::USE_CHANCTX),
            (self.no_interface, attr::NO_VIF),
            (self.ends_with_socket, attr::DESTROY_RADIO_ON_CLOSE),
            (self.p2p_device, attr::SUPPORT_P2P_DEVICE),
            (self.strict_regulation, attr::REG_STRICT_REG),
            (self.multi_link, attr::MLO_SUPPORT),
        ];
        for (_, kind) in flags.into_iter().filter(|(set, _)| *set) {
            w.bytes(kind, &[]);
        }
    }

    fn decode(body: &[u8]) -> Result<Self, DecodeError> {
        let mut radio = Self::default();
        for attribute in answer(body) {
            match attribute? {
                (attr::RADIO_ID, value) => radio.id = Some(parse_u32(value)?),
                (attr::RADIO_NAME, value) => radio.name = Some(text(value)),
                (attr::PERM_ADDR, value) => radio.permanent_address = Some(MacAddress(parse_mac(value)?)),
                (attr::CHANNELS, value) => radio.channels = Some(parse_u32(value)?),
                (attr::USE_CHANCTX, _) => radio.channel_contexts = true,
                (attr::NO_VIF, _) => radio.no_interface = true,
                (attr::DESTROY_RADIO_ON_CLOSE, _) => radio.ends_with_socket = true,
                (attr::SUPPORT_P2P_DEVICE, _) => radio.p2p_device = true,
                (attr::REG_HINT_ALPHA2, value) => {
                    let country = value.try_into();
                    radio.country = Some(country.map_err(|_| DecodeError("a country has two letters"))?);
                }
                (attr::REG_CUSTOM_REG, value) => radio.custom_regulation = Some(parse_u32(value)?),
                (attr::REG_STRICT_REG, _) => radio.strict_regulation = true,
                (attr::IFTYPE_SUPPORT, value) => radio.interface_types = Some(parse_u32(value)?),
                (attr::CIPHER_SUPPORT, value) => {
                    let ciphers = value.chunks(4).map(parse_u32).collect::<Result<_, _>>()?;
                    radio.ciphers = Some(ciphers);
                }
                (attr::MLO_SUPPORT, _) => radio.multi_link = true,
                _ => {}
            }
        }
        Ok(radio)
    }
}

impl Alias {
    fn decode(body: &[u8]) -> Result<Self, DecodeError> {
        let (mut radio, mut address) = (None, None);
        for attribute in answer(body) {
            match attribute? {
                (attr::ADDR_TRANSMITTER, value) => radio = Some(MacAddress(parse_mac(value)?)),
                (attr::ADDR_RECEIVER, value) => address = Some(MacAddress(parse_mac(value)?)),
                _ => {}
            }
        }
        Ok(Self { radio: required(radio)?, address: required(address)? })
    }
}

#[cfg(test)]
mod tests;
