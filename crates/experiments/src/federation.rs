//! The COTORRA letter's second validation (arXiv 2101.07676): a robot leaves the coverage of its domain, whose
//! orchestrator has found another domain's virtual access point by then, over a ledger with blocks.

pub mod dishonest;
mod drawn;
mod ledger_backend;

use std::{collections::BTreeMap, fmt::Write as _, path::Path, time::Duration};

use cotorra_federation::Step;
use cotorra_graph::{DomainId, Event, Instruction, NodeId, Stamped, Testbed, Timestamp, Walk};
use cotorra_measurements::{History, Kind, PageRequest, RunId};
use cotorra_testbed::{FolderError, Quantiles, orchestrators, write_file};
use serde::Serialize;

pub use cotorra_federation::{Access, Account, LedgerError, Network, PASSWORD};
pub use ledger_backend::LedgerBackend;

/// The files that [`Comparison::write`] makes.
pub const FILES: [&str; 4] = ["federation.svg", "federation.md", "federation.json", "steps.csv"];

/// The steps in the order of the published figure.
pub const STEPS: [Step; 11] = [
    Step::Announced,
    Step::AnnouncementReceived,
    Step::BidSent,
    Step::BidReceived,
    Step::WinnerChosen,
    Step::WinnerReceived,
    Step::DeploymentStarted,
    Step::DeploymentFinished,
    Step::ConfirmationSent,
    Step::ConfirmationReceived,
    Step::Attached,
];

/// Blocks from the announcement's to the confirmation's.
const BLOCKS_BETWEEN: u32 = 3;
/// Between the blocks of the published ledger, seconds.
const PUBLISHED_PERIOD_S: f64 = 5.0;
/// As published for such a ledger, mean and deviation, seconds.
const PUBLISHED_S: [f64; 2] = [18.05, 1.25];
/// The letter's figure, seconds.
const LETTER_S: f64 = 19.0;

/// Why a run shows no federation.
#[derive(Debug, thiserror::Error)]
pub enum NoFederation {
    /// Its history cannot be read.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    /// A step is missing.
    #[error(
        "the robot was not served by another domain: the history has no `{missing}`; it went as far as: {reached}"
    )]
    Incomplete {
        /// The first that is.
        missing: Step,
        /// What there is, with times.
        reached: String,
    },
}

/// What one run shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Federated {
    /// Between blocks, seconds.
    pub block_period_s: f64,
    /// The seed of the run.
    pub seed: u64,
    /// When each of [`STEPS`] was reached, seconds of the run.
    pub steps_s: Vec<f64>,
    /// How long no frame could pass while the robot changed to the vAP, seconds.
    pub gap_s: f64,
    /// The radio units before and after.
    pub attachments: [NodeId; 2],
    /// Position packets without an answer from the announcement until 5 s after the attachment.
    pub lost: usize,
    /// All of them.
    pub samples: usize,
    /// The longest service time in that time, ms.
    pub longest_ms: f64,
    /// The lowest speed of the robot in that time, as a share of its median there.
    pub slowest: f64,
    /// Whether the use was charged, and the provider heard it.
    pub is_paid: bool,
}

impl Federated {
    /// Reads what a run left in the Measurements.
    ///
    /// # Errors
    /// [`NoFederation`].
    pub fn read(
        history: &History,
        run: RunId,
        block_period: Duration,
        seed: u64,
    ) -> Result<Self, NoFederation> {
        let kinds = [Kind::Decision, Kind::Handover, Kind::Robot, Kind::ServiceTime];
        let mut events = Vec::new();
        let mut request = PageRequest::default();
        loop {
            let page = history.events(run, &kinds, .., request)?;
            events.extend(page.items);
            let Some(next) = page.next else { break };
            request.after = Some(next);
        }
        Self::of(&events, block_period, seed)
    }

