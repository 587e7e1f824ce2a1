//! A calibration as a whole: what is fitted, its tests, and the settings of the testbed that follow.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Direction, Link, Rate, Scale, Testbed};
use serde::Serialize;

use crate::{
    compare::{Comparison, compare},
    error::CalibrateError,
    handovers::{HandoverFit, fit_handovers},
    interference::{self, ChannelSurvey, InterferenceFit, fit_interference},
    path::{PathFit, fit_path},
    recorded::HandoverTime,
    settings::{FittedSetting, of_handovers, of_network, of_round_trips, of_way},
    survey::{
        FadingFit, Reading, SurveyComparison, SurveyFit, by_network, compare_survey, fit_fading, fit_network,
        split_survey,
    },
    times::{Means, OneWay, PacketTimes},
};

/// Measurements of a site.
#[derive(Debug, Clone, Default)]
pub struct Measurements {
    /// Readings of a signal survey.
    pub survey: Vec<Reading>,
    /// Packets over wired links, by the link's name.
    pub links: BTreeMap<String, LinkMeasurement>,
    /// Times of handovers.
    pub handovers: Vec<HandoverTime>,
    /// Busy times of channels, by the name of the radio unit that measured its own.
    pub channels: BTreeMap<String, ChannelSurvey>,
}

/// Packets over a wired link.
#[derive(Debug, Clone, PartialEq)]
pub enum LinkMeasurement {
    /// Their round trips.
    RoundTrips(PacketTimes),
    /// Their times in each direction.
    OneWay(OneWay),
}

/// Options of a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Target of round trips; the share above it is compared. One-way times have none.
    pub target: Option<Duration>,
    /// Share of packets, and of a survey's readings, that are fitted, from the start; the others test the fit.
    pub fitted_share: f64,
    /// Whether a survey's readings are of single frames, so that fading is fitted.
    pub fading: bool,
    /// Seed of draws and resamples.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { target: None, fitted_share: 0.6, fading: false, seed: 1 }
    }
}

/// The radio of a wireless network, fitted and tested.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NetworkCalibration {
    /// The fit.
    pub fit: SurveyFit,
    /// The fading; `None` if it was not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fading: Option<FadingFit>,
    /// The test.
    pub comparison: SurveyComparison,
}

/// A wired link, fitted and tested.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
#[expect(clippy::large_enum_variant, reason = "there is one for each link")]
pub enum LinkCalibration {
    /// By round trips.
    RoundTrips(PathCalibration),
    /// By one-way times.
    OneWay {
        /// The forward direction; `None` if it was not measured.
        forward: Option<PathCalibration>,
        /// The backward direction; `None` if it was not measured.
        backward: Option<PathCalibration>,
        /// The evidence on the mean delays.
        means: Means,
        /// Notes on both directions, for people.
        notes: Vec<String>,
    },
}

impl LinkCalibration {
    /// Returns the paths that were fitted, each with its name: `round trips`, `forward` or `backward`.
    pub fn paths(&self) -> impl Iterator<Item = (&'static str, &PathCalibration)> {
        let paths = match self {
            Self::RoundTrips(path) => [Some(("round trips", path)), None],
            Self::OneWay { forward, backward, .. } => [
                forward.as_ref().map(|path| ("forward", path)),
                backward.as_ref().map(|path| ("backward", path)),
            ],
        };
        paths.into_iter().flatten()
    }

    /// Whether the means are those of the site, rather than beyond an unknown one.
    pub fn mean_is_known(&self) -> bool {
        !matches!(self, Self::OneWay { means: Means::Unknown, .. })
    }

    /// Returns what to know about the measurement as a whole.
    pub fn notes(&self) -> &[String] {
        match self {
            Self::RoundTrips(_) => &[],
            Self::OneWay { notes, .. } => notes,
        }
    }
}

/// A path, fitted and tested.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PathCalibration {
    /// The fit.
    pub fit: PathFit,
    /// The test.
    pub comparison: Comparison,
}

/// Everything that was fitted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Calibration {
    /// Name of the testbed.
    pub testbed: String,
    /// Seed of draws and resamples.
    pub seed: u64,
    /// Wireless networks by SSID.
    pub networks: BTreeMap<String, NetworkCalibration>,
    /// Handovers of wireless networks, by SSID.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub handovers: BTreeMap<String, HandoverFit>,
    /// Interference by the name of the radio unit that measured its channel.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub interference: BTreeMap<String, InterferenceFit>,
    /// Links by name.
    pub links: BTreeMap<String, LinkCalibration>,
    /// Settings that put the fitted values into the testbed file, in order.
    pub settings: Vec<FittedSetting>,
}

impl Calibration {
    /// Fits a testbed to measurements.
    ///
    /// # Errors
    /// [`CalibrateError`] with what is missing, or what does not fit the testbed. The first error ends the calibration.
    pub fn new(
        testbed: &Testbed,
        measurements: &Measurements,
        options: Options,
    ) -> Result<Self, CalibrateError> {
        let Measurements { survey, links: measured, handovers, channels } = measurements;
        if survey.is_empty() && measured.is_empty() && handovers.is_empty() && channels.is_empty() {
            return Err(CalibrateError::too_little("there are no measurements to fit"));
        }
        let networks = calibrate_networks(testbed, survey, options)?;
        let mut settings: Vec<FittedSetting> = networks
            .iter()
            .flat_map(|(name, network)| of_network(testbed, name, &network.fit, network.fading.as_ref()))
            .collect();
        let handovers = fit_handovers(testbed, handovers, options.seed)?;
        settings.extend(handovers.iter().flat_map(|(name, fit)| of_handovers(testbed, name, fit)));
        let interference = fit_channels(testbed, channels, options.seed)?;
        settings
            .extend(interference.iter().flat_map(|(name, fit)| interference::settings(testbed, name, fit)));
        let mut links = BTreeMap::new();
        for (name, measured) in measured {
            let link = link(testbed, name)?;
            let calibrated = calibrate_link(link, measured, options);
            let (calibrated, of_link) = calibrated.map_err(|error| CalibrateError::of_link(name, error))?;
            settings.extend(of_link);
            links.insert(name.clone(), calibrated);
        }
        let (testbed, seed) = (testbed.name.clone(), options.seed);
        Ok(Self { testbed, seed, networks, handovers, interference, links, settings })
    }
}

