//! Signal surveys: path loss, walls and shadowing of a wireless network.

mod fading;
mod kriging;
mod likelihood;
mod posterior;
mod prediction;

use std::collections::BTreeMap;

use cotorra_graph::{Dbm, Node, OccupancyGrid, PathLoss, Position, RadioUnit, Testbed, WirelessNetwork};
use cotorra_numbers::Draws;
use serde::Serialize;

pub use self::fading::{FadingFit, fit_fading};
pub use self::prediction::{
    SignalPrediction, SignalPredictor, SurveyComparison, compare_survey, split_survey,
};
use self::{
    kriging::Middle,
    likelihood::{COEFFICIENTS, Field, Sample},
    posterior::Draw,
};
use crate::{
    csv::{self, Table},
    error::CalibrateError,
    estimate::Estimate,
};

/// Most readings of a survey. The time of a fit is proportional to them, and that of its preparation to their square.
pub const MAX_READINGS: usize = 20_000;
/// Fewest readings of a network.
const LEAST_READINGS: usize = 30;
/// Least ratio of the farthest to the nearest distance.
const LEAST_RATIO: f64 = 2.0;
/// Path loss is the same within this distance, metres: the reference distance of [`PathLoss::LogDistance`].
const REFERENCE_M: f64 = 1.0;

/// A reading of a survey.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Time since any start, seconds.
    pub time_s: f64,
    /// Place of the receiver.
    pub place: Position,
    /// Name of the radio unit.
    pub radio_unit: String,
    /// Received signal, dBm.
    pub signal: Dbm,
}

/// Reads a survey: CSV with the columns `time_s`, `x`, `y`, `radio_unit` and `signal_dbm`, and `z` if heights matter, in any
/// order. Places are metres from the map's origin.
///
/// # Errors
/// [`CalibrateError::Line`] with the first line that is wrong, or [`CalibrateError::Unreadable`].
pub fn parse_survey(text: &str) -> Result<Vec<Reading>, CalibrateError> {
    const USUAL: &str = "time_s,x,y,radio_unit,signal_dbm";
    const FAR_M: [f64; 2] = [-1e6, 1e6];
    csv::check_length(text)?;
    let table = Table::new(text)?;
    let [time, x, y, unit, signal] = ["time_s", "x", "y", "radio_unit", "signal_dbm"];
    let [time, x, y] = [table.required(time, USUAL)?, table.required(x, USUAL)?, table.required(y, USUAL)?];
    let [unit, signal] = [table.required(unit, USUAL)?, table.required(signal, USUAL)?];
    let z = table.column("z");
    let mut readings = Vec::new();
    for row in table.rows() {
        let row = row?;
        if readings.len() == MAX_READINGS {
            return Err(CalibrateError::line(
                row.line,
                format!("there are more than {MAX_READINGS} readings: keep every second one, or fewer"),
            ));
        }
        let place = Position::new(row.number(x, FAR_M)?, row.number(y, FAR_M)?);
        let height = z.map(|z| row.number(z, FAR_M)).transpose()?.unwrap_or_default();
        readings.push(Reading {
            time_s: row.number(time, [-1e12, 1e12])?,
            place: place.at_height(height),
            radio_unit: row.text(unit).to_owned(),
            signal: Dbm(row.number(signal, [-200.0, 60.0])?),
        });
    }
    match readings.is_empty() {
        true => Err(CalibrateError::Unreadable("the survey has a header, but no readings".to_owned())),
        false => Ok(readings),
    }
}

/// The radio of one wireless network, fitted to a survey.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurveyFit {
    /// Number of readings.
    pub readings: usize,
    /// Number of radio units that were heard.
    pub radio_units: usize,
    /// Loss at 1 m beyond that of free space, dB: antennas, cables, and errors of the transmitted power.
    pub reference_loss_db: Estimate,
    /// Exponent of the log-distance path loss.
    pub exponent: Estimate,
    /// Loss of each wall, dB; `None` if the testbed has no map, or all readings are behind equally many walls.
    pub wall_loss_db: Option<Estimate>,
    /// Standard deviation of shadowing, dB.
    pub deviation_db: Estimate,
    /// Correlation distance of shadowing, metres; `None` if the walk does not show it.
    pub correlation_m: Option<Estimate>,
    /// Standard deviation of what differs between readings at one place, dB: fast fading and rounding. It goes into no setting.
    pub noise_db: Estimate,
    /// Notes on the fit, for people.
    pub notes: Vec<String>,
    /// Predicts signals at other places.
    #[serde(skip)]
    middle: Middle,
}

