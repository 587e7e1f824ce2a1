//! Channels at 2.4 and 5 GHz.

use serde::{Deserialize, Serialize};

/// A frequency band.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Band {
    /// 2.4 GHz.
    Ghz2,
    /// 5 GHz.
    Ghz5,
}

/// The width of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Width {
    /// 20 MHz.
    Mhz20,
    /// 40 MHz.
    Mhz40,
    /// 80 MHz.
    Mhz80,
    /// 160 MHz.
    Mhz160,
}

impl Width {
    /// Returns the width in MHz.
    pub fn mhz(self) -> u16 {
        match self {
            Self::Mhz20 => 20,
            Self::Mhz40 => 40,
            Self::Mhz80 => 80,
            Self::Mhz160 => 160,
        }
    }
}

/// A channel of IEEE 802.11 with its width: 1 to 13 at 2.4 GHz, and 36 to 165 at 5 GHz. Channel 14, which only carries
/// 802.11b, and 6 GHz are left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Channel {
    band: Band,
    number: u8,
    width: Width,
}

/// A channel that does not exist.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ChannelError {
    /// No channel of the band has this number.
    #[error("there is no channel {number} at {}", .band.name())]
    Number {
        /// The band.
        band: Band,
        /// The number.
        number: u8,
    },
    /// No channel has this centre, in MHz.
    #[error("no channel at 2.4 or 5 GHz has its centre at {0} MHz")]
    Frequency(u32),
    /// The channel is not part of a wider one.
    #[error("channel {number} cannot be {} MHz wide", .width.mhz())]
    Width {
        /// The number.
        number: u8,
        /// The width.
        width: Width,
    },
}

impl Band {
    fn name(self) -> &'static str {
        match self {
            Self::Ghz2 => "2.4 GHz",
            Self::Ghz5 => "5 GHz",
        }
    }
}

/// Channels at 5 GHz that can be combined: first and last number of each block.
const BLOCKS: [(u8, u8); 4] = [(36, 64), (100, 128), (132, 144), (149, 161)];

impl Channel {
    /// Returns a channel by the number of its first 20 MHz, the primary channel.
    ///
    /// # Errors
    /// [`ChannelError`] if there is none.
    pub fn new(band: Band, number: u8, width: Width) -> Result<Self, ChannelError> {
        let exists = match band {
            Band::Ghz2 => matches!(number, 1..=13),
            Band::Ghz5 => number == 165 || block(number).is_some(),
        };
        if !exists {
            return Err(ChannelError::Number { band, number });
        }
        let channel = Self { band, number, width };
        let fits = match (band, width) {
            (_, Width::Mhz20) => true,
            (Band::Ghz2, width) => width == Width::Mhz40,
            (Band::Ghz5, width) => {
                let (first, last) = channel.span();
                block(number).is_some_and(|(start, end)| start <= first && last <= end) && {
                    // The only channels of 160 MHz are the first two blocks.
                    width != Width::Mhz160 || number <= 128
                }
            }
        };
        if fits { Ok(channel) } else { Err(ChannelError::Width { number, width }) }
    }

    /// Returns a channel by the centre of its primary channel.
    ///
    /// # Errors
    /// [`ChannelError`] if there is none.
    pub fn at_frequency(mhz: u32, width: Width) -> Result<Self, ChannelError> {
        let (band, number) = match mhz {
            2412..=2472 => (Band::Ghz2, (mhz - 2407) / 5),
            5180..=5825 => (Band::Ghz5, (mhz - 5000) / 5),
            _ => return Err(ChannelError::Frequency(mhz)),
        };
        let number = u8::try_from(number).map_err(|_| ChannelError::Frequency(mhz))?;
        let channel = Self::new(band, number, width)?;
        if channel.frequency_mhz() == mhz { Ok(channel) } else { Err(ChannelError::Frequency(mhz)) }
    }

    /// Returns the band.
    pub fn band(self) -> Band {
        self.band
    }

    /// Returns the number of the primary channel.
    pub fn number(self) -> u8 {
        self.number
    }

    /// Returns the width.
    pub fn width(self) -> Width {
        self.width
    }

    /// Returns the centre of the primary channel, in MHz.
    pub fn frequency_mhz(self) -> u32 {
        frequency_mhz(self.band, self.number)
    }

