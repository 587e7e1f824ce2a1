//! Frequencies of channels, path loss over distance, and the mean signal at a place. The radio model and coverage decisions
//! share them, and the loss by [walls](crate::Walls).

use crate::{
    hardware::{
        Band, ChannelWidth, HardwareGraph, Node, NodeKind, PathLoss, RadioUnit, WifiStandard, WirelessNetwork,
    },
    units::{Dbm, Position},
};

impl HardwareGraph {
    /// Returns the mean signal of a radio unit at a place: without shadowing and fading, and behind walls if its network has
    /// any. `None` if the node is no radio unit, or has no position.
    pub fn mean_signal(&self, radio_unit: &Node, place: Position) -> Option<Dbm> {
        let NodeKind::RadioUnit(unit) = &radio_unit.kind else { return None };
        let (network, at) = (self.wireless.get(&unit.network)?, radio_unit.position?);
        let unobstructed = network.mean_signal(unit, at.distance(place));
        Some(Dbm(unobstructed.0 - network.wall_loss_db(at, place)))
    }
}

impl WirelessNetwork {
    /// Returns the mean signal of a radio unit of this network at a distance in metres with no walls between: transmitted
    /// power less path loss.
    pub fn mean_signal(&self, unit: &RadioUnit, distance_m: f64) -> Dbm {
        let frequency_mhz = self.standard.frequency_mhz(unit.channel);
        Dbm(unit.tx_power.0 - self.path_loss.loss_db(distance_m, frequency_mhz))
    }

    /// Returns the distance in metres up to which the mean signal of a radio unit is `signal` at least with no walls between;
    /// 0 if it is weaker everywhere.
    pub fn range_m(&self, unit: &RadioUnit, signal: Dbm) -> f64 {
        self.path_loss.range_m(unit.tx_power.0 - signal.0, self.standard.frequency_mhz(unit.channel))
    }

    /// Returns the noise of a receiver over the whole width of a channel.
    pub fn noise(&self) -> Dbm {
        match self.width {
            ChannelWidth::Mhz20 => self.noise_floor,
            wider => Dbm(self.noise_floor.0 + 10.0 * (f64::from(wider.mhz()) / 20.0).log10()),
        }
    }

    /// Returns the loss by walls between two antennas, in dB: 0 without [`Self::walls`].
    pub fn wall_loss_db(&self, a: Position, b: Position) -> f64 {
        self.walls.as_ref().map_or(0.0, |walls| walls.loss_between(a, b))
    }
}

impl WifiStandard {
    /// Returns the band of a channel.
    pub const fn band(self, channel: u8) -> Band {
        match (self, channel) {
            (Self::G, _) | (Self::N | Self::Ax, ..=14) => Band::Ghz2,
            (Self::A | Self::Ac, _) | (Self::N | Self::Ax, _) => Band::Ghz5,
        }
    }

    /// Whether frames for one receiver may be sent together (A-MPDU).
    pub const fn aggregates(self) -> bool {
        matches!(self, Self::N | Self::Ac | Self::Ax)
    }

    /// Returns the lowest and the highest frequency of a channel of some width, MHz, by its primary channel of 20 MHz.
    ///
    /// At 5 GHz, channels of 40 and 80 MHz begin at channels 36, 100 and 149, and every two or four channels from there (IEEE
    /// 802.11-2020, table E-4). At 2.4 GHz, the second half of 40 MHz lies above channels 1 to 7, and below the others.
    pub fn span_mhz(self, channel: u8, width: ChannelWidth) -> [u16; 2] {
        let (width, centre) = (width.mhz(), self.frequency_mhz(channel));
        let lowest = match (self.band(channel), channel) {
            (Band::Ghz2, ..=7) => centre - 10,
            (Band::Ghz2, _) => centre + 10 - width,
            (Band::Ghz5, _) => {
                let first = match channel {
                    ..100 => 36,
                    100..149 => 100,
                    149.. => 149,
                };
                centre - 10 - 5 * u16::from(channel.saturating_sub(first)) % width
            }
        };
        [lowest, lowest + width]
    }

