//! An execution client, by the Engine API (Shanghai): it makes blocks, executes those of others, and is told which is final.
#![allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "a shell that waits, and whose tokens are as old as the clock says"
)]

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use base64::{Engine as _, engine::general_purpose::URL_SAFE_NO_PAD};
use hmac::{Hmac, Mac};
use serde::{Deserialize, de::DeserializeOwned};
use serde_json::{Value, json};
use sha2::Sha256;

use crate::{
    block::{Block, Position},
    consensus::Order,
    hex::{self, Bytes, Fixed, Quantity},
};

/// Longer, and an execution client is as good as away: the time that the specification has for it (`engine_newPayloadV2`, 8 s),
/// and some.
const PATIENCE: Duration = Duration::from_secs(10);

/// The secret that an execution client shares with its consensus client.
#[derive(Clone)]
pub struct Secret([u8; 32]);

/// Why there is no secret.
#[derive(Debug, thiserror::Error)]
pub enum SecretError {
    /// The file cannot be read.
    #[error("the secret of the Engine API, {}, cannot be read: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: io::Error,
    },
    /// It has something else in it.
    #[error("{} is to have the 64 hexadecimal digits of the Engine API's secret, as the execution client's --jwtSecret \
             (--authrpc.jwtsecret) names it", path.display())]
    Digits {
        /// The file.
        path: PathBuf,
    },
}

impl Secret {
    /// Reads the file that both share.
    ///
    /// # Errors
    /// [`SecretError`].
    pub fn read(path: &Path) -> Result<Self, SecretError> {
        let text =
            fs::read_to_string(path).map_err(|reason| SecretError::File { path: path.to_owned(), reason })?;
        let digits = text.trim().trim_start_matches("0x").to_ascii_lowercase();
        let secret = hex::decode_array(&format!("0x{digits}"));
        secret.map(Self).ok_or_else(|| SecretError::Digits { path: path.to_owned() })
    }

