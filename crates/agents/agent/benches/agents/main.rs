//! Cost of agents. Run it as root with `cargo bench -p cotorra-agent --bench agents`; `-- load` or `-- effect` runs one part.
//!
//! - 100 agents report at 10 Hz, beside clients of bare Zenoh: CPU time and memory of the core, messages lost.
//! - An instruction starts a program at an agent, beside starting it without one: the time until the program runs.
#![allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    clippy::unwrap_used,
    reason = "a benchmark reads the clock, waits, and panics on failures"
)]

mod bare;
mod core;
mod effect;
mod lab;
mod load;
mod machine;
mod ours;

use std::{env, path::Path};

fn main() {
    let arguments: Vec<_> = env::args().skip(1).collect();
    let words: Vec<_> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        // The parts of a load, each in a process of its own.
        ["core", folder] => ours::core(Path::new(folder)),
        ["agents", folder] => ours::agents(Path::new(folder)),
        ["bare-core", folder] => bare::core(Path::new(folder)),
        ["bare-agents", folder] => bare::agents(Path::new(folder)),
        _ if words.contains(&"--bench") => {
            println!("{}", machine::describe());
            for (name, measure) in [("load", load::measure as fn()), ("effect", effect::measure)] {
                if words.contains(&name) || words == ["--bench"] {
                    measure();
                }
            }
        }
        // As `cargo test --benches` calls it.
        _ => {}
    }
}