    fn of(events: &[Stamped], block_period: Duration, seed: u64) -> Result<Self, NoFederation> {
        let steps = first_steps(events);
        let at = |step: Step| {
            steps.get(step.as_str()).copied().ok_or_else(|| {
                let mut reached: Vec<_> = steps.iter().collect();
                reached.sort_by(|(_, a), (_, b)| a.total_cmp(b));
                let reached = reached.iter().map(|(step, at)| format!("{step} at {at:.2} s"));
                NoFederation::Incomplete { missing: step, reached: reached.collect::<Vec<_>>().join(", ") }
            })
        };
        let steps_s = STEPS.iter().map(|step| at(*step)).collect::<Result<Vec<_>, _>>()?;
        let (announced, attached) = (steps_s[0], steps_s[STEPS.len() - 1]);
        let around = |seconds: f64| (announced..=attached + 5.0).contains(&seconds);
        let (mut gap_s, mut attachments) = (0.0, None);
        let (mut lost, mut samples, mut longest_ms, mut speeds) = (0, 0, 0.0_f64, Vec::new());
        for Stamped { at, event } in events {
            let seconds = at.as_secs_f64();
            match event {
                // The one that the step tells of: it was told right before.
                Event::Handover(handover) if seconds <= attached => {
                    gap_s = handover.gap.as_secs_f64();
                    attachments = handover.from.clone().map(|from| [from, handover.to.clone()]);
                }
                Event::ServiceTime(sample) if around(sample.emitted.as_secs_f64()) => {
                    samples += 1;
                    match sample.took {
                        Some(took) => longest_ms = longest_ms.max(took.as_secs_f64() * 1e3),
                        None => lost += 1,
                    }
                }
                Event::Robot(context) if around(seconds) => speeds.push(context.sensors.velocity.linear),
                _ => {}
            }
        }
        let incomplete =
            || NoFederation::Incomplete { missing: Step::Attached, reached: "no handover".to_owned() };
        speeds.sort_by(f64::total_cmp);
        let slowest =
            speeds.first().zip(speeds.get(speeds.len() / 2)).map_or(0.0, |(least, median)| least / median);
        Ok(Self {
            block_period_s: block_period.as_secs_f64(),
            seed,
            steps_s,
            gap_s,
            attachments: attachments.ok_or_else(incomplete)?,
            lost,
            samples,
            longest_ms,
            slowest,
            is_paid: steps.contains_key(Step::Paid.as_str()),
        })
    }

    fn at(&self, step: Step) -> f64 {
        let place = STEPS.iter().position(|other| *other == step).expect("it is one of them");
        self.steps_s[place]
    }

    /// From the announcement to the attachment, seconds.
    pub fn total_s(&self) -> f64 {
        self.at(Step::Attached) - self.at(Step::Announced)
    }

    /// How long the vAP took to be deployed, seconds.
    pub fn deployment_s(&self) -> f64 {
        self.at(Step::DeploymentFinished) - self.at(Step::DeploymentStarted)
    }

    /// What waiting for blocks takes at the most, and what comes on top of it: a block for the announcement, two for bid and
    /// choice, one for the confirmation; deployment and attachment.
    pub fn bound_s(&self) -> f64 {
        f64::from(1 + BLOCKS_BETWEEN) * self.block_period_s + self.deployment_s() + self.gap_s
    }

    /// What it took beyond this run's own waiting for blocks, the deployment as far as no block is waited for meanwhile,
    /// and the attachment. The announcement's block is the one that it came in; the others follow at their period, and the
    /// confirmation comes in the first after the deployment.
    pub fn beyond_s(&self) -> f64 {
        let first = self.at(Step::AnnouncementReceived) - self.at(Step::Announced);
        let deployments_blocks = (self.deployment_s() / self.block_period_s).floor();
        let blocks = (f64::from(BLOCKS_BETWEEN) + deployments_blocks) * self.block_period_s;
        self.total_s() - first - blocks - self.gap_s
    }
}

