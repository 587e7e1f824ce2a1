//! What an agent or a core says over TLS: no bytes panic the decoder, however they are cut, and what it finds can be written
//! again.
#![no_main]

use cotorra_agent_transport::frame::{Decoder, FrameError, LONGEST};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|parts: Vec<&[u8]>| {
    let (mut decoder, mut written) = (Decoder::default(), Vec::new());
    let stream = parts.concat();
    for part in parts {
        decoder.push(part);
        loop {
            match decoder.poll(LONGEST) {
                Ok(Some(frame)) => frame.write(&mut written).expect("a vector takes all"),
                Ok(None) => break,
                Err(FrameError::Kind(_) | FrameError::TooLong { .. }) => {
                    return assert!(stream.starts_with(&written));
                }
            }
        }
    }
    assert!(stream.starts_with(&written));
});
