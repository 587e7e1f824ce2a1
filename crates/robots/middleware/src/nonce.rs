//! Nonces of robots' packets.
use cotorra_numbers::Draws;

/// Source of nonces.
#[derive(Debug, Clone)]
pub struct Nonces(Source);

#[derive(Debug, Clone)]
enum Source {
    System,
    Seeded(Draws),
}

impl Nonces {
    /// Nonces from the system's random number generator, which cannot be guessed.
    pub fn unpredictable() -> Self {
        Self(Source::System)
    }

    /// Nonces from a seed, for virtual time, where no other program sends packets.
    pub fn seeded(seed: u64) -> Self {
        Self(Source::Seeded(Draws::new(seed, "nonces")))
    }

    /// Draws the next nonce.
    pub(crate) fn draw(&mut self) -> u64 {
        match &mut self.0 {
            Source::System => getrandom::u64().expect("the system has random numbers"),
            Source::Seeded(stream) => stream.bits(),
        }
    }
}