fn calibrate_networks(
    testbed: &Testbed,
    survey: &[Reading],
    Options { fitted_share, fading, seed, .. }: Options,
) -> Result<BTreeMap<String, NetworkCalibration>, CalibrateError> {
    let calibrate = |(name, readings): (String, Vec<Reading>)| {
        let [fitted, test] = split_survey(&readings, fitted_share);
        let fit = fit_network(testbed, &name, &fitted, seed)
            .map_err(|error| CalibrateError::of_survey_part(fitted_share, error))?;
        let comparison = compare_survey(testbed, &name, &fit, &fitted, &test, seed)?;
        let fading = fading.then(|| fit_fading(testbed, &name, &fit, &fitted, seed)).transpose()?;
        Ok((name, NetworkCalibration { fit, fading, comparison }))
    };
    by_network(testbed, survey)?.into_iter().map(calibrate).collect()
}

/// Fits the interference on each channel, which one radio unit of its network measured.
fn fit_channels(
    testbed: &Testbed,
    channels: &BTreeMap<String, ChannelSurvey>,
    seed: u64,
) -> Result<BTreeMap<String, InterferenceFit>, CalibrateError> {
    let mut fits: BTreeMap<String, InterferenceFit> = BTreeMap::new();
    for (name, survey) in channels {
        let fit = fit_interference(testbed, name, survey, seed)?;
        let same = |other: &InterferenceFit| (&other.network, other.channel) == (&fit.network, fit.channel);
        if let Some((other, _)) = fits.iter().find(|(_, other)| same(other)) {
            return Err(CalibrateError::unsuited(format!(
                "radio units `{other}` and `{name}` are both on channel {}, where they hear the same: give the channel survey of \
                 one of them",
                fit.channel
            )));
        }
        fits.insert(name.clone(), fit);
    }
    Ok(fits)
}

fn calibrate_link(
    link: &Link,
    measured: &LinkMeasurement,
    options: Options,
) -> Result<(LinkCalibration, Vec<FittedSetting>), CalibrateError> {
    match measured {
        LinkMeasurement::RoundTrips(trips) => {
            let path = calibrate_path(trips, options)?;
            let settings = of_round_trips(link, &path.fit, sending(link, trips.frame_bytes))?;
            Ok((LinkCalibration::RoundTrips(path), settings))
        }
        LinkMeasurement::OneWay(OneWay { ways, means, notes }) => {
            let options = Options { target: None, ..options };
            let path = |way: &PacketTimes| calibrate_path(way, options);
            let [forward, backward] = ways.each_ref().map(|way| way.as_ref().map(path).transpose());
            let (forward, backward) = (forward?, backward?);
            let mut settings = Vec::new();
            for (i, direction) in [Direction::Forward, Direction::Backward].into_iter().enumerate() {
                if let (Some(path), Some(way)) = ([&forward, &backward][i], &ways[i]) {
                    let sending_ms = sending(link, way.frame_bytes)[i];
                    settings.extend(of_way(link, direction, &path.fit, *means, sending_ms)?);
                }
            }
            let (means, notes) = (*means, notes.clone());
            Ok((LinkCalibration::OneWay { forward, backward, means, notes }, settings))
        }
    }
}

fn calibrate_path(times: &PacketTimes, options: Options) -> Result<PathCalibration, CalibrateError> {
    let [fitted, test] = times.split(options.fitted_share);
    let fit = fit_path(&fitted, options.seed)?;
    let comparison = compare(&fit, &fitted, &test, options.target, options.seed)?;
    Ok(PathCalibration { fit, comparison })
}

fn link<'a>(testbed: &'a Testbed, name: &str) -> Result<&'a Link, CalibrateError> {
    let found = testbed.graph.links.iter().find(|link| link.id.as_str() == name);
    let link = found.ok_or_else(|| {
        let all: Vec<_> = testbed.graph.links.iter().map(|link| link.id.as_str()).collect();
        CalibrateError::unsuited(format!(
            "the testbed has no wired link `{name}`; its links are: {}",
            all.join(", ")
        ))
    })?;
    match link.scales == [Scale::default(); 2] {
        true => Ok(link),
        false => Err(CalibrateError::unsuited(format!(
            "link `{name}` has scales, which would change what is fitted: set its delay_scale and drop_scale to 1"
        ))),
    }
}

/// Returns the times that a frame takes to be sent forward, and its answer backward, ms. A trace counts as no time.
fn sending(link: &Link, [frame, answer]: [usize; 2]) -> [f64; 2] {
    [(&link.forward, frame), (&link.backward, answer)].map(|(conditions, bytes)| match &conditions.rate {
        Rate::Fixed { bits_per_second } => bytes as f64 * 8e3 / bits_per_second.bits_per_second() as f64,
        Rate::Unlimited | Rate::Trace { .. } | Rate::NamedTrace(_) => 0.0,
    })
}