    /// Returns the centre frequency of a 20 MHz channel, in MHz: 2407 + 5·n at 2.4 GHz, where channel 14 lies apart at 2484
    /// (IEEE 802.11-2020, 15.4.4.3), and 5000 + 5·n at 5 GHz (17.3.8.4.2).
    pub fn frequency_mhz(self, channel: u8) -> u16 {
        match (self.band(channel), channel) {
            (Band::Ghz5, n) => 5000 + 5 * u16::from(n),
            (Band::Ghz2, 14) => 2484,
            (Band::Ghz2, n) => 2407 + 5 * u16::from(n),
        }
    }
}

impl PathLoss {
    /// Nearer than this, antennas are no longer points: distances are clamped to it, in metres.
    const NEAREST_M: f64 = 0.1;
    /// The greatest range, in metres.
    const FARTHEST_M: f64 = 1e7;

    /// Loss between isotropic antennas, in dB; a pure function, so that what is heard at a place depends on that place
    /// alone.
    ///
    /// - Free space: 20 log d + 20 log f - 27.55 (ITU-R P.525-4, equation 4, in metres and MHz).
    /// - Log-distance: free space up to 1 m, 10·n·log d more beyond it (Rappaport, Wireless Communications, 4.9).
    /// - ITU indoor: 20 log f + N log d + L_f - 28 (ITU-R P.1238-9, equation 1). The recommendation begins at 1 m;
    ///   nearer, the loss follows the free-space slope of 20 dB a decade.
    pub fn loss_db(self, distance_m: f64, frequency_mhz: u16) -> f64 {
        let log_d = distance_m.max(Self::NEAREST_M).log10();
        let log_f = f64::from(frequency_mhz).log10();
        // dB a decade, beyond the reference distance of 1 m at which log d is 0.
        let falling_by = |slope: f64| if log_d > 0.0 { slope * log_d } else { 20.0 * log_d };
        match self {
            Self::FreeSpace => 20.0 * log_d + 20.0 * log_f - 27.55,
            Self::LogDistance { exponent } => falling_by(10.0 * exponent) + 20.0 * log_f - 27.55,
            Self::ItuIndoor { coefficient, floor_loss_db } => {
                falling_by(coefficient) + 20.0 * log_f + floor_loss_db - 28.0
            }
        }
    }

