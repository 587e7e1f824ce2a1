//! Twins of runs: the same run with one plug-in beside the core, which decides on new contexts. They show what the distance of
//! the plug-in cost, and what it would have decided.

use std::{
    num::NonZero,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use cotorra_graph::{
    Instruction, NodeId, PluginDistance, PluginId, PluginSpec, ServiceId, Testbed, Timestamp, millis,
};
use cotorra_measurements::regret::{ServiceFigures, ServiceTimes};
use cotorra_numbers::holm;
use cotorra_testbed::{Altered, Unrecorded, Void, beside_core, distant, is_same_subject};
use cotorra_testbed_file::annotated;
use serde::{Deserialize, Serialize};

use super::{Decided, Examined, LONGEST, Observer, Recorded, Regret, RegretError, Sample, compared::Paired};
use crate::{
    batch::{self, Batch, Maker, Wanted},
    journal::Journal,
    outcome::Outcome,
};

/// What the distance of a plug-in cost, over pairs of a run and its twin with the same seed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DistanceCost {
    pub plugin: PluginId,
    /// Its distance in the run.
    pub distance: PluginDistance,
    /// Number of seeds, i.e. of pairs.
    pub pairs: usize,
    /// Reason for which the first void twin is, if there is one. Its pair does not count.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub void: Option<Void>,
    /// The services whose samples count.
    pub services: Vec<ServiceCost>,
}

/// What a distance cost a service.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceCost {
    pub service: ServiceId,
    pub robot: NodeId,
    /// Target, milliseconds.
    pub service_time_target_ms: f64,
    /// Means of the runs' figures with the distance; samples of all runs.
    pub with: ServiceFigures,
    /// The same beside the core.
    pub without: ServiceFigures,
    pub regret: FiguresRegret,
}

/// Figures with the distance, less those beside the core, over pairs. Probabilities are corrected for all figures of all services
/// and plug-ins (Holm). `None` where no pair has the figure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FiguresRegret {
    /// Of the share above the target.
    pub above_target: Option<Paired>,
    /// Of the median, milliseconds.
    pub service_time_p50_ms: Option<Paired>,
    /// Of the 99th percentile, milliseconds.
    pub service_time_p99_ms: Option<Paired>,
}

/// What a plug-in decided beside the core, instead of a decision.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TwinDecision {
    pub gave: TwinGave,
    /// Time of the twin's decision.
    #[serde(rename = "at_ns", skip_serializing_if = "Option::is_none")]
    pub at: Option<Timestamp>,
    /// Time from it to the decision, milliseconds; below 0 if it came later.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub earlier_ms: Option<f64>,
    /// The twin's decision.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instruction: Option<Instruction>,
}

/// A twin's decision beside that of the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TwinGave {
    /// The same.
    Same,
    /// Another radio unit or node.
    Other,
    /// None about this robot or VNF that is nearer to this decision than to others of the run.
    None,
}

/// The result of a twin.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Twinned {
    /// By index in the testbed.
    services: Vec<ServiceFigures>,
    /// Applied decisions of the plug-in.
    decided: Vec<(Timestamp, Instruction)>,
}

/// A twin that is to be made: a plug-in with a distance, and the run.
pub(super) type Wants<'a> = (&'a PluginSpec, &'a Recorded);

impl Regret {
    /// Returns the number of twins that a decision of the first run and its likes need, or all without a number.
    ///
    /// # Errors
    /// [`RegretError::NoDecision`].
    pub fn count_twins(
        &self,
        recorded: &[Recorded],
        number: Option<NonZero<usize>>,
    ) -> Result<usize, RegretError> {
        Ok(self.twins(&super::select(recorded, number)?).len())
    }

