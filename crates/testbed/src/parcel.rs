//! Observations and chunks of policies as datagrams. They have the size of what they stand for, and nothing of its content.

use std::collections::{BTreeMap, BTreeSet};

/// Bytes of a part beside its header.
const PART: u32 = 1400;
/// Bytes of a header: the client, the sequence, the part and the number of parts.
const HEADER: usize = 16;

/// What belongs together: an observation, or the chunk that answers it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Parcel {
    /// Number of the service in the testbed.
    pub(crate) client: u32,
    /// Number of the observation.
    pub(crate) sequence: u32,
}

impl Parcel {
    /// Returns the datagrams that carry so many bytes, in order.
    pub(crate) fn datagrams(self, bytes: u32) -> impl Iterator<Item = Vec<u8>> {
        let parts = bytes.div_ceil(PART).max(1);
        (0..parts).map(move |part| {
            let size = (bytes - part * PART).min(PART) as usize;
            let mut datagram = Vec::with_capacity(HEADER + size);
            for field in [self.client, self.sequence, part, parts] {
                datagram.extend(field.to_le_bytes());
            }
            datagram.resize(HEADER + size, 0);
            datagram
        })
    }

    /// Returns the parcel of a datagram, and which of how many parts it is.
    pub(crate) fn of(datagram: &[u8]) -> Option<(Self, [u32; 2])> {
        let (fields, []) = datagram.get(..HEADER)?.as_chunks::<4>() else { return None };
        let [client, sequence, part, parts] =
            [0, 1, 2, 3].map(|field: usize| u32::from_le_bytes(fields[field]));
        (part < parts).then_some((Self { client, sequence }, [part, parts]))
    }
}

/// Parts that have arrived of the newest parcel of each client.
#[derive(Debug, Clone, Default)]
pub(crate) struct Parcels(BTreeMap<u32, (u32, BTreeSet<u32>)>);

impl Parcels {
    /// Takes a datagram. Returns its parcel, if it is the last part of it that was missing.
    pub(crate) fn receive(&mut self, datagram: &[u8]) -> Option<Parcel> {
        let (parcel, [part, parts]) = Parcel::of(datagram)?;
        let (newest, arrived) = self.0.entry(parcel.client).or_default();
        if parcel.sequence < *newest {
            return None;
        }
        if parcel.sequence > *newest {
            (*newest, *arrived) = (parcel.sequence, BTreeSet::new());
        }
        (arrived.insert(part) && arrived.len() == parts as usize).then_some(parcel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parcel_is_whole_once_all_of_its_parts_came_in_any_order() {
        let parcel = Parcel { client: 3, sequence: 7 };
        let mut datagrams: Vec<_> = parcel.datagrams(3000).collect();
        assert_eq!(datagrams.iter().map(Vec::len).collect::<Vec<_>>(), [1416, 1416, 216]);
        datagrams.reverse();
        datagrams.insert(1, datagrams[0].clone());
        let mut parcels = Parcels::default();
        let whole: Vec<_> = datagrams.iter().map(|datagram| parcels.receive(datagram)).collect();
        assert_eq!(whole, [None, None, None, Some(parcel)]);
        // Neither copies of it nor older ones come again.
        assert_eq!(parcels.receive(&datagrams[0]), None);
        let older = Parcel { sequence: 6, ..parcel };
        assert_eq!(older.datagrams(10).find_map(|datagram| parcels.receive(&datagram)), None);
        assert_eq!(parcels.receive(b"short"), None);
    }
}
