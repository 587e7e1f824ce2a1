//! Measurements of one run: the times of the negotiation's steps, and the service during it.

use std::{collections::BTreeMap, time::Duration};

use cotorra_federation::Step;
use cotorra_graph::{Event, Instruction, NodeId, ServiceId, Stamped, Testbed, Timestamp};
use cotorra_measurements::{History, Kind, RunId};
use cotorra_numbers::quantile;
use serde::Serialize;

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
pub(super) const BLOCKS_BETWEEN: u32 = 3;

/// Error of a run that shows no federation.
#[derive(Debug, thiserror::Error)]
pub enum NoFederation {
    /// The run's history cannot be read.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    /// A step is missing.
    #[error(
        "the robot was not served by another domain: the history has no `{missing}`; it went as far as: {reached}"
    )]
    Incomplete {
        /// The first missing step.
        missing: Step,
        /// The reached steps, with times.
        reached: String,
    },
}

/// The measurements of one run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Federated {
    /// Period between blocks, seconds.
    pub block_period_s: f64,
    pub seed: u64,
    /// Times of [`STEPS`], seconds since the run began.
    pub steps_s: Vec<f64>,
    /// Time without frames while the robot changed to the vAP, seconds.
    pub gap_s: f64,
    /// The radio units before and after the change.
    pub attachments: [NodeId; 2],
    /// Position packets without an answer from the announcement until 5 s after the attachment.
    pub lost: usize,
    /// All position packets in that time.
    pub samples: usize,
    /// The longest service time in that time, ms.
    pub longest_ms: f64,
    /// The lowest speed of the robot in that time, as a share of its median there.
    pub slowest: f64,
    /// Whether the use was charged, and the provider received the event.
    pub is_paid: bool,
}

impl Federated {
    /// Reads a run's measurements from its history.
    ///
    /// # Errors
    /// [`NoFederation`].
    pub fn read(
        history: &History,
        run: RunId,
        testbed: &Testbed,
        block_period: Duration,
        seed: u64,
    ) -> Result<Self, NoFederation> {
        let kinds = [Kind::Decision, Kind::Handover, Kind::Robot, Kind::ServiceTime];
        let mut events = history.all_events(run, &kinds)?;
        let navigates = |id: &ServiceId| testbed.services.iter().any(|its| its.id == *id && its.navigates());
        events.retain(|stamped: &Stamped| match &stamped.event {
            Event::ServiceTime(sample) => navigates(&sample.service),
            _ => true,
        });
        Self::of(&events, block_period, seed)
    }

    pub(super) fn of(events: &[Stamped], block_period: Duration, seed: u64) -> Result<Self, NoFederation> {
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
                // The step `attached` follows right after its handover.
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
            speeds.first().zip(quantile(&speeds, 0.5)).map_or(0.0, |(least, median)| least / median);
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

    pub(super) fn at(&self, step: Step) -> f64 {
        let place = STEPS.iter().position(|other| *other == step).expect("one of the steps");
        self.steps_s[place]
    }

    /// Returns the time from the announcement to the attachment, seconds.
    pub fn total_s(&self) -> f64 {
        self.at(Step::Attached) - self.at(Step::Announced)
    }

    /// Returns the vAP's deployment time, seconds.
    pub fn deployment_s(&self) -> f64 {
        self.at(Step::DeploymentFinished) - self.at(Step::DeploymentStarted)
    }

    /// Returns the longest total time, seconds: a block for the announcement, two for bid and choice, one for the
    /// confirmation, plus deployment and attachment.
    pub fn bound_s(&self) -> f64 {
        f64::from(1 + BLOCKS_BETWEEN) * self.block_period_s + self.deployment_s() + self.gap_s
    }

    /// Returns the part of the total time that waiting for blocks and the attachment do not explain, seconds.
    /// Deployment counts only as far as no block is awaited meanwhile. The announcement came in its first block; the
    /// other blocks follow at their period, and the confirmation comes in the first one after the deployment.
    pub fn beyond_s(&self) -> f64 {
        let first = self.at(Step::AnnouncementReceived) - self.at(Step::Announced);
        let deployments_blocks = (self.deployment_s() / self.block_period_s).floor();
        let blocks = (f64::from(BLOCKS_BETWEEN) + deployments_blocks) * self.block_period_s;
        self.total_s() - first - blocks - self.gap_s
    }
}

/// Returns the first time of each step, seconds.
fn first_steps(events: &[Stamped]) -> BTreeMap<&str, f64> {
    let mut steps = BTreeMap::new();
    // A run that continues another has steps from before its beginning.
    let reached =
        |at: &Timestamp, ago: &Option<Duration>| at.as_secs_f64() - ago.unwrap_or_default().as_secs_f64();
    for Stamped { at, event } in events {
        if let Event::Decision(decision) = event
            && let Instruction::Note { step, ago, .. } = &decision.instruction
        {
            steps.entry(step.as_str()).or_insert(reached(at, ago));
        }
    }
    // A loser may note a step first. Only the winner's steps count.
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