    /// Returns the distance in metres up to which the loss is `loss_db` at most, to a part in 10⁹; 0 if it is more
    /// everywhere, and [`Self::FARTHEST_M`] at most.
    fn range_m(self, loss_db: f64, frequency_mhz: u16) -> f64 {
        let is_within = |distance_m: f64| self.loss_db(distance_m, frequency_mhz) <= loss_db;
        if !is_within(Self::NEAREST_M) {
            return 0.0;
        }
        // The loss rises with the distance, so that halving the interval finds the end.
        let (mut near, mut far) = (Self::NEAREST_M, Self::FARTHEST_M);
        while far - near > near * 1e-9 {
            let middle = (near * far).sqrt();
            if is_within(middle) {
                near = middle;
            } else {
                far = middle;
            }
        }
        far
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_lie_where_the_standard_puts_them() {
        use WifiStandard::{A, Ac, G, N};
        let table = [
            (G, 1, 2412),
            (N, 6, 2437),
            (G, 13, 2472),
            (N, 14, 2484),
            (A, 36, 5180),
            (Ac, 165, 5825),
            (N, 36, 5180),
        ];
        for (standard, channel, mhz) in table {
            assert_eq!(standard.frequency_mhz(channel), mhz);
        }
    }

    #[test]
    fn wide_channels_lie_where_the_standard_puts_them() {
        use ChannelWidth::{Mhz20, Mhz40, Mhz80};
        use WifiStandard::{Ac, Ax, N};
        let table = [
            (Ac, 36, Mhz80, [5170, 5250]),
            (Ac, 48, Mhz80, [5170, 5250]),
            (Ax, 52, Mhz80, [5250, 5330]),
            (Ac, 100, Mhz80, [5490, 5570]),
            (Ac, 144, Mhz80, [5650, 5730]),
            (Ax, 149, Mhz80, [5735, 5815]),
            (N, 157, Mhz40, [5775, 5815]),
            (N, 161, Mhz40, [5775, 5815]),
            (N, 161, Mhz20, [5795, 5815]),
            (N, 1, Mhz40, [2402, 2442]),
            (Ax, 8, Mhz40, [2417, 2457]),
            (Ax, 13, Mhz40, [2442, 2482]),
            (Ax, 13, Mhz20, [2462, 2482]),
        ];
        for (standard, channel, width, span) in table {
            assert_eq!(standard.span_mhz(channel, width), span, "{standard:?} {channel} {width:?}");
        }
    }

    #[test]
    fn path_losses_match_the_golden_table() {
        let corridor = PathLoss::LogDistance { exponent: 1.8 };
        let offices = PathLoss::ItuIndoor { coefficient: 30.0, floor_loss_db: 0.0 };
        let upstairs = PathLoss::ItuIndoor { coefficient: 30.0, floor_loss_db: 15.0 };
        // Model, metres, MHz, dB; worked out by hand from the formulas.
        let golden = [
            (PathLoss::FreeSpace, 0.0, 2412, 20.10), // clamped to 0.1 m
            (PathLoss::FreeSpace, 0.1, 2412, 20.10),
            (PathLoss::FreeSpace, 1.0, 2412, 40.10),
            (PathLoss::FreeSpace, 10.0, 2437, 60.19),
            (PathLoss::FreeSpace, 100.0, 5180, 86.74),
            (corridor, 0.5, 2412, 34.08),
            (corridor, 1.0, 2412, 40.10),
            (corridor, 10.0, 2412, 58.10),
            (corridor, 30.0, 5180, 73.32),
            (offices, 1.0, 2412, 39.65),
            (offices, 10.0, 2412, 69.65),
            (offices, 50.0, 5180, 97.25),
            (upstairs, 10.0, 2412, 84.65),
        ];
        for (model, metres, mhz, expected) in golden {
            let loss = model.loss_db(metres, mhz);
            assert!((loss - expected).abs() < 0.01, "{model:?} at {metres} m: {loss:.3}, not {expected}");
        }
    }

    #[test]
    fn at_its_range_a_loss_is_reached() {
        for model in [
            PathLoss::FreeSpace,
            PathLoss::LogDistance { exponent: 1.8 },
            PathLoss::ItuIndoor { coefficient: 30.0, floor_loss_db: 15.0 },
        ] {
            for loss_db in [45.0, 60.5, 93.0] {
                let range = model.range_m(loss_db, 2437);
                let is = model.loss_db(range, 2437);
                assert!((is - loss_db).abs() < 1e-6, "{model:?}: {is} dB at {range} m, not {loss_db}");
            }
            assert_eq!(model.range_m(-10.0, 2437), 0.0);
            assert!((model.range_m(1e6, 2437) / PathLoss::FARTHEST_M - 1.0).abs() < 1e-8);
        }
    }

    #[test]
    fn signal_never_rises_with_distance() {
        for model in [
            PathLoss::FreeSpace,
            PathLoss::LogDistance { exponent: 3.0 },
            PathLoss::ItuIndoor { coefficient: 22.0, floor_loss_db: 0.0 },
        ] {
            let losses: Vec<_> = (0..1000).map(|i| model.loss_db(f64::from(i) * 0.1, 2437)).collect();
            assert!(losses.is_sorted(), "{model:?}");
        }
    }
}
