//! No datagram that comes to either end of a tunnel panics, or opens without its key.
#![no_main]

use std::time::Duration;

use cotorra_ledger::tunnel::{End, Received, Share, Tunnel};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|datagrams: Vec<(bool, &[u8])>| {
    let share = |at| Share::new(Duration::from_nanos(at), [0; 8]);
    let mut home = Tunnel::new(End::Home, [7; 32], share(1));
    let mut visited = Tunnel::new(End::Visited, [7; 32], share(2));
    let Received::Hello(answer) = visited.receive(&home.hello(), || share(3)) else { panic!("no answer") };
    assert_eq!(home.receive(&answer, || share(4)), Received::Opened);
    let sealed = home.seal(b"first").expect("the tunnel is open");
    assert_eq!(visited.receive(&sealed, || share(4)), Received::Message(b"first".to_vec()));
    let id = sealed[..8].to_vec();
    for (is_home, bytes) in datagrams {
        let end = if is_home { &mut home } else { &mut visited };
        assert_eq!(end.receive(bytes, || share(5)), Received::Rejected);
        assert_eq!(end.receive(&[&id, bytes].concat(), || share(5)), Received::Rejected);
    }
});
