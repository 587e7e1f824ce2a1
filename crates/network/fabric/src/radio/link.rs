//! One robot's link to one radio unit: its settings, impairments and counters. The air decides how long a frame takes and
//! whether it arrives; emulation adds its conditions on top.

use std::time::Duration;

use cotorra_graph::{
    BitRate, ConditionChange, Conditions, Direction, LinkContext, LinkCounters, LinkId, Medium, Position,
    Probed, Rate, Scale, Timestamp, WirelessNetwork,
};
use cotorra_numbers::Draws;

use super::{
    Network,
    fading::{FadingField, Moment},
    medium::QueueSettings,
    phy::{Exchange, Phy, Reception},
    rate_control::RateControl,
};
use crate::{
    balance::Balance,
    frame::Frame,
    impairment::{Impairments, jittered},
    meter::Meter,
    settings::{FabricError, Settings},
};

/// Returns the initial settings of all links of a network. No station gets more than the fastest PHY rate.
pub(super) fn initial_settings(network: &WirelessNetwork, phy: &Phy) -> Result<Settings, FabricError> {
    let medium = Medium { delay: Duration::ZERO, rate: phy.top_rate() };
    let rate = match network.rate {
        None => Rate::Unlimited,
        Some(rate) => Rate::Fixed { bits_per_second: rate.min(medium.rate) },
    };
    let (queue, queue_discipline) =
        network.access.edca().map(|edca| (edca.queue, edca.queue_discipline)).unwrap_or_default();
    let (delay, loss) = (network.delay, network.loss);
    let asked = Conditions { delay, loss, rate, queue, queue_discipline, ..Conditions::default() };
    Settings::new(asked, Scale::default(), medium)
}

/// A link that was in use or changed.
#[derive(Debug)]
pub(super) struct WirelessLink {
    id: LinkId,
    lanes: [Lane; 2],
    fading: Option<FadingField>,
    receptions: Option<(Moment, [Reception; 2])>,
}

/// One direction of a link.
#[derive(Debug)]
pub(super) struct Lane {
    settings: Settings,
    impairments: Impairments,
    rng: Draws,
    meter: Meter,
    rates: RateControl,
    /// Whether its ends were asked to agree to aggregates since the association.
    agreed: bool,
    /// Arrival of the last frame that kept its order.
    last_due: Timestamp,
}

/// The timing of a frame on a link.
#[derive(Debug, Clone, Copy)]
pub(super) struct Flight {
    /// Start of the first attempt.
    start: Timestamp,
    /// Airtime of the first attempt.
    first: Duration,
    /// Airtime of all further attempts.
    retries: Duration,
    /// Deviation of the delay, in units of the jitter's deviation; `None` if the frame skips the delay.
    deviate: Option<f64>,
}

/// The arrival of a frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Landing {
    pub(super) due: Timestamp,
    pub(super) flight: Flight,
    pub(super) twice: bool,
    /// Whether a bit of it was flipped.
    pub(super) corrupted: bool,
}

impl Flight {
    /// Returns the start of the first attempt.
    pub(super) fn start(&self) -> Timestamp {
        self.start
    }

    /// Returns the airtime of all attempts but the first.
    pub(super) fn retries(&self) -> Duration {
        self.retries
    }
}

impl WirelessLink {
    /// Creates the link of a network, on a channel with this centre.
    pub(super) fn new(id: LinkId, network: &Network, frequency_mhz: u16, seed: u64) -> Self {
        let Network { spec, settings, fixed_mode, .. } = network;
        let learns =
            spec.access.edca().map(|edca| edca.rate_control) == Some(cotorra_graph::RateControl::Minstrel);
        let rates = |direction: &str| match fixed_mode {
            Some(mode) => RateControl::Fixed(*mode),
            None if learns => RateControl::minstrel(Draws::new(seed, &format!("rates {id} {direction}"))),
            None => RateControl::Ideal,
        };
        let fading = spec
            .fading
            .as_ref()
            .map(|fading| FadingField::new(fading, frequency_mhz, Draws::new(seed, &format!("fading {id}"))));
        let lane = |direction: &str| Lane {
            settings: settings.clone(),
            impairments: Impairments::new(
                settings.effective(),
                Draws::new(seed, &format!("link {id} {direction}")),
            ),
            rng: Draws::new(seed, &format!("air {id} {direction}")),
            meter: Meter::default(),
            rates: rates(direction),
            agreed: false,
            last_due: Timestamp::ZERO,
        };
        Self { lanes: [lane("forward"), lane("backward")], id, fading, receptions: None }
    }