/// When each step was noted first.
fn first_steps(events: &[Stamped]) -> BTreeMap<&str, f64> {
    let mut steps = BTreeMap::new();
    // A run that goes on after another has steps from before it began.
    let reached =
        |at: &Timestamp, ago: &Option<Duration>| at.as_secs_f64() - ago.unwrap_or_default().as_secs_f64();
    for Stamped { at, event } in events {
        if let Event::Decision(decision) = event
            && let Instruction::Note { step, ago, .. } = &decision.instruction
        {
            steps.entry(step.as_str()).or_insert(reached(at, ago));
        }
    }
    // Who lost is not part of the figure, but may be heard first: what the winner did counts.
    let winner = events.iter().find_map(|stamped| match &stamped.event {
        Event::Decision(decision) => match &decision.instruction {
            Instruction::Note { step, .. } if step == Step::WinnerReceived.as_str() => Some(&decision.plugin),
            _ => None,
        },
        _ => None,
    });
    for Stamped { at, event } in events.iter().rev() {
        if let Event::Decision(decision) = event
            && let Instruction::Note { step, ago, .. } = &decision.instruction
            && Some(&decision.plugin) == winner
        {
            steps.insert(step.as_str(), reached(at, ago));
        }
    }
    steps
}

/// All runs of an experiment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// How the network between the nodes was: emulated, or a model.
    pub how: String,
    /// Which ledger it was, as in `an anvil node: one node without consensus`.
    pub ledger: String,
    /// As they were run.
    pub runs: Vec<Federated>,
}

/// Mean and deviation of a sample.
fn mean_and_deviation(values: &[f64]) -> [f64; 2] {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    [mean, (squares / (values.len() as f64 - 1.0).max(1.0)).sqrt()]
}

impl Comparison {
    /// The runs by block period.
    fn by_period(&self) -> Vec<Vec<&Federated>> {
        let mut periods: Vec<Vec<&Federated>> = Vec::new();
        for run in &self.runs {
            match periods.iter_mut().find(|of| of[0].block_period_s == run.block_period_s) {
                Some(of) => of.push(run),
                None => periods.push(vec![run]),
            }
        }
        periods
    }

    /// The table over block periods, in Markdown.
    pub fn to_markdown(&self) -> String {
        let Self { how, ledger, .. } = self;
        let mut text = format!("From the announcement to the attachment ({how}, on {ledger})\n\n");
        text += "| block period | runs | total | least | most | bound | ours beyond the blocks, median | most | vAP deployed in | \
                 gap | without answer | lowest speed | paid for |\n|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n";
        for runs in self.by_period() {
            let all =
                |figure: &dyn Fn(&Federated) -> f64| runs.iter().map(|run| figure(run)).collect::<Vec<_>>();
            let most = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let least = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
            let totals = all(&Federated::total_s);
            let beyond = all(&|run| run.beyond_s() * 1e3);
            let [mean, deviation] = mean_and_deviation(&totals);
            let lost: usize = runs.iter().map(|run| run.lost).sum();
            let samples: usize = runs.iter().map(|run| run.samples).sum();
            let row = format!(
                "| {} s | {} | {mean:.2} ± {deviation:.2} s | {:.2} s | {:.2} s | {:.2} s | {:.0} ms | {:.0} ms | {:.0} ms | {:.0} ms \
                 | {lost} of {samples} | {:.0} % | {} of {} |\n",
                runs[0].block_period_s,
                runs.len(),
                least(&totals),
                most(&totals),
                most(&all(&Federated::bound_s)),
                Quantiles::of(beyond.clone()).map_or(0.0, |quantiles| quantiles.p50),
                most(&beyond),
                most(&all(&|run| run.deployment_s() * 1e3)),
                most(&all(&|run| run.gap_s * 1e3)),
                least(&all(&|run| run.slowest * 100.0)),
                runs.iter().filter(|run| run.is_paid).count(),
                runs.len(),
            );
            text += &row;
        }
        let [mean, deviation] = PUBLISHED_S;
        line(
            &mut text,
            format_args!(
                "\nThe bound is what waiting for blocks takes at the most: one for the announcement, two for bid and choice, one \
                 for the confirmation; with the longest deployment and attachment. Published, with a block each 5 s: {mean} ± \
                 {deviation} s, and about {LETTER_S} s in the letter (arXiv 2101.07676)."
            ),
        );
        text
    }

