//! What chance does to packets on a link: loss, corruption, duplication, jitter and reordering, drawn from the link's
//! own stream of random numbers. Wired and wireless links share it.

use std::time::Duration;

use cotorra_graph::{Conditions, Jitter, JitterDistribution, Loss, Probability};
use rand::Rng;
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::{frame::Frame, random::unit};

/// The random impairments of one direction of a link.
#[derive(Debug, Clone)]
pub(crate) struct Impairments {
    rng: Xoshiro256PlusPlus,
    loss: LossProcess,
    corruption: Probability,
    duplication: Probability,
    reordering: Probability,
    jitter: Option<Jitter>,
    /// The second of the two normal deviates that one draw gives.
    spare: Option<f64>,
}

/// What decides on the next packet's loss.
#[derive(Debug, Clone, Copy, PartialEq)]
enum LossProcess {
    None,
    Independent {
        rate: Probability,
    },
    /// Gilbert's simple form of the Gilbert-Elliott model (Gilbert 1960): two states, all packets of the bad one
    /// are lost.
    Bursty {
        good_to_bad: f64,
        bad_to_good: f64,
        bad: bool,
    },
}

impl Impairments {
    /// The impairments that these conditions ask for.
    pub(crate) fn new(conditions: &Conditions, mut rng: Xoshiro256PlusPlus) -> Self {
        Self {
            loss: LossProcess::new(conditions.loss, &mut rng),
            rng,
            corruption: conditions.corruption,
            duplication: conditions.duplication,
            reordering: conditions.reordering,
            jitter: conditions.jitter,
            spare: None,
        }
    }

    /// Goes on with other conditions. A burst of losses under way goes on, too.
    pub(crate) fn change(&mut self, conditions: &Conditions) {
        let mut loss = LossProcess::new(conditions.loss, &mut self.rng);
        if let (LossProcess::Bursty { bad, .. }, LossProcess::Bursty { bad: now, .. }) =
            (&mut loss, self.loss)
        {
            *bad = now;
        }
        self.loss = loss;
        self.corruption = conditions.corruption;
        self.duplication = conditions.duplication;
        self.reordering = conditions.reordering;
        self.jitter = conditions.jitter;
    }

    /// Whether the next packet is lost.
    pub(crate) fn loses(&mut self) -> bool {
        match &mut self.loss {
            LossProcess::None => false,
            LossProcess::Independent { rate } => happens(&mut self.rng, *rate),
            LossProcess::Bursty { good_to_bad, bad_to_good, bad } => {
                let leaves = if *bad { *bad_to_good } else { *good_to_bad };
                *bad ^= unit(&mut self.rng) < leaves;
                *bad
            }
        }
    }

    /// Flips a bit of the packet if chance will have it; whether it did.
    pub(crate) fn corrupts(&mut self, frame: &mut Frame) -> bool {
        happens(&mut self.rng, self.corruption) && frame.flip_bit(self.rng.next_u64())
    }

    /// Whether the packet arrives twice.
    pub(crate) fn duplicates(&mut self) -> bool {
        happens(&mut self.rng, self.duplication)
    }

    /// Whether the packet skips the delay, and so overtakes those before it.
    pub(crate) fn reorders(&mut self) -> bool {
        happens(&mut self.rng, self.reordering)
    }

    /// How far the packet's delay deviates, in units of the jitter's deviation; 0 without jitter.
    pub(crate) fn deviate(&mut self) -> f64 {
        match self.jitter.map(|j| j.distribution) {
            None => 0.0,
            Some(JitterDistribution::Uniform) => 2.0 * unit(&mut self.rng) - 1.0,
            Some(JitterDistribution::Normal) => self.normal(),
            Some(JitterDistribution::Pareto) => pareto(1.0 - unit(&mut self.rng)),
        }
    }

    /// A standard normal deviate (Box and Muller 1958).
    fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * (1.0 - unit(&mut self.rng)).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * unit(&mut self.rng)).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

impl LossProcess {
    /// A process in its stationary state.
    fn new(loss: Loss, rng: &mut Xoshiro256PlusPlus) -> Self {
        match loss {
            Loss::None => Self::None,
            Loss::Independent { rate } => Self::Independent { rate },
            Loss::Bursty { rate, mean_burst } => {
                let bad_to_good = 1.0 / mean_burst;
                let good_to_bad = bad_to_good * rate.get() / (1.0 - rate.get());
                Self::Bursty { good_to_bad, bad_to_good, bad: happens(rng, rate) }
            }
        }
    }
}

/// Whether an event of that probability happens. What never or always does takes no random number.
fn happens(rng: &mut Xoshiro256PlusPlus, p: Probability) -> bool {
    p != Probability::ZERO && (p == Probability::ONE || unit(rng) < p.get())
}

/// The value of a Pareto distribution with shape 3, moved and scaled to mean 0 and standard deviation 1, that is
/// exceeded with probability `u` in (0, 1].
fn pareto(u: f64) -> f64 {
    // With scale 1: mean 3/2, variance 3/4 (for shape α: α/(α-1) and α/((α-1)²(α-2))).
    (1.0 / u.cbrt() - 1.5) / 0.75f64.sqrt()
}

/// A delay and its deviation from it, zero at least.
pub(crate) fn jittered(delay: Duration, deviate: f64, jitter: Option<Jitter>) -> Duration {
    let Some(jitter) = jitter else { return delay };
    let extra = deviate * jitter.deviation.as_nanos() as f64;
    Duration::from_nanos((delay.as_nanos() as f64 + extra).round() as u64)
}