    /// Returns the centre of the whole channel, in MHz.
    pub fn center_mhz(self) -> u32 {
        frequency_mhz(self.band, self.center())
    }

    /// Returns the number of the centre of the whole channel.
    pub(crate) fn center(self) -> u8 {
        let (first, last) = self.span();
        first.midpoint(last)
    }

    /// Returns the side on which the second 20 MHz are: 1 above, -1 below, or 0 if there are none.
    pub(crate) fn secondary(self) -> i8 {
        match (self.band, self.width) {
            (_, Width::Mhz20) => 0,
            (Band::Ghz2, _) if self.number > 7 => -1,
            (Band::Ghz5, _) if self.span().0 % 8 != self.number % 8 => -1,
            _ => 1,
        }
    }

    /// Whether weather radars use it, so that an access point has to listen before it sends and to move away when it hears one.
    pub fn has_radar(self) -> bool {
        let (first, last) = self.span();
        self.band == Band::Ghz5 && first <= 144 && last >= 52
    }

    /// Returns the global operating class (IEEE 802.11-2020, table E-4).
    pub(crate) fn operating_class(self) -> u8 {
        let group = match (self.band, self.number) {
            (Band::Ghz2, _) => 81,
            (Band::Ghz5, ..=48) => 115,
            (Band::Ghz5, ..=64) => 118,
            (Band::Ghz5, ..=144) => 121,
            // Channel 165 has no class of its own: it is in that of 149 to 161.
            (Band::Ghz5, _) => return [125, 126, 127, 128, 129][self.step()],
        };
        match self.step() {
            0 => group,
            step @ 1..=2 if self.band == Band::Ghz2 => group + 1 + step as u8,
            step @ 1..=2 => group + step as u8,
            step => 125 + step as u8,
        }
    }

    /// Returns 0 for 20 MHz, 1 and 2 for 40 MHz with the second half above and below, 3 for 80 MHz and 4 for 160 MHz.
    fn step(self) -> usize {
        match self.width {
            Width::Mhz20 => 0,
            Width::Mhz40 => 1 + usize::from(self.secondary() < 0),
            Width::Mhz80 => 3,
            Width::Mhz160 => 4,
        }
    }

    /// Returns the first and the last of its channels of 20 MHz.
    fn span(self) -> (u8, u8) {
        let (number, last) = (self.number, |first: u8, count: u8| first + 4 * (count - 1));
        let count = (self.width.mhz() / 20) as u8;
        match (self.band, self.width, block(number)) {
            (Band::Ghz2, Width::Mhz40, _) if number > 7 => (number - 4, number),
            (Band::Ghz5, width, Some((start, _))) if width > Width::Mhz20 => {
                let first = number - (number - start) % (4 * count);
                (first, last(first, count))
            }
            _ => (number, last(number, count)),
        }
    }

    /// Returns the parameters of a `CHAN_SWITCH` to it.
    pub(crate) fn switch_parameters(self) -> String {
        let mut text = self.frequency_mhz().to_string();
        if self.width > Width::Mhz20 {
            text += &format!(" sec_channel_offset={}", self.secondary());
            text += &format!(" center_freq1={}", self.center_mhz());
        }
        text += &format!(" bandwidth={} ht", self.width.mhz());
        if self.band == Band::Ghz5 {
            text += " vht";
        }
        text
    }
}

/// Returns the block of a number at 5 GHz.
fn block(number: u8) -> Option<(u8, u8)> {
    let is_in =
        |&(start, end): &(u8, u8)| (start..=end).contains(&number) && (number - start).is_multiple_of(4);
    BLOCKS.into_iter().find(is_in)
}

