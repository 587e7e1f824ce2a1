//! Nothing that another validator says, or that a damaged disk holds, panics.
#![no_main]

use std::time::Duration;

use cotorra_graph::Timestamp;
use cotorra_validator::{Consensus, Message, NetworkId, Note, Position, Settings, Validators};
use ed25519_dalek::SigningKey;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: (bool, &[u8])| {
    let (is_noted, text) = input;
    let genesis = Position { number: 0, hash: [0; 32], timestamp: 0 };
    let key = |index| SigningKey::from_bytes(&[index; 32]);
    let validators = Validators::new(&[1, 2, 3, 4].map(|index| key(index).verifying_key()));
    let network = NetworkId::new(&genesis.hash, &validators);
    let settings = Settings { validators, me: 0, key: key(1), network, period: Duration::from_secs(1) };
    let mut consensus = Consensus::new(settings, genesis, Timestamp::ZERO);
    if is_noted {
        if let Ok(notes) = serde_json::from_slice::<Vec<Note>>(text) {
            _ = consensus.start(Timestamp::ZERO, notes);
        }
    } else if let Ok(messages) = serde_json::from_slice::<Vec<Message>>(text) {
        _ = consensus.start(Timestamp::ZERO, Vec::new());
        for message in messages {
            consensus.hear(Timestamp::ZERO, 1, message);
        }
    }
});
