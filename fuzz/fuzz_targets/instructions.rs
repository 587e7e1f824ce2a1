//! No instruction in JSON makes the reader panic, and one that is read keeps to its bounds and survives JSON.
#![no_main]

use cotorra_graph::Instruction;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(instruction) = serde_json::from_slice::<Instruction>(bytes) else { return };
    assert!(instruction.measure().expect("it was read") <= Instruction::LONGEST);
    // A number that is too large for JSON is written as null.
    let json = serde_json::to_string(&instruction).expect("it is valid JSON");
    if let Ok(again) = serde_json::from_str::<Instruction>(&json) {
        assert_eq!(again.name(), instruction.name());
    }
    let _ = instruction.public();
});