    /// A JSON web token (RFC 7519, HS256) of that second of Unix, as the Engine API's authentication asks for.
    fn token(&self, issued: u64) -> String {
        let part = |text: &str| URL_SAFE_NO_PAD.encode(text);
        let claims = format!(r#"{{"iat":{issued}}}"#);
        let signed = format!("{}.{}", part(r#"{"alg":"HS256","typ":"JWT"}"#), part(&claims));
        let mut mac = Hmac::<Sha256>::new_from_slice(&self.0).expect("HMAC takes a key of any length");
        mac.update(signed.as_bytes());
        format!("{signed}.{}", URL_SAFE_NO_PAD.encode(mac.finalize().into_bytes()))
    }
}

/// Why an execution client did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// It cannot be reached.
    #[error("the execution client at {url} cannot be reached: {reason}")]
    Away {
        /// Where.
        url: String,
        /// Why not.
        reason: String,
    },
    /// It refuses.
    #[error("the execution client refuses {method}: {reason}")]
    Refused {
        /// What was asked.
        method: &'static str,
        /// Why.
        reason: String,
    },
    /// It says what nobody expects.
    #[error("the execution client answers {method} with what is none: {reason}")]
    Answer {
        /// What was asked.
        method: &'static str,
        /// What is wrong.
        reason: String,
    },
}

/// A JSON-RPC server over HTTP.
#[derive(Clone)]
pub(crate) struct Rpc {
    agent: ureq::Agent,
    url: String,
    secret: Option<Secret>,
}

#[derive(Deserialize)]
struct Answer {
    result: Option<Value>,
    error: Option<Value>,
}

impl Rpc {
    pub(crate) fn new(url: &str, secret: Option<Secret>) -> Self {
        let config = ureq::Agent::config_builder().timeout_global(Some(PATIENCE)).build();
        Self { agent: config.into(), url: url.to_owned(), secret }
    }

    pub(crate) fn call<T: DeserializeOwned>(
        &self,
        method: &'static str,
        params: Value,
    ) -> Result<T, EngineError> {
        let away =
            |reason: ureq::Error| EngineError::Away { url: self.url.clone(), reason: reason.to_string() };
        let mut request = self.agent.post(&self.url);
        if let Some(secret) = &self.secret {
            request = request.header("Authorization", format!("Bearer {}", secret.token(unix())));
        }
        let asked = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": params });
        let answer: Answer =
            request.send_json(asked).and_then(|mut a| a.body_mut().read_json()).map_err(away)?;
        if let Some(error) = answer.error {
            return Err(EngineError::Refused { method, reason: error.to_string() });
        }
        serde_json::from_value(answer.result.unwrap_or_default())
            .map_err(|error| EngineError::Answer { method, reason: error.to_string() })
    }

    /// The genesis block.
    pub(crate) fn genesis(&self) -> Result<Position, EngineError> {
        #[derive(Deserialize)]
        struct Header {
            hash: Fixed<32>,
            timestamp: Quantity,
        }
        let Header { hash, timestamp } = self.call("eth_getBlockByNumber", json!(["0x0", false]))?;
        Ok(Position { number: 0, hash: hash.0, timestamp: timestamp.to_u64().unwrap_or(u64::MAX - 1) })
    }
}

fn unix() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

/// What an execution client says of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It may be on the chain.
    Valid,
    /// It may not.
    Invalid,
    /// It does not know its parent.
    Unknown,
}

/// An execution client.
pub(crate) struct Engine {
    rpc: Rpc,
    /// Who gets what transactions pay for being included.
    fees: [u8; 20],
    /// So long it may look for transactions.
    build: Duration,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct PayloadStatus {
    status: String,
    validation_error: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Updated {
    payload_status: PayloadStatus,
    payload_id: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Built {
    execution_payload: Block,
}

impl Engine {
    pub(crate) fn new(url: &str, secret: Option<Secret>, fees: [u8; 20], build: Duration) -> Self {
        Self { rpc: Rpc::new(url, secret), fees, build }
    }

    /// Has a block executed.
    pub(crate) fn judge(&self, block: &Block) -> Result<Verdict, EngineError> {
        const METHOD: &str = "engine_newPayloadV2";
        let said: PayloadStatus = self.rpc.call(METHOD, json!([block]))?;
        verdict(METHOD, &said)
    }

    /// Makes a block the last, and final.
    pub(crate) fn finalize(&self, block: &Position) -> Result<Verdict, EngineError> {
        const METHOD: &str = "engine_forkchoiceUpdatedV2";
        let said: Updated = self.rpc.call(METHOD, json!([state(block), null]))?;
        verdict(METHOD, &said.payload_status)
    }

    /// Makes a block, if its parent is known.
    pub(crate) fn build(&self, order: &Order) -> Result<Option<Block>, EngineError> {
        const METHOD: &str = "engine_forkchoiceUpdatedV2";
        let attributes = json!({
            "timestamp": Quantity::new(order.timestamp),
            "prevRandao": Fixed(order.parent.hash),
            "suggestedFeeRecipient": Fixed(self.fees),
            "withdrawals": [],
        });
        let updated: Updated = self.rpc.call(METHOD, json!([state(&order.parent), attributes]))?;
        if verdict(METHOD, &updated.payload_status)? != Verdict::Valid {
            return Ok(None);
        }
        let reason = "there is no payload id".to_owned();
        let id = updated.payload_id.ok_or(EngineError::Answer { method: METHOD, reason })?;
        std::thread::sleep(self.build);
        let built: Built = self.rpc.call("engine_getPayloadV2", json!([id]))?;
        Ok(Some(built.execution_payload))
    }
}

fn state(head: &Position) -> Value {
    let hash = Fixed(head.hash);
    json!({ "headBlockHash": hash, "safeBlockHash": hash, "finalizedBlockHash": hash })
}

fn verdict(method: &'static str, said: &PayloadStatus) -> Result<Verdict, EngineError> {
    match said.status.as_str() {
        "VALID" => Ok(Verdict::Valid),
        "SYNCING" | "ACCEPTED" => Ok(Verdict::Unknown),
        "INVALID" | "INVALID_BLOCK_HASH" => {
            tracing::warn!(reason = said.validation_error, "the execution client finds a block invalid");
            Ok(Verdict::Invalid)
        }
        other => Err(EngineError::Answer { method, reason: format!("there is no status `{other}`") }),
    }
}

/// Transactions that wait at the execution client, by hash, as they are signed.
pub(crate) fn pending(rpc: &Rpc) -> Result<Vec<crate::transaction::Raw>, EngineError> {
    let content: Value = rpc.call("txpool_content", json!([]))?;
    let by_account = content["pending"].as_object().into_iter().flat_map(|accounts| accounts.values());
    let all = by_account.flat_map(|nonces| nonces.as_object().into_iter().flat_map(|nonces| nonces.values()));
    Ok(all.filter_map(crate::transaction::raw).collect())
}

/// Has the execution client take a transaction of another validator's.
pub(crate) fn submit(rpc: &Rpc, transaction: &Bytes) -> Result<(), EngineError> {
    rpc.call::<Value>("eth_sendRawTransaction", json!([transaction])).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_signed_with_the_secret() {
        // Made with Python's hmac, hashlib and base64.
        let secret = Secret(std::array::from_fn(|index| index as u8));
        assert_eq!(secret.token(1_700_000_000), TOKEN);
    }

    const TOKEN: &str = "eyJhbGciOiJIUzI1NiIsInR5cCI6IkpXVCJ9.eyJpYXQiOjE3MDAwMDAwMDB9.uAxdaUtr1_HpYPtNDLNlQ_sHMiP5eBV-ra8EjL3ScS8";

    #[test]
    fn a_secret_is_what_execution_clients_take_for_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("jwt");
        let read = |text: &str| {
            fs::write(&file, text).unwrap();
            Secret::read(&file).map(|secret| secret.0)
        };
        let digits = "0123456789abcdefABCDEF0123456789".repeat(2);
        assert_eq!(read(&digits).unwrap(), read(&format!("0x{digits}\n")).unwrap());
        for wrong in ["", "0x", &digits[2..], &format!("{digits}00"), &digits.replace('0', "g")] {
            assert!(matches!(read(wrong), Err(SecretError::Digits { .. })), "{wrong}");
        }
        assert!(matches!(Secret::read(&folder.path().join("no")), Err(SecretError::File { .. })));
    }
}