    /// Returns the frames that the link lost, dropped or duplicated.
    pub(super) fn balance(&self) -> Balance {
        let mut balance = Balance::default();
        self.lanes.iter().for_each(|lane| balance += lane.meter.counters.into());
        balance
    }

    /// Returns its name, and the counters of one direction.
    pub(super) fn counters(&self, direction: Direction) -> (&LinkId, &LinkCounters) {
        (&self.id, &self.lanes[direction as usize].meter.counters)
    }

    pub(super) fn lane(&mut self, direction: Direction) -> &mut Lane {
        &mut self.lanes[direction as usize]
    }

    /// Returns the rate of full frames, Mbit/s.
    pub(super) fn mbps(&self, direction: Direction, reception: &Reception) -> f64 {
        self.lanes[direction as usize].rates.mbps(reception)
    }

    /// Forgets what the rate control has learned, and that aggregates were agreed on.
    pub(super) fn begin_association(&mut self) {
        for lane in &mut self.lanes {
            lane.rates.restart();
            lane.agreed = false;
        }
    }

    /// Whether its ends have to agree to aggregates now: the first time since the association.
    pub(super) fn agrees(&mut self, direction: Direction) -> bool {
        !std::mem::replace(&mut self.lanes[direction as usize].agreed, true)
    }

    pub(super) fn settings(&self, direction: Direction) -> &Settings {
        &self.lanes[direction as usize].settings
    }

    /// Returns the moment of a robot at a place: what its fading depends on.
    pub(super) fn moment(&self, now: Timestamp, place: Position) -> Moment {
        let tick = self.fading.as_ref().map_or(0, |fading| fading.tick(now));
        Moment { place, tick }
    }

    /// Returns the power of the link in a moment over its mean, in dB; `distance_m` is that of both antennas.
    pub(super) fn fading_db(&self, moment: Moment, distance_m: f64) -> f64 {
        self.fading.as_ref().map_or(0.0, |fading| fading.gain_db(moment, distance_m))
    }

    /// Returns the cached reception of one direction, if it is of this moment.
    pub(super) fn reception(&self, direction: Direction, moment: Moment) -> Option<Reception> {
        self.receptions.filter(|(of, _)| *of == moment).map(|(_, receptions)| receptions[direction as usize])
    }

    /// Caches the receptions at both ends in a moment, forward first.
    pub(super) fn set_receptions(&mut self, moment: Moment, receptions: [Reception; 2]) {
        self.receptions = Some((moment, receptions));
    }

    /// Returns the context of one direction, in which so many frames wait now.
    pub(super) fn context(
        &self,
        now: Timestamp,
        direction: Direction,
        waiting: u64,
        probed: Option<Probed>,
    ) -> LinkContext {
        let Lane { settings, meter, .. } = &self.lanes[direction as usize];
        LinkContext {
            link: self.id.clone(),
            direction,
            delay: meter.delay(now),
            throughput_bps: meter.throughput_bps(now),
            queued_packets: Some(meter.most_queued(now, waiting)),
            probed,
            tested: None,
            asked: settings.asked().clone(),
            scale: settings.scale(),
            effective: settings.effective().clone(),
            counters: meter.counters,
        }
    }
}

impl Lane {
    /// Returns the settings after a change.
    pub(super) fn changed(&self, change: &ConditionChange) -> Result<Settings, FabricError> {
        if change.rate.as_ref().is_some_and(|rate| rate.trace_name().is_some()) {
            return Err(FabricError::NotOnWireless("trace"));
        }
        self.settings.changed(change)
    }

