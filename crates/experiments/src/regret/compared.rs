//! Alternatives beside decisions over several seeds: differences of runs with the same seed.

use cotorra_graph::{Instruction, PluginId, Timestamp};
use cotorra_numbers::{Mean, holm};
use serde::Serialize;

use super::{Examined, Stood, Tried, decided::target};

/// An alternative beside a decision, over all seeds in which the plug-in decided that and had the alternative.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Compared {
    /// The first seed with the decision.
    pub seed: u64,
    /// Number of the decision with that seed.
    pub number: usize,
    /// Time of the decision with that seed.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    pub plugin: PluginId,
    pub instruction: Instruction,
    /// The radio unit or the node of the alternative.
    pub target: String,
    /// Whether the alternative left everything as it was.
    pub stays: bool,
    /// Number of seeds, i.e. of pairs of runs.
    pub pairs: usize,
    /// Number of pairs in which walks end with the decision but not with the alternative.
    pub undone: usize,
    /// Share of samples kept with the alternative, less that with the decision.
    pub kept: Option<Paired>,
    /// The same difference of medians, milliseconds.
    pub service_time_p50_ms: Option<Paired>,
    /// The same difference of the number of late samples.
    #[serde(rename = "late_samples")]
    pub late: Option<Paired>,
    /// The same difference of the mean price of placed CPUs.
    pub cost: Option<Paired>,
    /// The same difference of the number of changes of VNFs' nodes.
    pub migrations: Option<Paired>,
    /// The same difference of the number of changes of radio unit.
    pub handovers: Option<Paired>,
}

/// A mean difference of pairs, with an interval of 95 % by Student's t distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Paired {
    /// Number of pairs.
    #[serde(skip)]
    pub n: usize,
    pub mean: f64,
    /// Lower bound; `None` for a single pair.
    pub low: Option<f64>,
    /// Upper bound; `None` for a single pair.
    pub high: Option<f64>,
    /// Probability of a mean at least as far from 0 if there is no difference. That of shares is corrected for the number of
    /// all alternatives of all decisions that were examined (Holm). `None` with fewer than three pairs.
    pub p: Option<f64>,
}

/// Verdict of the pairs on the share of samples kept, at 5 % for all alternatives together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// There are fewer than three pairs.
    TooFew,
    /// The alternative keeps more.
    Better,
    /// The alternative keeps less.
    Worse,
    /// The difference may be chance.
    Open,
}

impl Paired {
    pub(super) fn of(pairs: Vec<(f64, f64)>, most: f64) -> Option<Self> {
        let Mean { n, mean, interval, p } = Mean::of_differences(&pairs)?;
        let low = interval.map(|its| its.low.max(-most));
        let high = interval.map(|its| its.high.min(most));
        Some(Self { n, mean, low, high, p })
    }
}

impl Compared {
    /// Compares the alternatives of all decisions, in the order in which the decisions first stand.
    pub(super) fn all(examined: &[Examined]) -> Vec<Self> {
        let mut all: Vec<(Self, Vec<(&Stood, &Stood)>)> = Vec::new();
        let mut decisions: Vec<&Examined> = Vec::new();
        for its in examined {
            let first = decisions.iter().find(|first| first.decided.is_like(&its.decided)).copied();
            let first = first.unwrap_or_else(|| {
                decisions.push(its);
                its
            });
            for Tried { target, stays, stood, .. } in &its.tried {
                let Some(stood) = stood else { continue };
                let is_same = |(of, _): &&mut (Self, Vec<_>)| {
                    (of.seed, of.number, &of.target) == (first.seed, first.decided.number, target)
                };
                match all.iter_mut().find(is_same) {
                    Some((_, pairs)) => pairs.push((&its.stood, stood)),
                    None => all.push((Self::new(first, target, *stays), vec![(&its.stood, stood)])),
                }
            }
        }
        let mut all: Vec<_> = all.into_iter().map(|(of, pairs)| of.with(&pairs)).collect();
        all.sort_by_key(|of| {
            decisions.iter().position(|its| (its.seed, its.decided.number) == (of.seed, of.number))
        });
        let mut told: Vec<&mut f64> = all.iter_mut().filter_map(|of| of.kept.as_mut()?.p.as_mut()).collect();
        let corrected = holm(&told.iter().map(|p| **p).collect::<Vec<_>>());
        told.iter_mut().zip(corrected).for_each(|(p, corrected)| **p = corrected);
        all
    }

    fn new(first: &Examined, target: &str, stays: bool) -> Self {
        Self {
            seed: first.seed,
            number: first.decided.number,
            at: first.decided.at,
            plugin: first.decided.plugin.clone(),
            instruction: first.decided.instruction.clone(),
            target: target.to_owned(),
            stays,
            pairs: 0,
            undone: 0,
            kept: None,
            service_time_p50_ms: None,
            late: None,
            cost: None,
            migrations: None,
            handovers: None,
        }
    }

    /// Compares runs with the decision and with the alternative.
    fn with(self, pairs: &[(&Stood, &Stood)]) -> Self {
        let paired = |most: f64, read: fn(&Stood) -> Option<f64>| {
            let both = pairs.iter().filter_map(|(own, other)| Some((read(own)?, read(other)?)));
            Paired::of(both.collect(), most)
        };
        let count = |read: fn(&Stood) -> Option<f64>| paired(f64::INFINITY, read);
        Self {
            pairs: pairs.len(),
            undone: pairs.iter().filter(|(own, other)| own.walked && !other.walked).count(),
            kept: paired(1.0, |stood| stood.kept),
            service_time_p50_ms: count(|stood| stood.service_time_p50_ms),
            late: count(|stood| stood.late.map(|late| late as f64)),
            cost: count(|stood| stood.cost),
            migrations: count(|stood| stood.migrations.map(|count| count as f64)),
            handovers: count(|stood| stood.handovers.map(|count| count as f64)),
            ..self
        }
    }

    /// Returns the radio unit or the nodes of the decision.
    pub fn chosen(&self) -> String {
        target(&self.instruction)
    }

    /// Returns the verdict of the pairs.
    pub fn verdict(&self) -> Verdict {
        match self.kept {
            Some(Paired { p: Some(p), mean, .. }) if p < 0.05 => {
                if mean > 0.0 {
                    Verdict::Better
                } else {
                    Verdict::Worse
                }
            }
            Some(Paired { p: Some(_), .. }) => Verdict::Open,
            _ => Verdict::TooFew,
        }
    }

    /// Returns the best of the alternatives of each decision: with it, most walks end, then most samples are kept, then it is
    /// the fastest.
    pub fn best(all: &[Self]) -> Vec<&Self> {
        let decisions = all.chunk_by(|a, b| (a.seed, a.number) == (b.seed, b.number));
        let rank = |of: &Self| {
            let mean = |paired: Option<Paired>| paired.map_or(f64::NEG_INFINITY, |its| its.mean);
            (of.undone, mean(of.kept), -of.service_time_p50_ms.map_or(f64::INFINITY, |its| its.mean))
        };
        let best = |its: &'_ [Self]| -> usize {
            let better = |a: &usize, b: &usize| {
                let (a, b) = (rank(&its[*a]), rank(&its[*b]));
                b.0.cmp(&a.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2))
            };
            (0..its.len()).max_by(better).unwrap_or(0)
        };
        decisions.map(|its| &its[best(its)]).collect()
    }
}