fn frequency_mhz(band: Band, number: u8) -> u32 {
    match band {
        Band::Ghz2 => 2407 + 5 * u32::from(number),
        Band::Ghz5 => 5000 + 5 * u32::from(number),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn channel(band: Band, number: u8, width: Width) -> Channel {
        Channel::new(band, number, width).expect("a channel")
    }

    // Centres and classes of IEEE 802.11-2020, table E-4.
    #[test]
    fn centres_and_operating_classes_are_those_of_the_standard() {
        use Width::{Mhz20, Mhz40, Mhz80, Mhz160};
        for (number, width, secondary, center, class) in [
            (36, Mhz20, 0, 36, 115),
            (36, Mhz40, 1, 38, 116),
            (40, Mhz40, -1, 38, 117),
            (44, Mhz80, 1, 42, 128),
            (48, Mhz80, -1, 42, 128),
            (52, Mhz160, 1, 50, 129),
            (56, Mhz20, 0, 56, 118),
            (60, Mhz40, 1, 62, 119),
            (64, Mhz40, -1, 62, 120),
            (100, Mhz20, 0, 100, 121),
            (116, Mhz80, 1, 122, 128),
            (120, Mhz160, -1, 114, 129),
            (132, Mhz40, 1, 134, 122),
            (144, Mhz80, -1, 138, 128),
            (149, Mhz20, 0, 149, 125),
            (153, Mhz40, -1, 151, 127),
            (157, Mhz40, 1, 159, 126),
            (161, Mhz80, -1, 155, 128),
            (165, Mhz20, 0, 165, 125),
        ] {
            let channel = channel(Band::Ghz5, number, width);
            let found = (channel.secondary(), channel.center(), channel.operating_class());
            assert_eq!(found, (secondary, center, class), "{channel:?}");
        }
        for (number, width, secondary, center, class) in [
            (1, Mhz20, 0, 1, 81),
            (1, Mhz40, 1, 3, 83),
            (7, Mhz40, 1, 9, 83),
            (8, Mhz40, -1, 6, 84),
            (13, Mhz40, -1, 11, 84),
        ] {
            let channel = channel(Band::Ghz2, number, width);
            let found = (channel.secondary(), channel.center(), channel.operating_class());
            assert_eq!(found, (secondary, center, class), "{channel:?}");
        }
    }

    #[test]
    fn channels_that_do_not_exist_are_rejected() {
        let new = Channel::new;
        for number in [0, 14, 36] {
            assert_eq!(
                new(Band::Ghz2, number, Width::Mhz20),
                Err(ChannelError::Number { band: Band::Ghz2, number })
            );
        }
        for number in [1, 37, 68, 96, 148, 169] {
            assert_eq!(
                new(Band::Ghz5, number, Width::Mhz20),
                Err(ChannelError::Number { band: Band::Ghz5, number })
            );
        }
        for (number, width) in [(165, Width::Mhz40), (132, Width::Mhz160), (149, Width::Mhz160)] {
            assert_eq!(new(Band::Ghz5, number, width), Err(ChannelError::Width { number, width }));
        }
        assert_eq!(
            new(Band::Ghz2, 6, Width::Mhz80),
            Err(ChannelError::Width { number: 6, width: Width::Mhz80 })
        );
    }

    #[test]
    fn channels_of_radars_are_known() {
        let has_radar = |number, width| channel(Band::Ghz5, number, width).has_radar();
        assert!(!has_radar(48, Width::Mhz80));
        assert!(has_radar(48, Width::Mhz160));
        assert!(has_radar(52, Width::Mhz20));
        assert!(has_radar(144, Width::Mhz20));
        assert!(!has_radar(149, Width::Mhz80));
    }

    #[test]
    fn switch_parameters_name_the_whole_channel() {
        assert_eq!(channel(Band::Ghz2, 6, Width::Mhz20).switch_parameters(), "2437 bandwidth=20 ht");
        assert_eq!(
            channel(Band::Ghz5, 40, Width::Mhz80).switch_parameters(),
            "5200 sec_channel_offset=-1 center_freq1=5210 bandwidth=80 ht vht"
        );
    }

    proptest! {
        #[test]
        fn each_channel_is_found_by_its_frequency(number: u8, ghz5: bool, width in 0..4_usize) {
            let band = if ghz5 { Band::Ghz5 } else { Band::Ghz2 };
            let width = [Width::Mhz20, Width::Mhz40, Width::Mhz80, Width::Mhz160][width];
            if let Ok(channel) = Channel::new(band, number, width) {
                prop_assert_eq!(Channel::at_frequency(channel.frequency_mhz(), width), Ok(channel));
                let apart = channel.center_mhz().abs_diff(channel.frequency_mhz());
                prop_assert!(apart < u32::from(width.mhz()) / 2);
            }
        }

        #[test]
        fn a_frequency_is_a_channel_or_an_error(mhz: u32) {
            if let Ok(channel) = Channel::at_frequency(mhz, Width::Mhz20) {
                prop_assert_eq!(channel.frequency_mhz(), mhz);
            }
        }
    }
}
