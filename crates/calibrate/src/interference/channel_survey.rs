//! Counters of a channel's busy time: repeated output of `iw dev … survey dump`, or CSV.

use std::collections::BTreeMap;

use cotorra_graph::WifiStandard;

use crate::{
    csv::{Table, check_length},
    error::CalibrateError,
};

/// Beginning of each channel in the output of `iw`.
const BEGIN: &str = "Survey data from ";
/// Greatest counter, ms: some thousand years.
const MOST_MS: f64 = 1e14;

/// A channel, as measurements name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum MeasuredChannel {
    /// By its number.
    Number(u8),
    /// By its centre frequency, MHz.
    Frequency(u16),
}

impl MeasuredChannel {
    /// Whether it is a channel of a standard.
    pub(super) fn is(self, standard: WifiStandard, channel: u8) -> bool {
        match self {
            Self::Number(number) => number == channel,
            Self::Frequency(mhz) => mhz == standard.frequency_mhz(channel),
        }
    }
}

impl std::fmt::Display for MeasuredChannel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "channel {number}"),
            Self::Frequency(mhz) => write!(f, "{mhz} MHz"),
        }
    }
}

/// Counters at one time, ms since any start.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Counters {
    /// Time on the channel.
    pub active: f64,
    /// Time for which the channel was busy, transmissions of its own included.
    pub busy: f64,
    /// Time of its own transmissions; `None` if they were not counted.
    pub transmit: Option<f64>,
    /// Time of frames of its own stations; `None` if they were not counted.
    pub own_receive: Option<f64>,
}

/// Counters of each channel, in order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ChannelSurvey(pub BTreeMap<MeasuredChannel, Vec<Counters>>);

/// Reads a channel survey: outputs of `iw dev … survey dump` one after another, or CSV with the columns `channel`, `active_ms`
/// and `busy_ms`, and `tx_ms` and `own_rx_ms` if they are known. Counters add up, and lines between outputs, such as those of
/// `date`, are skipped.
///
/// # Errors
/// [`CalibrateError::Line`] with the first line that is wrong, or [`CalibrateError::Unreadable`].
pub fn parse_channel_survey(text: &str) -> Result<ChannelSurvey, CalibrateError> {
    check_length(text)?;
    let survey = if text.contains(BEGIN) { parse_dumps(text)? } else { parse_csv(text)? };
    match survey.0.is_empty() {
        true => Err(CalibrateError::Unreadable(
            "no channel has both an active and a busy time: the driver does not count them".to_owned(),
        )),
        false => Ok(survey),
    }
}

fn parse_csv(text: &str) -> Result<ChannelSurvey, CalibrateError> {
    const USUAL: &str = "time_s,channel,active_ms,busy_ms,tx_ms,own_rx_ms";
    let table = Table::new(text)?;
    let [channel, active, busy] = ["channel", "active_ms", "busy_ms"].map(|name| table.required(name, USUAL));
    let (channel, active, busy) = (channel?, active?, busy?);
    let [transmit, own_receive] = ["tx_ms", "own_rx_ms"].map(|name| table.column(name));
    let mut survey = ChannelSurvey::default();
    for row in table.rows() {
        let row = row?;
        let ms = |column: usize| row.number(column, [0.0, MOST_MS]);
        let number = row.text(channel).parse().map_err(|_| {
            CalibrateError::line(
                row.line,
                format!("`{:.40}` is not the number of a channel", row.text(channel)),
            )
        })?;
        let counters = Counters {
            active: ms(active)?,
            busy: ms(busy)?,
            transmit: transmit.map(ms).transpose()?,
            own_receive: own_receive.map(ms).transpose()?,
        };
        survey.0.entry(MeasuredChannel::Number(number)).or_default().push(counters);
    }
    Ok(survey)
}

/// The readings of a channel so far.
#[derive(Default)]
struct Block {
    frequency: Option<u16>,
    active: Option<f64>,
    busy: Option<f64>,
    transmit: Option<f64>,
    own_receive: Option<f64>,
}