/// Fits each wireless network that a survey heard. The seed decides the draws of the posterior.
///
/// # Errors
/// [`CalibrateError::Unsuited`] if a radio unit is not in the testbed or has no position, and [`CalibrateError::TooLittle`] if
/// the readings of a network do not determine its path loss.
pub fn fit_survey(
    testbed: &Testbed,
    readings: &[Reading],
    seed: u64,
) -> Result<BTreeMap<String, SurveyFit>, CalibrateError> {
    let fit = |(name, readings): (String, Vec<Reading>)| {
        let fitted = fit_network(testbed, &name, &readings, seed)?;
        Ok((name, fitted))
    };
    by_network(testbed, readings)?.into_iter().map(fit).collect()
}

/// Groups readings by the network of their radio units.
pub(crate) fn by_network(
    testbed: &Testbed,
    readings: &[Reading],
) -> Result<BTreeMap<String, Vec<Reading>>, CalibrateError> {
    let mut networks: BTreeMap<String, Vec<Reading>> = BTreeMap::new();
    for reading in readings {
        let (unit, _) = radio_unit(testbed, &reading.radio_unit)?;
        networks.entry(unit.network.clone()).or_default().push(reading.clone());
    }
    Ok(networks)
}

/// Fits one network to readings of its radio units.
pub(crate) fn fit_network(
    testbed: &Testbed,
    name: &str,
    readings: &[Reading],
    seed: u64,
) -> Result<SurveyFit, CalibrateError> {
    let mut units: BTreeMap<&str, Vec<&Reading>> = BTreeMap::new();
    for reading in readings {
        units.entry(&reading.radio_unit).or_default().push(reading);
    }
    let survey = Survey::new(testbed, name, &units)?;
    survey.fit(name, &mut Draws::new(seed, &format!("calibrate survey {name}")))
}

/// Finds a radio unit.
pub(crate) fn find_radio_unit<'a>(
    testbed: &'a Testbed,
    name: &str,
) -> Result<(&'a Node, &'a RadioUnit), CalibrateError> {
    let found = testbed.graph.radio_units().find(|(node, _)| node.id.as_str() == name);
    found.ok_or_else(|| {
        let all: Vec<_> = testbed.graph.radio_units().map(|(node, _)| node.id.as_str()).collect();
        CalibrateError::unsuited(format!(
            "the testbed has no radio unit `{name}`; its radio units are: {}",
            all.join(", ")
        ))
    })
}

/// Finds a radio unit and its position.
pub(crate) fn radio_unit<'a>(
    testbed: &'a Testbed,
    name: &str,
) -> Result<(&'a RadioUnit, Position), CalibrateError> {
    let (node, unit) = find_radio_unit(testbed, name)?;
    let unplaced = || CalibrateError::unsuited(format!("radio unit `{name}` has no position in the testbed"));
    Ok((unit, node.position.ok_or_else(unplaced)?))
}

/// Readings of one network, as a linear model.
struct Survey {
    units: Vec<Vec<Sample>>,
    /// Distances to the radio units, metres.
    distances: [f64; 2],
    walls: bool,
    notes: Vec<String>,
}

impl Survey {
    fn new(
        testbed: &Testbed,
        name: &str,
        units: &BTreeMap<&str, Vec<&Reading>>,
    ) -> Result<Self, CalibrateError> {
        let network = &testbed.graph.wireless[name];
        let map = testbed.map.as_ref();
        let samples = |(unit, readings): (&&str, &Vec<&Reading>)| {
            let (unit, at) = radio_unit(testbed, unit)?;
            Ok(readings.iter().map(|reading| sample(network, unit, at, map, reading)).collect())
        };
        let mut units: Vec<Vec<Sample>> = units.iter().map(samples).collect::<Result<_, CalibrateError>>()?;
        let (mut nearest, mut farthest) = (f64::INFINITY, 0.0_f64);
        let (mut fewest, mut most) = (f64::INFINITY, 0.0_f64);
        for sample in units.iter().flatten() {
            let distance = 10f64.powf(-sample.factors[1] / 10.0);
            (nearest, farthest) = (nearest.min(distance), farthest.max(distance));
            (fewest, most) = (fewest.min(-sample.factors[2]), most.max(-sample.factors[2]));
        }
        let mut notes = Vec::new();
        let walls = most > fewest;
        if map.is_some() && !walls {
            notes.push(format!("all readings are behind {fewest} walls, so the loss of a wall is not known"));
        }
        if network.walls.as_ref().is_some_and(|walls| walls.loss.at_most_db.is_some()) {
            notes.push("the bound `at_most` of walls is not fitted, and the new value has none".to_owned());
        }
        if !walls {
            units.iter_mut().flatten().for_each(|sample| sample.factors[2] = 0.0);
        }
        Ok(Self { units, distances: [nearest, farthest], walls, notes })
    }

