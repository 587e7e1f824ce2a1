//! Runs tests on the main thread, because a process can only enter a user namespace before it has other threads.

use std::{
    env,
    panic::{self, AssertUnwindSafe},
    process::ExitCode,
};

/// Lists the tests, or runs the selected ones with each labelled case, in nextest's protocol: `--list --format
/// terse`, and `NAME --exact` for each test. Without `--exact`, a part of the name is enough.
pub fn run<F: Copy, T: Copy>(
    tests: &[(&str, F)],
    cases: impl IntoIterator<Item = (String, T)>,
    call: impl Fn(F, T),
) -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let has = |flag: &str| arguments.iter().any(|argument| argument == flag);
    if has("--list") {
        if !has("--ignored") {
            tests.iter().for_each(|(name, _)| println!("{name}: test"));
        }
        return ExitCode::SUCCESS;
    }
    let filter = arguments.iter().find(|argument| !argument.starts_with('-')).map_or("", String::as_str);
    let is_chosen = |name: &str| if has("--exact") { name == filter } else { name.contains(filter) };
    let mut failed = false;
    for (label, case) in cases {
        for (name, test) in tests.iter().filter(|(name, _)| is_chosen(name)) {
            let passed = panic::catch_unwind(AssertUnwindSafe(|| call(*test, case))).is_ok();
            println!("{label}: {name}: {}", if passed { "ok" } else { "FAILED" });
            failed |= !passed;
        }
    }
    if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
