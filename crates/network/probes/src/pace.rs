//! Rate of probes of links, and their results.

use std::time::Duration;

use cotorra_graph::{Conditions, Probed, Probing};
use cotorra_stamp::{BASE_LENGTH, LinkEstimate, SessionConfig};

/// Bytes of the Ethernet, IPv4 and UDP headers of a probe.
const HEADERS: usize = 14 + 20 + 8;

/// Bytes of a probe's Ethernet frame.
pub const FRAME_BYTES: usize = HEADERS + BASE_LENGTH;

/// Largest share of a link's rate that its probes take, and of a channel's time that the probes of all robots take.
const SHARE: f64 = 0.01;

/// Returns the configuration for a wired link with these conditions: probes take no more than 1 % of its rate.
pub fn on_wire(settings: &Probing, conditions: [&Conditions; 2]) -> SessionConfig {
    let slowest = conditions.iter().map(|c| c.rate.mean_bits_per_second()).fold(f64::INFINITY, f64::min);
    let config = SessionConfig { interval: settings.interval, ..SessionConfig::default() };
    patient(settings, config.within(SHARE, slowest, HEADERS))
}

/// Returns the configuration for a robot's link. `turns` is the time of a frame of each robot; each interval has two of
/// them, a probe and its answer.
pub fn on_air(settings: &Probing, turns: Duration) -> SessionConfig {
    let interval = settings.interval.max(turns.mul_f64(2.0 / SHARE));
    patient(settings, SessionConfig { interval, ..SessionConfig::default() })
}

/// Keeps rare probes for longer.
fn patient(settings: &Probing, config: SessionConfig) -> SessionConfig {
    let window = settings.window.max(config.interval.saturating_mul(4));
    SessionConfig { window, patience: window / 2, ..config }
}

/// Converts the estimates of one direction of a link.
pub fn estimate(estimate: LinkEstimate) -> Probed {
    Probed {
        delay: estimate.delays.map(|(delays, _)| delays.mean),
        jitter: estimate.delays.and_then(|(delays, _)| delays.jitter),
        delay_age: estimate.delays.map(|(_, age)| age),
        loss: estimate.loss,
        loss_age: estimate.loss_age,
    }
}