    fn fit(mut self, name: &str, draws: &mut Draws) -> Result<SurveyFit, CalibrateError> {
        let readings: usize = self.units.iter().map(Vec::len).sum();
        if readings < LEAST_READINGS {
            return Err(CalibrateError::too_little(format!(
                "network `{name}` has {readings} readings: a fit needs {LEAST_READINGS} or more"
            )));
        }
        let [nearest, farthest] = self.distances;
        if farthest < LEAST_RATIO * nearest {
            return Err(CalibrateError::too_little(format!(
                "network `{name}` was heard from {nearest:.1} m to {farthest:.1} m only, so its exponent is not known: walk \
                 from near a radio unit to {LEAST_RATIO} times as far or more (distances within {REFERENCE_M} m count as that)"
            )));
        }
        let bounds = self.correlation_bounds().ok_or_else(|| {
            CalibrateError::too_little(format!("network `{name}` was surveyed at one place only"))
        })?;
        let coefficients = if self.walls { COEFFICIENTS } else { COEFFICIENTS - 1 };
        let field = Field::new(&self.units, coefficients);
        let posterior = posterior::draw(&field, coefficients, bounds, draws).ok_or_else(|| {
            CalibrateError::too_little(format!(
                "the readings of network `{name}` do not tell distance and walls apart: survey places that are near behind \
                 walls, and far without"
            ))
        })?;
        let estimate = |of: fn(&Draw) -> f64| Estimate::of(&mut posterior.iter().map(of).collect::<Vec<_>>());
        let distance = estimate(|draw| draw.distance);
        // An interval that ends at a bound says nothing on that side.
        const CLOSE: f64 = 1.25;
        let determined = distance.low > bounds[0] * CLOSE && distance.high < bounds[1] / CLOSE;
        if !determined {
            self.notes.push(format!(
                "the correlation distance of shadowing is not known: anything from {:.1} m to {:.1} m fits the walk; a longer \
                 walk, or more readings on a metre, would tell",
                distance.low, distance.high
            ));
        }
        Ok(SurveyFit {
            readings,
            radio_units: self.units.len(),
            reference_loss_db: estimate(|draw| draw.coefficients[0]),
            exponent: estimate(|draw| draw.coefficients[1]),
            wall_loss_db: self.walls.then(|| estimate(|draw| draw.coefficients[2])),
            deviation_db: estimate(|draw| draw.deviation),
            correlation_m: determined.then_some(distance),
            noise_db: estimate(|draw| draw.noise),
            notes: self.notes,
            middle: Middle::of(&posterior),
        })
    }

    /// Bounds of the correlation distance: from a third of a usual step to twice the extent of the walk. `None` if all readings
    /// are at one place.
    fn correlation_bounds(&self) -> Option<[f64; 2]> {
        let apart = |a: &Sample, b: &Sample| (a.place[0] - b.place[0]).hypot(a.place[1] - b.place[1]);
        let steps = self.units.iter().flat_map(|unit| unit.windows(2).map(|pair| apart(&pair[0], &pair[1])));
        let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
        steps.sort_unstable_by(f64::total_cmp);
        let step = *steps.get(steps.len() / 2)?;
        let extent = self.units.iter().flat_map(|unit| unit.iter().map(|s| apart(s, &unit[0])));
        let extent = extent.fold(0.0, f64::max);
        Some([step / 3.0, (2.0 * extent).max(step)])
    }
}

/// Returns a reading as a linear function of reference loss, exponent and wall loss, less shadowing.
fn sample(
    network: &WirelessNetwork,
    unit: &RadioUnit,
    at: Position,
    map: Option<&OccupancyGrid>,
    reading: &Reading,
) -> Sample {
    let distance = at.distance(reading.place);
    let frequency = network.standard.frequency_mhz(unit.channel);
    let free_space = PathLoss::FreeSpace.loss_db(distance.min(REFERENCE_M), frequency);
    let walls = map.map_or(0, |map| map.walls_between(at, reading.place));
    Sample {
        place: [reading.place.x, reading.place.y],
        factors: [-1.0, -10.0 * distance.max(REFERENCE_M).log10(), -(walls as f64)],
        value: reading.signal.0 - unit.tx_power.0 + free_space,
    }
}

#[cfg(test)]
mod tests;
