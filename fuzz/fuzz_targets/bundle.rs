//! No text panics the reader of agents' credentials, and what it reads is written the same again.
#![no_main]

use cotorra_enrolment::Bundle;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    if let Ok(bundle) = Bundle::parse(text) {
        let again = Bundle::parse(&bundle.text()).expect("it was a bundle");
        assert_eq!(again.text(), bundle.text());
        assert_eq!(again.certificate(), bundle.certificate());
    }
});
