//! u32 filters, which sort packets by address into classes or redirect all ingress packets. u32 is the oldest kind of
//! filter and the one that kernels most often have.

use std::net::IpAddr;

use crate::{handle::Handle, structure::word};
use cotorra_graph::IpNetwork;
use cotorra_netlink::{DecodeError, Writer, attributes};

/// Address field that a filter compares.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Field {
    Source,
    Destination,
}

/// Action of a filter on matching packets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Puts the packet into this class.
    Class(Handle),
    /// Redirects the packet to the interface with this index.
    Redirect(u32),
}

/// Packets that a filter matches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Packets {
    All,
    /// Those with an address of the network in this field.
    Network(Field, IpNetwork),
    /// Those between two MAC addresses.
    Frames {
        from: [u8; 6],
        to: [u8; 6],
    },
}

impl Packets {
    /// Returns the packets with an address of a network in this field; all without a network.
    pub(crate) fn of(field: Field, network: Option<IpNetwork>) -> Self {
        network.map_or(Self::All, |network| Self::Network(field, network))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Filter {
    pub(crate) packets: Packets,
    pub(crate) verdict: Verdict,
    /// Filters run in ascending priority. Each of ours has its own.
    pub(crate) priority: u16,
}

const CLASS: u16 = 1;
const SELECTOR: u16 = 5;
const ACTIONS: u16 = 7;
/// `TC_U32_TERMINAL`: the verdict is final.
const TERMINAL: u8 = 1;
/// Length of `struct tc_u32_sel` without its keys. Its third byte is the number of keys.
const SELECTOR_HEADER: usize = 16;
const KEY: usize = 16;

/// Offsets of the addresses in the headers of IPv4 (RFC 791) and IPv6 (RFC 8200).
const V4: [(Field, u32); 2] = [(Field::Source, 12), (Field::Destination, 16)];
const V6: [(Field, u32); 2] = [(Field::Source, 8), (Field::Destination, 24)];

/// Offsets of the words of both addresses in an Ethernet header, which ends where the network header begins.
const ETHERNET: [u32; 3] = [14_u32.wrapping_neg(), 10_u32.wrapping_neg(), 6_u32.wrapping_neg()];

fn offset(of: [(Field, u32); 2], field: Field) -> u32 {
    if field == of[0].0 { of[0].1 } else { of[1].1 }
}

impl Filter {
    /// Returns the EtherType of the packets that the filter examines.
    pub(crate) fn protocol(&self) -> u16 {
        match self.packets {
            Packets::Network(_, network) if network.address().is_ipv4() => 0x0800,
            Packets::Network(..) => 0x86dd,
            Packets::All | Packets::Frames { .. } => 0x0003,
        }
    }

    /// Returns mask, value and offset of each compared word, in network byte order. Offsets are from the network header.
    pub(crate) fn keys(&self) -> Vec<([u8; 4], [u8; 4], u32)> {
        let (field, network) = match self.packets {
            Packets::All => return vec![([0; 4], [0; 4], 0)],
            Packets::Frames { from, to } => {
                let [a, b, c, d, e, f] = to;
                let [g, h, i, j, k, l] = from;
                let words = [[a, b, c, d], [e, f, g, h], [i, j, k, l]];
                return words.into_iter().zip(ETHERNET).map(|(word, at)| ([0xff; 4], word, at)).collect();
            }
            Packets::Network(field, network) => (field, network),
        };
        let (address, start) = match network.address() {
            IpAddr::V4(v4) => (v4.octets().to_vec(), offset(V4, field)),
            IpAddr::V6(v6) => (v6.octets().to_vec(), offset(V6, field)),
        };
        let word = |(i, value): (usize, &[u8])| {
            let bits = u32::from(network.prefix()).saturating_sub(i as u32 * 32).min(32);
            let mask = u32::MAX.checked_shl(32 - bits).unwrap_or(0);
            let value = [value[0], value[1], value[2], value[3]];
            // A filter needs at least one key, so the first word is compared even under an empty mask.
            (bits > 0 || i == 0).then(|| (mask.to_be_bytes(), value, start + i as u32 * 4))
        };
        address.chunks_exact(4).enumerate().filter_map(word).collect()
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut w = Writer::default();
        if let Verdict::Class(class) = self.verdict {
            w.words(CLASS, &[class.0]);
        }
        let keys = self.keys();
        let mut selector = vec![0; SELECTOR_HEADER];
        selector[0] = TERMINAL;
        selector[2] = keys.len() as u8;
        for (mask, value, offset) in keys {
            selector.extend([mask, value, offset.to_ne_bytes(), [0; 4]].concat());
        }
        w.bytes(SELECTOR, &selector);
        if let Verdict::Redirect(interface) = self.verdict {
            w.with(ACTIONS, |w| {
                w.with(1, |w| {
                    w.text(1, "mirred");
                    w.with(2, |w| {
                        // index, capabilities, TC_ACT_STOLEN, two counters, TCA_EGRESS_REDIR, interface
                        w.words(2, &[0, 0, 4, 0, 0, 1, interface]);
                    });
                });
            });
        }
        w.finish()
    }

    /// Reads a filter's options from the kernel's answer. Returns `None` for a form that this crate never writes.
    pub(crate) fn decode(options: &[u8], protocol: u16, priority: u16) -> Result<Option<Self>, DecodeError> {
        let (mut verdict, mut selected) = (None, None);
        for attribute in attributes(options) {
            let (kind, value) = attribute?;
            match kind {
                CLASS => verdict = Some(Verdict::Class(Handle(word(value, 0)?))),
                ACTIONS => verdict = redirect(value)?.map(Verdict::Redirect).or(verdict),
                SELECTOR => selected = read_selector(value, protocol)?,
                _ => {}
            }
        }
        let (Some(verdict), Some(packets)) = (verdict, selected) else { return Ok(None) };
        let filter = Self { packets, verdict, priority };
        Ok((filter.protocol() == protocol).then_some(filter))
    }
}

fn redirect(actions: &[u8]) -> Result<Option<u32>, DecodeError> {
    for attribute in attributes(actions) {
        let (_, action) = attribute?;
        for attribute in attributes(action) {
            let (kind, options) = attribute?;
            if kind != 2 {
                continue;
            }
            for attribute in attributes(options) {
                let (kind, value) = attribute?;
                if kind == 2 && value.len() >= 28 {
                    return Ok(Some(word(value, 6)?));
                }
            }
        }
    }
    Ok(None)
}

fn read_selector(value: &[u8], protocol: u16) -> Result<Option<Packets>, DecodeError> {
    let keys = value.get(SELECTOR_HEADER..).ok_or(DecodeError("a filter's selector is too short"))?;
    let (fields, length) = match protocol {
        0x0800 => (V4, 4),
        0x86dd => (V6, 16),
        _ => return Ok(Some(read_frames(keys)?.unwrap_or(Packets::All))),
    };
    let mut address = vec![0_u8; length];
    let mut prefix = 0;
    let mut field = None;
    for key in keys.chunks_exact(KEY) {
        let mask = u32::from_be_bytes([key[0], key[1], key[2], key[3]]);
        let at = word(key, 2)?;
        let Some((found, start)) = fields.into_iter().find(|(_, s)| (*s..*s + length as u32).contains(&at))
        else {
            return Ok(None);
        };
        let place = (at - start) as usize;
        let Some(bytes) = address.get_mut(place..place + 4) else { return Ok(None) };
        bytes.copy_from_slice(&key[4..8]);
        prefix += mask.leading_ones() as u8;
        field = Some(found);
    }
    let address = match length {
        4 => IpAddr::from([address[0], address[1], address[2], address[3]]),
        _ => IpAddr::from(<[u8; 16]>::try_from(address).expect("an address of IPv6 has 16 bytes")),
    };
    Ok(field.and_then(|field| Some(Packets::Network(field, IpNetwork::new(address, prefix)?))))
}

/// Reads the comparison of both MAC addresses; `None` if the keys compare anything else.
fn read_frames(keys: &[u8]) -> Result<Option<Packets>, DecodeError> {
    if keys.len() != ETHERNET.len() * KEY {
        return Ok(None);
    }
    let mut words = [0_u8; 12];
    for ((key, offset), place) in keys.chunks_exact(KEY).zip(ETHERNET).zip(words.chunks_exact_mut(4)) {
        if word(key, 2)? != offset {
            return Ok(None);
        }
        place.copy_from_slice(&key[4..8]);
    }
    let [a, b, c, d, e, f, g, h, i, j, k, l] = words;
    Ok(Some(Packets::Frames { to: [a, b, c, d, e, f], from: [g, h, i, j, k, l] }))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn written_filters_are_read_back(bits: u128, v4: bool, prefix in 0_u8..=128, source: bool, class in 1_u16.., priority: u16) {
            let network = if v4 {
                IpNetwork::new((bits as u32).to_be_bytes().into(), prefix / 4)
            } else {
                IpNetwork::new(bits.to_be_bytes().into(), prefix)
            };
            let field = if source { Field::Source } else { Field::Destination };
            let packets = Packets::of(field, network);
            let filter = Filter { packets, verdict: Verdict::Class(Handle::class(class)), priority };
            prop_assert_eq!(Filter::decode(&filter.encode(), filter.protocol(), priority), Ok(Some(filter)));
        }

        #[test]
        fn filters_of_frames_are_read_back(from: [u8; 6], to: [u8; 6], class in 1_u16.., priority: u16) {
            let packets = Packets::Frames { from, to };
            let filter = Filter { packets, verdict: Verdict::Class(Handle::class(class)), priority };
            prop_assert_eq!(Filter::decode(&filter.encode(), filter.protocol(), priority), Ok(Some(filter)));
        }

        #[test]
        fn arbitrary_options_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..120), protocol: u16) {
            _ = Filter::decode(&bytes, protocol, 0);
            _ = Filter::decode(&bytes, 0x0800, 0);
            _ = Filter::decode(&bytes, 0x86dd, 0);
        }
    }

    #[test]
    fn redirect_filters_are_read_back() {
        let all = Filter { packets: Packets::All, verdict: Verdict::Redirect(7), priority: 9 };
        assert_eq!(Filter::decode(&all.encode(), 3, 9), Ok(Some(all)));
    }
}
