//! The nonces of a robot's packets.

use crate::random::Stream;

/// Where nonces come from.
#[derive(Debug, Clone)]
pub struct Nonces(Source);

#[derive(Debug, Clone)]
enum Source {
    System,
    Seeded(Stream),
}

impl Nonces {
    /// Numbers that nobody can guess: the system's.
    pub fn unpredictable() -> Self {
        Self(Source::System)
    }

    /// The same numbers for the same seed. For virtual time, where nobody else sends packets.
    pub fn seeded(seed: u64) -> Self {
        Self(Source::Seeded(Stream::new(seed, "nonces")))
    }

    /// The next.
    pub(crate) fn draw(&mut self) -> u64 {
        match &mut self.0 {
            Source::System => getrandom::u64().expect("the system has random numbers"),
            Source::Seeded(stream) => stream.bits(),
        }
    }
}
