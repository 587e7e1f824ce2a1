//! Nothing that a ledger's node or another operator says panics: logs, reverts and sealed messages.
#![no_main]

use cotorra_ledger::{Account, Attachment, Bid, Deployment, Salt, Secret, ServiceId, ethereum};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: (Vec<[u8; 32]>, Vec<u8>)| {
    let (topics, bytes) = input;
    _ = ethereum::decode_event(&topics, &bytes);
    _ = ethereum::decode_error(&bytes);
    let secret = Secret::new([1; 32], Deployment::default());
    let (salt, id, sender) = (Salt([2; 32]), ServiceId([3; 32]), Account([4; 20]));
    _ = secret.open::<Bid>(salt, id, sender, &bytes);
    _ = secret.open::<Attachment>(salt, id, sender, &bytes);
});
