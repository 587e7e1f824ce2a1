//! A calibration as a whole: what is fitted, how it is tested, and the settings of the testbed that follow.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Link, Rate, Scale, Testbed};
use serde::Serialize;

use crate::{
    compare::{Comparison, compare},
    error::CalibrateError,
    path::{PathFit, fit_path},
    round_trips::RoundTrips,
    settings::{FittedSetting, of_link, of_network},
    survey::{Reading, SurveyFit, fit_survey},
};

/// Measurements of a site.
#[derive(Debug, Clone, Default)]
pub struct Measurements {
    /// Readings of a signal survey.
    pub survey: Vec<Reading>,
    /// Round trips over wired links, by the link's name.
    pub round_trips: BTreeMap<String, RoundTrips>,
}

/// Options of a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Target of round trips; the share above it is compared.
    pub target: Option<Duration>,
    /// Share of round trips that are fitted, from the start; the others test the fit.
    pub fitted_share: f64,
    /// Seed of draws and resamples.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { target: None, fitted_share: 0.6, seed: 1 }
    }
}

/// A wired link, fitted and tested.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinkCalibration {
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
    pub networks: BTreeMap<String, SurveyFit>,
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
        if measurements.survey.is_empty() && measurements.round_trips.is_empty() {
            return Err(CalibrateError::too_little("there are no measurements to fit"));
        }
        let networks = fit_survey(testbed, &measurements.survey, options.seed)?;
        let mut settings: Vec<FittedSetting> =
            networks.iter().flat_map(|(name, fit)| of_network(testbed, name, fit)).collect();
        let mut links = BTreeMap::new();
        for (name, trips) in &measurements.round_trips {
            let link = link(testbed, name)?;
            let of_link_error = |error| CalibrateError::of_link(name, error);
            let calibrated = calibrate_link(trips, options).map_err(of_link_error)?;
            settings.extend(
                of_link(link, &calibrated.fit, sending(link, trips.frame_bytes)).map_err(of_link_error)?,
            );
            links.insert(name.clone(), calibrated);
        }
        Ok(Self { testbed: testbed.name.clone(), seed: options.seed, networks, links, settings })
    }
}

fn calibrate_link(trips: &RoundTrips, options: Options) -> Result<LinkCalibration, CalibrateError> {
    let [fitted, test] = trips.split(options.fitted_share);
    let fit = fit_path(&fitted, options.seed)?;
    let comparison = compare(&fit, &fitted, &test, options.target, options.seed)?;
    Ok(LinkCalibration { fit, comparison })
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

/// Returns the times that a frame takes to be sent over a link, forward and backward, ms. A trace counts as no time.
fn sending(link: &Link, bytes: usize) -> [f64; 2] {
    [&link.forward, &link.backward].map(|conditions| match &conditions.rate {
        Rate::Fixed { bits_per_second } => bytes as f64 * 8e3 / bits_per_second.bits_per_second() as f64,
        Rate::Unlimited | Rate::Trace { .. } => 0.0,
    })
}