    /// Changes the settings for frames sent from now on.
    pub(super) fn set(&mut self, settings: Settings) {
        self.impairments.change(settings.effective());
        self.settings = settings;
    }

    /// Returns the limit and the discipline of its queue.
    pub(super) fn queue(&self) -> QueueSettings {
        let Conditions { queue, queue_discipline, .. } = self.settings.effective();
        QueueSettings { limit: *queue, discipline: *queue_discipline }
    }

    pub(super) fn meter(&mut self) -> &mut Meter {
        &mut self.meter
    }

    /// Sends a frame over the air. The first attempt takes at least the frame's time at the station's rate.
    pub(super) fn exchange(&mut self, reception: &Reception, bytes: usize, contended: bool) -> Exchange {
        let mut exchange = reception.exchange(bytes, contended, || self.rng.unit());
        exchange.first = exchange.first.max(self.least_airtime(bytes));
        exchange
    }

    pub(super) fn rates(&mut self) -> &mut RateControl {
        &mut self.rates
    }

    /// Whether the conditions of emulation lose the next packet.
    pub(super) fn loses(&mut self) -> bool {
        self.impairments.loses()
    }

    /// Whether one attempt to send a frame succeeds, which fails with this probability.
    pub(super) fn receives(&mut self, error_rate: f64) -> bool {
        self.rng.unit() >= error_rate
    }

    /// Returns the airtime of a frame at the station's rate.
    pub(super) fn least_airtime(&self, bytes: usize) -> Duration {
        match &self.settings.effective().rate {
            Rate::Fixed { bits_per_second } => BitRate::serialisation(*bits_per_second, bytes),
            // Traces are rejected on wireless links.
            Rate::Unlimited | Rate::Trace { .. } | Rate::NamedTrace(_) => Duration::ZERO,
        }
    }

    /// Applies the impairments to a frame that was on the air from `start`; `None` if it is lost. `counts` says whether the
    /// counters include it.
    pub(super) fn land(
        &mut self,
        start: Timestamp,
        sent: &Exchange,
        frame: &mut Frame,
        counts: bool,
    ) -> Option<Landing> {
        if !sent.received || self.impairments.loses() {
            self.meter.counters.lost += u64::from(counts);
            return None;
        }
        let corrupted = self.impairments.corrupts(frame);
        self.meter.counters.corrupted += u64::from(corrupted && counts);
        let deviate = if self.impairments.reorders() { None } else { Some(self.impairments.deviate(start)) };
        let twice = self.impairments.duplicates();
        self.meter.counters.duplicated += u64::from(twice && counts);
        let flight = Flight { start, first: sent.first, retries: sent.retries, deviate };
        Some(Landing { due: self.line_up(&flight), flight, twice, corrupted })
    }

    /// Returns when a frame arrives. The delay includes the first attempt; retries come on top. Frames keep their order,
    /// except reordered ones.
    fn line_up(&mut self, flight: &Flight) -> Timestamp {
        let Flight { start, first, retries, deviate } = *flight;
        let Some(deviate) = deviate else { return start + first + retries };
        let Conditions { delay, jitter, .. } = self.settings.effective();
        let due = start + jittered(*delay, deviate, *jitter).max(first) + retries;
        self.last_due = self.last_due.max(due);
        self.last_due
    }

    /// Applies a shorter delay to the frames in flight, in the order of their arrival, so that later ones need not wait for
    /// them.
    pub(super) fn pull_forward<'a>(
        &mut self,
        now: Timestamp,
        under_way: impl Iterator<Item = (&'a Flight, &'a mut Timestamp)>,
    ) {
        self.last_due = now;
        for (flight, due) in under_way.filter(|(flight, _)| flight.deviate.is_some()) {
            let before = *due;
            *due = self.line_up(flight).min(before);
            self.last_due = *due;
        }
    }
}