    /// Writes [`FILES`]: the figure in the published layout, of the run in the middle of those with the published period,
    /// or the last; the table, and all
    /// steps of all runs.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, folder: &Path) -> Result<(), FolderError> {
        let [figure, table, data, csv] = FILES;
        let periods = self.by_period();
        let published = periods.iter().find(|runs| runs[0].block_period_s == PUBLISHED_PERIOD_S);
        if let Some(runs) = published.or(periods.last()) {
            let mut runs = runs.clone();
            runs.sort_by(|a, b| a.total_s().total_cmp(&b.total_s()));
            write_file(folder, figure, &drawn::draw(runs[runs.len() / 2], &self.ledger))?;
        }
        write_file(folder, table, &self.to_markdown())?;
        let json = serde_json::to_string_pretty(self).expect("a comparison holds only what JSON can");
        write_file(folder, data, &(json + "\n"))?;
        let mut rows = String::from("block_period_s,run,seed");
        STEPS.iter().for_each(|step| rows += &format!(",{}_s", step.as_str().replace(' ', "_")));
        rows += ",gap_s,total_s,bound_s,beyond_s\n";
        for (number, run) in self.runs.iter().enumerate() {
            line(&mut rows, format_args!("{},{number},{}", run.block_period_s, run.seed));
            rows.pop();
            run.steps_s.iter().for_each(|at| rows += &format!(",{at:.6}"));
            let figures = [run.gap_s, run.total_s(), run.bound_s(), run.beyond_s()];
            figures.iter().for_each(|figure| rows += &format!(",{figure:.6}"));
            rows.push('\n');
        }
        write_file(folder, csv, &rows)
    }
}

fn line(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    writeln!(text, "{arguments}").expect("writing into a string cannot fail");
}

/// What the plug-ins of a testbed are to be set to so that they federate with these blocks. `phase`, from 0 to 1, is where in
/// a block period the announcement comes, as far as that can be chosen.
pub fn settings(
    testbed: &Testbed,
    on: &LedgerBackend,
    block_period: Duration,
    phase: f64,
) -> Vec<(String, String)> {
    let period = block_period.as_secs_f64();
    // As an orchestrator does that knows its ledger's period. A network has other things to do, and is late now and then.
    let (collect, late) = match on {
        LedgerBackend::Modelled | LedgerBackend::Anvil => (1.25 * period, 0.0),
        LedgerBackend::Network { .. } => (3.0 * period + 2.0, 2.0 * period + 4.0),
    };
    // Four blocks, the deployment, some time to attach; halting takes time, too.
    let lead = period * (f64::from(1 + BLOCKS_BETWEEN) + phase) + 4.0 + late;
    orchestrators(testbed)
        .flat_map(|spec| {
            let path = format!("plugins.{}.settings", spec.id);
            [
                (format!("{path}.ledger"), on.setting(spec.domain.as_ref(), block_period)),
                (format!("{path}.lead"), format!("{lead:.3} s")),
                (format!("{path}.patience"), format!("{:.0} s", lead + 60.0)),
                (format!("{path}.collect"), format!("{collect:.3} s")),
            ]
        })
        .collect()
}

/// When a run is over for sure: a robot that is served by nobody would wait at the edge for ever.
pub fn longest(testbed: &Testbed) -> Duration {
    let walk = |walk: &Walk| {
        let length: f64 = walk.waypoints.windows(2).map(|leg| leg[0].distance(leg[1])).sum();
        length / walk.speed_limit
    };
    let walks = testbed.walks.iter().map(walk).fold(0.0_f64, f64::max);
    Duration::from_secs_f64((2.0 * walks).min(86_400.0)) + Duration::from_secs(60)
}

/// The domains that are to federate, in the order of their plug-ins.
pub fn domains(testbed: &Testbed) -> Vec<DomainId> {
    orchestrators(testbed).filter_map(|spec| spec.domain.clone()).collect()
}

#[cfg(test)]
mod tests;
