//! The figure in the letter's layout: negotiation and deployment as bars over time, above the robot's attachment.

use cotorra_federation::Step;
use cotorra_figure::{Axis, Bar, Row, Timeline};

use super::federated::Federated;

/// Time shown before the announcement and after the last step, as a share of the time between them.
const AROUND: f64 = 0.25;

/// Draws a run. Time begins at the announcement; `ledger` names the ledger of the negotiation.
pub(super) fn draw(run: &Federated, ledger: &str) -> Timeline {
    let begin = run.at(Step::Announced);
    let total = run.total_s();
    let around = AROUND * total;
    let bar = |from: f64, to: f64, name: &str| Bar { from, to, name: name.to_owned() };
    let between = |from: Step, to: Step, name: &str| bar(run.at(from) - begin, run.at(to) - begin, name);
    let negotiation = vec![
        between(Step::Announced, Step::AnnouncementReceived, "announcement"),
        between(Step::BidSent, Step::BidReceived, "bids"),
        between(Step::WinnerChosen, Step::WinnerReceived, "choice"),
        between(Step::ConfirmationSent, Step::ConfirmationReceived, "confirmation"),
    ];
    let deployment = vec![between(Step::DeploymentStarted, Step::DeploymentFinished, "vAP")];
    let [before, after] = &run.attachments;
    let attachment = vec![
        bar(-around, total, &format!("{before} (own domain)")),
        bar(total, total + around, &format!("{after} (vAP)")),
    ];
    let row = |name: &str, bars| Row { name: name.to_owned(), bars };
    Timeline {
        title: format!("Federation, a block each {} s: attached after {total:.2} s", run.block_period_s),
        note: format!("on {ledger}"),
        x: Axis::around("time since the announcement (s)", -around, total + around),
        rows: vec![
            row("DLT negotiation", negotiation),
            row("vAP deployment", deployment),
            row("attachment", attachment),
        ],
    }
}