impl Block {
    fn end(&mut self, survey: &mut ChannelSurvey) {
        let Self { frequency, active, busy, transmit, own_receive } = std::mem::take(self);
        if let (Some(mhz), Some(active), Some(busy)) = (frequency, active, busy) {
            let counters = Counters { active, busy, transmit, own_receive };
            survey.0.entry(MeasuredChannel::Frequency(mhz)).or_default().push(counters);
        }
    }
}

fn parse_dumps(text: &str) -> Result<ChannelSurvey, CalibrateError> {
    let (mut survey, mut block) = (ChannelSurvey::default(), Block::default());
    let mut interface = None;
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if let Some(name) = line.strip_prefix(BEGIN) {
            block.end(&mut survey);
            if *interface.get_or_insert(name) != name {
                let reason = "it has surveys of two interfaces: write each into a file of its own";
                return Err(CalibrateError::line(i + 1, reason));
            }
            continue;
        }
        let Some((key, value)) = line.split_once(':') else { continue };
        let number = || {
            let number = value.split_whitespace().next().and_then(|word| word.parse::<f64>().ok());
            number.filter(|number| (0.0..=MOST_MS).contains(number)).ok_or_else(|| {
                CalibrateError::line(i + 1, format!("`{key}` has no number, as in `{key}: 100 ms`"))
            })
        };
        match key {
            "frequency" => block.frequency = Some(number()? as u16),
            "channel active time" => block.active = Some(number()?),
            "channel busy time" => block.busy = Some(number()?),
            "channel transmit time" => block.transmit = Some(number()?),
            "channel BSS receive time" => block.own_receive = Some(number()?),
            _ => {}
        }
    }
    block.end(&mut survey);
    Ok(survey)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_of_iw_are_read_one_after_another() {
        let text = "1700000000.5
Survey data from wlan0
\tfrequency:\t\t\t2412 MHz [in use]
\tnoise:\t\t\t\t-92 dBm
\tchannel active time:\t\t1000 ms
\tchannel busy time:\t\t300 ms
\tchannel receive time:\t\t200 ms
\tchannel BSS receive time:\t50 ms
\tchannel transmit time:\t\t20 ms
Survey data from wlan0
\tfrequency:\t\t\t2437 MHz
1700000001.5
Survey data from wlan0
\tfrequency:\t\t\t2412 MHz [in use]
\tchannel active time:\t\t2000 ms
\tchannel busy time:\t\t700 ms
";
        let survey = parse_channel_survey(text).unwrap();
        let first = Counters { active: 1000.0, busy: 300.0, transmit: Some(20.0), own_receive: Some(50.0) };
        let second = Counters { active: 2000.0, busy: 700.0, transmit: None, own_receive: None };
        assert_eq!(survey.0, BTreeMap::from([(MeasuredChannel::Frequency(2412), vec![first, second])]));
        assert!(MeasuredChannel::Frequency(2412).is(WifiStandard::N, 1));
    }

    #[test]
    fn tables_have_their_columns_in_any_order() {
        let survey = parse_channel_survey("busy_ms,channel,active_ms\n30,6,100\n60,6,200\n").unwrap();
        let counters = survey.0[&MeasuredChannel::Number(6)].as_slice();
        assert_eq!(counters[1], Counters { active: 200.0, busy: 60.0, ..Counters::default() });
    }

    #[test]
    fn wrong_channel_surveys_are_rejected_in_place() {
        for (text, expected) in [
            ("", "the file is empty: it needs a header"),
            ("channel,active_ms,busy_ms\nx,1,1\n", "line 2: `x` is not the number of a channel"),
            ("channel,active_ms,busy_ms\n1,-1,1\n", "line 2: `-1` is not a number from 0 to 100000000000000"),
            (
                "Survey data from a\nfrequency: fast\n",
                "line 2: `frequency` has no number, as in `frequency: 100 ms`",
            ),
            (
                "Survey data from a\nSurvey data from b\n",
                "line 2: it has surveys of two interfaces: write each into a file of its own",
            ),
            (
                "Survey data from a\nfrequency: 2412 MHz\n",
                "no channel has both an active and a busy time: the driver does not count them",
            ),
        ] {
            assert_eq!(parse_channel_survey(text).unwrap_err().to_string(), expected);
        }
    }
}
