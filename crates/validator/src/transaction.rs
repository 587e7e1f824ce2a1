//! Transactions as they are signed, from what an execution client shows of those that wait: legacy ones, and those of
//! EIP-2930 and EIP-1559. For nodes that do not pass transactions on among themselves.

use alloy_rlp::{BufMut, Encodable, Header};
use serde::Deserialize;
use serde_json::Value;
use sha3::{Digest, Keccak256};

use crate::hex::{Bytes, Fixed, Quantity};

/// A transaction, and its hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Raw {
    pub(crate) hash: [u8; 32],
    pub(crate) bytes: Bytes,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Shown {
    hash: Fixed<32>,
    #[serde(rename = "type")]
    kind: Quantity,
    chain_id: Option<Quantity>,
    nonce: Quantity,
    gas_price: Option<Quantity>,
    max_priority_fee_per_gas: Option<Quantity>,
    max_fee_per_gas: Option<Quantity>,
    gas: Quantity,
    to: Option<Fixed<20>>,
    value: Quantity,
    input: Bytes,
    access_list: Option<Vec<Access>>,
    v: Quantity,
    r: Quantity,
    s: Quantity,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Access {
    address: Fixed<20>,
    storage_keys: Vec<Fixed<32>>,
}

/// The fields of an RLP list.
#[derive(Default)]
struct List(Vec<u8>);

impl List {
    fn bytes(mut self, bytes: &[u8]) -> Self {
        bytes.encode(&mut self.0);
        self
    }

    fn number(self, number: &Quantity) -> Self {
        self.bytes(&number.to_bytes())
    }

    fn list(mut self, list: Self) -> Self {
        list.end(&mut self.0);
        self
    }

    fn end(self, out: &mut Vec<u8>) {
        Header { list: true, payload_length: self.0.len() }.encode(out);
        out.put_slice(&self.0);
    }
}

/// The hash of a transaction as it is signed.
pub(crate) fn hash(transaction: &Bytes) -> [u8; 32] {
    Keccak256::digest(&transaction.0).into()
}

/// The transaction, if it is of a kind that is known and all that was signed is shown.
pub(crate) fn raw(shown: &Value) -> Option<Raw> {
    let shown: Shown = serde_json::from_value(shown.clone()).ok()?;
    let to = shown.to.map_or(Vec::new(), |to| to.0.to_vec());
    let mut bytes = Vec::new();
    let kind = shown.kind.to_u64()?;
    let fields = match kind {
        0 => List::default().number(&shown.nonce).number(shown.gas_price.as_ref()?),
        1 => List::default()
            .number(shown.chain_id.as_ref()?)
            .number(&shown.nonce)
            .number(shown.gas_price.as_ref()?),
        2 => List::default()
            .number(shown.chain_id.as_ref()?)
            .number(&shown.nonce)
            .number(shown.max_priority_fee_per_gas.as_ref()?)
            .number(shown.max_fee_per_gas.as_ref()?),
        _ => return None,
    };
    let mut fields = fields.number(&shown.gas).bytes(&to).number(&shown.value).bytes(&shown.input.0);
    if kind > 0 {
        bytes.push(kind as u8);
        let accesses = shown.access_list.unwrap_or_default().iter().fold(List::default(), |list, access| {
            let keys = access.storage_keys.iter().fold(List::default(), |keys, key| keys.bytes(&key.0));
            list.list(List::default().bytes(&access.address.0).list(keys))
        });
        fields = fields.list(accesses);
    }
    fields.number(&shown.v).number(&shown.r).number(&shown.s).end(&mut bytes);
    // The signature covers it all: were anything missing, the hash would be another.
    let bytes = Bytes(bytes);
    (hash(&bytes) == shown.hash.0).then_some(Raw { hash: shown.hash.0, bytes })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::hex;

    #[test]
    fn a_transaction_is_as_it_was_signed() {
        // The example of EIP-155.
        let signed = "0xf86c098504a817c800825208943535353535353535353535353535353535353535880de0b6b3a76400008025a028ef61340bd939bc\
                      2195fe537567866003e1a15d3c71ff63e1590620aa636276a067cbe9d8997f761aecb703304b3800ccf555c9f3dc64214b297fb1966a3b6d83";
        let bytes = Bytes(hex::decode(signed).unwrap());
        let shown = json!({
            "hash": hex::encode(&hash(&bytes)),
            "type": "0x0",
            "nonce": "0x9",
            "gasPrice": "0x4a817c800",
            "gas": "0x5208",
            "to": "0x3535353535353535353535353535353535353535",
            "value": "0xde0b6b3a7640000",
            "input": "0x",
            "v": "0x25",
            "r": "0x28ef61340bd939bc2195fe537567866003e1a15d3c71ff63e1590620aa636276",
            "s": "0x67cbe9d8997f761aecb703304b3800ccf555c9f3dc64214b297fb1966a3b6d83",
        });
        assert_eq!(raw(&shown).unwrap().bytes, bytes);
        for (field, value) in
            [("nonce", "0x8"), ("type", "0x1"), ("type", "0x4"), ("v", "0x26"), ("r", "0x0")]
        {
            let mut other = shown.clone();
            other[field] = json!(value);
            assert_eq!(raw(&other), None, "{field}");
        }
    }
}