    /// Returns the twins of all runs with decisions of plug-ins with a distance.
    pub(super) fn twins<'a>(&'a self, decided: &[(&'a Recorded, &Decided)]) -> Vec<Wants<'a>> {
        let mut twins: Vec<Wants<'a>> = Vec::new();
        for spec in distant(&self.testbed) {
            for (run, _) in decided.iter().filter(|(_, decided)| decided.plugin == spec.id) {
                if !twins.iter().any(|(of, before)| of.id == spec.id && before.seed == run.seed) {
                    twins.push((spec, run));
                }
            }
        }
        twins
    }

    /// Makes twins, or takes them from the journal.
    pub(super) fn make_twins(
        &self,
        twins: &[Wants<'_>],
        journal: &Journal,
        jobs: NonZero<usize>,
        go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<Batch<Twinned>, RegretError> {
        let beside: Vec<_> = twins.iter().map(|(spec, _)| self.beside(spec)).collect();
        let wanted: Vec<_> = twins
            .iter()
            .zip(&beside)
            .map(|((spec, run), (testbed, text))| {
                let name = format!("twin with {} beside the core seed={}", spec.id, run.seed);
                let key = self.keys.key(journal.version(), testbed, text, self.until);
                Wanted { name, key, samples: None }
            })
            .collect();
        let maker = Maker { journal, keys: &self.keys, judge: Void::wrong };
        let make = |place: usize, stop: &AtomicBool| {
            let ((spec, run), (testbed, text)) = (twins[place], &beside[place]);
            let folder = journal.path().join(format!("twin-{place}"));
            let until = Some(self.until.unwrap_or(run.duration * LONGEST));
            let altered = &Altered::default();
            let run = Unrecorded { seed: run.seed, until, altered, folder: &folder, text };
            self.twin(&spec.id, testbed, &run, (maker, &wanted[place]), stop)
        };
        batch::run(journal, jobs, (&wanted, self.keys.file()), make, go_on)
    }

    fn twin(
        &self,
        plugin: &PluginId,
        testbed: &Arc<Testbed>,
        run: &Unrecorded<'_>,
        (maker, wanted): (Maker<'_>, &Wanted),
        stop: &AtomicBool,
    ) -> Result<Option<Outcome<Twinned>>, RegretError> {
        let mut observer = Observer::new(testbed);
        let (see, go_on) = (|event: &_| observer.see(event), || !stop.load(Ordering::Relaxed));
        let made = maker.make(wanted, Arc::clone(testbed), run, see, go_on)?;
        let its = observer.decided.into_iter().filter(|decided| decided.plugin == *plugin);
        let decided = its.map(|decided| (decided.at, decided.instruction)).collect();
        let twinned = Twinned { services: self.figures(&observer.samples), decided };
        Ok(made.map(|outcome| outcome.map(|_| twinned)))
    }

    /// Returns the testbed with a plug-in beside the core, and the text of its file.
    fn beside(&self, spec: &PluginSpec) -> (Arc<Testbed>, String) {
        let mut testbed = Testbed::clone(&self.testbed);
        let its = testbed.plugins.iter_mut().filter(|of| of.id == spec.id);
        its.for_each(|its| its.distance = PluginDistance::default());
        (Arc::new(testbed), annotated(&self.text, &beside_core(spec)))
    }

    /// Returns the figures of all services over a whole run.
    fn figures(&self, samples: &[Sample]) -> Vec<ServiceFigures> {
        let mut times = vec![ServiceTimes::default(); self.testbed.services.len()];
        samples.iter().for_each(|sample| times[sample.service].add(sample.emitted, sample.took));
        let target_ms = self.testbed.services.iter().map(|service| millis::of(service.kpis.service_time));
        times.iter().zip(target_ms).map(|(times, target_ms)| times.figures(target_ms)).collect()
    }

    /// Compares runs with their twins, and adds to each decision what the twin decided.
    pub(super) fn distances(
        &self,
        twins: &[Wants<'_>],
        made: &Batch<Twinned>,
        recorded: &[Recorded],
        examined: &mut [Examined],
    ) -> Vec<DistanceCost> {
        let pairs = || twins.iter().zip(&made.done);
        let measured = |outcome: &Option<Outcome<Twinned>>| outcome.as_ref()?.measured().cloned();
        for its in examined {
            let is_its = |(spec, run): &Wants<'_>| spec.id == its.decided.plugin && run.seed == its.seed;
            let twin = pairs().find(|(wants, _)| is_its(wants)).and_then(|(_, outcome)| measured(outcome));
            let run = recorded.iter().find(|run| run.seed == its.seed);
            its.twin =
                twin.zip(run).map(|(twin, run)| TwinDecision::of(&its.decided, &run.decided, &twin.decided));
        }
        let cost = |spec: &PluginSpec| {
            let its = || pairs().filter(|((of, _), _)| of.id == spec.id);
            let both: Vec<_> = its()
                .filter_map(|((_, run), outcome)| {
                    Some((self.figures(&run.samples), measured(outcome)?.services))
                })
                .collect();
            let void = its().find_map(|(_, outcome)| outcome.as_ref()?.void().cloned());
            let services = self.services.iter().filter_map(|service| self.cost(service, &both)).collect();
            let (plugin, distance) = (spec.id.clone(), spec.distance.clone());
            DistanceCost { plugin, distance, pairs: both.len(), void, services }
        };
        let is_there = |spec: &&PluginSpec| twins.iter().any(|(of, _)| of.id == spec.id);
        let mut all: Vec<_> = distant(&self.testbed).filter(is_there).map(cost).collect();
        correct(&mut all);
        all
    }

    /// Returns what a distance cost a service; `None` without samples.
    fn cost(
        &self,
        id: &ServiceId,
        pairs: &[(Vec<ServiceFigures>, Vec<ServiceFigures>)],
    ) -> Option<ServiceCost> {
        let place = self.testbed.services.iter().position(|service| service.id == *id)?;
        let service = &self.testbed.services[place];
        let pairs: Vec<_> = pairs.iter().map(|(with, without)| (with[place], without[place])).collect();
        let (with, without): (Vec<_>, Vec<_>) = pairs.iter().copied().unzip();
        let (with, without) = (means(&with), means(&without));
        let paired = |most: f64, read: fn(&ServiceFigures) -> Option<f64>| {
            let both = pairs.iter().filter_map(|(with, without)| Some((read(without)?, read(with)?)));
            Paired::of(both.collect(), most)
        };
        let regret = FiguresRegret {
            above_target: paired(1.0, |its| its.above_target),
            service_time_p50_ms: paired(f64::INFINITY, |its| its.service_time_p50_ms),
            service_time_p99_ms: paired(f64::INFINITY, |its| its.service_time_p99_ms),
        };
        (with.samples + without.samples > 0).then(|| ServiceCost {
            service: service.id.clone(),
            robot: service.robot.clone(),
            service_time_target_ms: millis::of(service.kpis.service_time),
            with,
            without,
            regret,
        })
    }
}

/// Returns the means of figures over runs, and the number of all samples.
fn means(runs: &[ServiceFigures]) -> ServiceFigures {
    let mean = |read: fn(&ServiceFigures) -> Option<f64>| {
        let values: Vec<f64> = runs.iter().filter_map(read).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    ServiceFigures {
        samples: runs.iter().map(|run| run.samples).sum(),
        above_target: mean(|run| run.above_target),
        service_time_p50_ms: mean(|run| run.service_time_p50_ms),
        service_time_p99_ms: mean(|run| run.service_time_p99_ms),
    }
}

/// Corrects the probabilities of all figures.
fn correct(all: &mut [DistanceCost]) {
    let regrets = all.iter_mut().flat_map(|cost| &mut cost.services).map(|service| &mut service.regret);
    let figures = regrets.flat_map(|regret| {
        [&mut regret.above_target, &mut regret.service_time_p50_ms, &mut regret.service_time_p99_ms]
    });
    let mut told: Vec<&mut f64> = figures.filter_map(|figure| figure.as_mut()?.p.as_mut()).collect();
    let corrected = holm(&told.iter().map(|p| **p).collect::<Vec<_>>());
    told.iter_mut().zip(corrected).for_each(|(p, corrected)| **p = corrected);
}

impl TwinDecision {
    /// Returns the twin's decision that is nearest in time to a decision of the run, about the same robot or VNF, unless another
    /// decision of the run is nearer to it.
    fn of(decided: &Decided, run: &[Decided], twin: &[(Timestamp, Instruction)]) -> Self {
        let apart = |a: Timestamp, b: Timestamp| a.since(b).max(b.since(a));
        let nearest = twin
            .iter()
            .filter(|(_, instruction)| is_same_subject(instruction, &decided.instruction))
            .min_by_key(|(at, _)| apart(*at, decided.at));
        let own = nearest.and_then(|(at, _)| {
            let about = run.iter().filter(|own| {
                own.plugin == decided.plugin && is_same_subject(&own.instruction, &decided.instruction)
            });
            about.min_by_key(|own| apart(*at, own.at))
        });
        match nearest {
            Some((at, instruction)) if own.is_some_and(|own| own.number == decided.number) => Self {
                gave: if *instruction == decided.instruction { TwinGave::Same } else { TwinGave::Other },
                at: Some(*at),
                earlier_ms: Some(millis::of(decided.at.since(*at)) - millis::of(at.since(decided.at))),
                instruction: Some(instruction.clone()),
            },
            _ => Self { gave: TwinGave::None, at: None, earlier_ms: None, instruction: None },
        }
    }

    /// Returns the radio unit or the nodes that the twin chose.
    pub fn chosen(&self) -> Option<String> {
        self.instruction.as_ref().map(super::decided::target)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attach(unit: &str) -> Instruction {
        Instruction::Attach { robot: "robot".parse().unwrap(), radio_unit: unit.parse().unwrap() }
    }

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    fn run(decisions: &[(f64, &str)]) -> Vec<Decided> {
        let decided = |(place, (seconds, unit)): (usize, &(f64, &str))| Decided {
            number: place + 1,
            time: 1,
            at: at(*seconds),
            plugin: "far".parse().unwrap(),
            instruction: attach(unit),
            reason: None,
            alternatives: Vec::new(),
            next: None,
        };
        decisions.iter().enumerate().map(decided).collect()
    }

    fn gave(decisions: &[(f64, &str)], twin: &[(f64, &str)]) -> Vec<(TwinGave, Option<i64>)> {
        let run = run(decisions);
        let twin: Vec<_> = twin.iter().map(|(seconds, unit)| (at(*seconds), attach(unit))).collect();
        let of = |decided| TwinDecision::of(decided, &run, &twin);
        run.iter().map(of).map(|its| (its.gave, its.earlier_ms.map(|ms| ms.round() as i64))).collect()
    }

    #[test]
    fn each_decision_has_the_nearest_of_the_twin_once() {
        let run = [(10.2, "A"), (20.2, "B"), (30.2, "C")];
        assert_eq!(
            gave(&run, &[(10.0, "A"), (19.0, "D"), (30.5, "C")]),
            [(TwinGave::Same, Some(200)), (TwinGave::Other, Some(1200)), (TwinGave::Same, Some(-300))]
        );
        // The twin had one decision less, and it is nearer to the first.
        assert_eq!(gave(&run[..2], &[(10.0, "B")]), [(TwinGave::Other, Some(200)), (TwinGave::None, None)]);
        assert_eq!(gave(&run[..1], &[]), [(TwinGave::None, None)]);
    }
}
