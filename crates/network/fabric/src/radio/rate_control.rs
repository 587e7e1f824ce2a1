//! The rate of each frame or aggregate from one sender to one receiver.

use cotorra_graph::{Band, Timestamp, WirelessNetwork};
use cotorra_numbers::Draws;

use super::{
    minstrel::{Chain, Minstrel, Tried},
    phy::{ATTEMPTS, Phy, Reception},
};
use crate::settings::FabricError;

/// Parameters of an attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Attempt {
    pub(super) mode: usize,
    /// Whether RTS and CTS come first.
    pub(super) rts: bool,
    /// Whether it is a frame by itself, also where frames are aggregated.
    pub(super) alone: bool,
    /// Attempts after which a frame is given up.
    pub(super) most: u32,
}

/// Chooses modes.
#[derive(Debug)]
pub(super) enum RateControl {
    /// The mode with the highest expected goodput at the present signal, as if the sender knew it.
    Ideal,
    /// Always this mode.
    Fixed(usize),
    /// Linux's, which learns from acknowledgements. It begins anew with each association.
    Minstrel { state: Option<Box<Learning>>, rng: Draws },
}

#[derive(Debug)]
pub(super) struct Learning {
    minstrel: Minstrel,
    running: Option<Running>,
}

/// A chain of modes in use.
#[derive(Debug)]
struct Running {
    chain: Chain,
    stage: usize,
    /// Attempts of this stage.
    used: u32,
    tried: Vec<Tried>,
}

/// Returns the mode of all data frames of a network; `None` if a rate control chooses modes.
///
/// # Errors
/// [`FabricError::NoSuchRate`] if the network's standard, width and streams do not have it.
pub(super) fn fixed_mode(network: &WirelessNetwork) -> Result<Option<usize>, FabricError> {
    match network.access.edca().map(|edca| edca.rate_control) {
        Some(cotorra_graph::RateControl::Fixed(rate)) => {
            // Both bands have the same modes.
            let mode = Phy::of(network, Band::Ghz5).mode_of(rate);
            mode.map(Some).ok_or(FabricError::NoSuchRate { standard: network.standard.described(), rate })
        }
        _ => Ok(None),
    }
}

impl RateControl {
    /// Creates Linux's rate control.
    pub(super) fn minstrel(rng: Draws) -> Self {
        Self::Minstrel { state: None, rng }
    }

    /// Forgets what it has learned.
    pub(super) fn restart(&mut self) {
        if let Self::Minstrel { state, .. } = self {
            *state = None;
        }
    }

    /// Returns how the next attempt to send a frame of this length, and others with it, is made.
    pub(super) fn attempt(
        &mut self,
        now: Timestamp,
        phy: &Phy,
        reception: &Reception,
        frame_bytes: usize,
    ) -> Attempt {
        match self {
            Self::Ideal => {
                Attempt { mode: reception.best(frame_bytes), rts: false, alone: false, most: ATTEMPTS }
            }
            Self::Fixed(mode) => Attempt { mode: *mode, rts: false, alone: false, most: ATTEMPTS },
            Self::Minstrel { state, rng } => {
                let Learning { minstrel, running } = &mut **state.get_or_insert_with(|| {
                    let minstrel = Minstrel::new(now, phy, rng.fork());
                    Box::new(Learning { minstrel, running: None })
                });
                let begin = || Running { chain: minstrel.chain(now), stage: 0, used: 0, tried: Vec::new() };
                let Running { chain, stage, .. } = running.get_or_insert_with(begin);
                let now = chain.stages[*stage];
                Attempt {
                    mode: now.mode,
                    rts: now.rts,
                    alone: chain.is_sample && *stage == 0,
                    most: chain.stages.iter().map(|stage| stage.attempts).sum(),
                }
            }
        }
    }

    /// Records the outcome of the attempt: MPDUs sent, and acknowledged.
    pub(super) fn record(&mut self, now: Timestamp, sent: u32, acknowledged: u32) {
        let Self::Minstrel { state: Some(state), .. } = self else { return };
        let Learning { minstrel, running } = &mut **state;
        let Some(run) = running else { return };
        let stage = run.chain.stages[run.stage];
        match run.tried.last_mut().filter(|tried| tried.mode == stage.mode) {
            Some(tried) => {
                tried.sent += sent;
                tried.acknowledged += acknowledged;
            }
            None => run.tried.push(Tried { mode: stage.mode, sent, acknowledged }),
        }
        run.used += 1;
        if run.used >= stage.attempts {
            (run.stage, run.used) = (run.stage + 1, 0);
        }
        if acknowledged > 0 || run.stage == run.chain.stages.len() {
            minstrel.record(now, sent, &run.tried);
            *running = None;
        }
    }

    /// Returns the rate of full frames, Mbit/s.
    pub(super) fn mbps(&self, reception: &Reception) -> f64 {
        match self {
            Self::Minstrel { state: Some(state), .. } => reception.mbps_of(state.minstrel.best()),
            Self::Fixed(mode) => reception.mbps_of(*mode),
            Self::Ideal | Self::Minstrel { state: None, .. } => reception.mbps(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use cotorra_graph::WifiStandard;

    #[test]
    fn a_chain_goes_on_until_something_is_acknowledged() {
        let phy = Phy::usual(WifiStandard::N);
        let reception = Reception::new(phy, 40.0);
        let mut rates = RateControl::minstrel(Draws::new(1, "rates"));
        // It begins with a sample of the next mode, and the slowest mode twice in each of three entries.
        let attempts = [(); 7].map(|()| {
            let Attempt { mode, alone, most, .. } = rates.attempt(Timestamp::ZERO, phy, &reception, 1000);
            rates.record(Timestamp::ZERO, 1, 0);
            (mode, alone, most)
        });
        assert_eq!(attempts[0], (1, true, 7));
        assert_eq!(attempts[1..], [(0, false, 7); 6]);
        let RateControl::Minstrel { state: Some(state), .. } = &rates else { panic!("it has learned") };
        assert!(state.running.is_none(), "the chain is over");
        rates.attempt(Timestamp::ZERO, phy, &reception, 1000);
        rates.record(Timestamp::ZERO, 1, 1);
        let RateControl::Minstrel { state: Some(state), .. } = &rates else { panic!("it has learned") };
        assert!(state.running.is_none(), "an acknowledgement ends a chain");
    }

    #[test]
    fn an_association_begins_anew() {
        let phy = Phy::usual(WifiStandard::N);
        let reception = Reception::new(phy, 40.0);
        let mut rates = RateControl::minstrel(Draws::new(1, "rates"));
        for ms in 0..500 {
            let now = Timestamp::from_nanos(ms * 1_000_000);
            rates.attempt(now, phy, &reception, 1000);
            rates.record(now, 1, 1);
        }
        assert!(rates.mbps(&reception) > 40.0);
        rates.restart();
        assert_eq!(rates.attempt(Timestamp::ZERO, phy, &reception, 1000).mode, 1, "the first sample");
    }
}
